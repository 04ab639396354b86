"""State of the metal that is carried to the next impact: from the points of a particle to the elements of its splat."""

from dataclasses import dataclass
from typing import Annotated, Any

import numpy as np

from ..core.records import Rows, rows_of

UNKNOWN: Any = None  # value of a field that a cloud of points does not have


@dataclass(frozen=True, kw_only=True)
class MetalState:
    """State of n points or elements. eps_p: equivalent plastic strain that hardens the metal; eps_recovered: plastic strain removed
    by recovery (`physics.recovery`); T (K): temperature; eps_gradient (1/m): gradient of eps_p (during an impact: in the unrotated
    frame), zero in metals that gradients do not harden. If a field is added to this class, no other code must change: the program
    stores and restores the field, and passes it to the mesh of a splat and to the next impact."""

    eps_p: Annotated[np.ndarray, Rows(least=0.0)] = UNKNOWN
    T: Annotated[np.ndarray, Rows()] = UNKNOWN
    eps_gradient: Annotated[np.ndarray, Rows(3)] = UNKNOWN
    eps_recovered: Annotated[np.ndarray, Rows()] = UNKNOWN

    @property
    def plastic_strain(self) -> np.ndarray:
        """Total equivalent plastic strain (n,), recovered strain included, as in results."""
        return self.eps_p + self.eps_recovered


def carried(record: MetalState) -> dict[str, np.ndarray]:
    """The fields of `MetalState` in a record, by name, for the next impact; fields with the value UNKNOWN are left out."""
    return {name: vars(record)[name] for name in rows_of(MetalState) if vars(record)[name] is not None}
