"""What threads and jobs gain on this machine: python workflows/scaling.py   # docs/tables/scaling.csv (about five minutes)

Steps of an impact on 1, 2, 4 ... threads, and draft impacts of which 1, 2, 4 ... are computed at the same time, up to --most (default:
the cores of this machine). Each ratio is the time of one over the time of N: N at best.
"""

import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import count, takewhile
from multiprocessing import get_context
from pathlib import Path

from bench import BEGUN, begun, per_step
from pages import machine, options, scene_file
from study_table import REMAKE, write_table

from coupler import run
from coupler.core.process import cores
from coupler.core.threads import threads_of

ROUNDS = 5  # in turn, so that other work slows down all alike; the median counts


def step_on(points: int, counts: list[int]) -> dict[int, float]:
    """Seconds of a step on each number of threads. Large particles: soon after the first contact."""
    with threads_of(counts[-1]):
        impact = begun(points, min(BEGUN, 5e-9 * (5000 / points) ** 0.5))
    times: dict[int, list[float]] = {n: [] for n in counts}
    for _ in range(ROUNDS):
        for n in counts:
            with threads_of(n):
                times[n].append(per_step(impact, time.perf_counter))
    impact.particle.close()
    return {n: statistics.median(own) for n, own in times.items()}


def draft(_: int) -> None:
    """Compute one draft impact on one thread."""
    with tempfile.TemporaryDirectory() as folder:
        run(scene_file("single_ni", preset="draft"), Path(folder) / "run", threads=1, quiet=True, error=False)


def impact_among(counts: list[int]) -> dict[int, float]:
    """Seconds of an impact over the number of impacts at a time."""
    times = {}
    for n in counts:
        with ProcessPoolExecutor(n, get_context("spawn")) as pool:
            list(pool.map(draft, range(n)))  # starts the processes
            start = time.perf_counter()
            list(pool.map(draft, range(3 * n)))
            times[n] = (time.perf_counter() - start) / (3 * n)
    return times


if __name__ == "__main__":
    a = options(__doc__, points=[1000, 5000, 16000, 89000], most=cores())
    counts = list(takewhile(lambda n: n <= a.most, (2**k for k in count())))
    rows: list[dict[str, object]] = []
    for what, measure in [
        *(
            (f"a step of {points} points, threads", lambda points=points: step_on(points, counts))
            for points in a.points
        ),
        ("a draft impact, impacts at a time", lambda: impact_among(counts)),
    ]:
        times = measure()
        for n, seconds in times.items():
            row = {"what": what, "number": n, "ms": f"{1e3 * seconds:.4g}", "gain": f"{times[1] / seconds:.3g}"}
            print(f"{what} {n}: {row['ms']} ms, {row['gain']} times as fast as with one", flush=True)
            rows.append(row)
    write_table("scaling", rows, f"remake: {REMAKE}; {machine()}")
