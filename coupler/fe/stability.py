"""Stable time step of the whole target: its highest frequency by power iteration.

The element bound of `kernels.stable_dt` is safe, but too short: with averaged nodal pressure the volumetric modes of single
elements are soft, and the true limit is 1.5 to 3 times longer. A few power iterations with the linearised operator find it. They
start from the last vector plus a random motion of the elements with the smallest bounds. A mode that becomes the fastest within ten
steps can be missed: therefore a safety factor is applied, and the step is at most three times the element bound.

Often the particle needs a much shorter step than the mesh. Then the limit is not computed in each chunk of steps: it is taken to
decrease as the element bound does.
"""

from dataclasses import dataclass
from typing import Annotated, NamedTuple

import numpy as np

from ..compiling import njit
from ..core import safety
from ..core.arrays import Floats, Ints, Links
from ..core.loops import ranges
from ..core.records import Shape
from ..core.threads import share, together
from ..geometry.matrix_kernels import product, scaled, transposed
from ..geometry.tetrahedra import lumped
from ..geometry.vector_kernels import apart
from ..physics.constitutive import bulk_stiffness
from .blocks import edge_cofactors
from .inertia import ElementInertia
from .kernels import LEAST_ELEMENTS, LEAST_NODES, SHAPE_STIFFNESS, gather_forces, shape_strain, stable_dt
from .mesh import FiniteElements
from .model import Cells, Metals

# A limit this much longer than the needed step is not computed in SELDOM - 1 of SELDOM calls. In 6 scenes, two of them coatings and one
# of 900 m/s, the limit computed in spite of this was never below the needed step times this margin.
MARGIN, SELDOM = 1.25, 4
PERTURBED_ELEMENTS = 12  # number of elements, those with the smallest bounds, whose nodes get a random motion


class Response(NamedTuple):
    """A small motion w (n,3) of the nodes, the squares (n,) of its rows, and the linear response to w: change dv (m,) of volumes,
    change dp (n,) of mean stresses, forces fe (m,4,3) of elements and f (n,3) of nodes, in m3, Pa and N for w in m."""

    w: Floats
    square: Floats
    dv: Floats
    dp: Floats
    fe: Floats
    f: Floats


@njit(cache=True, nogil=True)
def _volume_change(lo: int, hi: int, x: Floats, c: Cells, r: Response) -> None:
    """Write the change of each element's volume to r.dv."""
    w = r.w
    for e in range(lo, hi):
        n0, n1, n2, n3 = c.conn[e, 0], c.conn[e, 1], c.conn[e, 2], c.conn[e, 3]
        c00, c01, c02, c10, c11, c12, c20, c21, c22, _ = edge_cofactors(x[n0], x[n1], x[n2], x[n3])
        total = c00 * (w[n1, 0] - w[n0, 0]) + c01 * (w[n1, 1] - w[n0, 1]) + c02 * (w[n1, 2] - w[n0, 2])
        total += c10 * (w[n2, 0] - w[n0, 0]) + c11 * (w[n2, 1] - w[n0, 1]) + c12 * (w[n2, 2] - w[n0, 2])
        total += c20 * (w[n3, 0] - w[n0, 0]) + c21 * (w[n3, 1] - w[n0, 1]) + c22 * (w[n3, 2] - w[n0, 2])
        r.dv[e] = total / 6.0


@njit(cache=True, nogil=True)
def _nodal_stiffening(lo: int, hi: int, J: Floats, c: Cells, metals: Metals, r: Response) -> None:
    """Write the change of mean stress at each node, K dJ, to r.dp."""
    for a in range(lo, hi):
        total = 0.0
        for q in range(c.start[a], c.start[a + 1]):
            total += r.dv[c.table[q] >> 2]
        r.dp[a] = bulk_stiffness(metals.laws[metals.of_node[a]], J[a]) * 0.25 * total / c.V0_node[a]


@njit(cache=True, nogil=True)
def _forces(lo: int, hi: int, x: Floats, c: Cells, metals: Metals, r: Response) -> None:
    """Write the elastic forces of the motion, element by element, to r.fe."""
    w, dp, fe = r.w, r.dp, r.fe
    for e in range(lo, hi):
        n0, n1, n2, n3 = c.conn[e, 0], c.conn[e, 1], c.conn[e, 2], c.conn[e, 3]
        law = metals.laws[metals.of_element[e]]
        c00, c01, c02, c10, c11, c12, c20, c21, c22, det = edge_cofactors(x[n0], x[n1], x[n2], x[n3])
        C = c00, c01, c02, c10, c11, c12, c20, c21, c22
        edges = (*apart(w, n0, n1), *apart(w, n0, n2), *apart(w, n0, n3))
        g00, g01, g02, g10, g11, g12, g20, g21, g22 = scaled(1.0 / det, product(transposed(edges), C))
        mean = 0.25 * (dp[n0] + dp[n1] + dp[n2] + dp[n3])
        J = det / 6.0 / c.V0[e]
        beyond = shape_strain(J)
        if beyond != 0.0:
            mean += SHAPE_STIFFNESS * law.K * max(1.0 - beyond, 0.0) / (J * J) * r.dv[e] / c.V0[e]
        G, mean = law.G, mean - 2.0 / 3.0 * law.G * (g00 + g11 + g22)
        yz, xz, xy = G * (g12 + g21), G * (g02 + g20), G * (g01 + g10)
        sigma = 2.0 * G * g00 + mean, xy, xz, xy, 2.0 * G * g11 + mean, yz, xz, yz, 2.0 * G * g22 + mean
        h10, h11, h12, h20, h21, h22, h30, h31, h32 = scaled(1.0 / 6.0, product(C, sigma))
        fe[e, 0, 0], fe[e, 0, 1], fe[e, 0, 2] = -h10 - h20 - h30, -h11 - h21 - h31, -h12 - h22 - h32
        fe[e, 1, 0], fe[e, 1, 1], fe[e, 1, 2] = h10, h11, h12
        fe[e, 2, 0], fe[e, 2, 1], fe[e, 2, 2] = h20, h21, h22
        fe[e, 3, 0], fe[e, 3, 1], fe[e, 3, 2] = h30, h31, h32


@njit(cache=True, nogil=True)
def _square(lo: int, hi: int, w: Floats, square: Floats) -> None:
    """Write the squares of the rows of w (n,3) to square (n,)."""
    for a in range(lo, hi):
        square[a] = w[a, 0] * w[a, 0] + w[a, 2] * w[a, 2] + w[a, 1] * w[a, 1]


@njit(cache=True, nogil=True)
def _resist(
    team: Ints, n: int, m: int, scale: float, inverse: Floats, x: Floats, J: Floats, c: Cells, metals: Metals, r: Response
) -> None:  # fmt: skip
    """Multiply the motion r.w by `scale`, or by zero at nodes whose inverse mass (n,) is zero. Then compute r.square and the linear
    response to r.w. Only for the first n nodes and m elements; in all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_NODES):
        for a in range(lo, hi):
            factor = scale if inverse[a] > 0.0 else 0.0
            r.w[a, 0], r.w[a, 1], r.w[a, 2] = r.w[a, 0] * factor, r.w[a, 1] * factor, r.w[a, 2] * factor
        _square(lo, hi, r.w, r.square)
    for lo, hi, _ in ranges(team, 1, m, LEAST_ELEMENTS):
        _volume_change(lo, hi, x, c, r)
    for lo, hi, _ in ranges(team, 2, n, LEAST_NODES):
        _nodal_stiffening(lo, hi, J, c, metals, r)
    for lo, hi, _ in ranges(team, 3, m, LEAST_ELEMENTS):
        _forces(lo, hi, x, c, metals, r)
    for lo, hi, _ in ranges(team, 4, n, LEAST_NODES):
        gather_forces(lo, hi, c, r.fe, r.f)


@njit(cache=True, nogil=True)
def _respond(team: Ints, n: int, inverse: Floats, r: Response) -> None:
    """Replace the motion of the first n nodes by the accelerations that its forces cause; inverse (n,) 1/kg. In all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_NODES):
        for a in range(lo, hi):
            for d in range(3):
                r.w[a, d] = r.f[a, d] * inverse[a]
        _square(lo, hi, r.w, r.square)


@njit(cache=True, nogil=True)
def resist(springs: Links, w: Floats, active: int, f: Floats) -> None:
    """Add the product of the stiffness matrix of springs and a small motion w (n,3) m to f (n,3) N. Rows of w from `active` on are
    zero."""
    for i in range(len(springs.ends)):
        a, weight = springs.ends[i], springs.weights[i]
        if min(a[0], a[1], a[2], a[3]) >= active:
            continue
        for d in range(3):
            pull = 0.0
            for j in range(4):
                pull += weight[j] * w[a[j], d]
            pull *= springs.strength[i]
            for j in range(4):
                f[a[j], d] += weight[j] * pull


def masses_for(t: FiniteElements, dt: float) -> np.ndarray:
    """Masses (n,) kg of the nodes with which the bound of every element is dt (s): the mass of each element is multiplied by
    (dt / its own step)^2."""
    conn = t.mesh.conn
    share(lambda lo, hi: stable_dt(lo, hi, t.nodes.x, t.nodes.J, t.cells, t.metals, t.dt_of), len(conn), LEAST_ELEMENTS)
    mass = t.laws["rho"][t.law_of] * t.mesh.V0 * (dt / t.dt_of) ** 2
    return lumped(conn, mass, len(t.nodes.x))


@dataclass(eq=False)
class FrequencyState:
    """State of the power iteration. w (n,3): its vector; random: state of the random generator after the last iteration; warm: whether
    w has been iterated; known: number of nodes that have been part of an iteration; limit (s): its last result; bound (s): of the
    elements in that call; estimates: calls since then."""

    w: Annotated[np.ndarray, Shape(-1, 3)]
    random: dict[str, object]
    warm: bool = False
    known: int = 0
    limit: float = 0.0
    bound: float = 1.0
    estimates: int = 0


class HighestFrequency(FrequencyState):
    """Power iteration on one target. It keeps its vector between calls."""

    def __init__(self, nodes: int, elements: int):
        self._random = np.random.default_rng(1)
        super().__init__(np.zeros((nodes, 3)), dict(self._random.bit_generator.state))
        dp, f = np.zeros(nodes), np.zeros((nodes, 3))
        self._r = Response(self.w, np.zeros(nodes), np.zeros(elements), dp, np.zeros((elements, 4, 3)), f)
        self._elements = 0  # number of elements in the last call

    def longest_step(
        self, t: FiniteElements, bound: float, n: int, m: int, springs: Links | None = None,
        inertia: ElementInertia | None = None, masses: tuple[np.ndarray, np.ndarray] | None = None, enough: float = np.inf,
    ) -> float:  # fmt: skip
        """Stable time step (s), without damping, of the first n nodes and m elements of a `Target`. bound (s): safe bound of the
        elements, with springs and inertia; enough (s): needed step: a much longer one is only an estimate in most calls.

        springs: springs between nodes; inertia: inertia of scaled elements; masses: masses (n,) kg of the nodes and their inverses, 0
        for fixed nodes, in place of the masses of the target.
        """
        expected = self.limit * min(1.0, bound / self.bound)
        if expected > MARGIN * enough and n <= self.known and self.estimates < SELDOM - 1:
            self.estimates += 1
            return expected
        mesh, inertia = t.mesh, inertia or ElementInertia()
        mass, inverse = masses or (t.mass, t.inv_mass)
        w, f = self._r.w[:n], self._r.f
        for of_element in (self._r.dv, self._r.fe):  # elements that have become inactive are not part of the iteration
            of_element[m : self._elements] = 0.0
        self._elements, self._random.bit_generator.state = m, self.random
        size = float(np.sqrt(np.mean(w * w))) if self.warm else 0.0
        if not self.warm:
            w[:] = self._random.standard_normal((n, 3))
            size = 1.0
        elif n > self.known:  # nodes that have become active since the last call can have the fastest mode
            w[self.known : n] = size * self._random.standard_normal((n - self.known, 3))
        self.known = max(self.known, n)
        worst = np.argpartition(t.dt_of[:m], min(PERTURBED_ELEMENTS, m - 1))[:PERTURBED_ELEMENTS]
        near = np.unique(mesh.conn[worst])
        w[near] += max(size, 1e-300) * np.sqrt(n / len(near)) * 0.3 * self._random.standard_normal((len(near), 3))
        self.random = dict(self._random.bit_generator.state)
        omega2, scale, mass, square = 0.0, 1.0, mass[:n], self._r.square[:n]
        whole = mass.sum()
        for _ in range(4 if self.warm else 25):
            together(_resist, n, m, scale, inverse, t.nodes.x, t.nodes.J, t.cells, t.metals, self._r)
            before = float(mass @ square) + inertia.twice_kinetic(w)
            if springs is not None:
                resist(springs, self._r.w, n, f)
            inertia.slow(f)
            together(_respond, n, inverse, self._r)
            after = float(mass @ square) + inertia.twice_kinetic(w)
            omega2, scale = np.sqrt(after / before), float(1.0 / np.sqrt(after / whole))
        w *= scale
        self.warm, self.bound, self.estimates = True, bound, 0
        self.limit = float(min(max(safety.MESH * 2.0 / np.sqrt(omega2), bound), safety.LONGEST * bound))
        return self.limit
