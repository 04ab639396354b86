"""What each effect changes, and whether leaving out what `auto` leaves out matters.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # everything on against auto: docs/tables/effects_proof.csv
    python workflows/effects_study.py --docs     # runs nothing: writes the tables into docs/effects.md and coupler/effects_study.csv

Rows that are there are not computed again. Costs are processor time of the loop, not wall time: other work on the machine
disturbs them less, but it does. Runs of the proof alternate, everything on and auto, and of each the least of its repeats
counts.
"""

import argparse
import csv
import shutil
import time
from pathlib import Path
from typing import Any

from coupler import Scene, run
from coupler.effects import NAMES
from coupler.errors import ColdsprayError
from coupler.plan import plan

STUDY, PROOF = Path("docs/tables/effects_study.csv"), Path("docs/tables/effects_proof.csv")
PACKAGED, DOCS = Path("coupler/effects_study.csv"), Path("docs/effects.md")
PACKAGED_COLUMNS = ["effect", "number", "scene", "flattening", "crater", "T_mean", "T_p99", "cost_share"]
MEASURES = {
    "flattening": "flattening_ratio_total", "crater": "crater_depth_m", "diameter": "splat_diameter_m", "T_mean": "T_mean_K",
    "T_p99": "T_p99_K",
}  # fmt: skip
EXACT = (
    "ahead_of_waves",
    "adhesion",
    "absorbing_boundaries",
)  # not of the law: adhesion is no small change, the others no physics


def scene(
    material: str,
    diameter: float,
    velocity: float,
    base: str,
    points: int = 500,
    more: str = "",
    after: str = "",
    below: str = "",
) -> str:
    """A scene file: particle of so many um and m/s, of about so many points."""
    spacing = (3.141592653589793 / 6 * diameter**3 / points) ** (1 / 3)
    table = (
        f'[[particle]]\nmaterial = "{material}"\ndiameter = "{diameter:g} um"\nvelocity = "{velocity:g} m/s"\n{more}\n'
    )
    size = f'diameter = "{8 * diameter:g} um"\nheight = "{4 * diameter:g} um"\n'
    return f'{table}{after}[substrate]\nmaterial = "{base}"\n{size}{below}\n[resolution]\nspacing = "{spacing!r} um"\n'


def _next(velocity: float, dwell: str = "") -> str:
    return f'[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "{velocity:g} m/s"\n{dwell}\n'


SCENES = {
    "Ni on steel, 500 m/s": scene("Ni", 25, 500, "SS304"),
    "slow: Ni 5 um, 200 m/s": scene("Ni", 5, 200, "SS304"),
    "fast: Ni 60 um, 1250 m/s": scene("Ni", 60, 1250, "SS304"),
    "preheated: Ni at 600 K, 400 m/s": scene("Ni", 25, 400, "SS304", more='temperature = "600 K"'),
    "Ti on Ti, 600 m/s": scene("Ti", 25, 600, "Ti"),
    "soft on hard: Al on steel, 500 m/s": scene("Al", 25, 500, "SS304"),
    "hard on soft: Ni on Al, 400 m/s": scene("Ni", 25, 400, "Al"),
    "Cu on Cu, 500 m/s": scene("OFHC_Cu", 25, 500, "OFHC_Cu"),
    "rebound: Ni, 150 m/s": scene("Ni", 25, 150, "SS304"),
    "large: Ni 200 um, 300 m/s": scene("Ni", 200, 300, "SS304"),
}
PROOFS = SCENES | {
    "rod: Ni, 450 m/s": scene("Ni", 25, 450, "SS304", more='shape = "rod"'),
    "hollow: Ni, 450 m/s": scene("Ni", 25, 450, "SS304", more='shape = "hollow_sphere"'),
    "three Ni, 20 us between": scene(
        "Ni", 25, 500, "SS304", more='dwell = "20 us"', after=_next(500, 'dwell = "20 us"') + _next(500)
    ),
}  # fmt: skip


def compute(text: str, effects: Any) -> dict[str, float]:
    """Run a scene with these effects; its measures, and the processor time of its loop (s)."""
    import json

    folder = Path("runs/effects_study")
    shutil.rmtree(folder, ignore_errors=True)
    marks: list[float] = []
    made = Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study")
    begun = time.process_time()
    summary = run(made, folder, threads=1, probe=lambda impact: marks.append(time.process_time())).summary
    found = {name: float(summary[key]) for name, key in MEASURES.items()}
    shutil.rmtree(folder)
    cpu = (
        marks[-1] - marks[0] if len(made.particles) == 1 else time.process_time() - begun
    )  # pauses and splats are a part of it
    return found | {"cpu_s": cpu, "steps": float(summary["steps"]), "drift": float(summary["energy_drift"])}


def changes(found: dict[str, float], whole: dict[str, float]) -> dict[str, float]:
    """Change of each measure in percent of what it is with everything on."""
    return {name: 100.0 * (found[name] / whole[name] - 1.0) for name in MEASURES}


class Table:
    """A CSV file that grows row by row. key: the columns that tell a row from others."""

    def __init__(self, path: Path, key: tuple[str, ...], remake: str):
        self.path, self.key, self.remake = path, key, remake
        self.rows: list[dict[str, str]] = []
        if path.exists():
            with path.open() as file:
                self.rows = list(csv.DictReader(line for line in file if not line.startswith("#")))

    def has(self, *key: str) -> bool:
        return any(tuple(row[name] for name in self.key) == key for row in self.rows)

    def add(self, row: dict[str, Any]) -> None:
        self.rows.append({k: f"{v:.4g}" if isinstance(v, float) else str(v) for k, v in row.items()})
        print(self.rows[-1], flush=True)
        columns = list(dict.fromkeys(name for one in self.rows for name in one))
        self.path.parent.mkdir(parents=True, exist_ok=True)
        with self.path.open("w", newline="") as file:
            file.write(f"# remake: {self.remake} (rows that are here are kept)\n")
            writer = csv.DictWriter(file, columns, restval="")
            writer.writeheader()
            writer.writerows(self.rows)


def study(table: Table) -> None:
    """Leave out one effect at a time."""
    for name, text in SCENES.items():
        wanted = [effect for effect in NAMES if effect not in (*EXACT, "cooling") and not table.has(name, effect)]
        if not wanted:
            continue
        numbers = {row.name: row.value for row in plan(Scene.from_text(text, "effects_study")).effects.rows}
        base = ["all", *(f"-{effect}" for effect in EXACT)]
        whole = compute(text, base)
        for effect in wanted:
            try:
                found = compute(text, [*base, f"-{effect}"])
            except ColdsprayError as problem:
                table.add({"scene": name, "effect": effect, "number": numbers[effect], "failed": str(problem)[:100]})
                continue
            cost = 1.0 - found["cpu_s"] / found["steps"] * whole["steps"] / whole["cpu_s"]
            row = {"scene": name, "effect": effect, "number": numbers[effect], **changes(found, whole)}
            table.add({**row, "cost_share": cost, "steps": found["steps"], "drift": found["drift"], "failed": ""})


def proof(table: Table, repeats: int) -> None:
    """Everything on against auto."""
    for name, text in PROOFS.items():
        if table.has(name):
            continue
        made = plan(Scene.from_text(text, "effects_study")).effects
        runs: dict[str, list[dict[str, float]]] = {"all": [], "auto": []}
        for _ in range(repeats):
            for which, found in runs.items():
                found.append(compute(text, which))
        cpu = {which: min(one["cpu_s"] for one in found) for which, found in runs.items()}
        off = " ".join(effect for effect in NAMES if effect not in made.active)
        row = {
            "scene": name,
            **changes(runs["auto"][0], runs["all"][0]),
            "cpu_all_s": cpu["all"],
            "cpu_auto_s": cpu["auto"],
        }
        table.add({**row, "ratio": cpu["all"] / cpu["auto"], "steps": runs["auto"][0]["steps"], "left_out": off})


def main() -> None:
    """Fill the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--proof", action="store_true", help="everything on against auto")
    parser.add_argument("--repeats", type=int, default=2, help="of each run of the proof")
    parser.add_argument("--docs", action="store_true", help="write the tables that are there into the documents")
    a = parser.parse_args()
    influence = Table(STUDY, ("scene", "effect"), "python workflows/effects_study.py")
    against = Table(PROOF, ("scene",), "python workflows/effects_study.py --proof")
    if a.docs:
        write(influence, against)
    elif a.proof:
        proof(against, a.repeats)
        write(influence, against)
    else:
        study(influence)
        write(influence, against)


def write(influence: Table, against: Table) -> None:
    """Put the tables into docs/effects.md between their marks, and what `coldspray check` shows into the package."""
    known = [row for row in influence.rows if not row.get("failed")]
    with PACKAGED.open("w", newline="") as file:
        file.write("# remake: python workflows/effects_study.py --docs\n")
        writer = csv.DictWriter(file, PACKAGED_COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows(known)
    text = DOCS.read_text()
    for mark, lines in (("study", _study_lines(known)), ("proof", _proof_lines(against.rows))):
        before, _, rest = text.partition(f"<!-- {mark}: written by workflows/effects_study.py -->")
        _, found, after = rest.partition(f"<!-- end of {mark} -->")
        if not found:
            raise SystemExit(f"{DOCS} has no place for the table: it needs marks for {mark}")
        text = f"{before}<!-- {mark}: written by workflows/effects_study.py -->\n\n" + "\n".join(lines)
        text += f"\n\n<!-- end of {mark} -->{after}"
    DOCS.write_text(text)


def _study_lines(rows: list[dict[str, str]]) -> list[str]:
    lines = [
        "| effect left out | scene | number | " + " | ".join(MEASURES) + " | cost |",
        "|---" * (len(MEASURES) + 4) + "|",
    ]
    for effect in dict.fromkeys(row["effect"] for row in rows):
        for row in sorted((r for r in rows if r["effect"] == effect), key=lambda r: float(r["number"])):
            cells = [f"{float(row[name]):+.2f}" for name in MEASURES]
            cells.append(f"{100 * float(row['cost_share']):.0f} %")
            lines.append(f"| {effect} | {row['scene']} | {row['number']} | {' | '.join(cells)} |")
    return lines


def _proof_lines(rows: list[dict[str, str]]) -> list[str]:
    head = "| scene | " + " | ".join(MEASURES) + " | CPU all, s | CPU auto, s | ratio | left out |"
    lines = [head, "|---" * (len(MEASURES) + 5) + "|"]
    for row in rows:
        cells = [f"{float(row[name]):+.2f}" for name in MEASURES]
        cells += [f"{float(row[name]):.1f}" for name in ("cpu_all_s", "cpu_auto_s")] + [
            f"{float(row['ratio']):.2f}",
            row["left_out"],
        ]
        lines.append(f"| {row['scene']} | {' | '.join(cells)} |")
    if rows:
        worst = max(abs(float(row[name])) for row in rows for name in MEASURES)
        ratios = sorted(float(row["ratio"]) for row in rows)
        median = ratios[len(ratios) // 2] if len(ratios) % 2 else 0.5 * sum(ratios[len(ratios) // 2 - 1 :][:2])
        lines += [
            "",
            f"Largest change {worst:.2f} %; median ratio {median:.2f}, from {ratios[0]:.2f} to {ratios[-1]:.2f}.",
        ]
    return lines


if __name__ == "__main__":
    main()
