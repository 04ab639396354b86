"""The state of the target as records: each field is stored, restored, renumbered and joined without further code."""

from dataclasses import dataclass, field
from typing import Annotated

import numpy as np

from ..core.records import Rows, Shape, Sums
from ..physics.metal import MetalState


@dataclass(frozen=True)
class NodeState:
    """State of n nodes. x (m); v (m/s): velocity half a step before x; f, f_old (N): internal forces of this and of the last step;
    total (N): sum of all forces; J: volume ratio; p (Pa); energy (J per reference m3); node_number: index in the full domain, for a
    node of a sub-domain, -1 for new nodes."""

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
    """State of m elements. s (Pa): Cauchy stress deviator, Voigt order xx yy zz yz xz xy; rate (1/s): rate of eps_p; heat (J): part
    of the heat that raises the pressure of the nodes in the next step; volume (m3); sigma_y (Pa); fe (N): forces on the corners;
    element_number: as node_number; thermal_stress (Pa, Voigt): part of the stress caused by changes of temperature at rest."""

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
    """Energy balance of a target since its start, J. plastic: plastic work; numerical: work of the bulk viscosity and of the
    inertia of scaled elements; heat: part of the heat that raises the pressure; internal_work: work against the
    internal forces; absorbed: energy absorbed at boundaries. impulse (3,) N s: external impulse; time s."""

    plastic: float = 0.0
    numerical: float = 0.0
    heat: float = 0.0
    internal_work: float = 0.0
    absorbed: float = 0.0
    time: float = 0.0
    impulse: Annotated[np.ndarray, Shape(3)] = field(default_factory=lambda: np.zeros(3))


@dataclass(eq=False)
class EdgeState:
    """State of an elastic boundary (`fe.window.Edge`). origin (3,) m: source of the waves that it absorbs; rest (k,3) m: rest
    positions of its nodes."""

    origin: Annotated[np.ndarray, Shape(3)]
    rest: Annotated[np.ndarray, Shape(-1, 3)]
