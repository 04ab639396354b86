"""Speed-up by ranks: python workflows/bench_ranks.py [--repeats 3]   # docs/tables/ranks.csv

The first 22 ns of two scenes run in one process of one thread, and under mpiexec on two and three ranks. In `single_ni` at `standard`
the particle needs several times the time of the target; in the other scene both need the same time. The table has the wall time of
the steps, its ratio to one process on one thread, and the share of it in which each rank waits for others in the exchange (without
waiting inside LAMMPS). Each round runs all of them in turn; the median over the rounds counts.
"""

import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

from pages import impact_tables, machine, options, scene_file
from study_table import write_table

from coupler import Result, Scene

WAYS = {"one process, one thread": 1, "two ranks": 2, "three ranks": 3}
EQUAL = impact_tables("Ni", 25.0, 500.0, spacing=2.0)
EQUAL["resolution"] |= {"element_size": "2.4 um", "growth": 0.12}
PROGRAM = """
import sys
from coupler import run
warm, scene, out = sys.argv[1:]
for path in (warm, scene):
    run(path, out, force=True, threads=1)
"""  # the first run loads compiled kernels, which takes as long as a hundred steps


def measured(name: str, scene: Scene, repeats: int) -> list[dict[str, object]]:
    """A row of the table for each way to run the scene."""
    times: dict[str, list[float]] = {name: [] for name in WAYS}
    idle: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as place:
        path, warm = Path(place) / "scene.toml", Path(place) / "warm.toml"
        for file, time in ((path, "22 ns"), (warm, "3 ns")):
            file.write_text(scene.with_(end={"at": None, "time": time}).to_toml())
        for repeat in range(repeats):
            for way, ranks in WAYS.items():
                out = Path(place) / f"{ranks}"
                program = [sys.executable, "-c", PROGRAM, str(warm), str(path), str(out)]
                launch = [str(Path(sys.executable).parent / "mpiexec"), "-n", str(ranks)] if ranks > 1 else []
                subprocess.run([*launch, *program], check=True)
                result = Result(out)
                times[way].append(result.wall_loop_s)
                idle[way] = result.idle_share
                print(f"{name}, round {repeat + 1}: {way:26s} {times[way][-1]:6.2f} s", flush=True)
    medians = {way: statistics.median(values) for way, values in times.items()}
    first = medians["one process, one thread"]
    rows = []
    for way, seconds in medians.items():
        waiting = " ".join(f"{share:.2f}" for share in idle[way])
        print(f"{name}: {way:26s} {seconds:6.2f} s  {seconds / first:.2f} of one process; waiting {waiting or '-'}")
        values = name, way, f"{seconds:.2f}", f"{seconds / first:.2f}", waiting
        rows.append(dict(zip(("scene", "way", "seconds", "of one process", "waiting, by rank"), values, strict=True)))
    return rows


if __name__ == "__main__":
    a = options(__doc__, repeats=3)
    scenes = {"single_ni": scene_file("single_ni"), "equal loads": Scene.from_dict(EQUAL)}
    rows = [row for name, scene in scenes.items() for row in measured(name, scene, a.repeats)]
    write_table("ranks", rows, f"remake: make bench; {machine()}")
