"""What a choice of the model changes: a scene with other strength sets or coefficients of friction, a coating with other seeds."""

import math
import tomllib
from collections.abc import Callable, Mapping
from pathlib import Path

from ..errors import ColdsprayError
from ..files.result import Result
from ..measures import CONVERGING, measure
from ..physics import materials
from ..plan.planning import plan
from ..plan.reading import Scene
from ..report.words import errors_of, shown
from .runs import run_points
from .table import in_columns

# Coulomb's coefficient: no friction, and sticking: at a pressure of the flow stress more would shear the metal (von Mises; Johnson &
# Mellor 1973, Engineering plasticity)
FRICTIONS = (0.0, round(1.0 / math.sqrt(3.0), 3))


def other_frictions(scene: Scene) -> dict[str, str]:
    """Name, such as "friction 0" -> the scene (TOML) with this coefficient of FRICTIONS; none where its effects leave friction out."""
    data = tomllib.loads(scene.to_toml())
    scenes = {
        f"friction {mu:g}": Scene.from_dict({**data, "contact": {"friction": mu}}, scene.name) for mu in FRICTIONS
    }
    if not any(plan(other).effects.friction for other in scenes.values()):
        return {}
    return {name: other.to_toml() for name, other in scenes.items() if other.contact.friction != scene.contact.friction}


def other_sets(scene: Scene) -> dict[str, str]:
    """Name, such as "Ni Steinberg_1996" -> the scene (TOML) with this set of one of its metals in place of its own. A metal whose law
    is the scene's own has no other."""
    data = tomllib.loads(scene.to_toml())
    scenes = {}
    for name in dict.fromkeys((scene.particles[-1].material, scene.substrate.material)):
        table = scene.materials.get(name, {})
        try:
            known = materials.entry(str(table.get("base", name)))
        except ColdsprayError:
            continue
        if "law" in table:
            continue
        for choice in known.sets:
            if choice != scene.derived.material(name).strength.set:
                changed = {**data, "materials": {**scene.materials, name: {**table, "strength": choice}}}
                scenes[f"{name} {choice}"] = Scene.from_dict(changed, scene.name).to_toml()
    return scenes


def compute(scenes: Mapping[str, str], folder: Path, jobs: int, log: Callable[[str], None]) -> dict[str, Result]:
    """Run the scenes in a folder, `jobs` at a time, unless they are there. Results by name, without those that fail."""
    points = {name: name.replace(" ", "_") for name in scenes}
    statuses = run_points(folder, {points[name]: text for name, text in scenes.items()}, jobs, log)
    return {name: Result(folder / point) for name, point in points.items() if statuses[point] == "done"}


#: choice of the model, and folder of its runs in that of the run -> the other scenes, and why there are none
SPREADS = {
    "strength": (other_sets, "the library has no other strength set for the metals of this scene"),
    "friction": (other_frictions, "the effects of this scene leave friction out"),
}


def lines(result: Result, others: Mapping[str, Result]) -> list[str]:
    """The measures of a run beside the least and the greatest of the others, as lines."""
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
    return [f"with {', '.join(others)}:", *in_columns(rows), f"verdicts with them: {counted}"]
