"""The materials of a run and their colours in pictures."""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import chain
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.patches import Patch
from numpy.typing import NDArray

from ..files.fields import Fields
from ..files.summary import Values

PHASE = "phase"  # in place of a field: the materials in their colours
#: Colours of materials at full brightness, red green blue; the first is that of a coating of one material.
PHASES = np.array([[1.0, 1.0, 1.0], [1.05, 0.8, 0.55], [0.7, 1.05, 0.75], [1.08, 0.75, 0.85], [0.65, 0.85, 1.08]])
BRIGHT = 0.82  # mean brightness of materials in pictures


@dataclass(frozen=True)
class Phases:
    """The materials of a run. names: those of particles in the order of the impacts, then those that only the substrate has. The other
    fields are indices into names. particles (n, 2): material of shell and core of each particle; ground (k,): of each body of the
    substrate."""

    names: list[str]
    particles: NDArray[np.int64]
    ground: NDArray[np.int64]

    def of(self, bodies: Fields) -> NDArray[np.int64]:
        """Index (m,) of the material of each tetrahedron of target or splats."""
        none = np.zeros(len(bodies.cells))
        body, impact, core = (bodies.data.get(name, none).astype(np.int64) for name in ("body", "impact", "core"))
        ground = self.ground[np.minimum(body, len(self.ground) - 1)]
        return np.where(impact > 0, self.particles[impact - 1, core], ground)


def phases_of(plan: Values) -> Phases | None:
    """The materials of a run, from its plan; None if all its particles are of one material, or the plan cannot be read."""
    try:
        particles = [[each["material"]["name"], (each["core"] or each)["material"]["name"]] for each in plan["impacts"]]
        substrate = [plan["target"]["material"], *(metal for metal, _ in reversed(plan["target"]["layers"]))]
        ground = [metal["name"] for metal in substrate]
    except (KeyError, TypeError, ValueError):
        return None
    names = list(dict.fromkeys([*chain(*particles), *ground]))
    if len(set(chain(*particles))) == 1:
        return None
    return Phases(names, np.vectorize(names.index)(particles), np.vectorize(names.index)(ground))


def colour_of(phase: int, bright: float = BRIGHT) -> tuple[float, float, float]:
    """Colour of a material by its index: red, green, blue, 0 to 1. bright: factor on the values of PHASES."""
    red, green, blue = np.minimum(bright * PHASES[phase % len(PHASES)], 1.0).tolist()
    return red, green, blue


def name_phases(axis: Axes, names: Sequence[str], **options: Any) -> None:
    """Draw the legend of materials, in the order of their colours. options: of `Axes.legend`."""
    patches = [Patch(facecolor=colour_of(k)) for k in range(len(names))]
    axis.legend(patches, names, fontsize=8, **options).set_zorder(8)
