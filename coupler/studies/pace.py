"""The speed of this machine, measured once (`timing.measure`) and kept in the user's cache folder.

`coupler.plan.cost` has the costs of steps, elements and points of the machine on which its constants were fitted; one factor
transfers them to this one.
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
from ..plan.forecast import forecast
from ..plan.model import Plan

FACTORS = (0.05, 50.0)  # limits of what is accepted


@dataclass(frozen=True)
class Pace:
    """factor: time on this machine over that of the constants of `plan.cost`; source: its origin, for messages."""

    factor: float
    source: str

    def seconds(self, plan: Plan) -> float:
        """Processor time of a plan in one thread here, s."""
        return self.factor * forecast(plan).whole


def of_this_machine(measure: Callable[[], float], anew: bool = False) -> Pace:
    """The pace of this machine, from the cache or measured now (some seconds; half a minute where kernels have to be compiled).

    measure: `timing.measure`, called where the cache has nothing, and with `anew`. Where the small impact cannot be computed the
    factor is 1 and `source` has the reason.
    """
    path, key = user_folder() / "pace.json", machine()
    known = _read(path)
    if not anew and key in known:
        return _pace(known[key])
    try:
        factor = measure()
    except (ColdsprayError, ImportError, OSError) as error:
        return Pace(1.0, f"of another machine: timing this one failed ({' '.join(str(error).split())[:60]})")
    entry: _Entry = {"factor": factor, "date": date.today().isoformat()}
    _write(path, known | {key: entry})
    return _pace(entry)


class _Entry(TypedDict, total=False):
    """The pace of one machine in the cache."""

    factor: float
    date: str


def machine() -> str:
    """The key of this machine in the cache: its name, its processor, the program's version."""
    return " | ".join((platform.node(), processor(), __version__))


def _pace(entry: _Entry) -> Pace:
    return Pace(float(entry["factor"]), f"timed on {entry['date']} (--recalibrate repeats it)")


def _read(path: Path) -> dict[str, _Entry]:
    """The entries of the cache by machine; none if the file is missing or damaged."""
    try:
        known = read_json_object(path)
    except StoreError:
        return {}
    low, high = FACTORS
    return {
        k: _Entry(factor=v["factor"], date=str(v.get("date", "an unknown day"))) for k, v in known.items()
        if isinstance(v, dict) and isinstance(v.get("factor"), float) and low <= v["factor"] <= high
    }  # fmt: skip


def _write(path: Path, known: Mapping[str, _Entry]) -> None:
    """Write the cache; a folder that cannot be written is not an error."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        write_text(path, json.dumps(known, indent=1))
    except (OSError, StoreError):
        pass
