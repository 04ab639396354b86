"""What each effect changes, and what `auto` saves.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # everything on against auto, twelve scenes at draft: docs/tables/effects_proof.csv
    python workflows/effects_study.py --docs     # runs nothing: writes the page

Rows in the tables of changes are not computed again. Times are processor time of one thread. What is compared goes on in turn, so that
other work on the machine slows down all alike, and the least of several rounds (--rounds N) counts.
"""

import json
import math
import time
from collections.abc import Mapping, Sequence
from functools import cache

import numpy as np
from pages import computed, fill, markdown, number, options, single_impact, spacing_of, study_table, write_parts

from coupler import Scene
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.measures import CONVERGING, measure
from coupler.plan.effects import EFFECTS, GRADIENTS
from coupler.plan.planning import plan
from coupler.scene.effects import NAMES
from coupler.studies.table import Row, StudyTable

STUDY_COLUMNS = ("scene", "effect", "number", *CONVERGING)
PROOF_COLUMNS = ("scene", "cpu_all_s", "cpu_auto_s", "ratio", "left_out")
SHOWN = {"flattening_ratio": "flattening", "eps_p_mean": "mean strain", "T_p99_K": "T rise 99 %"}
# not left out of a scene that does not ask for it: of no meaning to a single impact, or to one without bonds by exposure
NEVER = ("adhesion", "cooling", GRADIENTS)
FLOW = ("temperature_dependent_k", "conduction", "particle_conduction", "interface_conduction")
CROSSINGS = 1.5  # D/v: how far impacts are followed where their time is measured


def scene(metal: str, diameter: float, velocity: float, base: str = "SS304", more: str = "", points: int = 500) -> str:
    """A scene of so many points (0: by preset) in a particle of so many um and m/s. more: of the particle."""
    text = single_impact(metal, diameter, velocity, base, spacing_of(points, diameter) if points else 0.0)
    size = f'\ndiameter = "{8 * diameter:g} um"\nheight = "{4 * diameter:g} um"\n'
    return text.replace("[substrate]\n", f"{more}\n[substrate]").replace("[substrate]", f"[substrate]{size}")


def sequence(*dwells: str, points: int = 500) -> str:
    """Nickel particles of 25 um, one more than the pauses between them."""
    text = scene("Ni", 25, 500, more=f'dwell = "{dwells[0]}"', points=points)
    later = [f'[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "500 m/s"\n{dwell}\n'
             for dwell in (*(f'dwell = "{dwell}"' for dwell in dwells[1:]), "")]  # fmt: skip
    ending = '[adhesion]\nkind = "tied"\n[end]\nat = "rest"\n'
    return text.replace("[substrate]", f"{''.join(later)}{ending}[substrate]")


def exposing(metal: str, diameter: float, velocity: float) -> str:
    """A particle on its own metal, with bonds by exposure."""
    bonds = '[adhesion]\nkind = "cohesive"\ncriterion = "exposure"\n'
    return f"{scene(metal, diameter, velocity, metal)}\n{bonds}"


EACH = tuple(name for name in NAMES if name not in NEVER)
STUDIES = {  # scene: its text, what is left out of it
    "Ni on steel, 500 m/s": (scene("Ni", 25, 500), EACH),
    "Cu on Cu, 500 m/s": (scene("OFHC_Cu", 25, 500, "OFHC_Cu"), FLOW),
    "Ni 5 um, 200 m/s": (scene("Ni", 5, 200), FLOW),
    "Ni 190 um, 300 m/s": (scene("Ni", 190, 300), FLOW),
    **{f"two Ni, {pause} between": (sequence(pause), ("cooling",)) for pause in ("10 ns", "100 ns", "1 us")},
    "bonds by exposure: Ni 10 um, 660 m/s": (exposing("Ni", 10, 660), (GRADIENTS,)),
    "bonds by exposure: Ni 40 um, 660 m/s": (exposing("Ni", 40, 660), (GRADIENTS,)),
    "bonds by exposure: Cu 14 um, 570 m/s": (exposing("OFHC_Cu", 14, 570), (GRADIENTS,)),
    "bonds by exposure: Al 22 um, 620 m/s": (exposing("Al1100", 22, 620), (GRADIENTS,)),
}
PROOFS = {
    "Ni 25 um on steel, 500 m/s": scene("Ni", 25, 500, points=0),
    "Ni 5 um on steel, 200 m/s": scene("Ni", 5, 200, points=0),
    "Ni 190 um on steel, 300 m/s": scene("Ni", 190, 300, points=0),
    "Ni 40 um on steel, 150 m/s": scene("Ni", 40, 150, points=0),
    "Cu 20 um on steel, 450 m/s": scene("OFHC_Cu", 20, 450, points=0),
    "Cu 30 um on Cu, 400 m/s": scene("OFHC_Cu", 30, 400, "OFHC_Cu", points=0),
    "Al 25 um on Al, 500 m/s": scene("Al", 25, 500, "Al", points=0),
    "Ti 30 um at 500 K on Ti, 600 m/s": scene("Ti", 30, 600, "Ti", 'temperature = "500 K"', points=0),
    "Ti 15 um on Al, 450 m/s": scene("Ti", 15, 450, "Al", points=0),
    "Ni 25 um at 600 K, 400 m/s": scene("Ni", 25, 400, more='temperature = "600 K"', points=0),
    "SS316L 35 um at 30 degrees, 500 m/s": scene("SS316L", 35, 500, more='angle = "30 deg"', points=0),
    "two Ni 25 um, 20 us between": sequence("20 us", points=0),
}


def compute(text: str) -> dict[str, float]:
    """Run a scene: its measures at its end, temperatures as their rise, and `cpu_s`, the processor time of all of it. A measure outside
    its range is nan."""
    checked = Scene.from_text(text, "effects_study")
    with computed(checked) as (result, cpu):
        last, T_0 = result.impacts[-1], checked.particles[-1].temperature
    end = {**last, **last["end"]}
    end["rebound_velocity_m_s"] = max(end["velocity_z_m_s"], 0.0)  # also of a particle that is tied at its end
    values = {
        key: float(end[key]) - measure(key).initial(T_0) if end.get(key) is not None else math.nan for key in CONVERGING
    }
    return values | {"cpu_s": cpu}


def study(table: StudyTable) -> None:
    """Leave out one effect at a time."""

    @cache
    def whole(name: str) -> dict[str, float]:
        return compute(f"effects = {json.dumps(base(name))}\n{STUDIES[name][0]}")

    def base(name: str) -> list[str]:
        return ["all", f"+{GRADIENTS}"] if GRADIENTS in STUDIES[name][1] else ["all"]

    def row_of(name: str, effect: str) -> dict[str, object]:
        """Changes in percent of what it is with everything on; nan where that is 0."""
        text = STUDIES[name][0]
        numbers = {row.name: row.value for row in plan(Scene.from_text(text, "effects_study")).decisions}
        values = compute(f"effects = {json.dumps([*base(name), f'-{effect}'])}\n{text}")
        changes = {key: 100.0 * (values[key] / (whole(name)[key] or math.nan) - 1.0) for key in CONVERGING}
        return {"number": f"{numbers[effect]:.4g}", **changes}

    fill(table, ((name, effect) for name, (_, effects) in STUDIES.items() for effect in effects), row_of)


def in_turn(scenes: Mapping[str, str], rounds: int) -> dict[str, Sequence[float]]:
    """Processor time (s) of each ten steps of impacts that differ in their effects, until CROSSINGS x D/v, the least of some rounds.

    They go on in turn, ten steps of each at a time. The first ten are left out: they load compiled code.
    """
    least: dict[str, Sequence[float]] = {}
    for _ in range(rounds):
        costs: dict[str, list[float]] = {name: [] for name in scenes}
        planned = {name: plan(Scene.from_text(text, "effects_study")) for name, text in scenes.items()}
        impacts = {name: Impact(build_domains(each)) for name, each in planned.items()}
        first = next(iter(planned.values())).impact
        end = CROSSINGS * first.diameter / float(np.linalg.norm(first.velocity))
        while going := {name: impact for name, impact in impacts.items() if impact.time < end}:
            for name, impact in going.items():
                start = time.process_time()
                advance_chunk(impact)
                costs[name].append(time.process_time() - start)
        for name, impact in impacts.items():
            impact.particle.close()
            least[name] = np.minimum(costs[name][1:], least.get(name, np.inf))
    return least


def proof(name: str, rounds: int) -> dict[str, object]:
    """Everything that can act against `auto`, at draft: steps of single impacts in turn, a sequence as whole runs in turn."""
    texts = {effects: f'preset = "draft"\neffects = "{effects}"\n{PROOFS[name]}' for effects in ("all", "auto")}
    planned = plan(Scene.from_text(texts["auto"], "effects_study"))
    if len(planned.impacts) == 1:
        cpu = {key: float(np.sum(costs)) for key, costs in in_turn(texts, rounds).items()}
    else:
        pairs = [{key: compute(each)["cpu_s"] for key, each in texts.items()} for _ in range(rounds + 1)]
        cpu = {key: min(pair[key] for pair in pairs[1:]) for key in texts}  # the first ones compile
    left_out = " ".join(row.name for row in planned.decisions if not row.on)
    return {"cpu_all_s": cpu["all"], "cpu_auto_s": cpu["auto"], "ratio": cpu["all"] / cpu["auto"], "left_out": left_out}


def main() -> None:
    """Fill the tables."""
    a = options(__doc__, "proof", "docs", rounds=2)
    command = "python workflows/effects_study.py"
    influence = study_table("effects_study", STUDY_COLUMNS, ("scene", "effect"), command)
    against = study_table("effects_proof", PROOF_COLUMNS, ("scene",), f"{command} --proof")
    if a.proof:
        fill(against, ((name,) for name in PROOFS), lambda name: proof(name, a.rounds))
    elif not a.docs:
        study(influence)
    write(influence.rows, against.rows)


def write(influence: list[Row], against: list[Row]) -> None:
    """Write the table of effects and what `auto` saves into the page."""
    lines = []
    for effect in EFFECTS:
        own = [row for row in influence if row["effect"] == effect.name]
        span = sorted(number(row, "number") for row in own)
        cells = [max((abs(number(row, key)) for row in own), default=math.nan) for key in SHOWN]
        lines.append([
            effect.name, effect.number, " to ".join(dict.fromkeys(f"{value:.2g}" for value in span[:: max(len(span) - 1, 1)])) or "-",
            *("-" if math.isnan(cell) else f"{cell:.1f}" for cell in cells), f"{effect.threshold:g}",
        ])  # fmt: skip
    head = ["effect", "number", "of the scenes", *(f"{name}, %" for name in SHOWN.values()), "threshold"]
    ratios = [number(row, "ratio") for row in against]
    median = f"Median {np.median(ratios):.2f}, from {min(ratios):.2f} to {max(ratios):.2f}." if ratios else ""
    write_parts("effects", {
        "table": markdown(head, lines, influence),
        "proof": [median],
    })  # fmt: skip


if __name__ == "__main__":
    main()
