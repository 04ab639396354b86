"""Sparse systems whose rows the threads share."""

import numpy as np
import pytest
from scipy.sparse import csr_array

from coupler.core.threads import threads_of
from coupler.geometry.products import LEAST, solve


@pytest.mark.usefixtures("eight_cores")
def test_conjugate_gradients_solve_a_ring_with_the_same_digits_in_all_threads() -> None:
    """A ring of springs on a floor, 2 + c on the diagonal and -1 beside it: what one load moves falls off on both sides as
    exp(-|i| arccosh(1 + c/2)). Each iteration reaches one node more, so that five are too few."""
    n, c = 4 * LEAST + 1, 0.5
    i = np.arange(n)
    columns = np.stack([i, (i - 1) % n, (i + 1) % n], axis=1)
    A = csr_array((np.tile([2.0 + c, -1.0, -1.0], n), columns.ravel(), np.arange(0, 3 * n + 1, 3)), shape=(n, n))
    b = np.where(i == n // 2, 1.0, 0.0)
    exact = np.exp(-np.abs(i - n // 2) * np.arccosh(1.0 + 0.5 * c)) / (2.0 * np.sinh(np.arccosh(1.0 + 0.5 * c)))
    found = []
    for threads in (1, 2, 5):
        x = np.zeros(n)
        with threads_of(threads):
            assert solve(A, b, x, 1e-10, most=100)
            assert not solve(A, b, np.zeros(n), 1e-10, most=5)
        found.append(x)
    np.testing.assert_allclose(found[0], exact, atol=1e-9)
    assert all(np.array_equal(x, found[0]) for x in found)
