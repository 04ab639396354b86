"""Sweeps whose points are made up: what their runs leave behind, without a run."""

import json
from pathlib import Path
from typing import Any

import numpy as np
from made_up_run import summary_of

from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text
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


def flattening(v: np.ndarray, D: np.ndarray) -> np.ndarray:
    return 0.8 * np.tanh(v / 600.0) + 0.03 * np.log(D / 25e-6)


def pretend(folder: Path, name: str, **measures: float) -> None:
    """Leave behind what a finished run of a point leaves for a map."""
    scene = Scene.load(folder / f"{name}.toml")
    run = folder / name
    run.mkdir()
    (run / "scene.toml").write_text(scene.to_toml())
    decided = plan(scene)
    (run / "plan.json").write_text(plan_text(decided))
    own = {"velocity_ratio": decided.impact.velocity_ratio, "restitution": 20.0 / scene.particle.velocity}
    (run / "summary.json").write_text(json.dumps(summary_of(own | {"end": measures})))
    (folder / f"{name}.json").write_text(json.dumps({"status": "done", "reason": "", "exit_code": 0}))


def made(folder: Path, whole: Sweep) -> Path:
    """A sweep whose points are done, with the flattening that `flattening` says."""
    for name in whole.points:
        whole.write(folder, name)
        p = Scene.load(folder / f"{name}.toml").particle
        pretend(folder, name, flattening_ratio=float(flattening(np.array(p.velocity), np.array(p.diameter))))
    return folder
