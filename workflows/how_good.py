"""How good is it? Every comparison with a laboratory in one table: python workflows/how_good.py   # docs/evidence/how_good.md

Runs nothing: reads the tables of the studies; measured values are in measurements.toml and paper_values.toml. Two values are apart when
they differ by more than the root of the sum of the squares of their errors; an unknown error counts as 0.
"""

import math
from collections.abc import Iterator
from typing import NamedTuple

import coating_stress
import experiments
import numpy as np
from pages import drawing, markdown, with_error, write_parts
from study_table import column, number, table_rows
from validation_page import scattered, seven

from coupler.physics.materials import entry
from coupler.plan import refinement

VALIDATION, IMPACTS = "[validation](validation.md)", "[impacts](experiments.md)"
COATINGS = "[coatings](coating_stress.md)"


class Pair(NamedTuple):
    """A measured value, a computed one, and their errors, nan if unknown. digits: decimal places; page: link to a page with sources."""

    kind: str
    what: str
    measured: float
    measured_error: float
    computed: float
    computed_error: float
    digits: int
    page: str

    @property
    def apart(self) -> float:
        """Computed less measured value where these are apart, else 0."""
        error = math.hypot(np.nan_to_num(self.measured_error), np.nan_to_num(self.computed_error))
        off = self.computed - self.measured
        return off if abs(off) > error else 0.0


def splats() -> Iterator[Pair]:
    """Flattening of the particles of the paper, with the scatter by velocity and misalignment, and of an alloy on hard steel."""
    rows = table_rows("validation")
    for splat in seven(rows):
        ours, name = number(splat.row, "flattening_end"), splat.name[:2]
        over = [r for r in rows if r["run"].startswith(f"{name[0]}-")] if name[1] == ":" else []
        over += scattered(name[1]) if name[0] == "D" else []
        scatter = float(np.nanstd(column(over, "flattening_end"))) if over else 0.0
        error = math.hypot(scatter, ours * refinement.forecast(number(splat.row, "points"))["flattening_ratio"])
        yield Pair("flattening", splat.name, splat.flattening["experiment"], math.nan, ours, error, 2, VALIDATION)
    rows = [row for row in table_rows("splats_4340") if row["metal"] == "Al2024" and not row["failed"]]
    for alloy, (ratio, error) in experiments.SPLAT["measured"].items():
        own, band = experiments.splat_ratio(rows[0]), number(rows[0], "flattening_band")
        yield Pair("flattening", f"{alloy} on 4340 (Al2024)", ratio, error, own, band, 2, IMPACTS)


def others() -> Iterator[Pair]:
    """Flattening in coatings of iron and nickel, and stress of magnesium below aluminium."""
    rows = [row for row in table_rows("coatings") if not (row["test"] or row["failed"])]
    for quantity, what, *values, digits in (pair for row in rows for pair in coating_stress.coating_pairs(row)):
        if not what.endswith("h / w"):
            yield Pair(quantity, what, *values[0], *values[1], digits, COATINGS)


def rebounds() -> Iterator[Pair]:
    """Mean restitution over the window of velocities, with the first strength set of each metal."""
    rows = table_rows("restitution_sets")
    for metal in experiments.METALS:
        name = next(iter(entry(metal).sets))
        ours = dict(zip(*experiments.curve(rows, metal, name, "standard"), strict=True))
        theirs = {v: e for v, e in experiments.REBOUND[metal]["e"] if experiments.in_window(v) and v in ours}
        computed, measured = float(np.mean([ours[v] for v in theirs])), float(np.mean(list(theirs.values())))
        what = f"{metal} {experiments.REBOUND[metal]['diameter_um']} µm, 250 to 550 m/s ({name})"
        error = experiments.band_of(rows, metal)
        yield Pair("restitution", what, measured, experiments.REBOUND["e_error"], computed, error, 3, IMPACTS)


def critical() -> Iterator[Pair]:
    """Critical velocities by computed bonds, at `fine` with gradients."""
    for row in table_rows("critical_velocity"):
        usual = row["preset"] == "fine" and row["taylor_alpha"] == "0.35" and not row["strength"].startswith("critical")
        if usual and row["measured_m_s"] and row["critical_m_s"]:
            half = 0.5 * (number(row, "sticks_from_m_s") - number(row, "rebounds_to_m_s"))
            what = f"{row['metal']} {row['diameter_um']} µm, bonds"
            values = number(row, "measured_m_s"), math.nan, number(row, "critical_m_s"), half
            yield Pair("critical velocity, m/s", what, *values, 0, "[bonding](bonding.md)")


def coatings() -> Iterator[Pair]:
    """Stress and density of aluminium coatings."""
    for c in coating_stress.comparisons(table_rows("coating_al")):
        for kind, k, digits, key in (("stress, MPa", 9, 0, "stress_MPa"), ("density, %", 5, 1, "density")):
            values = column(c.rows, key)
            error = coating_stress.error_of(values)
            yield Pair(kind, c.name, *c.measured[k : k + 2], float(values.mean()), error, digits, COATINGS)


def flights() -> Iterator[Pair]:
    """Velocities at impact that a laser measured."""
    for row in table_rows("flights"):
        if row["by"] == "laser":
            what = f"{row['metal']} {row['median_um']} µm, {row['gas']}"
            velocities = number(row, "published_m_s"), math.nan, number(row, "computed_m_s"), math.nan
            yield Pair("velocity at impact, m/s", what, *velocities, 0, "[gas](gas.md)")


def pairs() -> list[Pair]:
    """All comparisons, those of a kind together."""
    found = [*splats(), *rebounds(), *critical(), *coatings(), *others(), *flights()]
    kinds = [p.kind for p in found]
    return sorted(found, key=lambda p: kinds.index(p.kind))


def table(pairs: list[Pair]) -> list[str]:
    """All pairs, and of each kind how many are apart."""
    lines, last = [], ""
    for p in pairs:
        cells = with_error(p.measured, p.measured_error, p.digits), with_error(p.computed, p.computed_error, p.digits)
        quantity, apart = f"{p.kind}: {p.page}", f"{p.apart:+.{p.digits}f}" if p.apart else "no"
        lines.append([quantity if quantity != last else "", p.what, *cells, apart])
        last = quantity
    counts = []
    for kind in dict.fromkeys(p.kind for p in pairs):
        own = [p for p in pairs if p.kind == kind]
        counts.append(f"{kind.split(',')[0]} {sum(not p.apart for p in own)} of {len(own)}")
    told = f"Not apart: {', '.join(counts)}; in all {sum(not p.apart for p in pairs)} of {len(pairs)}."
    return [told, "", *markdown("quantity | case | measured | computed | apart", lines)]


def draw(pairs: list[Pair]) -> None:
    """Draw computed against measured values, a panel for each kind."""
    kinds = list(dict.fromkeys(p.kind for p in pairs))
    with drawing("how_good", 11.0, 6.4, "constrained") as figure:
        for axes, kind in zip(figure.subplots(2, 3).flat, kinds, strict=True):
            own = [p for p in pairs if p.kind == kind]
            x, dx, y, dy = (np.nan_to_num([p[k] for p in own]) for k in (2, 3, 4, 5))
            axes.errorbar(x, y, dy, dx, "o", ms=4, capsize=2)
            ends = np.array([min((x - dx).min(), (y - dy).min()), max((x + dx).max(), (y + dy).max())])
            axes.plot(ends, ends, "--", color="0.5", lw=1)
            axes.set(title=kind, xlabel="measured", ylabel="computed")


if __name__ == "__main__":
    found = pairs()
    lines = table(found)
    print(lines[0])
    draw(found)
    write_parts("how_good", {"table": lines})
