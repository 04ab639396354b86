"""How the cost of an impact grows with the splats before it: python workflows/growth.py [--impacts 10] [--out docs/tables/growth.csv]

Nickel particles of 20 um at 550 m/s on steel, coarse (700 points), at places drawn from a seed within 12 um of the axis. One line for
each impact: elements, steps, wall time of the steps and of making a body of the splat, per step and per element, who set dt.
"""

import argparse
import csv
import random
import tempfile
from pathlib import Path

from coupler import Scene, run
from coupler.progress import Progress

HEAD = """
name = "growth"
[substrate]
material = "SS304"
[resolution]
spacing = "1.8 um"
"""


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


def main() -> None:
    """Run, tabulate, record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--impacts", type=int, default=10)
    parser.add_argument("--seed", type=int, default=2)
    parser.add_argument("--keep", type=Path, help="folder for the run's files (default: a temporary one)")
    parser.add_argument("--out", type=Path, default=Path("docs/tables/growth.csv"))
    a = parser.parse_args()
    with tempfile.TemporaryDirectory() as place:
        result = run(scene(a.impacts, a.seed), a.keep or Path(place) / "run", force=True, progress=Progress())
        summary = result.summary
    joins = [*summary["joins"], {}]
    rows = []
    for i, (impact, join) in enumerate(zip(summary["impacts"], joins, strict=True), 1):
        by = impact["dt_limited_by"]
        per_step = impact["wall_loop_s"] / impact["steps"]
        rows.append([
            i, impact["elements"], impact["steps"], f"{impact['wall_loop_s']:.1f}", f"{1e3 * per_step:.2f}",
            f"{join.get('joining_s', 0.0):.1f}",
            f"{100 * by['target'] / impact['steps']:.0f}", f"{impact['flattening_ratio']:.3f}", f"{impact['energy_drift']:.1e}",
        ])  # fmt: skip
    names = [
        "impact",
        "elements",
        "steps",
        "steps s",
        "ms per step",
        "joining s",
        "dt set by the bodies %",
        "flattening",
        "drift",
    ]
    print("\n".join("  ".join(f"{cell!s:>10}" for cell in row) for row in [names, *rows]))
    with a.out.open("w", newline="") as file:
        file.write("# remake: python workflows/growth.py\n")
        csv.writer(file).writerows([names, *rows])


if __name__ == "__main__":
    main()
