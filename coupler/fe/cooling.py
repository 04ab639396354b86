"""Heat through a pause: Fourier's law over all bodies, implicit in time, while the bodies are at rest.

scikit-fem assembles the conduction of linear tetrahedra in the current configuration; capacities are lumped, and links carry
heat between nodes of one body and facets of another. Backward Euler with steps that grow geometrically, as diffusion slows
down; k(T) and c_p(T) are those at the beginning of each step. Elements keep their own temperatures as `fe.heat` says: what
one lies above the mean of its nodes flows into them, what changes at nodes it gets back as an increment. Heat is conserved
to the tolerance of the linear solver.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_matrix, diags
from scipy.sparse.linalg import cg
from skfem import Basis, BilinearForm, ElementTetP1, MeshTet
from skfem.helpers import dot, grad

from ..errors import SolverError
from ..physics.constitutive import conductivities
from .explicit import Target
from .heat import gains, means, shares, take_heat

STEP_GROWTH = 1.1  # of the step
FIRST_STEP = 0.1  # first step, in the shortest time that heat takes through an element
LINK_RESISTANCE = 0.01  # of a link of perfect contact, in that of an element
CG_TOLERANCE = 1e-11  # of the linear solver


@dataclass(frozen=True)
class Film:
    """Gas on a surface: nodes (k,), each with an area (k,) m2; coefficient W/(m2 K), T K of the gas."""

    nodes: np.ndarray
    area: np.ndarray
    coefficient: float
    T: float


@dataclass(frozen=True)
class Links:
    """Perfect thermal contact between bodies: nodes (k,), each with a place on a triangle (k,3), weights (k,3), and area (k,) m2."""

    nodes: np.ndarray
    triangles: np.ndarray
    weights: np.ndarray
    area: np.ndarray


def cool(
    target: Target, time: float, held: np.ndarray, held_T: float, links: Sequence[Links] = (), film: Film | None = None
) -> dict[str, float]:
    """Conduct heat for `time` s in a `Target` at rest. Its T, sigma_y and ledger are updated, its pressures in its next step.

    held: nodes kept at held_T K; every other face is insulated but for the film.
    Returns steps, hottest and mean temperatures before and after
    (K), and the heat (J) that held nodes have taken away. Raises SolverError when the linear solver does not come to an end.
    """
    t = target
    n, m = len(t.x), len(t.mesh.conn)
    share, own, gain, capacity, mean = np.zeros(m), np.zeros(m), np.zeros(m), np.zeros(n), np.zeros(n)
    heat, laws, law_of, V0 = np.zeros(m), t.laws, t.law_of, t.mesh.V0

    def nodal(values: np.ndarray) -> np.ndarray:
        shares(0, m, V0, laws, law_of, t.T, share)
        means(0, n, t.start, t.table, share, values, capacity, mean)
        return mean.copy()

    before = _extremes(t)
    T = nodal(t.T)
    grad2, assemble = _conduction(t)
    free = np.ones(n)
    free[held] = 0.0
    dt, left, steps, taken = 0.0, time, 0, 0.0
    known = np.full(n, np.inf)
    from_gas = np.zeros(n)  # W/K
    if film is not None:
        from_gas += np.bincount(film.nodes, film.coefficient * film.area, n)
    T_gas = film.T if film is not None else 0.0
    while left > 0.0:
        T_mean = T[t.mesh.conn].mean(axis=1)
        k = conductivities(laws[law_of], T_mean)
        if np.abs(T - known).max() > 1.0:  # K: until then the matrix is good enough
            K, known = assemble(k) + sum((_across(each, n, k) for each in links), diags(from_gas)), T.copy()
        rate = k * grad2 / (4.0 * share / V0)
        dt = min(left, STEP_GROWTH * dt if steps else FIRST_STEP / float(rate.max()))
        dt = left if left < 1.5 * dt else dt
        own[:] = (t.T - T_mean) * -np.expm1(-dt * rate)
        source = capacity * nodal(own)
        # held nodes: their rows and columns leave the system, what they give the others goes to the right-hand side
        fixed = np.where(free == 0.0, held_T - T, 0.0)
        A = diags(free) @ (diags(capacity) + dt * K) @ diags(free) + diags(1.0 - free)
        b = free * (source - dt * (K @ (T + fixed) - from_gas * T_gas)) + fixed
        change, failed = cg(A, b, x0=fixed, rtol=CG_TOLERANCE, maxiter=5000, M=diags(1.0 / A.diagonal()))
        if failed:
            raise SolverError(
                "the heat conduction of the pause does not converge: give a shorter dwell or a finer preset"
            )
        # each element gets what its nodes gained, and gives what it had above them
        gains(0, m, t.mesh.conn, share, change, own, gain)
        take_heat(0, m, gain, V0, laws, law_of, t.T, heat, t.sigma_y, t.eps_p)
        taken -= float(gain.sum())
        T += change
        nodal(t.T)
        left = left - dt if dt < left else 0.0
        steps += 1
    t.heat += heat
    t.sums[2] += float(heat.sum())
    after = _extremes(t)
    return {
        "time_s": time, "heat_steps": float(steps), "T_max_before_K": before[0], "T_max_after_K": after[0],
        "T_mean_before_K": before[1], "T_mean_after_K": after[1], "taken_away_J": taken,
    }  # fmt: skip


def _conduction(t: Target) -> tuple[np.ndarray, Callable[[np.ndarray], csr_matrix]]:
    """tr(sum b b^T) (m,) of the elements, 1/m2, and a function that assembles the matrix (n,n) W/K for k (m,) W/mK."""
    mesh = MeshTet(np.ascontiguousarray(t.x.T), np.ascontiguousarray(t.mesh.conn.T, np.int64), sort_t=False)
    basis = Basis(mesh, ElementTetP1(), intorder=1)
    form = BilinearForm(lambda u, v, w: w.k * dot(grad(u), grad(v)))
    squares = [np.broadcast_to(b[0].grad, (3, len(t.mesh.conn), 1))[:, :, 0] for b in basis.basis]
    return sum(np.einsum("ae,ae->e", g, g) for g in squares), lambda k: form.assemble(basis, k=k[:, None]).tocsr()


def _across(links: Links, n: int, k: np.ndarray) -> csr_matrix:
    """What links add to the matrix: H d^T d each (W/K), d the difference of a node and its place on a triangle."""
    count = len(links.nodes)
    conductance = float(k.min()) * np.sqrt(links.area) / LINK_RESISTANCE  # zero where there is no area
    rows = np.repeat(np.arange(count), 4)
    columns = np.concatenate([links.nodes[:, None], links.triangles], axis=1).ravel()
    d = csr_matrix(
        (np.concatenate([np.ones((count, 1)), -links.weights], axis=1).ravel(), (rows, columns)), shape=(count, n)
    )
    return (d.T @ diags(conductance) @ d).tocsr()


def _extremes(t: Target) -> tuple[float, float]:
    return float(t.T.max()), float(np.average(t.T, weights=t.mesh.V0))
