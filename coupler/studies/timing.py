"""Measurement of the speed of this machine with a small impact. The result is the factor of `pace.Pace`."""

import itertools
import math
import statistics
import tempfile
import time
from pathlib import Path
from typing import Any

from ..deposition.run import run
from ..errors import SolverError
from ..plan import cost
from ..plan.reading import Scene
from .pace import FACTORS

REPEATS = 2  # of the impact; the faster one counts, because other work on the machine only adds time
FEWEST_CHUNKS = 8  # of time steps, for a median
SMALL = """
preset = "draft"
[particle]
material = "Ni"
diameter = "10 um"
velocity = "500 m/s"
[substrate]
material = "SS304"
diameter = "80 um"
height = "40 um"
[end]
time = "8 ns"
"""  # about 100 steps


def measure() -> float:
    """Measure the speed factor of this machine (`pace.Pace`): a small impact is timed in one thread. The factor is limited to
    FACTORS. Raises SolverError if the timing run has fewer than FEWEST_CHUNKS chunks of steps."""
    low, high = FACTORS
    return min(max(min(_timed() for _ in range(REPEATS)), low), high)


def _timed() -> float:
    """Processor time of a step (median over chunks of steps), divided by the time from the constants of `plan.cost`."""
    marks: list[tuple[float, int]] = []

    def probe(impact: Any) -> None:
        marks.append((time.process_time(), impact.particle.steps))

    with tempfile.TemporaryDirectory() as place:
        scene = Scene.from_text(SMALL, "pace")
        result = run(scene, Path(place) / "pace", threads=1, probe=probe, quiet=True, checkpoint_every=math.inf)
        expected = cost.step_time(1.0, int(result.points), int(result.elements), scene.resolution.engine)
    steps = [(t1 - t0) / (n1 - n0) for (t0, n0), (t1, n1) in itertools.pairwise(marks) if n1 > n0]
    if len(steps) < FEWEST_CHUNKS:
        raise SolverError(
            f"the timing run has only {len(steps)} chunks of time steps, but {FEWEST_CHUNKS} are needed: repeat the command"
        )
    return statistics.median(steps) / expected
