"""How fast this machine is: two small impacts, timed once and remembered in the user's cache folder.

`coupler.plan.cost` has what steps, elements and points cost where its constants were fitted. Two impacts of few and of many points
tell the two factors that carry them over to this machine: one for what a step costs by itself and by its elements, one for points.
"""

import itertools
import json
import math
import os
import platform
import statistics
import tempfile
import time
from collections.abc import Callable
from dataclasses import dataclass
from datetime import date
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import ColdsprayError, SolverError

if TYPE_CHECKING:
    from ..plan.planning import Plan

REPEATS = 2  # of each of the two impacts; the faster counts
WORTH = 8  # chunks of steps that a median is taken of, at least
FACTORS = (0.05, 50.0)  # what is believed of a machine
SMALL = """
[particle]
material = "Ni"
diameter = "10 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
diameter = "80 um"
height = "40 um"
[resolution]
spacing = "{spacing} um"
element_size = "2 um"
[end]
time = "{time} ns"
"""
USUAL = (1000.0, 5000.0)  # points and elements of a step that stands for all that is no step
SIZES = (("1.204", "10"), ("0.559", "4"))  # spacing um and time ns: about 300 and 3000 points, some 100 steps each


@dataclass(frozen=True)
class Pace:
    """What this machine takes over what the constants of `estimates` say. steps: for a step and its elements; points: for the
    points of a step; said: where they are from."""

    steps: float
    points: float
    said: str

    def seconds(self, what: "Plan") -> float:
        """Processor time of a plan in one thread here, s."""
        from ..plan import cost as estimates

        own = estimates.step_time(1.0, USUAL[1]), estimates.point_time(1.0, USUAL[0])
        of_all_else = (self.steps * own[0] + self.points * own[1]) / sum(own)
        return what.cost.steps * self.steps + what.cost.points * self.points + what.cost.rest * of_all_else


def of_this_machine(anew: bool = False, say: Callable[[str], None] = lambda text: None) -> Pace:
    """The pace of this machine, from the cache or measured now (some seconds; half a minute where kernels have to be compiled).

    anew: measure though the cache has it. say(text): told before measuring. Where the small impacts cannot be computed the
    factors are 1 and `said` has the reason.
    """
    path, key = folder() / "pace.json", machine()
    known = _read(path)
    if not anew and key in known:
        return _pace(known[key])
    say("timing two small impacts, once for this machine ...")
    try:
        steps, points = measure()
    except (ColdsprayError, ImportError, OSError) as error:
        return Pace(1.0, 1.0, f"of another machine: timing this one failed ({' '.join(str(error).split())[:60]})")
    found = {"steps": steps, "points": points, "date": date.today().isoformat()}
    _write(path, known | {key: found})
    return _pace(found)


def measure() -> tuple[float, float]:
    """The two factors of this machine, timed now in one thread. Raises SolverError if there was too little to time."""
    from ..plan import cost as estimates

    sizes = [
        min((_timed(SMALL.format(spacing=spacing, time=time)) for _ in range(REPEATS)), key=lambda found: found[2])
        for spacing, time in SIZES
    ]  # other work on the machine only ever adds to a time
    # f_s (step + element E) + f_p point N = seconds of a step, for the two impacts
    (a, b, s), (c, d, t) = (
        (estimates.SECONDS_PER_STEP + estimates.SECONDS_PER_ELEMENT * E, estimates.SECONDS_PER_POINT * N, seconds)
        for N, E, seconds in sizes
    )
    determinant = a * d - b * c
    low, high = FACTORS
    steps, points = (s * d - b * t) / determinant, (a * t - c * s) / determinant
    return min(max(steps, low), high), min(max(points, low), high)


def _timed(text: str) -> tuple[int, int, float]:
    """Points and elements of a scene, and processor time of one of its steps, s: the median over the chunks of steps."""
    from ..deposition.run import run
    from ..scene.model import Scene

    marks: list[tuple[float, int]] = []

    def probe(impact: Any) -> None:
        marks.append((time.process_time(), impact.particle.steps))

    with tempfile.TemporaryDirectory() as place:
        made = Scene.from_text(text, "pace")
        summary = run(made, Path(place) / "pace", threads=1, probe=probe, checkpoint_every=math.inf).summary
    steps = [(t1 - t0) / (n1 - n0) for (t0, n0), (t1, n1) in itertools.pairwise(marks) if n1 > n0]
    if len(steps) < WORTH:
        raise SolverError(f"only {len(steps)} chunks of steps to time")
    return summary["points"], summary["elements"], statistics.median(steps)


def machine() -> str:
    """What tells one machine from another: its name, its processor, the program's version."""
    from .. import __version__

    return " | ".join((platform.node(), processor(), __version__))


def processor() -> str:
    """The processor's own name, "" where the system does not tell."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


def folder() -> Path:
    """Where the program keeps what it may lose: $COLDSPRAY_CACHE, or coldspray in $XDG_CACHE_HOME or in ~/.cache."""
    if own := os.environ.get("COLDSPRAY_CACHE"):
        return Path(own)
    return Path(os.environ.get("XDG_CACHE_HOME") or Path.home() / ".cache") / "coldspray"


def _pace(found: dict[str, Any]) -> Pace:
    steps, points = float(found["steps"]), float(found["points"])
    return Pace(steps, points, f"timed on {found.get('date', 'an unknown day')} (--recalibrate to do it again)")


def _read(path: Path) -> dict[str, dict[str, Any]]:
    """What is remembered; nothing if the file is not there or not ours."""
    try:
        known = json.loads(path.read_text(encoding="utf-8"))
    except (OSError, ValueError):
        return {}
    sound = known.items() if isinstance(known, dict) else ()
    low, high = FACTORS
    return {
        k: v for k, v in sound
        if isinstance(v, dict) and all(isinstance(v.get(n), float) and low <= v[n] <= high for n in ("steps", "points"))
    }  # fmt: skip


def _write(path: Path, known: dict[str, dict[str, Any]]) -> None:
    """Remember; a folder that cannot be written is no reason to fail."""
    try:
        path.parent.mkdir(parents=True, exist_ok=True)
        part = path.with_suffix(f".{os.getpid()}")
        part.write_text(json.dumps(known, indent=1), encoding="utf-8")
        part.replace(path)
    except OSError:
        pass
