"""What each effect changes, and what `auto` saves.

    python workflows/effects_study.py            # one effect left out at a time: docs/tables/effects_study.csv
    python workflows/effects_study.py --proof    # time of all effects over that of auto, scenes at draft: docs/tables/effects_proof.csv
    python workflows/effects_study.py --docs     # runs nothing: writes the page

Rows in the tables are not computed again. Times are processor time of one thread. Compared runs advance in turn, so that other work
on the machine slows down all of them equally; the least time of several rounds (--rounds N) counts.
"""

import math
import time
from collections.abc import Mapping, Sequence
from functools import cache, partial
from typing import Any

import numpy as np
from pages import computed, drawing, impact_tables, markdown, options, spacing_of, write_parts
from study_table import REMAKE, Row, measurements, number, study

from coupler import Scene
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.measures import CONVERGING, measure
from coupler.plan.effects import EFFECTS, GRADIENTS
from coupler.plan.planning import plan
from coupler.scene.effects import NAMES

SHOWN = {"flattening_ratio": "flattening", "eps_p_mean": "mean strain", "T_p99_K": "T rise 99 %"}
# left out only in some scenes: these effects do nothing in a single impact, or without bonds by exposure
NEVER = ("adhesion", "cooling", "recovery", GRADIENTS)
FLOW = ("temperature_dependent_k", "conduction", "particle_conduction", "interface_conduction")
Tables = dict[str, Any]
LEAST = 0.05  # %: bars of smaller changes end here
CROSSINGS = 1.5  # in units of D/v: duration of the impacts whose processor time is measured


def tables(metal: str, diameter: float, velocity: float, base: str = "SS304", points: int = 500, **more: str) -> Tables:
    """The scene of an impact; um, m/s. points: number of points (0: by preset); more: further keys of the particle."""
    spacing = spacing_of(points, diameter) if points else 0.0
    return impact_tables(metal, diameter, velocity, base, (8 * diameter, 4 * diameter), spacing, **more)


def sequence(dwell: str, points: int = 500) -> Tables:
    """Two nickel particles of 25 um with a pause between them."""
    first = tables("Ni", 25, 500, dwell=dwell, points=points)
    later = {key: value for key, value in first["particle"].items() if key != "dwell"}
    return first | {"particle": [first["particle"], later], "adhesion": {"kind": "tied"}, "end": {"at": "rest"}}


def exposing(metal: str, diameter: float, velocity: float) -> Tables:
    """A particle on its own metal, with bonds by exposure."""
    return tables(metal, diameter, velocity, metal) | {"adhesion": {"kind": "cohesive", "criterion": "exposure"}}


EACH = tuple(name for name in NAMES if name not in NEVER)
STUDIES = {  # name: the scene, what is left out of it
    "Ni on steel, 500 m/s": (tables("Ni", 25, 500), EACH),
    "Cu on Cu, 500 m/s": (tables("OFHC_Cu", 25, 500, "OFHC_Cu"), FLOW),
    "Ni 5 um, 200 m/s": (tables("Ni", 5, 200), FLOW),
    "Ni 190 um, 300 m/s": (tables("Ni", 190, 300), FLOW),
    **{f"two Ni, {pause} between": (sequence(pause), ("cooling",)) for pause in ("10 ns", "100 ns", "1 us")},
    "bonds by exposure: Ni 10 um, 660 m/s": (exposing("Ni", 10, 660), (GRADIENTS,)),
    "bonds by exposure: Ni 40 um, 660 m/s": (exposing("Ni", 40, 660), (GRADIENTS,)),
    "bonds by exposure: Cu 14 um, 570 m/s": (exposing("OFHC_Cu", 14, 570), (GRADIENTS,)),
    "bonds by exposure: Al 22 um, 620 m/s": (exposing("Al1100", 22, 620), (GRADIENTS,)),
}
PROOFS = {name: tables(**said, points=0) for name, said in measurements("effects", "scenes").items()}
PROOFS["two Ni 25 um, 20 us between"] = sequence("20 us", points=0)


def compute(effects: str | list[str], said: Tables) -> dict[str, float]:
    """Run a scene. Returns its measures at the end (nan if none; temperatures as their rise), and the processor time `cpu_s`."""
    checked = Scene.from_dict({"effects": effects, **said}, "effects_study")
    with computed(checked) as (result, cpu):
        last, T_0 = result.impacts[-1], checked.particles[-1].temperature
    end = {**last, **last["end"]}
    end["rebound_velocity_m_s"] = max(end["velocity_z_m_s"], 0.0)  # also of a particle that is tied at its end
    known = [key for key in CONVERGING if end.get(key) is not None]
    values = dict.fromkeys(CONVERGING, math.nan) | {k: float(end[k]) - measure(k).initial(T_0) for k in known}
    return values | {"cpu_s": cpu}


def influence(docs: bool) -> list[Row]:
    """The table of changes: one effect left out at a time. docs: compute none."""

    @cache
    def whole(name: str) -> dict[str, float]:
        return compute(base(name), STUDIES[name][0])

    def base(name: str) -> list[str]:
        return ["all", f"+{GRADIENTS}"] if GRADIENTS in STUDIES[name][1] else ["all"]

    def row_of(name: str, effect: str) -> dict[str, object]:
        """Changes of the measures, in percent of their values with all effects on; nan if a value is 0."""
        said = STUDIES[name][0]
        numbers = {row.name: row.value for row in plan(Scene.from_dict(said, "effects_study")).decisions}
        values = compute([*base(name), f"-{effect}"], said)
        changes = {key: 100.0 * (values[key] / (whole(name)[key] or math.nan) - 1.0) for key in CONVERGING}
        return {"number": f"{numbers[effect]:.4g}", **changes}

    keys = ((name, effect) for name, (_, effects) in STUDIES.items() for effect in effects)
    return study("effects_study", ("scene", "effect"), () if docs else keys, row_of).rows


def in_turn(scenes: Mapping[str, Scene], rounds: int) -> dict[str, Sequence[float]]:
    """Processor time (s) of each ten steps of impacts that differ in their effects, until CROSSINGS x D/v; the least of all rounds.

    The impacts advance in turn, ten steps at a time. The first ten steps do not count: they load compiled code.
    """
    least: dict[str, Sequence[float]] = {}
    for _ in range(rounds):
        costs: dict[str, list[float]] = {name: [] for name in scenes}
        planned = {name: plan(each) for name, each in scenes.items()}
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
    """Time of all effects and of `auto`, at draft: of the steps of single impacts, or of whole runs of a sequence, in turn."""
    said = PROOFS[name] | {"preset": "draft"}
    scenes = {each: Scene.from_dict({"effects": each, **said}, "effects_study") for each in ("all", "auto")}
    if len(scenes["auto"].particles) == 1:
        cpu = {key: float(np.sum(costs)) for key, costs in in_turn(scenes, rounds).items()}
    else:
        pairs = [{each: compute(each, said)["cpu_s"] for each in scenes} for _ in range(rounds + 1)]
        cpu = {key: min(pair[key] for pair in pairs[1:]) for key in scenes}  # the first ones compile
    left_out = " ".join(row.name for row in plan(scenes["auto"]).decisions if not row.on)
    return {"cpu_all_s": cpu["all"], "cpu_auto_s": cpu["auto"], "ratio": cpu["all"] / cpu["auto"], "left_out": left_out}


def draw(largest: Mapping[str, list[float]]) -> None:
    """Bars of the largest changes of each effect, on a logarithmic axis."""
    with drawing("effects", 7.0, 4.2, "constrained") as figure:
        axis = figure.add_subplot()
        for k, (name, colour) in enumerate(zip(SHOWN.values(), ("#0072b2", "#d55e00", "#009e73"), strict=True)):
            places = np.arange(len(largest)) + 0.27 * (k - 1)
            axis.barh(places, [max(cells[k], LEAST) for cells in largest.values()], 0.27, color=colour, label=name)
        axis.set_yticks(range(len(largest)), list(largest), fontsize=8)
        axis.set(xscale="log", xlim=(LEAST, 100.0), xlabel="largest change without the effect (%)")
        axis.xaxis.set_major_formatter("{x:g}")
        axis.invert_yaxis()
        axis.legend(fontsize=8, ncols=3, loc="lower center", bbox_to_anchor=(0.5, 1.0))


def write(changes: list[Row], against: list[Row]) -> None:
    """Write the table of the effects, the time that `auto` saves and the figure into the page."""
    lines, largest = [], {}
    for effect in EFFECTS:
        own = [row for row in changes if row["effect"] == effect.name]
        cells = [max((abs(number(row, key)) for row in own), default=math.nan) for key in SHOWN]
        if own:
            largest[effect.name] = cells
            lines.append([effect.name, effect.number, *(f"{cell:.1f}" for cell in cells), f"{effect.threshold:g}"])
    head = ["effect", "number", *(f"{name}, %" for name in SHOWN.values()), "threshold"]
    ratios = [number(row, "ratio") for row in against]
    spread = f"median of {len(ratios)} scenes at `draft`; {min(ratios):.2f} to {max(ratios):.2f}" if ratios else ""
    saved = f"All effects take {np.median(ratios):.2f} times the time of `auto` ({spread})." if ratios else ""
    draw(largest)
    write_parts("effects", {"table": markdown(head, lines, changes), "proof": [saved]})


if __name__ == "__main__":
    a = options(__doc__, "proof", "docs", rounds=2)
    proofs = ((name,) for name in PROOFS) if a.proof else ()
    against = study("effects_proof", ("scene",), proofs, partial(proof, rounds=a.rounds), remake=f"{REMAKE} --proof")
    write(influence(a.docs or a.proof), against.rows)
