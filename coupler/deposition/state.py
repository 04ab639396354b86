"""What a checkpoint of a run of several impacts holds."""

from dataclasses import dataclass

from ..files.store import StoreState
from ..files.summary import Values
from ..impact.bodies import BodiesState
from ..impact.run import ImpactStart, RunningState
from ..impact.summary import ImpactRecord


@dataclass(frozen=True)
class DepositionState:
    """What a checkpoint holds: an impact on its way or, between two of them, the bodies; how much of the files is written; records and
    reports of the finished impacts; wall time so far, s; start: of an impact on its way."""

    running: RunningState | None
    bodies: BodiesState | None
    store: StoreState
    records: list[ImpactRecord]
    joins: list[Values]
    wall: float
    start: ImpactStart | None
