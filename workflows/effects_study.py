"""What each effect changes, and whether leaving out what `auto` leaves out matters.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # everything on against auto: docs/tables/effects_proof.csv
    python workflows/effects_study.py --docs     # runs nothing: writes the page and coupler/plan/effects_study.csv

Rows in the tables are not computed again. What effects cost is measured by workflows/effects_costs.py. Costs are processor time
of one thread, of impacts that go on in turn, so that other work on the machine slows them down alike.
"""

import argparse
import json
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pages import PAGES, ROOT, markdown, marked, study_table, table_rows, versions, write_parts

from coupler import Scene, run
from coupler.errors import ColdsprayError
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_window
from coupler.plan.effects import LEFT_OUT, THRESHOLDS, largest_threshold, worst_change
from coupler.plan.planning import plan
from coupler.scene.effects import NAMES
from coupler.studies.table import Row, StudyTable, write_rows

Effects = str | list[str]
PACKAGED = ROOT / "coupler" / "plan" / "effects_study.csv"
PACKAGED_COLUMNS = ["effect", "number", "scene", "flattening", "crater", "diameter", "T_mean", "T_p99", "cost_share"]
MEASURES = {
    "flattening": "flattening_ratio_total", "crater": "crater_depth_m", "diameter": "splat_diameter_m", "T_mean": "T_mean_K",
    "T_p99": "T_p99_K",
}  # fmt: skip
STUDY_COLUMNS = ("scene", "effect", "number", *MEASURES, "steps", "drift", "failed")
PROOF_COLUMNS = ("scene", *MEASURES, "cpu_all_s", "cpu_auto_s", "ratio", "steps", "left_out")
BASE = ["all"]
NEVER = (
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


def compute(text: str, effects: Effects) -> dict[str, float]:
    """Run a scene with these effects; its measures and the processor time of all of it (s)."""
    checked = Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study")
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        result = run(checked, Path(folder) / "run", threads=1)
    values = {name: float(getattr(result, key)) for name, key in MEASURES.items()}
    cpu = time.process_time() - start
    return values | {"cpu_s": cpu, "steps": float(result.steps), "drift": float(result.energy_drift)}


def in_turn(text: str, choices: Mapping[str, Effects], crossings: float) -> dict[str, list[float]]:
    """Processor time (s) of each ten steps of impacts of one scene that differ in their effects, until crossings x D/v.

    They go on in turn, ten steps of each at a time. The first ten are left out: they load compiled code.
    """
    impacts, end = {}, 0.0
    for name, effects in choices.items():
        planned = plan(Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study"))
        impacts[name] = Impact(build_domains(planned))
        end = crossings * planned.impact.diameter / float(np.linalg.norm(planned.impact.velocity))
    costs: dict[str, list[float]] = {name: [] for name in impacts}
    going = dict(impacts)
    while going:
        for name, impact in list(going.items()):
            start = time.process_time()
            advance_window(impact)
            costs[name].append(time.process_time() - start)
            if impact.time >= end:
                del going[name]
    for impact in impacts.values():
        impact.particle.close()
        impact.close()
    return {name: seconds[1:] for name, seconds in costs.items()}


def least_of(rounds: int, text: str, choices: Mapping[str, Effects], crossings: float) -> dict[str, list[float]]:
    """`in_turn` several times: of each ten steps the least."""
    least: dict[str, list[float]] = {}
    for _ in range(rounds):
        for name, costs in in_turn(text, choices, crossings).items():
            least[name] = [min(pair) for pair in zip(least.get(name, costs), costs, strict=True)]
    return least


def changes(values: dict[str, float], whole: dict[str, float]) -> dict[str, float]:
    """Change of each measure in percent of what it is with everything on."""
    return {name: 100.0 * (values[name] / whole[name] - 1.0) for name in MEASURES}


def study(table: StudyTable) -> None:
    """Leave out one effect at a time."""
    for name, text in SCENES.items():
        wanted = [effect for effect in _asked(name) if (name, effect) not in table]
        if not wanted:
            continue
        numbers = _numbers(text)
        whole = compute(text, BASE)
        for effect in wanted:
            try:
                values = compute(text, [*BASE, f"-{effect}"])
            except ColdsprayError as problem:
                print(
                    table.add(
                        {"scene": name, "effect": effect, "number": numbers[effect], "failed": str(problem)[:100]}
                    )
                )
                continue
            row = {"scene": name, "effect": effect, "number": numbers[effect], **changes(values, whole)}
            print(table.add({**row, "steps": values["steps"], "drift": values["drift"]}), flush=True)


def _numbers(text: str) -> dict[str, float]:
    return {row.name: row.value for row in plan(Scene.from_text(text, "effects_study")).effects.rows}


def _asked(scene_name: str) -> list[str]:
    """The effects to leave out of a scene."""
    if scene_name in ONLY:
        return list(ONLY[scene_name])
    return [effect for effect in NAMES if effect not in NEVER]


def proof(table: StudyTable, rounds: int) -> None:
    """Everything on against auto."""
    choices = {"all": "all", "auto": "auto"}
    for name, text in PROOFS.items():
        if (name,) in table:
            continue
        scene = Scene.from_text(text, "effects_study")
        left_out = " ".join(effect for effect in NAMES if effect not in plan(scene).effects.active)
        single = len(scene.particles) == 1
        runs = [{which: compute(text, which) for which in choices} for _ in range(1 if single else max(rounds, 2))]
        if single:
            cpu = {which: sum(costs) for which, costs in least_of(rounds, text, choices, CROSSINGS).items()}
        else:  # pauses and splats are a part of it
            cpu = {which: min(times[which]["cpu_s"] for times in runs) for which in choices}
        first = runs[0]
        row = {
            "scene": name,
            **changes(first["auto"], first["all"]),
            "cpu_all_s": cpu["all"],
            "cpu_auto_s": cpu["auto"],
        }
        print(
            table.add({**row, "ratio": cpu["all"] / cpu["auto"], "steps": first["auto"]["steps"], "left_out": left_out})
        )


def main() -> None:
    """Fill the tables."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--proof", action="store_true", help="everything on against auto")
    parser.add_argument("--rounds", type=int, default=1, help="of the proof's time measurement")
    parser.add_argument("--docs", action="store_true", help="run nothing: write the tables into the page")
    a = parser.parse_args()
    command = "python workflows/effects_study.py"
    influence = study_table("effects_study", STUDY_COLUMNS, ("scene", "effect"), command)
    against = study_table("effects_proof", PROOF_COLUMNS, ("scene",), f"{command} --proof")
    if a.proof and not a.docs:
        proof(against, a.rounds)
    elif not a.docs:
        study(influence)
    write(influence, against)


def write(influence: StudyTable, against: StudyTable) -> None:
    """Write the tables into the page, and the one that `coldspray check` reads into the package."""
    now = {name: _numbers(text) for name, text in SCENES.items()}  # as the package defines them
    known = [row | {"number": f"{now[row['scene']][row['effect']]:.4g}"} for row in influence.rows if not row["failed"]]
    costs = table_rows("effects_costs")
    saves = {row["effects"].removeprefix("without "): row["saves"] for row in costs}
    rows = [{**row, "cost_share": saves.get(row["effect"], "")} for row in known]
    write_rows(PACKAGED, PACKAGED_COLUMNS, rows, "remake: python workflows/effects_study.py --docs")
    write_parts(PAGES["effects"], {
        "thresholds": thresholds_part(known),
        "study": [*study_part(known), "", versions(known)],
        "costs": markdown(["effects", "ms per step", "saves"], (
            [marked(row["effects"], row), f"{float(row['ms_per_step']):.2f}", f"{100 * float(row['saves']):.1f} %"] for row in costs
        )),
        "proof": proof_part(against.rows),
    })  # fmt: skip


def thresholds_part(rows: list[Row]) -> list[str]:
    """Each threshold beside the largest one that the study allows."""
    lines = []
    for effect in NAMES:
        cases = [row for row in rows if row["effect"] == effect and float(row["number"]) > 0.0]
        if not cases or effect in (*EITHER, *CAUSAL):
            continue
        far = [row for row in cases if worst_change(row) > LEFT_OUT]
        least = min((float(row["number"]) for row in far), default=0.0)
        near = [row for row in far if float(row["number"]) <= 2.0 * least] or cases
        most = max(near, key=lambda row: worst_change(row) / float(row["number"]))
        allowed = largest_threshold(effect) or 0.0
        case = [most["scene"], most["number"], f"{worst_change(most):.2f}"]
        lines.append([effect, f"{THRESHOLDS[effect].threshold:g}", f"{allowed:.2g}", *case])
    head = [
        "effect",
        "threshold",
        "allowed by the line",
        "the case that asks for most",
        "its number",
        "its largest change, %",
    ]
    return markdown(head, lines)


def study_part(rows: list[Row]) -> list[str]:
    """The change of each measure, in percent, by effect and its number."""
    effects = list(dict.fromkeys(row["effect"] for row in rows))
    ordered = sorted(rows, key=lambda row: (effects.index(row["effect"]), float(row["number"])))
    lines = [
        [row["effect"], marked(row["scene"], row), row["number"], *(f"{float(row[name]):+.2f}" for name in MEASURES)]
        for row in ordered
    ]
    return markdown(["effect left out", "scene", "number", *MEASURES], lines)


def proof_part(rows: list[Row]) -> list[str]:
    """Everything on against auto: changes in percent and processor time."""
    lines = []
    for row in rows:
        cells = [
            *(f"{float(row[name]):+.2f}" for name in MEASURES),
            *(f"{float(row[c]):.1f}" for c in ("cpu_all_s", "cpu_auto_s")),
        ]
        lines.append([marked(row["scene"], row), *cells, f"{float(row['ratio']):.2f}", row["left_out"]])
    table = markdown(["scene", *MEASURES, "CPU all, s", "CPU auto, s", "ratio", "left out"], lines)
    if not rows:
        return table
    worst = max(abs(float(row[name])) for row in rows for name in MEASURES)
    ratios = [float(row["ratio"]) for row in rows]
    spread = f"median ratio {np.median(ratios):.2f}, from {min(ratios):.2f} to {max(ratios):.2f}"
    return [*table, "", f"Largest change {worst:.2f} %; {spread}."]


if __name__ == "__main__":
    main()
