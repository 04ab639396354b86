"""The error budget: effects that are left out, and the discretisation, together stay within the accuracy asked for.

What leaving an effect out changes is measured for a set of cases (docs/evidence/effects.md); the nearest are scaled by its number.
"""

import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache

from ..measures import BANDED
from ..measures import measure as record
from .bands import SHAPE, Band, table
from .cost import flow_stress
from .effects import GRADIENTS, NUMBERS, Effects, Situation, numbers

ACCURACY = {"draft": 0.05, "standard": 0.02, "fine": 0.01}  # asked for by each preset
SHAPES = ("flattening_ratio", "flattening_ratio_total", *SHAPE[1:])
REST = "way_to_rest"  # from the greatest deformation on: left out, an impact ends there
LEFT_TO_EFFECTS = 0.25  # of the discretisation's share, where that alone takes up the accuracy asked for
CASES = 3  # measured ones that an estimate rests on
LEAST_SAVING = 0.01  # of a step's time: what saves less stays in
# Below these numbers an effect does not act: no wave is back yet; the pause is too short for heat to leave the splat; heat that does
# not leave its element changes the rise of the temperature by less than 2 % (docs/evidence/effects.md).
CANNOT_ACT_BELOW = {"absorbing_boundaries": 1.0, "cooling": 0.05, "conduction": 0.05}
NOT_LEFT_OUT = ("adhesion", "friction", "cooling", "conduction", GRADIENTS)  # a scene has it or not
# Where plastic work may heat a metal by more than this share of the way to melting, an impact is followed to rest: at the greatest
# deformation of the fast case of the study (1.1) the pressure holds 8 % of the points deeper than a spacing in the target.
HOT = 0.3


@dataclass(frozen=True)
class Row:
    """One effect, or the way to rest: the number that tells its size and its value; whether it takes part, and the reason.

    changes: what leaving it out is expected to change, by measure, over the measure's value (of temperatures: over their rise);
    saves: of the processor time of a step, or of the run's.
    """

    name: str
    number: str
    value: float
    changes: dict[str, float]
    saves: float
    on: bool
    why: str


@dataclass(frozen=True)
class Share:
    """Of one measure asked for, over its value: discretisation, its band; omitted, the sum of what is left out; allowed, for both."""

    measure: str
    discretisation: float
    omitted: float
    allowed: float


@dataclass(frozen=True)
class Budget:
    """accuracy: asked for, over the value; shares: of the measures asked for; rows: of all effects and of the way to rest."""

    accuracy: float
    shares: tuple[Share, ...]
    rows: tuple[Row, ...]

    @property
    def saved(self) -> float:
        """Share of the processor time that is saved by what is left out and would be measurable; gradients of plastic strain are a
        choice of the model."""
        chosen = [row for row in self.rows if row.name != GRADIENTS and row.value > 0.0]
        left = math.prod(1.0 - row.saves for row in chosen if not row.on)
        return 1.0 - left

    def on(self, name: str) -> bool:
        """Whether an effect, or the way to rest, takes part."""
        return next(row.on for row in self.rows if row.name == name)

    @property
    def effects(self) -> Effects:
        """The effects that take part."""
        return Effects(**{row.name: row.on for row in self.rows if row.name != REST})

    def added(self, bands: Sequence[Band]) -> tuple[Band, ...]:
        """Bands of the discretisation, each with the share of what is left out."""
        omitted = {share.measure: share.omitted for share in self.shares}
        return tuple(Band(b.measure, b.share + omitted.get(b.measure, 0.0), b.why) for b in bands)


def decide(
    situations: Sequence[Situation],
    requested: Mapping[str, bool],
    accuracy: float,
    wanted: Sequence[str],
    bands: Sequence[Band],
) -> Budget:
    """Leave out what saves most for what it changes, as long as each measure stays within its allowance.

    situations: one for each impact, of each number the largest counts; requested: what the scene decides itself (effects, REST);
    accuracy: over the value; wanted: the measures asked for; bands: of the discretisation. A measure may be off by `accuracy`, or,
    where the discretisation takes that up, by LEFT_TO_EFFECTS more than its band.
    """
    each = [numbers(situation) | {REST: rest_number(situation)} for situation in situations]
    values = {name: max(one[name] for one in each) for name in each[0]}
    wide = {band.measure: band.share for band in bands}
    measures = [name for name in wanted if name in wide]
    allowed = {name: max(accuracy, (1.0 + LEFT_TO_EFFECTS) * wide[name]) for name in measures}
    spent = {name: wide[name] for name in measures}
    known = {name: expected(name, values) for name in values}
    on = {name: can_act(name, value) for name, value in values.items()}
    on[GRADIENTS] &= any(situation.exposed for situation in situations)
    on |= requested

    def price(name: str) -> float:
        changes, saves = known[name]
        return max((changes[m] / (allowed[m] - wide[m]) for m in measures), default=0.0) / max(saves, 1e-9)

    kept = {*requested, *NOT_LEFT_OUT, *([REST] if values["thermal_softening"] > HOT else [])}
    open_to_choice = [n for n in values if on[n] and n not in kept and known[n][1] >= LEAST_SAVING]
    for name in sorted(open_to_choice, key=price):
        changes = known[name][0]
        if all(spent[m] + changes[m] <= allowed[m] for m in measures):
            on[name] = False
            spent = {m: spent[m] + changes[m] for m in measures}
    rows = [
        Row(name, {REST: "flow stress / (rho v^2)", **NUMBERS}[name], value, *known[name], on[name],
            reason(name, value, on[name], requested, known[name][0], measures))
        for name, value in values.items()
    ]  # fmt: skip
    shares = [Share(m, wide[m], spent[m] - wide[m], allowed[m]) for m in measures]
    return Budget(accuracy, tuple(shares), tuple(rows))


def reason(
    name: str,
    value: float,
    on: bool,
    requested: Mapping[str, bool],
    changes: Mapping[str, float],
    measures: Sequence[str],
) -> str:
    """Why an effect takes part or not, in words."""
    if name in requested:
        return "as the scene says, or what is asked for needs it" if name == REST else "as the scene says"
    if not can_act(name, value):
        return "it cannot act here"
    if name == GRADIENTS and not on:
        change = changes["flattening_ratio"]
        told = f"; flattening {100.0 * change:.2g} % off" if math.isfinite(change) else ""
        return f"bonds by exposure only{told}"
    if name in NOT_LEFT_OUT:
        return "the scene has it"
    worst = max(measures, key=lambda m: changes[m], default="")
    if not worst or not math.isfinite(changes[worst]):
        return "nothing asked for needs it" if not on else "what it changes is not known"
    return f"without it {record(worst).short} {100.0 * changes[worst]:.2g} % off"


def can_act(name: str, value: float) -> bool:
    """Whether an effect can change anything where its number has this value."""
    return value > CANNOT_ACT_BELOW.get(name, 0.0)


def rest_number(situation: Situation) -> float:
    """Flow stress over the dynamic pressure, of the particle: the elastic return after the greatest deformation grows with it."""
    metal, T = situation.materials[0], situation.temperatures[0]
    return flow_stress(metal, T, situation.velocity / situation.diameter) / (metal.rho * situation.velocity**2)


def expected(name: str, values: Mapping[str, float]) -> tuple[dict[str, float], float]:
    """What leaving an effect out is expected to change, by measure, over its value (infinite where nothing was measured), and the share
    of the processor time that this saves.

    values: the number of each effect. The CASES nearest in it, and by a tenth in the number that differs most, are scaled to
    its value: in proportion where theirs is larger, with the square where it is smaller. The largest counts; time is that of the
    nearest.
    """
    value = values[name]
    if not can_act(name, value):
        return dict.fromkeys(BANDED, 0.0), 0.0
    scenes = _scenes()
    cases = [row for row in _measured() if row["effect"] == name and float(row["number"]) > 0.0]

    def far(row: Mapping[str, str]) -> float:
        others = scenes[row["scene"]]
        return _apart(float(row["number"]), value) + 0.1 * max(_apart(others[n], values[n]) for n in others)

    near = sorted(cases, key=far)[:CASES]
    if not near:
        return dict.fromkeys(BANDED, math.inf), 0.0

    def change(measure: str) -> float:
        ratios = [value / float(row["number"]) for row in near]
        scaled = [abs(float(row[measure] or "nan")) * max(x, x * x) for row, x in zip(near, ratios, strict=True)]
        return 0.01 * max((x for x in scaled if math.isfinite(x)), default=math.inf)

    return {measure: change(measure) for measure in BANDED}, max(float(near[0]["cost_share"] or 0.0), 0.0)


def _apart(a: float, b: float) -> float:
    return abs(math.log(max(a, 1e-12) / max(b, 1e-12)))


@cache
def _scenes() -> dict[str, dict[str, float]]:
    """The numbers of each measured scene."""
    numbers_of: dict[str, dict[str, float]] = {}
    for row in _measured():
        numbers_of.setdefault(row["scene"], {})[row["effect"]] = float(row["number"])
    return numbers_of


@cache
def _measured() -> list[dict[str, str]]:
    return table("effects_study.csv")
