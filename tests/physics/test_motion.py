"""What both domains do with forces and velocities, in several threads."""

import numpy as np
import pytest

from coupler.core.loops import PARTS
from coupler.core.threads import threads_of, together
from coupler.physics import motion

N, DT = 3 * motion.LEAST + 7, 0.5


@pytest.mark.usefixtures("eight_cores")
@pytest.mark.parametrize("threads", [1, 3])
def test_the_work_of_a_step_is_that_of_the_mean_forces(threads: int) -> None:
    """sum dt (f_old + f) / 2 . v to rounding of a sum of 18,000 terms; the same to the last bit with any number of threads."""
    f_old, f, v, more = np.random.default_rng(1).standard_normal((4, N, 3))
    taken, handed = more.copy(), f.copy()
    total, (booked, added) = np.zeros((N, 3)), np.zeros((2, PARTS))
    expected = DT * float(np.sum(0.5 * (f_old + f) * v))
    with threads_of(threads):
        together(motion.add_up, N, DT, f_old, f, v, more, total, added)
        together(motion.book_all, DT, f_old, handed, v, taken, booked)
    assert booked.sum() == pytest.approx(expected, rel=1e-10)
    assert np.array_equal(booked, added)
    assert np.count_nonzero(booked) == 3
    assert np.array_equal(total, f + more)
    assert np.array_equal(f_old, f)
    assert np.array_equal(handed, total)
    assert not taken.any()
