"""How the cost of an impact grows with the splats before it: python workflows/growth.py [--impacts 10] [--docs]

Nickel particles of 20 um at 550 m/s on steel, coarse (700 points), at places drawn from a seed within 12 um of the axis. One line for
each impact in docs/tables/growth.csv: elements, steps, processor time (one thread) of the steps, of what comes before them (the splat
before becomes a body, joins, comes to rest; building), who set dt. --docs computes nothing and draws the figure of the page on speed.
"""

import random

from pages import EVIDENCE, TABLES, column, computed, impact_tables, options, spent, table_rows, write_table

from coupler import Scene
from coupler.impact.exchange import Impact
from coupler.report.picture import blank, save


def scene(impacts: int, seed: int) -> Scene:
    """Particles at random places within a disc."""
    dice, particles = random.Random(seed), []
    for _ in range(impacts):
        x = y = 12.0
        while x * x + y * y >= 144:
            x, y = dice.uniform(-12, 12), dice.uniform(-12, 12)
        tables = impact_tables("Ni", 20.0, 550.0, spacing=1.8, dwell="0 us", offset=[f"{x:.2f} um", f"{y:.2f} um"])
        particles.append(tables.pop("particle"))
    more = {"adhesion": {"kind": "tied"}, "end": {"at": "rest"}}
    return Scene.from_dict({"particle": particles, **tables, **more}, "growth")


class Clock:
    """A probe: the table's row of each impact."""

    def __init__(self) -> None:
        self.rows = list[dict[str, object]]()
        self._ledger: object = None
        self._began = self._last = spent()

    def __call__(self, impact: Impact) -> None:
        now = spent()
        if impact.ledger.before != self._ledger:  # a retry makes a new ledger with the same start
            self._ledger, self._began = impact.ledger.before, now
            self.rows.append({"before s": f"{now - self._last:.1f}"})
        self._last = now
        seconds, steps = now - self._began, impact.particle.steps
        self.rows[-1] = {
            "impact": len(self.rows), "elements": len(impact.target.mesh.conn), "steps": steps,
            "before s": self.rows[-1]["before s"], "steps s": f"{seconds:.1f}", "ms per step": f"{1e3 * seconds / steps:.2f}",
            "end ns": f"{impact.time * 1e9:.1f}", "dt mean ps": f"{impact.time / steps * 1e12:.1f}",
            "dt set by the bodies %": f"{100 * impact.limits['target'] / steps:.0f}",
            "stretch": f"{impact.particle.totals.stretch_min:.2f}", "drift": f"{impact.ledger.rows.get('drift', 0.0):.1e}",
        }  # fmt: skip


def draw() -> None:
    """Processor time of each impact, and its number of steps."""
    rows = table_rows("growth")
    number, before, steps = (column(rows, name) for name in ("impact", "before s", "steps s"))
    figure = blank(6.0, 3.2, 110)
    axes = figure.add_axes((0.11, 0.16, 0.77, 0.81))
    axes.bar(number, before, color="#999999", label="new body, joining, equilibrium")
    axes.bar(number, steps, bottom=before, color="#0072b2", label="steps of the impact")
    axes.set(xlabel="impact", ylabel="processor time (s)", xticks=number)
    right = axes.twinx()
    right.plot(number, column(rows, "steps"), "ko--", ms=4, label="number of steps (right)")
    right.set_ylim(0, None)
    figure.legend(loc="upper left", bbox_to_anchor=(0.11, 0.97))
    save(figure, EVIDENCE / "growth.png")


def main() -> None:
    """Run, record, draw."""
    a = options(__doc__, "docs", impacts=10, seed=2)
    if not a.docs:
        clock = Clock()
        with computed(scene(a.impacts, a.seed), probe=clock):
            write_table(TABLES / "growth.csv", clock.rows, "remake: python workflows/growth.py")
    draw()


if __name__ == "__main__":
    main()
