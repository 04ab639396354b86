"""The state of the target as records: a further field here is stored, restored, renumbered and joined."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ..core.records import Rows, Shape, Sums
from ..physics.metal import MetalState


@dataclass(frozen=True)
class NodeState:
    """State of n nodes: x m, v m/s half a step before, f and f_old internal forces of this and the last step N, total N: with all other
    forces; J: volume ratio, p Pa, energy J per reference m3; node_number: in the full
    domain of a sub-domain, -1 of new nodes."""

    x: Annotated[np.ndarray, Rows(3)]
    v: Annotated[np.ndarray, Rows(3)]
    f: Annotated[np.ndarray, Rows(3)]
    f_old: Annotated[np.ndarray, Rows(3)]
    total: Annotated[np.ndarray, Rows(3)]
    J: Annotated[np.ndarray, Rows(fill=1.0)]
    p: Annotated[np.ndarray, Rows()]
    energy: Annotated[np.ndarray, Rows()]
    node_number: Annotated[np.ndarray, Rows(dtype=np.int64, fill=-1)]


@dataclass(frozen=True)
class ElementState(MetalState):
    """State of m elements: s Pa, Cauchy deviator in Voigt order xx yy zz yz xz xy; rate 1/s, of eps_p; heat J, for the nodes in the
    next step; volume m3; sigma_y Pa; fe N, forces on the corners; thermal_stress Pa, Voigt: the part of the stress that changes of
    temperature at rest have made; element_number: as node_number."""

    s: Annotated[np.ndarray, Rows(6)]
    rate: Annotated[np.ndarray, Rows()]
    heat: Annotated[np.ndarray, Rows()]
    volume: Annotated[np.ndarray, Rows()]
    sigma_y: Annotated[np.ndarray, Rows()]
    fe: Annotated[np.ndarray, Rows(4, 3)]
    element_number: Annotated[np.ndarray, Rows(dtype=np.int64, fill=-1)]
    thermal_stress: Annotated[np.ndarray, Rows(6)]


@dataclass
class Balance(Sums):
    """Energy balance of a target, J, from its start: plastic work; numerical dissipation, the work of the bulk viscosity with what the
    inertia of scaled elements has taken; heat put into the nodes' energy; internal work; energy absorbed at boundaries. impulse (3,)
    N s: from outside; time s."""

    plastic: float = 0.0
    numerical: float = 0.0
    heat: float = 0.0
    internal_work: float = 0.0
    absorbed: float = 0.0
    time: float = 0.0
    impulse: Annotated[np.ndarray, Shape(3)] = field(default_factory=lambda: np.zeros(3))


@dataclass(eq=False)
class EdgeState:
    """State of an elastic boundary (`fe.window.Edge`): origin (3,) m; rest (k,3) m: rest positions of its nodes."""

    origin: Annotated[np.ndarray, Shape(3)]
    rest: Annotated[np.ndarray, Shape(-1, 3)]
