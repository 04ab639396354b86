"""Influence of a choice of the model: a scene with the other strength sets of its metals, or with other coefficients of friction."""

import math
from collections.abc import Mapping
from pathlib import Path

from ..files.result import Result
from ..measures import CONVERGING, measure
from ..plan.job import sets_of
from ..plan.planning import plan
from ..plan.reading import Scene
from ..report.words import errors_of, shown
from .runs import Log, results
from .table import in_columns

# Coulomb's coefficient: no friction, and sticking. At a contact pressure equal to the flow stress, a higher coefficient would shear the
# metal itself (von Mises; Johnson & Mellor 1973, Engineering plasticity).
FRICTIONS = (0.0, round(1.0 / math.sqrt(3.0), 3))


def other_frictions(scene: Scene) -> dict[str, str]:
    """The scenes (TOML) with each coefficient of FRICTIONS, by name, such as "friction 0". Empty if the effects of the scene exclude
    friction."""
    scenes = {f"friction {mu:g}": scene.with_(contact={"friction": mu}) for mu in FRICTIONS}
    if not any(plan(other).effects.friction for other in scenes.values()):
        return {}
    return {name: other.to_toml() for name, other in scenes.items() if other.contact.friction != scene.contact.friction}


def other_sets(scene: Scene) -> dict[str, str]:
    """The scenes (TOML) in which one metal has another strength set, by name, such as "Ni Steinberg_1996". A metal whose law is given
    in the scene has no other set."""
    scenes = {}
    for name in dict.fromkeys((scene.particles[-1].material, scene.substrate.material)):
        table = scene.materials.get(name, {})
        for choice in sets_of({key: value for key, value in table.items() if key != "strength"}, name):
            if choice != scene.derived.material(name).strength.set:
                scenes[f"{name} {choice}"] = scene.with_(materials={name: {"strength": choice}}).to_toml()
    return scenes


def compute(scenes: Mapping[str, str], folder: Path, jobs: int, log: Log) -> dict[str, Result]:
    """Run scenes (TOML by name) in a folder, `jobs` at the same time. Returns the results by name. Runs that fail or are undecided
    are left out."""
    found, _ = results(folder, {name.replace(" ", "_"): text for name, text in scenes.items()}, jobs, log)
    decided = {point: result for point, result in found.items() if result.undecided is None}
    return {name: decided[point] for name in scenes if (point := name.replace(" ", "_")) in decided}


# choice of the model, which names the folder of its runs -> the function that makes the other scenes, message if there are none
SPREADS = {
    "strength": (other_sets, "the library has no other strength set for the metals of this scene"),
    "friction": (other_frictions, "the effects of this scene exclude friction"),
}


def lines(result: Result, others: Mapping[str, Result]) -> list[str]:
    """Text lines: each measure of a run with its smallest and largest value in the other runs, and the verdicts of the other runs."""
    rows: list[tuple[str, ...]] = [("", "this run", "least", "most", "")]
    errors = errors_of(result.summary)
    for key in CONVERGING:
        found = {name: float(other.values[key]) for name, other in others.items() if other.values.get(key) is not None}
        if found and result.values.get(key) is not None:
            names = (end(found, key=found.__getitem__) for end in (min, max))
            ends = [f"{shown(key, found[name])} ({name})" for name in names]
            rows.append((measure(key).label, shown(key, result.values[key], errors.get(key)), *ends, measure(key).unit))
    verdicts = [str(other.values.get("verdict")) for other in others.values()]
    counted = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
    return [f"with {', '.join(others)}:", *in_columns(rows), f"verdicts of these runs: {counted}"]
