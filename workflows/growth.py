"""How the cost of an impact grows with the splats before it: python workflows/growth.py [--impacts 10]   # docs/tables/growth.csv

Nickel particles of 20 um at 550 m/s on steel, coarse (700 points), at places drawn from a seed within 12 um of the axis. One line for
each impact, written when it is over: elements, steps, processor time (one thread) of the steps, of what comes before them (the splat
before becomes a body, joins, comes to rest; building), who set dt.
"""

import argparse
import random
import resource
import tempfile
from pathlib import Path

from pages import TABLES, write_table

from coupler import Scene, run
from coupler.impact.exchange import Impact
from coupler.progress import Progress

HEAD = """
name = "growth"
[substrate]
material = "SS304"
[resolution]
spacing = "1.8 um"
"""
COLUMNS = (
    "impact", "elements", "steps", "before s", "steps s", "ms per step", "end ns", "dt mean ps", "dt set by the bodies %",
    "stretch", "drift",
)  # fmt: skip


def scene(impacts: int, seed: int) -> Scene:
    """Particles at random places within a disc."""
    dice = random.Random(seed)
    text = HEAD
    for _ in range(impacts):
        while True:
            x, y = dice.uniform(-12, 12), dice.uniform(-12, 12)
            if x * x + y * y < 144:
                break
        text += f'[[particle]]\nmaterial = "Ni"\ndiameter = "20 um"\nvelocity = "550 m/s"\noffset = ["{x:.2f} um", "{y:.2f} um"]\n'
    return Scene.from_text(text, "growth")


def used() -> float:
    """Processor time of this process and of those it has waited for (the mesher), s."""
    own, children = (resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN))
    return own.ru_utime + own.ru_stime + children.ru_utime + children.ru_stime


class Clock:
    """A probe: the table's row of each impact, written anew after every chunk of steps."""

    def __init__(self) -> None:
        self.rows = list[list[str]]()
        self._ledger: object = None
        self._began = self._last = used()

    def __call__(self, impact: Impact) -> None:
        now, before = used(), 0.0
        if impact.ledger.before != self._ledger:  # a retry makes a new ledger with the same start
            self._ledger, self._began, before = impact.ledger.before, now, now - self._last
            self.rows.append(["0"] * 3 + [f"{before:.1f}"])
        self._last = now
        spent, steps = now - self._began, impact.particle.steps
        self.rows[-1] = [
            str(len(self.rows)), str(len(impact.target.mesh.conn)), str(steps), self.rows[-1][3], f"{spent:.1f}",
            f"{1e3 * spent / steps:.2f}", f"{impact.time * 1e9:.1f}", f"{impact.time / steps * 1e12:.1f}",
            f"{100 * impact.limits['target'] / steps:.0f}", f"{impact.particle.stretch_min:.2f}",
            f"{impact.ledger.rows.get('drift', 0.0):.1e}",
        ]  # fmt: skip
        if steps % 100 == 0 or before:
            self.write()

    def write(self) -> None:
        rows = [dict(zip(COLUMNS, row + [""] * (len(COLUMNS) - len(row)), strict=True)) for row in self.rows]
        write_table(TABLES / "growth.csv", rows, "remake: python workflows/growth.py")


def main() -> None:
    """Run, tabulate, record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--impacts", type=int, default=10)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for the run's files (default: a temporary one)")
    a = parser.parse_args()
    clock = Clock()
    with tempfile.TemporaryDirectory() as place:
        out = a.keep or Path(place) / "run"
        run(scene(a.impacts, a.seed), out, force=True, progress=Progress(), threads=1, probe=clock)
    clock.write()
    print("\n".join("  ".join(f"{cell:>10}" for cell in row) for row in [COLUMNS, *clock.rows]))


if __name__ == "__main__":
    main()
