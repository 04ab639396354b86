"""How far a measure may be off at a resolution, from the ladders of docs/evidence/accuracy.md as packaged in bands.csv.

A band is the largest of two things: what the fit v + a h^p of the ladder is still off its limit at h = N^(-1/3), with the scatter
about that fit; and half of what the knobs of the scheme move the measure by, which shrinks with h alike. It is none of the error
of the model: not of Johnson-Cook's numbers, of friction, of the effects left out.
"""

import csv
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cache
from importlib.resources import files

from ..errors import ColdsprayError
from ..measures import measure as record

SHAPE = ("flattening_ratio", "crater_depth_m", "splat_diameter_m")  # what --accuracy is about
KNOB_AXES = ("element size", "dt", "viscosity", "hourglass", "contact stiffness")
LEAST, MOST = 300, 64000  # points that a choice may fall on


class AccuracyError(ColdsprayError):
    """An accuracy or a time that no setting gives: says what can be had."""


@dataclass(frozen=True)
class Band:
    """measure: its key; share: half-width over its value (of temperatures: over their rise); why: the axis that drives it, and the
    cases it rests on; beyond: why it is a guess, empty where it is none."""

    measure: str
    share: float
    why: str
    beyond: str = ""


@dataclass(frozen=True)
class Kind:
    """What a band depends on. points: of the particle; speed m/s; impacts: of the run; plain: whether it is a case like those of
    the table, a sphere straight down."""

    points: float
    speed: float
    impacts: int = 1
    plain: bool = True


def band(measure: str, kind: Kind) -> Band | None:
    """The band of a measure; None for those that do not converge (local maxima) and those that were not looked at.

    Between the speeds of the table it is interpolated, the wider of the cases of one speed; beyond them it is that of the nearest.
    """
    rows = [row for row in _rows() if row["measure"] == measure]
    if not rows:
        return None
    speeds: dict[float, tuple[float, str, str]] = {}
    for row in rows:
        if int(row["impacts"]) > 1:
            continue
        share, driver = _share(row, kind.points)
        speed = float(row["speed"])
        if share > speeds.get(speed, (0.0, "", ""))[0]:
            speeds[speed] = share, driver, row["case"]
    if not speeds:
        return None
    known = sorted(speeds)
    below = max((s for s in known if s <= kind.speed), default=known[0])
    above = min((s for s in known if s >= kind.speed), default=known[-1])
    t = (kind.speed - below) / (above - below) if above > below else 0.0
    share = (1.0 - t) * speeds[below][0] + t * speeds[above][0]
    nearer = above if t > 0.5 else below
    driver, cases = speeds[nearer][1], [speeds[s][2] for s in dict.fromkeys((below, above))]
    for row in rows if kind.impacts > 1 else ():
        if int(row["impacts"]) > 1 and (of_pile := _share(row, kind.points))[0] > share:
            share, driver, cases = *of_pile, [row["case"]]
    beyond = [] if known[0] <= kind.speed <= known[-1] else [f"{kind.speed:.0f} m/s is outside the table"]
    beyond += [] if kind.plain else ["the table has no such shape or angle"]
    why = f"{driver}, from {' and '.join(cases)}" + (f"; {', '.join(beyond)}: a guess" if beyond else "")
    return Band(measure, share, why, ", ".join(beyond))


def _share(row: Mapping[str, str], points: float) -> tuple[float, str]:
    """Half-width over the value at so many points, and what drives it."""
    p, h = float(row["order"]), points ** (-1.0 / 3.0)
    drivers = {"spacing of the points": float(row["slope"]) * h**p + float(row["scatter"])}
    if row["knobs_at"]:
        shrunk = (h / float(row["knobs_at"]) ** (-1.0 / 3.0)) ** p
        drivers |= {axis: float(row[axis]) * shrunk for axis in KNOB_AXES if row[axis]}
    driver = max(drivers, key=lambda name: drivers[name])
    return drivers[driver], driver


def of_measures(kind: Kind) -> tuple[Band, ...]:
    """The bands of all measures that have one."""
    measures = dict.fromkeys(row["measure"] for row in _rows())
    return tuple(b for measure in measures if (b := band(measure, kind)) is not None)


def half_widths(
    bands: Sequence[Band], values: Mapping[str, float | None], T_0: float
) -> dict[str, dict[str, float | str]]:
    """Measure -> half_width in its own unit, and why. values: the measures; T_0: K, the particle's before the impact."""
    widths: dict[str, dict[str, float | str]] = {}
    for each in bands:
        value = values.get(each.measure)
        whole = abs(value - record(each.measure).initial(T_0)) if value is not None else 0.0
        if whole > 0.0:
            widths[each.measure] = {"half_width": each.share * whole, "why": each.why}
    return widths


def worst(kind: Kind, measures: tuple[str, ...] = SHAPE) -> tuple[str, float]:
    """The measure with the widest band, and its share. Raises AccuracyError if there is no table."""
    shares = {m: b.share for m in measures if (b := band(m, kind)) is not None}
    if not shares:
        raise AccuracyError("coupler/plan/bands.csv has none of the measures: make it again with `make accuracy`")
    name = max(shares, key=lambda m: shares[m])
    return name, shares[name]


def points_for(share: float, kind: Kind) -> int:
    """The fewest points that bring the bands of the shape to `share`. Raises AccuracyError if MOST do not."""
    at = lambda n: worst(Kind(n, kind.speed, kind.impacts, kind.plain))  # noqa: E731
    if at(MOST)[1] > share:
        name, least = at(MOST)
        raise AccuracyError(
            f"--accuracy {100 * share:g}% cannot be had: with {MOST} points the {record(name).short} is still uncertain by"
            f" {100 * least:.2g} %; ask for that or more (docs/evidence/accuracy.md)"
        )
    low, high = LEAST, MOST
    while high - low > 0.01 * high:
        middle = round(math.sqrt(low * high))
        low, high = (low, middle) if at(middle)[1] <= share else (middle, high)
    return LEAST if at(LEAST)[1] <= share else high


@cache
def _rows() -> list[dict[str, str]]:
    return table("bands.csv")


def table(name: str) -> list[dict[str, str]]:
    """The rows of a table of this package, none where it is missing: a study makes it."""
    file = files(__package__).joinpath(name)
    lines = file.read_text(encoding="utf-8").splitlines() if file.is_file() else []
    return list(csv.DictReader(line for line in lines if not line.startswith("#")))
