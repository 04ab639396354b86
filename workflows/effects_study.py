"""What each effect changes, and whether leaving out what `auto` leaves out matters.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # everything on against auto: docs/tables/effects_proof.csv
    python workflows/effects_study.py --costs    # time of a step, and the share that leaving out saves: docs/tables/effects_costs.csv
    python workflows/effects_study.py --docs     # runs nothing: writes the page and coupler/plan/effects_study.csv

Rows in the tables of changes are not computed again. Costs are processor time of one thread, of impacts that go on in turn, so that
other work on the machine slows them down alike; of each ten steps the least of several rounds (--rounds N) counts.
"""

import json
import tempfile
import time
from collections.abc import Iterable, Mapping
from pathlib import Path

import numpy as np
from pages import (
    PAGES,
    ROOT,
    TABLES,
    markdown,
    marked,
    number,
    options,
    single_impact,
    spacing_of,
    study_table,
    table_rows,
    versions,
    write_parts,
    write_table,
)  # fmt: skip

from coupler import Scene, run
from coupler.errors import ColdsprayError, SolverError
from coupler.impact.domains import build_domains
from coupler.impact.exchange import WINDOW, Impact
from coupler.impact.loop import advance_window
from coupler.plan.effects import THRESHOLDS
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
NEVER = ("adhesion", "cooling")  # not left out of a scene that does not ask for it: of no meaning to a single impact
CROSSINGS = 1.5  # D/v: how far impacts are followed where their time is measured
EITHER = ("friction", "plastic_heating")  # a scene has them or not, whatever their size
LEFT_OUT = 1 / 3  # percent: what an effect below its threshold may change at the most
CAUSAL = ("absorbing_boundaries",)  # nothing can come back before the waves do


def scene(metal: str, diameter: float, velocity: float, base: str = "SS304", more: str = "", after: str = "") -> str:
    """A scene of about 500 points in a particle of so many um and m/s. more: of the particle; after: further particles."""
    size = f'diameter = "{8 * diameter:g} um"\nheight = "{4 * diameter:g} um"\n'
    text = single_impact(metal, diameter, velocity, base, spacing_of(500, diameter))
    tied = '[adhesion]\nkind = "tied"\n' if after else ""
    text = text.replace("[substrate]\n", f"{more}\n{after}{tied}[substrate]\n")
    return text.replace("[resolution]", f"{size}[resolution]")


def following(dwell: str = "") -> str:
    return f'[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "500 m/s"\n{dwell}\n'


SCENES = {
    "Ni on steel, 500 m/s": scene("Ni", 25, 500),
    "slow: Ni 5 um, 200 m/s": scene("Ni", 5, 200),
    "fast: Ni 60 um, 1250 m/s": scene("Ni", 60, 1250),
    "preheated: Ni at 600 K, 400 m/s": scene("Ni", 25, 400, more='temperature = "600 K"'),
    "Ti on Ti, 600 m/s": scene("Ti", 25, 600, "Ti"),
    "soft on hard: Al on steel, 500 m/s": scene("Al", 25, 500),
    "hard on soft: Ni on Al, 400 m/s": scene("Ni", 25, 400, "Al"),
    "Cu on Cu, 500 m/s": scene("OFHC_Cu", 25, 500, "OFHC_Cu"),
    "rebound: Ni, 150 m/s": scene("Ni", 25, 150),
    "large: Ni 190 um, 300 m/s": scene("Ni", 190, 300),
    **{
        f"two Ni, {pause} between": scene("Ni", 25, 500, more=f'dwell = "{pause}"', after=following())
        for pause in ("10 ns", "100 ns", "1 us", "20 us")
    },
}
WARM = (
    "thermal_softening", "temperature_dependent_cp", "friction_heat", "dissipation_heat", "mie_gruneisen", "thermal_expansion",
)  # fmt: skip
FLOW = ("temperature_dependent_k", "conduction", "particle_conduction", "interface_conduction")
ONLY = {
    "preheated: Ni at 600 K, 400 m/s": WARM,
    "Ti on Ti, 600 m/s": (*WARM, "particle_conduction"),
    "soft on hard: Al on steel, 500 m/s": (*WARM, "particle_conduction", "interface_conduction"),
    "hard on soft: Ni on Al, 400 m/s": (*WARM, "conduction", "interface_conduction"),
    "Cu on Cu, 500 m/s": (*WARM, *FLOW),
    "rebound: Ni, 150 m/s": ("thermal_softening", "dissipation_heat", "mie_gruneisen", "thermal_expansion"),
    "large: Ni 190 um, 300 m/s": FLOW,
    **{name: ("cooling",) for name in SCENES if name.startswith("two Ni")},
}  # what is left out of each scene; of the others everything
PROOFS = {name: text for name, text in SCENES.items() if not name.startswith("two Ni")} | {
    "rod: Ni, 450 m/s": scene("Ni", 25, 450, more='shape = "rod"'),
    "hollow: Ni, 450 m/s": scene("Ni", 25, 450, more='shape = "hollow_sphere"'),
    "three Ni, 20 us between": scene(
        "Ni", 25, 500, more='dwell = "20 us"', after=following('dwell = "20 us"') + following()
    ),
}


def compute(text: str, effects: Effects) -> dict[str, float]:
    """Run a scene with these effects; its measures and the processor time of all of it (s)."""
    checked = Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study")
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        result = run(checked, Path(folder) / "run", threads=1)
        cpu = time.process_time() - start
        missing = [
            f"{key}: {result.refused.get(key, 'no value')}" for key in MEASURES.values() if getattr(result, key) is None
        ]
        if missing:
            raise SolverError(f"no effect can be measured without {'; '.join(missing)}")
        values = {name: float(getattr(result, key)) for name, key in MEASURES.items()}
        values |= {"cpu_s": cpu, "steps": float(result.steps), "drift": float(result.energy_drift)}
    return values


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


def costs(rounds: int) -> None:
    """Time of a step with everything on, and the share of it that leaving out an effect saves."""
    choices: dict[str, Effects] = {"everything on": "all", "auto": "auto", "none": "none"}
    choices |= {f"without {name}": ["all", f"-{name}"] for name in NAMES if name not in NEVER}
    least = least_of(rounds, SCENES["Ni on steel, 500 m/s"], choices, CROSSINGS)
    step = {name: sum(times) / (WINDOW * len(times)) for name, times in least.items()}
    whole = step["everything on"]
    rows = [{"effects": k, "ms_per_step": f"{1e3 * s:.4g}", "saves": f"{1.0 - s / whole:.4f}"} for k, s in step.items()]
    write_table(TABLES / "effects_costs.csv", rows, "remake: python workflows/effects_study.py --costs")


def study(table: StudyTable) -> None:
    """Leave out one effect at a time."""
    for name, text in SCENES.items():
        effects = ONLY.get(name, [effect for effect in NAMES if effect not in NEVER])
        wanted = [effect for effect in effects if (name, effect) not in table]
        if not wanted:
            continue
        numbers = _numbers(text)
        whole = compute(text, BASE)
        for effect in wanted:
            row: dict[str, object] = {"scene": name, "effect": effect, "number": numbers[effect]}
            try:
                values = compute(text, [*BASE, f"-{effect}"])
                row |= {**changes(values, whole), "steps": values["steps"], "drift": values["drift"]}
            except ColdsprayError as problem:
                row |= {"failed": str(problem)[:100]}
            print(table.add(row), flush=True)


def _numbers(text: str) -> dict[str, float]:
    return {row.name: row.value for row in plan(Scene.from_text(text, "effects_study")).effects.rows}


def proof(table: StudyTable, rounds: int) -> None:
    """Everything on against auto."""
    choices = {"all": "all", "auto": "auto"}
    for name, text in PROOFS.items():
        if (name,) in table:
            continue
        scene = Scene.from_text(text, "effects_study")
        single = len(scene.particles) == 1
        runs = [{which: compute(text, which) for which in choices} for _ in range(1 if single else max(rounds, 2))]
        if single:
            cpu = {which: sum(times) for which, times in least_of(rounds, text, choices, CROSSINGS).items()}
        else:  # pauses and splats are a part of it
            cpu = {which: min(times[which]["cpu_s"] for times in runs) for which in choices}
        row = {
            "scene": name, **changes(runs[0]["auto"], runs[0]["all"]), "cpu_all_s": cpu["all"], "cpu_auto_s": cpu["auto"],
            "ratio": cpu["all"] / cpu["auto"], "steps": runs[0]["auto"]["steps"],
            "left_out": " ".join(effect for effect in NAMES if effect not in plan(scene).effects.active),
        }  # fmt: skip
        print(table.add(row), flush=True)


def main() -> None:
    """Fill the tables."""
    a = options(__doc__, "proof", "costs", "docs", rounds=1)
    command = "python workflows/effects_study.py"
    influence = study_table("effects_study", STUDY_COLUMNS, ("scene", "effect"), command)
    against = study_table("effects_proof", PROOF_COLUMNS, ("scene",), f"{command} --proof")
    if a.docs:
        pass
    elif a.proof:
        proof(against, a.rounds)
    elif a.costs:
        costs(a.rounds)
    else:
        study(influence)
    write(influence, against)


def write(influence: StudyTable, against: StudyTable) -> None:
    """Write the tables into the page, and the one that `coldspray check` reads into the package."""
    now = {name: _numbers(text) for name, text in SCENES.items()}  # as the package defines them
    known = [row | {"number": f"{now[row['scene']][row['effect']]:.4g}"} for row in influence.rows if not row["failed"]]
    table = table_rows("effects_costs")
    saves = {row["effects"].removeprefix("without "): row["saves"] for row in table}
    rows = [{**row, "cost_share": saves.get(row["effect"], "")} for row in known]
    write_rows(PACKAGED, PACKAGED_COLUMNS, rows, "remake: python workflows/effects_study.py --docs")
    lines = [
        [marked(row["effects"], row), f"{number(row, 'ms_per_step'):.2f}", f"{100 * number(row, 'saves'):.1f} %"]
        for row in table
    ]
    write_parts(PAGES["effects"], {
        "thresholds": thresholds_part(known), "study": [*study_part(known), "", versions(known)],
        "costs": markdown("effects | ms per step | saves", lines), "proof": proof_part(against.rows),
    })  # fmt: skip


def largest_threshold(name: str, rows: Iterable[Mapping[str, str]]) -> float | None:
    """The largest threshold that the rows of the study allow; None for an effect without measured cases.

    Of the cases that changed something by more than LEFT_OUT those count whose number is within twice the smallest: a straight
    line from nothing at zero through each, the steepest of which reaches LEFT_OUT at what is returned. Influence grows at least in
    proportion to the number, so that below it is less. Where no case changed more, the largest number measured.
    """
    cases = [(float(row["number"]), worst_change(row)) for row in rows if row["effect"] == name]
    too_much = [(number, change) for number, change in cases if change > LEFT_OUT]
    if not too_much:
        return max((number for number, _ in cases), default=None)
    least = min(number for number, _ in too_much)
    return min(LEFT_OUT * number / change for number, change in too_much if number <= 2.0 * least)


def worst_change(row: Mapping[str, str]) -> float:
    """The largest change of any measure in a row of the study, in percent, without its sign."""
    return max(abs(float(row[measure])) for measure in ("flattening", "crater", "diameter", "T_mean", "T_p99"))


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
        allowed = largest_threshold(effect, rows) or 0.0
        case = [most["scene"], most["number"], f"{worst_change(most):.2f}"]
        lines.append([effect, f"{THRESHOLDS[effect].threshold:g}", f"{allowed:.2g}", *case])
    head = "effect | threshold | allowed by the line | the case that asks for most | its number | its largest change, %"
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
        cells = [f"{number(row, name):+.2f}" for name in MEASURES]
        cells += [f"{number(row, 'cpu_all_s'):.1f}", f"{number(row, 'cpu_auto_s'):.1f}", f"{number(row, 'ratio'):.2f}"]
        lines.append([marked(row["scene"], row), *cells, row["left_out"]])
    table = markdown(["scene", *MEASURES, "CPU all, s", "CPU auto, s", "ratio", "left out"], lines)
    if not rows:
        return table
    worst = max(abs(number(row, name)) for row in rows for name in MEASURES)
    ratios = [number(row, "ratio") for row in rows]
    spread = f"median ratio {np.median(ratios):.2f}, from {min(ratios):.2f} to {max(ratios):.2f}"
    return [*table, "", f"Largest change {worst:.2f} %; {spread}."]


if __name__ == "__main__":
    main()
