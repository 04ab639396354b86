"""What each effect changes, and what `auto` changes and saves.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # everything on against auto at draft: docs/tables/effects_proof.csv
    python workflows/effects_study.py --costs    # time of a step, and the share that leaving out saves: docs/tables/effects_costs.csv
    python workflows/effects_study.py --docs     # runs nothing: writes the page

Rows in the tables of changes are not computed again. Costs are processor time of one thread, of impacts that go on in turn, so that
other work on the machine slows them down alike; of each ten steps the least of several rounds (--rounds N) counts.
"""

import json
import math
import tempfile
import time
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from pages import (
    PAGES,
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
from coupler.errors import ColdsprayError
from coupler.impact.domains import build_domains
from coupler.impact.exchange import WINDOW, Impact
from coupler.impact.loop import advance_window
from coupler.measures import CONVERGING, MEASURES, measure
from coupler.plan.effects import GRADIENTS, THRESHOLDS
from coupler.plan.planning import plan
from coupler.scene.effects import NAMES
from coupler.studies.table import Row, StudyTable

Effects = str | list[str]
STUDY_COLUMNS = ("scene", "effect", "number", *CONVERGING, "steps", "drift", "failed")
PROOF_COLUMNS = (
    "scene", *CONVERGING, "failed", "cpu_all_s", "cpu_auto_s", "ratio", "time_all_s", "time_auto_s", "left_out",
)  # fmt: skip
BASE = ["all", f"-{GRADIENTS}"]
# not left out of a scene that does not ask for it: of no meaning to a single impact, or to one without bonds by exposure
NEVER = ("adhesion", "cooling", GRADIENTS)
CROSSINGS = 1.5  # D/v: how far impacts are followed where their time is measured


def scene(metal: str, diameter: float, velocity: float, base: str = "SS304", more: str = "", after: str = "") -> str:
    """A scene of about 500 points in a particle of so many um and m/s. more: of the particle; after: further particles."""
    size = f'diameter = "{8 * diameter:g} um"\nheight = "{4 * diameter:g} um"\n'
    text = single_impact(metal, diameter, velocity, base, spacing_of(500, diameter))
    tied = '[adhesion]\nkind = "tied"\n[end]\nat = "rest"\n' if after else ""
    text = text.replace("[substrate]\n", f"{more}\n{after}{tied}[substrate]\n")
    return text.replace("[resolution]", f"{size}[resolution]")


def exposing(metal: str, diameter: float, velocity: float) -> str:
    """A particle on its own metal, with bonds by exposure."""
    bonds = '[adhesion]\nkind = "cohesive"\ncriterion = "exposure"\n'
    return f"{scene(metal, diameter, velocity, metal)}\n{bonds}"


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
    "bonds by exposure: Ni 10 um, 660 m/s": exposing("Ni", 10, 660),
    "bonds by exposure: Ni 40 um, 660 m/s": exposing("Ni", 40, 660),
    "bonds by exposure: Cu 14 um, 570 m/s": exposing("OFHC_Cu", 14, 570),
    "bonds by exposure: Al 22 um, 620 m/s": exposing("Al1100", 22, 620),
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
    **{name: (GRADIENTS,) for name in SCENES if name.startswith("bonds")},
}  # what is left out of each scene; of the others everything
PROOFS = {name: text for name, text in SCENES.items() if not name.startswith(("two Ni", "bonds"))} | {
    "rod: Ni, 450 m/s": scene("Ni", 25, 450, more='shape = "rod"'),
    "hollow: Ni, 450 m/s": scene("Ni", 25, 450, more='shape = "hollow_sphere"'),
    "not in the study: Cu on steel, 600 m/s": scene("OFHC_Cu", 20, 600),
    "not in the study: Ti at 500 K on Al, 450 m/s": scene("Ti", 35, 450, "Al", more='temperature = "500 K"'),
    "not in the study: Al on Al, 650 m/s": scene("Al", 30, 650, "Al"),
    "three Ni, 20 us between": scene(
        "Ni", 25, 500, more='dwell = "20 us"', after=following('dwell = "20 us"') + following()
    ),
}


def compute(text: str, effects: Effects) -> dict[str, float]:
    """Run a scene with these effects: its measures at its end, temperatures as their rise; the processor time of all of it (s). A
    measure outside its range is nan."""
    checked = Scene.from_text(f"effects = {json.dumps(effects)}\n{text}", "effects_study")
    start = time.process_time()
    with tempfile.TemporaryDirectory() as folder:
        result = run(checked, Path(folder) / "run", threads=1)
        cpu = time.process_time() - start
        last, T_0 = result.impacts[-1], checked.particles[-1].temperature
        end = {**last, **last["end"]}
        end["rebound_velocity_m_s"] = max(end["velocity_z_m_s"], 0.0)  # also of a particle that is tied at its end
        values = {
            key: float(end[key]) - measure(key).initial(T_0) if end.get(key) is not None else math.nan
            for key in (*CONVERGING, "time_s")
        }
        values |= {"cpu_s": cpu, "steps": float(result.steps), "drift": float(result.energy_drift)}
    return values


def in_turn(scenes: Mapping[str, str], crossings: float) -> dict[str, list[float]]:
    """Processor time (s) of each ten steps of impacts that differ in their effects, until crossings x D/v.

    They go on in turn, ten steps of each at a time. The first ten are left out: they load compiled code.
    """
    impacts, end = {}, 0.0
    for name, text in scenes.items():
        planned = plan(Scene.from_text(text, "effects_study"))
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
    return {name: seconds[1:] for name, seconds in costs.items()}


def least_of(rounds: int, scenes: Mapping[str, str], crossings: float) -> dict[str, list[float]]:
    """`in_turn` several times: of each ten steps the least."""
    least: dict[str, list[float]] = {}
    for _ in range(rounds):
        for name, costs in in_turn(scenes, crossings).items():
            least[name] = [min(pair) for pair in zip(least.get(name, costs), costs, strict=True)]
    return least


def changes(values: dict[str, float], whole: dict[str, float]) -> dict[str, float]:
    """Change of each measure in percent of what it is with everything on; nan where that is 0."""
    return {key: 100.0 * (values[key] / (whole[key] or math.nan) - 1.0) for key in CONVERGING}


def costs(rounds: int) -> None:
    """Time of a step with everything on, and the share of it that leaving out an effect saves."""
    choices: dict[str, Effects] = {"everything on": BASE, "none": "none"}
    choices |= {f"without {name}": [*BASE, f"-{name}"] for name in NAMES if name not in NEVER}
    rows = shares("Ni on steel, 500 m/s", choices, rounds)
    with_bonds: dict[str, Effects] = {"everything on, bonds by exposure": "all", f"without {GRADIENTS}": BASE}
    rows += shares("bonds by exposure: Ni 10 um, 660 m/s", with_bonds, rounds)
    write_table(TABLES / "effects_costs.csv", rows, "remake: python workflows/effects_study.py --costs")


def shares(name: str, choices: Mapping[str, Effects], rounds: int) -> list[dict[str, object]]:
    """Rows of the table of costs: choices of effects for the scene of this name, each beside the first of them."""
    scenes = {key: f"effects = {json.dumps(effects)}\n{SCENES[name]}" for key, effects in choices.items()}
    step = {key: sum(times) / (WINDOW * len(times)) for key, times in least_of(rounds, scenes, CROSSINGS).items()}
    whole = next(iter(step.values()))
    return [{"effects": k, "ms_per_step": f"{1e3 * s:.4g}", "saves": f"{1.0 - s / whole:.4f}"} for k, s in step.items()]


def study(table: StudyTable) -> None:
    """Leave out one effect at a time."""
    for name, text in SCENES.items():
        effects = ONLY.get(name, [effect for effect in NAMES if effect not in NEVER])
        wanted = [effect for effect in effects if (name, effect) not in table]
        if not wanted:
            continue
        numbers = _numbers(text)
        base = ["all"] if GRADIENTS in effects else BASE
        whole = compute(text, base)
        for effect in wanted:
            row: dict[str, object] = {"scene": name, "effect": effect, "number": numbers[effect]}
            try:
                values = compute(text, [*base, f"-{effect}"])
                row |= {**changes(values, whole), "steps": values["steps"], "drift": values["drift"]}
            except ColdsprayError as problem:
                row |= {"failed": str(problem)[:100]}
            print(table.add(row), flush=True)


def _numbers(text: str) -> dict[str, float]:
    return {row.name: row.value for row in plan(Scene.from_text(text, "effects_study")).decisions}


def proof(table: StudyTable, rounds: int) -> None:
    """Everything that can act against auto, at draft."""
    for name, text in PROOFS.items():
        if (name,) in table:
            continue
        text = f'preset = "draft"\n{text}'
        rows = plan(Scene.from_text(text, "effects_study")).decisions
        cannot = [
            r.name for r in rows if r.name in ("absorbing_boundaries", "cooling") and r.value <= THRESHOLDS[r.name]
        ]
        everything = [*BASE, *(f"-{name}" for name in cannot)]
        scenes = {"all": f"effects = {json.dumps(everything)}\n{text}", "auto": text}
        step = {key: sum(times) for key, times in least_of(rounds, scenes, CROSSINGS).items()}
        row: dict[str, object] = {"scene": name, "left_out": " ".join(row.name for row in rows if not row.on)}
        try:
            whole, values = compute(text, everything), compute(text, "auto")
        except ColdsprayError as problem:
            row |= {"failed": str(problem)[:100]}
        else:
            times = {"time_all_s": whole["time_s"], "time_auto_s": values["time_s"]}
            cpu = step["all"] * whole["time_s"], step["auto"] * values["time_s"]
            row |= {
                **changes(values, whole),
                **times,
                "cpu_all_s": cpu[0],
                "cpu_auto_s": cpu[1],
                "ratio": cpu[0] / cpu[1],
            }
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
    """Write the tables into the page."""
    now = {name: _numbers(text) for name, text in SCENES.items()}  # as the package defines them
    known = [row | {"number": f"{now[row['scene']][row['effect']]:.4g}"} for row in influence.rows if not row["failed"]]
    table = table_rows("effects_costs")
    lines = [
        [marked(row["effects"], row), f"{number(row, 'ms_per_step'):.2f}", f"{100 * number(row, 'saves'):.1f} %"]
        for row in table
    ]
    parts = {"gradients": [], "study": []}
    for row in known:
        parts["gradients" if row["effect"] == GRADIENTS else "study"].append(row)
    write_parts(PAGES["effects"], {
        **{name: [*study_part(own), "", versions(own)] for name, own in parts.items()},
        "costs": markdown("effects | ms per step | saves", lines), "proof": proof_part(against.rows),
    })  # fmt: skip


def study_part(rows: list[Row]) -> list[str]:
    """The change of each measure, in percent, by effect and its number."""
    effects = list(dict.fromkeys(row["effect"] for row in rows))
    ordered = sorted(rows, key=lambda row: (effects.index(row["effect"]), float(row["number"])))
    lines = [
        [row["effect"], marked(row["scene"], row), row["number"], *(f"{number(row, name):+.2f}" for name in CONVERGING)]
        for row in ordered
    ]
    return markdown(["left out", "scene", "number", *(MEASURES[name].short for name in CONVERGING)], lines)


def proof_part(rows: list[Row]) -> list[str]:
    """Everything on against auto: changes in percent and processor time."""
    lines = []
    for row in rows:
        cells = (
            [row["failed"]] * len(CONVERGING) if row["failed"] else [f"{number(row, name):+.2f}" for name in CONVERGING]
        )
        ratio = "-" if row["failed"] else f"{number(row, 'ratio'):.2f}"
        lines.append([marked(row["scene"], row), *cells, ratio, row["left_out"].replace("_", " ")])
    head = ["scene", *(MEASURES[name].short for name in CONVERGING), "time, ratio", "left out"]
    ratios = [number(row, "ratio") for row in rows if not row["failed"]]
    text = f"Median ratio {np.median(ratios):.2f}, from {min(ratios):.2f} to {max(ratios):.2f}." if ratios else ""
    return [*markdown(head, lines), "", text]


if __name__ == "__main__":
    main()
