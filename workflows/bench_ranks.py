"""What ranks gain: python workflows/bench_ranks.py [--repeats 3] [--out docs/tables/ranks.csv]

`single_ni` at `standard`, its first 22 ns, in one process (one thread; two) and under mpiexec on two and three ranks, both placements:
wall time of the steps, its ratio to one process on one thread, and the share of it that each rank waits for others in the
exchange (what a rank waits inside LAMMPS is not in it). The runs of a round follow one another; the median over rounds is kept.
"""

import argparse
import csv
import json
import os
import platform
import statistics
import subprocess
import sys
import tempfile
from pathlib import Path

WAYS = {
    "one process, one thread": (1, None, 1), "one process, two threads": (1, None, 2), "two ranks, split": (2, "split", 1),
    "two ranks, spread": (2, "spread", 1), "three ranks, split": (3, "split", 1), "three ranks, spread": (3, "spread", 1),
}  # fmt: skip
PROGRAM = """
import sys
from coupler import Scene, run
scene, out, placement, threads = sys.argv[1:]
run(scene, out, force=True, placement=placement or None, threads=int(threads))
"""


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--repeats", type=int, default=3)
    parser.add_argument("--out", type=Path, default=Path("docs/tables/ranks.csv"))
    a = parser.parse_args()
    mpiexec = Path(sys.executable).parent / "mpiexec"
    text = (Path(__file__).parent / "single_ni.toml").read_text()
    times: dict[str, list[float]] = {name: [] for name in WAYS}
    idle: dict[str, list[float]] = {}
    with tempfile.TemporaryDirectory() as place:
        scene = Path(place) / "scene.toml"
        end = '[end]\ntime = "22 ns"\n'
        scene.write_text(text.replace('[end]\nat = "rest"', end.strip()) if "[end]" in text else text + end)
        for repeat in range(a.repeats):
            for name, (ranks, placement, threads) in WAYS.items():
                out = f"{place}/{ranks}{placement}{threads}"
                program = [sys.executable, "-c", PROGRAM, str(scene), out, placement or "", str(threads)]
                launch = [str(mpiexec), "-n", str(ranks)] if ranks > 1 else []
                subprocess.run([*launch, *program], check=True)
                summary = json.loads((Path(out) / "summary.json").read_text())
                times[name].append(summary["wall_loop_s"])
                idle[name] = summary["idle_share"]
                print(f"round {repeat + 1}: {name:26s} {times[name][-1]:6.2f} s", flush=True)
    first = statistics.median(times["one process, one thread"])
    rows = []
    for name in WAYS:
        seconds = statistics.median(times[name])
        rows.append(
            [name, f"{seconds:.2f}", f"{seconds / first:.2f}", " ".join(f"{share:.2f}" for share in idle[name])]
        )
        print(f"{name:26s} {seconds:6.2f} s  {seconds / first:.2f} of one process; waiting {rows[-1][-1] or '-'}")
    with a.out.open("w", newline="") as file:
        file.write(
            f"# remake: make bench; {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}\n"
        )
        csv.writer(file).writerows([["how", "seconds", "of one process", "waiting, by rank"], *rows])


if __name__ == "__main__":
    main()
