"""What each effect changes, and whether leaving out what `auto` leaves out matters.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # everything on against auto: docs/tables/effects_proof.csv
    python workflows/effects_study.py --docs     # runs nothing: writes docs/evidence/effects.md and coupler/plan/effects_study.csv

Rows that are there are not computed again. What effects cost is measured by workflows/effects_costs.py. Costs are processor time
of one thread, of impacts that go on in turn, so that other work on the machine slows them down alike.
"""

import argparse
import csv
import json
import tempfile
import time
from pathlib import Path
from typing import Any

import numpy as np

from coupler import Scene, run
from coupler.errors import ColdsprayError
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_window
from coupler.plan.effects import LEFT_OUT, THRESHOLDS, largest_threshold, worst_change
from coupler.plan.planning import plan
from coupler.scene.effects import NAMES

STUDY, PROOF = Path("docs/tables/effects_study.csv"), Path("docs/tables/effects_proof.csv")
COSTS, KERNELS = Path("docs/tables/effects_costs.csv"), Path("docs/tables/effects_kernels.csv")
PACKAGED, DOCS = Path("coupler/plan/effects_study.csv"), Path("docs/evidence/effects.md")
PACKAGED_COLUMNS = ["effect", "number", "scene", "flattening", "crater", "diameter", "T_mean", "T_p99", "cost_share"]
MEASURES = {
    "flattening": "flattening_ratio_total", "crater": "crater_depth_m", "diameter": "splat_diameter_m", "T_mean": "T_mean_K",
    "T_p99": "T_p99_K",
}  # fmt: skip
BASE = ["all", "-ahead_of_waves"]  # what is left out of: the waves' elements change nothing (tests/test_fe.py)
NEVER = (
    "ahead_of_waves",
    "adhesion",
    "cooling",
)  # not left out of a scene that does not ask for it: of no meaning to a single impact
CROSSINGS = 1.5  # D/v: how far impacts are followed where their time is measured
EITHER = ("friction", "plastic_heating")  # a scene has them or not, whatever their size
CAUSAL = ("absorbing_boundaries",)  # nothing can come back before the waves do


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
    "large: Ni 190 um, 300 m/s": scene("Ni", 190, 300, "SS304"),
    "two Ni, 10 ns between": scene("Ni", 25, 500, "SS304", more='dwell = "10 ns"', after=_next(500)),
    "two Ni, 100 ns between": scene("Ni", 25, 500, "SS304", more='dwell = "100 ns"', after=_next(500)),
    "two Ni, 1 us between": scene("Ni", 25, 500, "SS304", more='dwell = "1 us"', after=_next(500)),
    "two Ni, 20 us between": scene("Ni", 25, 500, "SS304", more='dwell = "20 us"', after=_next(500)),
}
WARM = ("thermal_softening", "temperature_dependent_cp", "friction_heat", "mie_gruneisen", "thermal_expansion")
FLOW = ("temperature_dependent_k", "conduction", "particle_conduction", "interface_conduction")
ONLY = {
    "preheated: Ni at 600 K, 400 m/s": WARM,
    "Ti on Ti, 600 m/s": (*WARM, "particle_conduction"),
    "soft on hard: Al on steel, 500 m/s": (*WARM, "particle_conduction", "interface_conduction"),
    "hard on soft: Ni on Al, 400 m/s": (*WARM, "conduction", "interface_conduction"),
    "Cu on Cu, 500 m/s": (*WARM, *FLOW),
    "rebound: Ni, 150 m/s": ("thermal_softening", "mie_gruneisen", "thermal_expansion"),
    "large: Ni 190 um, 300 m/s": FLOW,
    **{name: ("cooling",) for name in SCENES if name.startswith("two Ni")},
}  # what is left out of each scene; of the others everything
PROOFS = {name: text for name, text in SCENES.items() if not name.startswith("two Ni")} | {
    "rod: Ni, 450 m/s": scene("Ni", 25, 450, "SS304", more='shape = "rod"'),
    "hollow: Ni, 450 m/s": scene("Ni", 25, 450, "SS304", more='shape = "hollow_sphere"'),
    "three Ni, 20 us between": scene(
        "Ni", 25, 500, "SS304", more='dwell = "20 us"', after=_next(500, 'dwell = "20 us"') + _next(500)
    ),
}  # fmt: skip


def compute(text: str, effects: Any) -> dict[str, float]:
    """Run a scene with these effects; its measures and the processor time of all of it (s)."""
    made = Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study")
    begun = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        summary = run(made, Path(folder) / "run", threads=1).summary
    found = {name: float(summary[key]) for name, key in MEASURES.items()}
    cpu = time.process_time() - begun
    return found | {"cpu_s": cpu, "steps": float(summary["steps"]), "drift": float(summary["energy_drift"])}


def in_turn(text: str, asked: dict[str, Any], crossings: float) -> dict[str, list[float]]:
    """Processor time (s) of each ten steps of impacts of one scene that differ in their effects, until crossings x D/v.

    They go on in turn, ten steps of each at a time. The first ten are left out: they load compiled code.
    """
    made, end = {}, 0.0
    for name, effects in asked.items():
        what = plan(Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study"))
        made[name] = Impact(build_domains(what))
        end = crossings * what.impact.diameter / float(np.linalg.norm(what.impact.velocity))
    costs: dict[str, list[float]] = {name: [] for name in made}
    going = dict(made)
    while going:
        for name, impact in list(going.items()):
            start = time.process_time()
            advance_window(impact)
            costs[name].append(time.process_time() - start)
            if impact.time >= end:
                del going[name]
    for impact in made.values():
        impact.particle.close()
        impact.close()
    return {name: found[1:] for name, found in costs.items()}


def least_of(rounds: int, text: str, asked: dict[str, Any], crossings: float) -> dict[str, list[float]]:
    """`in_turn` several times: of each ten steps the least."""
    least: dict[str, list[float]] = {}
    for _ in range(rounds):
        for name, costs in in_turn(text, asked, crossings).items():
            least[name] = [min(pair) for pair in zip(least.get(name, costs), costs, strict=True)]
    return least


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
        wanted = [effect for effect in _asked(name) if not table.has(name, effect)]
        if not wanted:
            continue
        numbers = _numbers(text)
        whole = compute(text, BASE)
        for effect in wanted:
            try:
                found = compute(text, [*BASE, f"-{effect}"])
            except ColdsprayError as problem:
                table.add({"scene": name, "effect": effect, "number": numbers[effect], "failed": str(problem)[:100]})
                continue
            row = {"scene": name, "effect": effect, "number": numbers[effect], **changes(found, whole)}
            table.add({**row, "steps": found["steps"], "drift": found["drift"], "failed": ""})


def _numbers(text: str) -> dict[str, float]:
    return {row.name: row.value for row in plan(Scene.from_text(text, "effects_study")).effects.rows}


def _asked(scene_name: str) -> list[str]:
    """The effects to leave out of a scene."""
    if scene_name in ONLY:
        return list(ONLY[scene_name])
    return [effect for effect in NAMES if effect not in NEVER]


def proof(table: Table, rounds: int) -> None:
    """Everything on against auto."""
    asked = {"all": "all", "auto": "auto"}
    for name, text in PROOFS.items():
        if table.has(name):
            continue
        scene = Scene.from_text(text, "effects_study")
        left_out = " ".join(effect for effect in NAMES if effect not in plan(scene).effects.active)
        single = len(scene.particles) == 1
        runs = [{which: compute(text, which) for which in asked} for _ in range(1 if single else max(rounds, 2))]
        if single:
            cpu = {which: sum(costs) for which, costs in least_of(rounds, text, asked, CROSSINGS).items()}
        else:  # pauses and splats are a part of it
            cpu = {which: min(one[which]["cpu_s"] for one in runs) for which in asked}
        found = runs[0]
        row = {
            "scene": name,
            **changes(found["auto"], found["all"]),
            "cpu_all_s": cpu["all"],
            "cpu_auto_s": cpu["auto"],
        }
        table.add({**row, "ratio": cpu["all"] / cpu["auto"], "steps": found["auto"]["steps"], "left_out": left_out})


def main() -> None:
    """Fill the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--proof", action="store_true", help="everything on against auto")
    parser.add_argument("--rounds", type=int, default=1, help="of the proof's time measurement")
    parser.add_argument("--docs", action="store_true", help="write the tables that are there into the documents")
    a = parser.parse_args()
    influence = Table(STUDY, ("scene", "effect"), "python workflows/effects_study.py")
    against = Table(PROOF, ("scene",), "python workflows/effects_study.py --proof")
    if a.docs:
        write(influence, against)
    elif a.proof:
        proof(against, a.rounds)
        write(influence, against)
    else:
        study(influence)
        write(influence, against)


def write(influence: Table, against: Table) -> None:
    """Put the tables into docs/evidence/effects.md between their marks, and what `coldspray check` shows into the package."""
    now = {name: _numbers(text) for name, text in SCENES.items()}  # as they are defined today
    known = [row | {"number": f"{now[row['scene']][row['effect']]:.4g}"} for row in influence.rows if not row["failed"]]
    costs = {row["effects"].removeprefix("without "): row["saves"] for row in _rows(COSTS)}
    with PACKAGED.open("w", newline="") as file:
        file.write("# remake: python workflows/effects_study.py --docs\n")
        writer = csv.DictWriter(file, PACKAGED_COLUMNS, extrasaction="ignore")
        writer.writeheader()
        writer.writerows({**row, "cost_share": costs.get(row["effect"], "")} for row in known)
    text = DOCS.read_text()
    for mark, lines in (
        ("thresholds", _threshold_lines(known)),
        ("study", _study_lines(known)),
        ("costs", _cost_lines(_rows(COSTS))),
        ("kernels", _kernel_lines(_rows(KERNELS))),
        ("proof", _proof_lines(against.rows)),
    ):
        before, _, rest = text.partition(f"<!-- {mark}: written by workflows/effects_study.py -->")
        _, found, after = rest.partition(f"<!-- end of {mark} -->")
        if not found:
            raise SystemExit(f"{DOCS} has no place for the table: it needs marks for {mark}")
        text = f"{before}<!-- {mark}: written by workflows/effects_study.py -->\n\n" + "\n".join(lines)
        text += f"\n\n<!-- end of {mark} -->{after}"
    DOCS.write_text(text)


def _rows(path: Path) -> list[dict[str, str]]:
    if not path.exists():
        return []
    with path.open() as file:
        return list(csv.DictReader(line for line in file if not line.startswith("#")))


def _threshold_lines(rows: list[dict[str, str]]) -> list[str]:
    lines = [
        "| effect | threshold | allowed by the line | the case that asks for most | its number | its largest change, % |",
        "|---" * 6 + "|",
    ]
    for effect in NAMES:
        cases = [row for row in rows if row["effect"] == effect and float(row["number"]) > 0.0]
        if not cases or effect in (*EITHER, *CAUSAL):
            continue
        far = [row for row in cases if worst_change(row) > LEFT_OUT]
        least = min((float(row["number"]) for row in far), default=0.0)
        near = [row for row in far if float(row["number"]) <= 2.0 * least] or cases
        most = max(near, key=lambda row: worst_change(row) / float(row["number"]))
        allowed = largest_threshold(effect) or 0.0
        lines.append(
            f"| {effect} | {THRESHOLDS[effect][1]:g} | {allowed:.2g} | {most['scene']} | {most['number']} | {worst_change(most):.2f} |"
        )
    return lines


def _study_lines(rows: list[dict[str, str]]) -> list[str]:
    lines = [
        "| effect left out | scene | number | " + " | ".join(MEASURES) + " |",
        "|---" * (len(MEASURES) + 3) + "|",
    ]
    for effect in dict.fromkeys(row["effect"] for row in rows):
        for row in sorted((r for r in rows if r["effect"] == effect), key=lambda r: float(r["number"])):
            cells = [f"{float(row[name]):+.2f}" for name in MEASURES]
            lines.append(f"| {effect} | {row['scene']} | {row['number']} | {' | '.join(cells)} |")
    return lines


def _cost_lines(rows: list[dict[str, str]]) -> list[str]:
    lines = ["| effects | ms per step | saves |", "|---|---|---|"]
    return lines + [
        f"| {row['effects']} | {float(row['ms_per_step']):.2f} | {100 * float(row['saves']):.1f} % |" for row in rows
    ]


def _kernel_lines(rows: list[dict[str, str]]) -> list[str]:
    columns = [f"{what}_{name}_ns" for what in ("element", "point") for name in ("off", "zero", "cannot")]
    heads = [f"{what}, {name}" for what in ("element", "point") for name in ("off", "as a zero", "cannot be on")]
    lines = ["| ns per step, left out | " + " | ".join(heads) + " | compiling, s |", "|---" * (len(heads) + 2) + "|"]
    return lines + [
        f"| {row['effect']} | "
        + " | ".join(f"{float(row[name]):.0f}" for name in columns)
        + f" | {float(row['compile_s']):.1f} |"
        for row in rows
    ]


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
