"""The speed of this machine as a factor on the costs of `coupler.plan.cost`, whose constants are those of another machine. It is
measured once (`timing.measure`) and stored in the cache folder of the user."""

import json
import platform
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from textwrap import fill
from typing import Any

from .. import __version__
from ..caches import user_folder
from ..errors import ColdsprayError, StoreError
from ..files.inputs import read_json_object
from ..files.outputs import write_text
from ..files.provenance import processor
from ..measures import CONVERGING, MEASURES
from ..plan import refinement
from ..plan.cost import forecast
from ..plan.model import Plan
from ..plan.text import duration

FACTORS = (0.05, 50.0)  # limits of a factor


@dataclass(frozen=True)
class Pace:
    """The speed of a machine. factor: computing time on it divided by the time from the constants of `plan.cost`; source: origin of
    the factor, for messages."""

    factor: float
    source: str

    def seconds(self, plan: Plan) -> float:
        """Processor time of a plan in one thread on this machine, s."""
        return self.factor * forecast(plan).whole


def lines(plan: Plan, pace: Pace, verbose: bool = True) -> str:
    """Text lines for `check`: wall time of a plan on this machine, and the expected error. verbose: include where the values come
    from."""
    shares = refinement.forecast(plan.impacts[-1].points)
    cells = [f"{MEASURES[name].short} {100 * shares[name]:.2g} %" for name in CONVERGING if name in shares]
    text = f"expected: +- {', '.join(cells)}; the run measures its actual error"
    lines = [
        f"  wall time  about {duration(pace.seconds(plan))} on one core here, after compilation; {pace.source}",
        fill(text, 119, initial_indent="  error      ", subsequent_indent=" " * 13),
    ]
    if verbose:
        lines.append("             error of the discretisation alone, median of 24 scenes (docs/evidence/accuracy.md)")
    return "\n".join(lines)


def of_this_machine(measure: Callable[[], float], anew: bool = False) -> Pace:
    """The speed of this machine. measure: `timing.measure`, which is called if the cache has no entry, or with `anew`. It takes some
    seconds, or half a minute if kernels must be compiled. If it fails the factor is 1, and `source` has the reason."""
    path, key = user_folder() / "pace.json", machine()
    known = _read(path)
    if anew or key not in known:
        try:
            factor = measure()
        except (ColdsprayError, ImportError, OSError) as error:
            return Pace(
                1.0, f"of another machine, because timing this one failed ({' '.join(str(error).split())[:60]})"
            )
        known[key] = {"factor": factor, "date": date.today().isoformat()}
        with suppress(OSError, StoreError):  # the folder may be read-only
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, json.dumps(known, indent=1))
    return Pace(known[key]["factor"], f"timed on {known[key]['date']} (measure again with --recalibrate)")


def machine() -> str:
    """The key of this machine in the cache: name, processor, version of the program."""
    return " | ".join((platform.node(), processor(), __version__))


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """The entries of the cache: {"factor", "date"} for each machine; empty if the file is missing or damaged."""
    with suppress(StoreError, LookupError, TypeError, ValueError):
        known: dict[str, Any] = read_json_object(path)
        timed = ((name, float(entry["factor"]), str(entry["date"])) for name, entry in known.items())
        return {name: {"factor": f, "date": day} for name, f, day in timed if FACTORS[0] <= f <= FACTORS[1]}
    return {}
