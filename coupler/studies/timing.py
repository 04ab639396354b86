"""Two small impacts, timed: the factors of `pace.Pace` for this machine."""

import itertools
import math
import statistics
import tempfile
import time
from pathlib import Path
from typing import Protocol

from ..deposition.run import run
from ..errors import SolverError
from ..plan import cost
from ..plan.reading import Scene
from .pace import FACTORS

REPEATS = 2  # of each of the two impacts; the faster counts
FEWEST_CHUNKS = 8  # of steps, for a median
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
engine = "{engine}"
[end]
time = "{time} ns"
"""
SIZES = (("1.204", "10"), ("0.559", "4"))  # spacing um and time ns: about 300 and 3000 points, some 100 steps each


class _Particle(Protocol):
    steps: int


class _Impact(Protocol):
    """The part of an impact that the probe reads."""

    @property
    def particle(self) -> _Particle: ...


def measure() -> tuple[float, float]:
    """The two factors of this machine, timed now in one thread. Raises SolverError if there was too little to time."""
    sizes = [
        min(
            (_timed(SMALL.format(spacing=spacing, time=time, engine=cost.TIMED_ENGINE)) for _ in range(REPEATS)),
            key=lambda timed: timed[2],
        )
        for spacing, time in SIZES
    ]  # other work on the machine only ever adds to a time
    # f_s (step + element E) + f_p point N = seconds of a step, for the two impacts
    (a, b, s), (c, d, t) = (
        (cost.SECONDS_PER_STEP + cost.SECONDS_PER_ELEMENT * E, cost.SECONDS_PER_POINT[cost.TIMED_ENGINE] * N, seconds)
        for N, E, seconds in sizes
    )
    determinant = a * d - b * c
    low, high = FACTORS
    steps, points = (s * d - b * t) / determinant, (a * t - c * s) / determinant
    return min(max(steps, low), high), min(max(points, low), high)


def _timed(text: str) -> tuple[int, int, float]:
    """Points and elements of a scene, and processor time of one of its steps, s: the median over the chunks of steps."""
    marks: list[tuple[float, int]] = []

    def probe(impact: _Impact) -> None:
        marks.append((time.process_time(), impact.particle.steps))

    with tempfile.TemporaryDirectory() as place:
        scene = Scene.from_text(text, "pace")
        result = run(scene, Path(place) / "pace", threads=1, probe=probe, quiet=True, checkpoint_every=math.inf)
        points, elements = int(result.points), int(result.elements)
    steps = [(t1 - t0) / (n1 - n0) for (t0, n0), (t1, n1) in itertools.pairwise(marks) if n1 > n0]
    if len(steps) < FEWEST_CHUNKS:
        raise SolverError(f"only {len(steps)} chunks of steps to time")
    return points, elements, statistics.median(steps)
