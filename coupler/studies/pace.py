"""The speed of this machine as a factor on the costs of `coupler.plan.cost`, whose constants are those of another machine. It is
measured once with a small impact, and stored in the cache folder of the user."""

import math
import platform
import re
import time
from collections.abc import Callable
from contextlib import suppress
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from tempfile import TemporaryDirectory
from textwrap import fill
from typing import Any

import numpy as np

from .. import __version__
from ..caches import user_folder
from ..errors import ColdsprayError, StoreError
from ..files.outputs import write_text
from ..files.provenance import processor
from ..files.result import Result
from ..measures import CONVERGING, MEASURES
from ..plan import refinement
from ..plan.cost import forecast, step_time
from ..plan.model import Plan
from ..plan.reading import Scene
from ..plan.text import duration

LEAST, MOST = 0.05, 50.0  # limits of a factor
REPEATS = 2  # of the impact; the faster one counts, because other work on the machine only adds time
SMALL = """
preset = "draft"
particle = { material = "Ni", diameter = "10 um", velocity = "500 m/s" }
substrate = { material = "SS304", diameter = "80 um", height = "40 um" }
end = { time = "8 ns" }
"""  # about 100 steps


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
    """The speed of this machine. measure: function that measures the factor, which is called if the cache has none, or with `anew`. It
    takes some seconds, or half a minute if kernels must be compiled. If it fails the factor is 1, and `source` has the reason."""
    path, factor = kept(), math.nan
    with suppress(OSError, ValueError):  # a missing or damaged file
        text, day = path.read_text(encoding="utf-8").split()
        factor = float(text)
    if anew or not LEAST <= factor <= MOST:
        try:
            factor, day = measure(), date.today().isoformat()
        except (ColdsprayError, ImportError, OSError) as error:
            reason = " ".join(str(error).split())[:60]
            return Pace(1.0, f"measured on another machine, because the measurement on this one failed ({reason})")
        with suppress(OSError, StoreError):  # the folder may be read-only
            path.parent.mkdir(parents=True, exist_ok=True)
            write_text(path, f"{factor:.6g} {day}\n")
    return Pace(factor, f"timed on {day} (measure again with --recalibrate)")


def kept() -> Path:
    """The file with the factor of this machine. The file name contains name and processor of the machine and version of the program."""
    machine = f"{platform.node()} {processor()} {__version__}"
    return user_folder() / f"pace_{re.sub(r'[^A-Za-z0-9.]+', '_', machine)}.txt"


def measure(run: Callable[..., Result]) -> float:
    """Measure the factor of this machine with a small impact. The factor is limited to LEAST..MOST. run: `deposition.run.run`. Raises
    SolverError."""
    return min(max(min(_timed(run) for _ in range(REPEATS)), LEAST), MOST)


def _timed(run: Callable[..., Result]) -> float:
    """Processor time of a step in one thread (median over chunks of steps), divided by the time from the constants of `plan.cost`."""
    marks: list[tuple[float, int]] = []  # processor time, steps so far

    def probe(impact: Any) -> None:
        marks.append((time.process_time(), impact.particle.steps))

    with TemporaryDirectory() as folder:
        scene = Scene.from_text(SMALL, "pace")
        result = run(scene, folder + "/pace", threads=1, probe=probe, quiet=True, checkpoint_every=math.inf)
        expected = step_time(1.0, int(result.points), int(result.elements), scene.resolution.engine)
    seconds, steps = np.diff(marks, axis=0).T
    return float(np.median(seconds / steps)) / expected
