"""Arrays of a target of n nodes and m elements, as arguments of its kernels. SI units.

Voigt order everywhere: xx yy zz yz xz xy. Nodes and elements are numbered outwards: active ones come first.
"""

from typing import NamedTuple

from ..core.arrays import Floats, Ints, Laws
from .state import ElementState, NodeState


class Cells(NamedTuple):
    """conn (m,4): corners; B (m,3,3) 1/m: reference gradients of their shape functions 1 to 3; V0 (m,), V0_node (n,) m3: reference
    volumes; start (n+1,), table (4m,): table[start[a]:start[a + 1]] is 4 e + c for each element e around node a; a is its corner c (0
    to 3)."""

    conn: Ints
    B: Floats
    V0: Floats
    V0_node: Floats
    start: Ints
    table: Ints


class Metals(NamedTuple):
    """LAW records, and the index of the record of each element (m,) and node (n,)."""

    laws: Laws
    of_element: Ints
    of_node: Ints


class Viscosity(NamedTuple):
    """Bulk viscosity: coefficients b1 of its linear and b2 of its quadratic part; dt_of (m,) s: safe bound of the step of each
    element. The length of an element is the cube root of its volume, but at most THIN times the path of a wave in the time dt_of:
    without this limit, a thin element is not stable at the step of the whole mesh."""

    b1: float
    b2: float
    dt_of: Floats


class Active(NamedTuple):
    """kicked: number of nodes that the forces at n accelerate; nodes, elements: numbers of nodes and elements computed at n+1."""

    kicked: int
    nodes: int
    elements: int


class Nodes(NamedTuple):
    """Arrays (n,3): x (m), v (m/s), internal forces f and those of the last step f_old (N), external forces f_ext (N), sum of all
    forces `total` (N). Arrays (n,): inv_mass (1/kg), volume ratio J, pressure p (Pa), energy (J per reference m3)."""

    x: Floats
    v: Floats
    f: Floats
    f_old: Floats
    f_ext: Floats
    total: Floats
    inv_mass: Floats
    J: Floats
    p: Floats
    energy: Floats

    @classmethod
    def of(cls, n: NodeState, f_ext: Floats, inv_mass: Floats) -> "Nodes":
        """The arrays of a node state, with external forces and inverse masses."""
        return cls(n.x, n.v, n.f, n.f_old, f_ext, n.total, inv_mass, n.J, n.p, n.energy)


class Elements(NamedTuple):
    """Arrays (m,): volume (m3), sigma_y (Pa), eps_p, rate (1/s), T (K), heat (J). s (m,6) Pa: Cauchy stress deviator; fe (m,4,3) N:
    forces on the corners; eps_gradient (m,3) 1/m."""

    volume: Floats
    s: Floats
    sigma_y: Floats
    eps_p: Floats
    rate: Floats
    T: Floats
    heat: Floats
    fe: Floats
    eps_gradient: Floats

    @classmethod
    def of(cls, e: ElementState) -> "Elements":
        """The arrays of an element state."""
        return cls(e.volume, e.s, e.sigma_y, e.eps_p, e.rate, e.T, e.heat, e.fe, e.eps_gradient)
