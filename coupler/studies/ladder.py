"""The accuracy ladder: the settings of resolution and scheme at which one scene is computed, and the table of the results."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from ..errors import StoreError
from ..measures import CONVERGING
from ..plan.reading import Scene
from ..plan.refinement import at_points
from .table import StudyTable

POINTS = (500, 1000, 2000, 3500, 5000)
REFERENCE = 16000
KNOBS_AT = 1000
FEWEST_POINTS = 200
MEASURES = (*CONVERGING, "eps_p_max", "T_max_K")
COLUMNS = (
    "axis", "setting", "points", "points_used", "elements", "steps", "dt_mean_s", "sim_time_s", "cpu_s", "cpu_loop_s", "wall_s",
    *MEASURES, "numerical_dissipation", "energy_drift", "failed",
)  # fmt: skip
KNOB_AXES = ("element size", "dt", "viscosity", "hourglass", "contact stiffness")
STEP = {"courant": 0.4, "stretch": 0.9, "frequency": 0.85}  # the defaults of `coupler.sph.particle.Numerics`
# Parameters of the scheme, for each of KNOB_AXES: name in the table -> changed values.
_TRIED: tuple[dict[str, dict[str, float]], ...] = (
    {"1.2 spacings": {"element": 1.2}, "2.5 spacings": {"element": 2.5}},
    {f"{f:g} dt": {name: f * value for name, value in STEP.items()} for f in (0.5, 1.25, 2.0)},
    {"Q1 0": {"Q1": 0.0}, "Q1 0.2": {"Q1": 0.2}},
    {"hourglass 0.3": {"hourglass": 0.3}, "hourglass 3": {"hourglass": 3.0}},
    {"k 0.3": {"contact_stiffness": 0.3}, "k 3": {"contact_stiffness": 3.0}},
)
KNOBS = dict(zip(KNOB_AXES, _TRIED, strict=True))
EFFECTS = ("all", "none")
KEY = ("axis", "setting", "points")  # columns that identify a row


@dataclass(frozen=True)
class LadderPoint:
    """One setting. points: of the largest particle; element: smallest edge of the target's elements over the spacing;
    effects: in place of the scene's; numerics: as `coupler.run` takes them."""

    axis: str
    name: str
    points: int
    element: float | None = None
    effects: str | None = None
    numerics: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str, str]:
        """The values of KEY in its row."""
        return self.axis, self.name, str(self.points)


def ladder_points(
    points: Sequence[int] = POINTS, reference: int = REFERENCE, knobs_at: int | None = KNOBS_AT
) -> list[LadderPoint]:
    """The settings, the cheap ones first. knobs_at: points at which scheme parameters and effects are varied; None: they are not.

    Raises StoreError for a reference that is not finer than the settings compared with it.
    """
    if reference <= max([*points, knobs_at or 0]):
        raise StoreError(
            f"--reference {reference} must be finer than the settings compared with it: more than {max([*points, knobs_at or 0])}"
        )
    ladder = [LadderPoint("points", f"{n} points", n) for n in sorted(set(points))]
    for axis, tried in KNOBS.items() if knobs_at else ():
        for name, change in tried.items():
            numerics = {k: v for k, v in change.items() if k != "element"}
            ladder.append(LadderPoint(axis, name, knobs_at or 0, change.get("element"), None, numerics))
    ladder += [LadderPoint("effects", f"effects {which}", knobs_at, None, which) for which in EFFECTS if knobs_at]
    return [*ladder, LadderPoint("reference", f"{reference} points", reference)]


def scene_at(scene: Scene, point: LadderPoint) -> Scene:
    """The scene with the resolution and effects of a ladder point in place of its own."""
    changes = {} if point.effects is None else {"effects": point.effects}
    return at_points(scene, point.points, changes, point.element)


def ladder_table(path: Path, about: str) -> StudyTable:
    """The table of a ladder. Raises StoreError for a file that is none."""
    return StudyTable(path, COLUMNS, KEY, about)


def finished(rows: Sequence[Mapping[str, str]]) -> Iterator[Mapping[str, str]]:
    """The rows that have measures."""
    return (row for row in rows if not row["failed"])
