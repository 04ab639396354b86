"""The speed of this machine, measured once (`timing.measure`) and kept in the user's cache folder.

`coupler.plan.cost` has the costs of steps, elements and points of the machine on which its constants were fitted. Two factors
transfer them to this one: for the cost of a step and its elements, and for that of its points.
"""

from __future__ import annotations

import json
import platform
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TypedDict

from .. import __version__
from ..caches import user_folder
from ..errors import ColdsprayError, StoreError
from ..files.inputs import read_json_object
from ..files.outputs import write_text
from ..files.provenance import processor
from ..plan import cost
from ..plan.planning import Plan

FACTORS = (0.05, 50.0)  # limits of what is accepted
USUAL = (1000.0, 5000.0)  # points and elements of a step that stands for all that is no step


@dataclass(frozen=True)
class Pace:
    """Times on this machine over those of the constants of `plan.cost`. steps: of a step and its elements; points: of the points
    of a step; source: the origin of both, for messages."""

    steps: float
    points: float
    source: str

    def seconds(self, plan: Plan) -> float:
        """Processor time of a plan in one thread here, s."""
        own = cost.step_time(1.0, USUAL[1]), cost.point_time(1.0, USUAL[0], cost.TIMED_ENGINE)
        of_all_else = (self.steps * own[0] + self.points * own[1]) / sum(own)
        return plan.cost.steps * self.steps + plan.cost.points * self.points + plan.cost.rest * of_all_else


def of_this_machine(measure: Callable[[], tuple[float, float]], anew: bool = False) -> Pace:
    """The pace of this machine, from the cache or measured now (some seconds; half a minute where kernels have to be compiled).

    measure: `timing.measure`, called where the cache has nothing, and with `anew`. Where the small impacts cannot be computed the
    factors are 1 and `source` has the reason.
    """
    path, key = user_folder() / "pace.json", machine()
    known = _read(path)
    if not anew and key in known:
        return _pace(known[key])
    try:
        steps, points = measure()
    except (ColdsprayError, ImportError, OSError) as error:
        return Pace(1.0, 1.0, f"of another machine: timing this one failed ({' '.join(str(error).split())[:60]})")
    entry: _Entry = {"steps": steps, "points": points, "date": date.today().isoformat()}
    _write(path, known | {key: entry})
    return _pace(entry)


class _Entry(TypedDict, total=False):
    """The pace of one machine in the cache."""

    steps: float
    points: float
    date: str


def machine() -> str:
    """The key of this machine in the cache: its name, its processor, the program's version."""
    return " | ".join((platform.node(), processor(), __version__))


def _pace(entry: _Entry) -> Pace:
    origin = f"timed on {entry['date']} (--recalibrate repeats it)"
    return Pace(float(entry["steps"]), float(entry["points"]), origin)


def _read(path: Path) -> dict[str, _Entry]:
    """The entries of the cache by machine; none if the file is missing or damaged."""
    try:
        known = read_json_object(path)
    except StoreError:
        return {}
    low, high = FACTORS
    return {
        k: _Entry(steps=v["steps"], points=v["points"], date=str(v.get("date", "an unknown day"))) for k, v in known.items()
        if isinstance(v, dict) and all(isinstance(v.get(n), float) and low <= v[n] <= high for n in ("steps", "points"))
    }  # fmt: skip


def _write(path: Path, known: Mapping[str, _Entry]) -> None:
    """Write the cache; a folder that cannot be written is not an error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(known, indent=1))
    except (OSError, StoreError):
        pass
