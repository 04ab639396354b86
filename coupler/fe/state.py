"""The state of the target as records: a field more here is kept, restored, renumbered and joined."""

from dataclasses import dataclass
from typing import Annotated

import numpy as np

from ..state.records import Rows, Shape
from .heat import ConductionState
from .inertia import InertiaState
from .stability import FrequencyState


@dataclass(frozen=True)
class NodeState:
    """Of n nodes: x m, v m/s at half a step before, f and f_old internal forces of this and the last step N, total N: with all other
    forces; J: volume ratio, p Pa, energy J per reference m3; node_number: in the bodies that these
    were cut from, -1 of new ones."""

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
class ElementState:
    """Of m elements: s Pa, Cauchy deviator in Voigt order xx yy zz yz xz xy; eps_p; rate 1/s, of eps_p; heat J, to go to the nodes in
    the next step; volume m3; T K; sigma_y Pa; fe N, forces on the corners; thermal_stress Pa, Voigt: the part of the stress that
    changes of temperature at rest have made; element_number: as node_number; eps_gradient 1/m: gradient of eps_p in the unrotated
    frame, zero in metals that it does not harden.
    """

    s: Annotated[np.ndarray, Rows(6)]
    eps_p: Annotated[np.ndarray, Rows()]
    rate: Annotated[np.ndarray, Rows()]
    heat: Annotated[np.ndarray, Rows()]
    volume: Annotated[np.ndarray, Rows()]
    T: Annotated[np.ndarray, Rows()]
    sigma_y: Annotated[np.ndarray, Rows()]
    fe: Annotated[np.ndarray, Rows(4, 3)]
    element_number: Annotated[np.ndarray, Rows(dtype=np.int64, fill=-1)]
    thermal_stress: Annotated[np.ndarray, Rows(6)]
    eps_gradient: Annotated[np.ndarray, Rows(3)]


@dataclass(frozen=True)
class EdgeState:
    """Of an elastic edge (`fe.window.Edge`): origin (3,) m and where its nodes are at rest, (k,3) m."""

    origin: Annotated[np.ndarray, Shape(3)]
    rest: Annotated[np.ndarray, Shape(-1, 3)]


@dataclass(frozen=True)
class TargetState:
    """Everything that makes a target go on as if nothing had happened; the mesh is not in it.

    force_suffix_sum (n+1,3) N: [i] is the sum of nodal forces of nodes i and above at the time they became inactive; drag (d,3) N: of
    the dashpots; support (3,) N, impulse (3,) N s: from outside; sums: plastic work, work of the bulk viscosity with what the inertia
    of scaled elements has taken, heat put into the nodes' energy, J; internal_work, absorbed J; time, dt_last s; reach, horizon m;
    least_mass kg; active_nodes, active_elements: how many are computed. edge: of a window, where that is elastic.
    """

    nodes: NodeState
    elements: ElementState
    conduction: ConductionState | None
    highest: FrequencyState | None
    edge: EdgeState | None
    inertia: InertiaState
    internal_work: float
    absorbed: float
    dt_last: float
    time: float
    reach: float
    horizon: float
    least_mass: float
    active_nodes: int
    active_elements: int
    force_suffix_sum: Annotated[np.ndarray, Shape(-1, 3)]
    drag: Annotated[np.ndarray, Shape(-1, 3)]
    support: Annotated[np.ndarray, Shape(3)]
    impulse: Annotated[np.ndarray, Shape(3)]
    sums: Annotated[np.ndarray, Shape(3)]
