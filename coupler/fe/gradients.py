"""Gradient of the plastic strain of elements, which hardens a metal (`constitutive.with_gradient`)."""

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from ..compiling import njit
from ..core.arrays import Floats
from ..geometry.matrix_kernels import applied, inverse, polar, product, transposed
from ..geometry.vector_kernels import add
from .explicit import Target
from .model import Cells


@contextmanager
def growing(target: Target) -> Iterator[None]:
    """Context manager for a chunk of steps. At its end the gradient of the chunk's plastic strain is added to `eps_gradient`, in
    metals that gradients harden."""
    if not target.laws["gradient_length"].any():
        yield
        return
    before = target.elements.eps_p.copy()
    yield
    hardens = target.laws["gradient_length"][target.law_of] > 0.0
    grown = np.where(hardens, target.elements.eps_p - before, 0.0)
    at_node, share = np.empty((2, len(target.nodes.x)))
    _grow(target.active_elements, grown, target.nodes.x, target.cells, at_node, share, target.elements.eps_gradient)


@njit(cache=True, nogil=True)
def _grow(m: int, grown: Floats, x: Floats, c: Cells, at_node: Floats, share: Floats, eps_gradient: Floats) -> None:
    """Add the gradient of the plastic strain of a chunk of steps to eps_gradient (m,3) 1/m of the first m elements.

    grown (m,): plastic strain of the chunk. It is averaged at the nodes, weighted with the volumes around them; at_node, share (n,):
    work arrays. The stored gradient is R^T F^-T = U^-1 times that in the reference configuration: it is taken in the current
    configuration and rotated back, as Huang et al. (2004) integrate it.
    """
    conn, V0 = c.conn, c.V0
    for e in range(m):
        for a in conn[e]:
            at_node[a] = share[a] = 0.0
    for e in range(m):
        for a in conn[e]:
            at_node[a] += V0[e] * grown[e]
            share[a] += V0[e]
    for e in range(m):
        if not grown[e] > 0.0:
            continue
        n0, n1, n2, n3 = conn[e, 0], conn[e, 1], conn[e, 2], conn[e, 3]
        first, b = at_node[n0] / share[n0], c.B[e]
        d1, d2, d3 = at_node[n1] / share[n1] - first, at_node[n2] / share[n2] - first, at_node[n3] / share[n3] - first
        edges = (
            x[n1, 0] - x[n0, 0], x[n2, 0] - x[n0, 0], x[n3, 0] - x[n0, 0], x[n1, 1] - x[n0, 1], x[n2, 1] - x[n0, 1],
            x[n3, 1] - x[n0, 1], x[n1, 2] - x[n0, 2], x[n2, 2] - x[n0, 2], x[n3, 2] - x[n0, 2],
        )  # fmt: skip
        B = b[0, 0], b[0, 1], b[0, 2], b[1, 0], b[1, 1], b[1, 2], b[2, 0], b[2, 1], b[2, 2]
        F = product(edges, B)
        g0, g1, g2 = applied(transposed(B), d1, d2, d3)
        back, _ = inverse(product(transposed(polar(F)), F))
        g0, g1, g2 = applied(back, g0, g1, g2)
        add(eps_gradient, e, g0, g1, g2)
