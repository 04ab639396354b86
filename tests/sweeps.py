"""Sweeps whose points are made up: what their runs leave behind, without a run."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np
from made_up_run import summary_of

from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text
from coupler.studies.runs import write_scene
from coupler.studies.sweep import Sweep

SHARED = {"preset": "draft", "substrate": {"material": "SS304"}}


def points(**changed: Any) -> dict[str, Any]:
    """A sweep of nickel as nested dicts, its points changed."""
    plain = {
        "material": ["Ni"],
        "diameter": ["10 um", "25 um"],
        "velocity": ["400 m/s", "700 m/s"],
        "temperature": ["300 K"],
    }
    return {"name": "few", "points": plain | changed, "scene": SHARED}


def scattered(places: Sequence[tuple[float, float]]) -> Sweep:
    """A sweep of single points of nickel at (diameter in um, velocity in m/s)."""
    each = [{"material": "Ni", "diameter": f"{D:.6g} um", "velocity": f"{v:.6g} m/s"} for D, v in places]
    return Sweep.from_dict({"name": "few", "points": each, "scene": SHARED})


def flattening(v: np.ndarray, D: np.ndarray) -> np.ndarray:
    return 0.8 * np.tanh(v / 600.0) + 0.03 * np.log(D / 25e-6)


def pretend(folder: Path, name: str, verdict: str | None = None, **measures: float) -> None:
    """Leave behind what a finished run of a point leaves for a map. Of a verdict "sticks" the restitution is zero."""
    scene = Scene.load(folder / f"{name}.toml")
    run = folder / name
    run.mkdir()
    (run / "scene.toml").write_text(scene.to_toml())
    decided = plan(scene)
    (run / "plan.json").write_text(plan_text(decided))
    own: dict[str, Any] = {"velocity_ratio": decided.impact.velocity_ratio, "verdict": verdict}
    own["restitution"] = 0.0 if verdict == "sticks" else 20.0 / scene.particle.velocity
    if verdict == "undecided":
        own |= {"restitution": None, "undecided": "the time limit came first"}
    (run / "summary.json").write_text(json.dumps(summary_of(own | {"end": measures})))
    (folder / f"{name}.json").write_text(json.dumps({"status": "done", "reason": "", "exit_code": 0}))


def made(folder: Path, whole: Sweep, critical: float | None = None) -> Path:
    """A sweep whose points are done, with the flattening that `flattening` says. critical: m/s, from which on they stick."""
    for name in whole.points:
        write_scene(folder, name, whole.points[name])
        p = Scene.load(folder / f"{name}.toml").particle
        verdict = None if critical is None else "sticks" if p.velocity >= critical else "rebounds"
        pretend(folder, name, verdict, flattening_ratio=float(flattening(np.array(p.velocity), np.array(p.diameter))))
    return folder
