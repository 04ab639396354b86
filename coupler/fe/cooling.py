"""Heat through a pause: Fourier's law over all bodies, implicit in time, while the bodies are at rest.

Linear tetrahedra in the current configuration, their gradients by scikit-fem; capacities are lumped, and links carry heat
between nodes of one body and facets of another. The L-stable diagonally implicit Runge-Kutta scheme of two stages and second order
(Alexander 1977, SIAM J. Numer. Anal. 14, 1006) with steps that grow geometrically, as diffusion slows down;
k(T) and c_p(T) are those at the beginning of each step. Elements keep their own temperatures as `fe.heat` says: what
one lies above the mean of its nodes flows into them, what changes at nodes it gets back as an increment. Heat is conserved
to rounding: what the linear solver leaves of the whole of it is spread over all nodes.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial
from itertools import combinations

import numpy as np
from numpy.lib.recfunctions import repack_fields
from scipy.sparse import coo_matrix, csr_matrix
from scipy.sparse.linalg import LinearOperator, cg
from skfem import Basis, ElementTetP1, MeshTet

from ..errors import SolverError
from ..geometry.products import times
from ..physics.constitutive import conductivities
from .explicit import Target
from .heat import gains, means, shares, take_heat
from .model import Elements

GAMMA = 1.0 - 0.5**0.5  # of Alexander's scheme
STEP_GROWTH = (
    2.0  # of the step: with 1.5 the temperatures after a pause are a fifth closer to the limit, at 1.6 times the steps
)
FIRST_STEP = 0.1  # first step, in the shortest time that heat takes through an element
LINK_RESISTANCE = 0.03  # of a link of perfect contact, in that of an element: 0.01 takes half as many iterations more
CG_TOLERANCE = 3e-4  # of the linear solver: a millikelvin after a pause; 1e-4 takes an eighth more iterations


@dataclass(frozen=True)
class Film:
    """Gas on a surface: nodes (k,), each with an area (k,) m2; coefficient W/(m2 K), T K of the gas."""

    nodes: np.ndarray
    area: np.ndarray
    coefficient: float
    T: float


@dataclass(frozen=True)
class Links:
    """Perfect thermal contact between bodies: nodes (k,), each with a point on a triangle (k,3), weights (k,3), and area (k,) m2."""

    nodes: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray
    area: np.ndarray


def cool(
    target: Target, time: float, fixed: np.ndarray, fixed_T: float, links: Sequence[Links] = (), film: Film | None = None
) -> dict[str, float]:  # fmt: skip
    """Conduct heat for `time` s in a `Target` at rest. Its T, sigma_y and ledger are updated, its pressures in its next step.

    fixed: nodes kept at fixed_T K; every other face is insulated but for the film. Returns steps, hottest and mean temperatures before
    and after (K), and the heat (J) that has left through fixed nodes and to the gas. Raises SolverError when the linear solver does not
    come to an end.
    """
    t = target
    n, m = len(t.nodes.x), len(t.mesh.conn)
    carried, own, gain, capacity, mean = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(n), np.zeros(n)
    heat, V0 = np.zeros(m), t.mesh.V0
    elements = Elements.of(t.elements)._replace(heat=heat)

    def nodal(values: np.ndarray) -> np.ndarray:
        shares(0, m, t.cells, t.metals, t.elements.T, carried)
        means(0, n, t.cells, carried, values, capacity, mean)
        return mean.copy()

    before = _extremes(t)
    T = nodal(t.elements.T)
    from_gas = np.zeros(n)  # W/K
    if film is not None:
        from_gas += np.bincount(film.nodes, film.coefficient * film.area, n)
    T_gas = film.T if film is not None else 0.0
    matrix = _Conduction.of(t, links, from_gas)
    free = np.ones(n)
    free[fixed] = 0.0
    between = free[matrix.indices] * np.repeat(free, np.diff(matrix.indptr))
    conducting = repack_fields(t.laws[["k_0", "k_slope", "k_T0", "k_T1"]])[t.law_of]
    dt, left, steps, taken = 0.0, time, 0, 0.0
    known = np.full(n, np.inf)
    while left > 0.0:
        T_mean = T[t.mesh.conn].mean(axis=1)
        k = conductivities(conducting, T_mean)
        if np.abs(T - known).max() > 1.0:  # K: until then the matrix is good enough
            K, known = matrix.assemble(k), T.copy()
        rate = k * matrix.grad2 / (4.0 * carried / V0)
        dt = min(left, STEP_GROWTH * dt if steps else FIRST_STEP / float(rate.max()))
        dt = left if left < 1.5 * dt else dt
        own[:] = (t.elements.T - T_mean) * -np.expm1(-dt * rate)
        source = capacity * nodal(own)
        # fixed nodes: their rows and columns leave the system, what they give the others goes to the right-hand side
        rise = np.where(free == 0.0, fixed_T - T, 0.0)
        A = matrix.filled(GAMMA * dt * K.data * between)
        A.data[matrix.diagonal] += free * capacity + (1.0 - free)
        inverse = 1.0 / A.data[matrix.diagonal]
        product = LinearOperator(A.shape, partial(times, A), dtype=float)
        jacobi = LinearOperator(A.shape, lambda r, inverse=inverse: inverse * r)
        change = rise.copy()
        stage = np.zeros(n)
        for weight in ((1.0 - GAMMA) / GAMMA, 1.0):
            b = GAMMA * free * (source - dt * (K @ (T + change) - from_gas * T_gas))
            stage, failed = cg(product, b, x0=stage, rtol=CG_TOLERANCE, maxiter=5000, M=jacobi)
            if failed:
                raise SolverError(
                    "the heat conduction in the pause between impacts does not converge: give a shorter dwell or a finer preset"
                )
            # what the solver has left of the whole heat, spread over all nodes
            stage += free * (np.sum(b - product @ stage) / (free @ (product @ free)))
            change += weight * stage
        # each element gets what its nodes gained, and gives what it had above them
        gains(0, m, t.mesh.conn, carried, change, own, gain)
        take_heat(0, m, gain, t.cells, t.metals, elements)
        taken -= float(gain.sum())
        T += change
        nodal(t.elements.T)
        left = left - dt if dt < left else 0.0
        steps += 1
    t.elements.heat[:] += heat
    t.balance.heat += float(heat.sum())
    after = _extremes(t)
    return {
        "time_s": time, "heat_steps": float(steps), "T_max_before_K": before[0], "T_max_after_K": after[0],
        "T_mean_before_K": before[1], "T_mean_after_K": after[1], "taken_away_J": taken,
    }  # fmt: skip


@dataclass(frozen=True)
class _Conduction:
    """The matrix (n,n) W/K of elements, links and film, whose pattern stays as conductivities change.

    Rows of elements and links add up to zero: the matrix is that of conductances between pairs of nodes. low, high (p,): the pairs;
    parts (p,m+1): their conductances for a unit of each element's k, and of the smallest k (links); from_gas (n,) W/K; indices, indptr,
    source (z,): the pattern, and which of the pairs, the pairs turned round and the nodes each entry is; diagonal (n,): where it is
    in the data; grad2 (m,) 1/m2: tr(sum b b^T) of the elements.
    """

    low: np.ndarray
    high: np.ndarray
    parts: csr_matrix
    from_gas: np.ndarray
    indices: np.ndarray
    indptr: np.ndarray
    source: np.ndarray
    diagonal: np.ndarray
    grad2: np.ndarray

    @classmethod
    def of(cls, t: Target, links: Sequence[Links], from_gas: np.ndarray) -> "_Conduction":
        """The matrix of a target where its nodes are now; from_gas (n,) W/K."""
        n, m, conn = len(t.nodes.x), len(t.mesh.conn), t.mesh.conn.astype(np.int64)
        mesh = MeshTet(np.ascontiguousarray(t.nodes.x.T), np.ascontiguousarray(conn.T), sort_t=False)
        basis = Basis(mesh, ElementTetP1(), intorder=1, disable_doflocs=True)
        g = [b[0].grad[:, :, 0] for b in basis.basis]  # (3,m) each
        first, second = np.array(list(combinations(range(4), 2))).T
        first_node, second_node = [conn[:, first].T.ravel()], [conn[:, second].T.ravel()]
        values = [-np.einsum("de,de->e", g[a], g[b]) * basis.dx[:, 0] for a, b in zip(first, second, strict=True)]
        column = [np.tile(np.arange(m), len(first))]
        for link in links:  # conductance k sqrt(area) / LINK_RESISTANCE, 0 where there is no area, times d d^T
            ends = np.concatenate([link.nodes[:, None], link.triangles], axis=1)
            d = np.concatenate([np.ones((len(ends), 1)), -link.weights], axis=1)  # a node less its point on a triangle
            d *= np.sqrt(np.sqrt(link.area) / LINK_RESISTANCE)[:, None]
            first_node.append(ends[:, first].ravel())
            second_node.append(ends[:, second].ravel())
            values.append(-(d[:, first] * d[:, second]).ravel())
            column.append(np.full(first_node[-1].size, m))
        a, b = np.concatenate(first_node), np.concatenate(second_node)
        pairs, row = np.unique(np.minimum(a, b) * n + np.maximum(a, b), return_inverse=True)
        low, high = np.divmod(pairs, n)
        parts = csr_matrix((np.concatenate(values), (row, np.concatenate(column))), shape=(len(pairs), m + 1))
        nodes = np.arange(n)
        rows, columns = np.concatenate([low, high, nodes]), np.concatenate([high, low, nodes])
        pattern = coo_matrix((np.arange(len(rows)), (rows, columns)), shape=(n, n)).tocsr()
        diagonal = np.flatnonzero(pattern.data >= 2 * len(pairs))
        grad2 = np.sum([np.einsum("de,de->e", each, each) for each in g], axis=0)
        return cls(low, high, parts, from_gas, pattern.indices, pattern.indptr, pattern.data, diagonal, grad2)

    def filled(self, data: np.ndarray) -> csr_matrix:
        """A matrix of this pattern."""
        n = len(self.diagonal)
        return csr_matrix((data, self.indices, self.indptr), shape=(n, n))

    def assemble(self, k: np.ndarray) -> csr_matrix:
        """The matrix for conductivities k (m,) W/mK; links of perfect contact have the smallest."""
        n, between = len(self.from_gas), self.parts @ np.append(k, k.min())
        own = np.bincount(self.low, between, n) + np.bincount(self.high, between, n) + self.from_gas
        return self.filled(np.concatenate([-between, -between, own])[self.source])


def _extremes(t: Target) -> tuple[float, float]:
    return float(t.elements.T.max()), float(np.average(t.elements.T, weights=t.mesh.V0))
