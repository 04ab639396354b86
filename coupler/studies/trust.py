"""How far a number can be trusted: green, amber or red. The mark follows from experiments on the same kind of metal at a similar
velocity."""

import tomllib
from collections.abc import Sequence
from functools import cache
from importlib.resources import files
from typing import Any, NamedTuple

GREEN, AMBER, RED = "green", "amber", "red"
MARKS = (GREEN, AMBER, RED)  # from the best to the worst
NEAR = 1.5  # ratio of two velocities up to which they count as similar
RULE = (
    "Green: the model agrees with all measurements on this kind of metal at a similar velocity. Amber: it agrees with some of them; or"
    " there are none, and it agrees with at least half of the measurements on other metals and velocities. Red: all other cases."
)


class Comparison(NamedTuple):
    """A comparison with an experiment. kind: kind of metal; slowest, fastest: impact velocities, m/s; apart: computed minus measured
    value as text, "no" if the two agree within their errors."""

    kind: str
    slowest: float
    fastest: float
    apart: str


class Mark(NamedTuple):
    """A trust mark. colour: one of MARKS; why: the comparisons that decide the colour, as text."""

    colour: str
    why: str


@cache
def table() -> dict[str, Any]:
    """The comparisons of docs/evidence/how_good.md as a table: quantity -> case -> Comparison. The entry "kinds" gives the metals of
    each kind."""
    raw = tomllib.loads((files(__package__) / "comparisons.toml").read_text(encoding="utf-8"))
    return {"kinds": raw.pop("kinds")} | {
        quantity: {case: Comparison(*row) for case, row in cases.items()} for quantity, cases in raw.items()
    }


def mark(quantities: Sequence[str], metal: str, velocity: float, base: str = "") -> Mark:
    """The trust mark of a number: the worst mark of the quantities on which it depends; red if there are none. metal: metal of the
    powder in the library; velocity: impact velocity, m/s; base: metal of the substrate. If `base` differs from `metal`, green becomes
    amber, because no critical velocity is measured for such pairs."""
    each = [_mark(quantity, metal, velocity) for quantity in quantities]
    if not each:
        return Mark(RED, "not compared with measurements")
    worst, why = max((colour for colour, _ in each), key=MARKS.index), "; ".join(text for _, text in each)
    if base and base != metal and worst == GREEN:
        worst, why = AMBER, f"{why}; no measurement on {base}"
    return Mark(worst, why)


def _mark(quantity: str, metal: str, velocity: float) -> Mark:
    known = table()
    kind = next((name for name, metals in known["kinds"].items() if metal in metals), "")
    rows: list[Comparison] = list(known[quantity].values())
    own = [row for row in rows if row.kind == kind and row.slowest / NEAR <= velocity <= row.fastest * NEAR]
    met, met_own = (sum(row.apart == "no" for row in group) for group in (rows, own))
    if own:
        colour = GREEN if met_own == len(own) else AMBER if met_own else RED
        return Mark(colour, f"{quantity}: {met_own} of {len(own)} measurements on {kind} agree")
    others = f"{met} of {len(rows)} others agree"
    text = f"{quantity}: no measurement on {kind or metal} near {velocity:.0f} m/s, {others}"
    return Mark(AMBER if 2 * met >= len(rows) else RED, text)
