"""What a checkpoint of a run holds."""

from dataclasses import dataclass

from ..files.store import StoreState
from ..files.summary import Values
from ..impact.summary import ImpactRecord
from ..target.bodies import BodiesState
from .task import TaskState


@dataclass(frozen=True)
class DepositionState:
    """State of a run before a batch of impacts: the bodies, how much of the files is written, records and reports of the finished
    impacts; wall time so far, s; within: of an impact on the whole target that has begun since."""

    bodies: BodiesState
    store: StoreState
    records: list[ImpactRecord]
    joins: list[Values]
    wall: float
    within: TaskState | None
