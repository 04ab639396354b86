"""Measure what threads and jobs gain on this machine: python workflows/scaling.py   # docs/tables/scaling.csv, about five minutes

Steps of one impact on 1, 2, 4 ... threads, and coarse impacts of which 1, 2, 4 ... run at the same time, up to the number of cores.
"""

import statistics
import tempfile
import time
from concurrent.futures import ProcessPoolExecutor
from itertools import count, takewhile
from multiprocessing import get_context
from pathlib import Path

from pages import TABLES, impact_tables, machine, options, spacing_of, write_table

from coupler.core.cores import cores
from coupler.core.threads import threads_of
from coupler.deposition.run import run
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.plan.planning import plan
from coupler.plan.reading import Scene

BEGIN = 2e-9  # s into the impact: surfaces touch, points flow
STEPS, ROUNDS = 40, 5


def scene(points: int) -> Scene:
    """The impact of a nickel particle of about so many points."""
    return Scene.from_dict(impact_tables("Ni", 25.0, 500.0, spacing=spacing_of(points)), "scaling")


def steps_on(points: int, counts: list[int]) -> dict[int, float]:
    """Seconds of a step on so many threads: the median of rounds in turn, so that other work slows down all alike."""
    times: dict[int, list[float]] = {n: [] for n in counts}
    with threads_of(counts[-1]):
        impact = Impact(build_domains(plan(scene(points))))
        while impact.time < BEGIN:
            advance_chunk(impact)
    for _ in range(ROUNDS):
        for n in counts:
            with threads_of(n):
                before, start = impact.particle.steps, time.perf_counter()
                while impact.particle.steps < before + STEPS:
                    advance_chunk(impact)
                times[n].append((time.perf_counter() - start) / (impact.particle.steps - before))
    impact.particle.close()
    return {n: statistics.median(own) for n, own in times.items()}


def coarse(_: int) -> None:
    """One coarse impact of 10 ns on one thread."""
    with tempfile.TemporaryDirectory() as folder:
        run(scene(1000).with_(end={"time": "10 ns"}), Path(folder) / "run", threads=1, quiet=True, error=False)


def jobs_at_a_time(counts: list[int]) -> dict[int, float]:
    """Seconds that a coarse impact takes, over how many are computed at a time."""
    taken = {}
    for n in counts:
        with ProcessPoolExecutor(n, get_context("spawn")) as pool:
            list(pool.map(coarse, range(n)))  # starts the processes
            start = time.perf_counter()
            list(pool.map(coarse, range(2 * n)))
            taken[n] = (time.perf_counter() - start) / (2 * n)
    return taken


def main() -> None:
    """Measure, print, record."""
    a = options(__doc__, points=[1000, 5000, 16000], most=cores())
    counts = list(takewhile(lambda n: n <= a.most, (2**k for k in count())))
    rows: list[dict[str, object]] = []

    def tell(what: str, took: dict[int, float], unit: str) -> None:
        for n, seconds in took.items():
            gain = took[counts[0]] / seconds
            print(f"{what}, {n}: {1e3 * seconds:.4g} ms {unit}, {gain:.2f} times as fast as one", flush=True)
            rows.append({"what": what, "number": n, "ms": f"{1e3 * seconds:.4g}", "gain": f"{gain:.3g}"})

    for points in a.points:
        tell(f"threads, {points} points", steps_on(points, counts), "a step")
    tell("impacts at a time", jobs_at_a_time(counts), "an impact")
    write_table(TABLES / "scaling.csv", rows, f"remake: python workflows/scaling.py; {machine()}")


if __name__ == "__main__":
    main()
