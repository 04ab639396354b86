"""Random scenes over the whole allowed range of every field: python workflows/fuzz.py [--n 100] [--seed 1] [--keep DIR]

Each is computed by the command, coarse and for a short time, in a process that computes many. Allowed ends: a result (exit code 0; 4:
not at rest in its time, which it says) in which `verify.check` finds no fault, or one message (2: the scene is refused, 3: the solver
gives up), within the time. All else (a fault, a traceback, a signal, no end) is printed and kept in DIR, and the exit code is then 1.
DIR/table.csv has a row for each seed; its seeds are not computed again.
"""

import argparse
import contextlib
import json
import math
import multiprocessing
import os
import random
import resource
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from multiprocessing.connection import Connection, wait
from pathlib import Path
from typing import Any

import verify

from coupler import Result, report
from coupler.commands.main import main as coldspray
from coupler.studies.table import StudyTable

MATERIALS = ("Ni", "Ti", "SS304", "OFHC_Cu", "Al", "42CrMo4")
SHAPES = ("sphere", "hollow_sphere", "oblate", "rod", "flake", "angular")
PATIENCE = 600  # s of processor time; of wall time ten times as many: no end means that nothing goes on
SCENES = 25  # by one process, at most: what it forgets to give back stays small
ENDS = {0: "a result", 2: "refused", 3: "given up", 4: "undecided"}
COLUMNS = ("seed", "end", "seconds", "message")
Played = tuple[int | None, str, list[str], float]  # exit code (None: no end), what was said, faults of the result, s


def log_between(dice: random.Random, low: float, high: float) -> float:
    """Evenly in the logarithm."""
    return math.exp(dice.uniform(math.log(low), math.log(high)))


def particle(dice: random.Random, alone: bool, diameter: float) -> dict[str, Any]:
    """A table [particle], any field left out now and then."""
    velocity, angle = log_between(dice, 10, 2000), dice.uniform(0, 80)
    fall = 1e-3 * velocity * math.cos(math.radians(angle))  # um/ns
    table: dict[str, Any] = {
        "material": dice.choice(MATERIALS),
        "diameter": f"{diameter:.4g} um",
        "velocity": f"{velocity:.4g} m/s",
    }
    maybe = {
        "shape": dice.choice(SHAPES),
        "angle": f"{angle:.4g} deg",
        "tilt": f"{dice.uniform(-90, 90):.4g} deg",
        "temperature": f"{log_between(dice, 100, 1700):.4g} K",
        "offset": [f"{dice.uniform(-1, 1) * diameter:.4g} um" for _ in "xy"],
        "gap": f"{dice.uniform(0, 1) * min(diameter, 20.0 * diameter / 25.0 * fall):.4g} um",  # 20 ns in flight, for 25 um
        "dwell": f"{dice.uniform(0, 10):.4g} us",
    }
    return table | {name: value for name, value in maybe.items() if dice.random() < (0.4 if alone else 0.25)}


def flight_time(table: dict[str, Any], spacing: float) -> float:
    """Time in ns from the start of a particle to its contact. spacing: um; half of it is the gap unless said."""
    gap, velocity, angle = (
        float(table.get(name, default).split()[0])
        for name, default in (("gap", f"{spacing / 2} um"), ("velocity", ""), ("angle", "0 deg"))
    )
    return 1e3 * gap / (velocity * math.cos(math.radians(angle)))


def scene(seed: int) -> dict[str, Any]:
    """The scene of a seed: fields over their ranges, but sizes that go together, so that most can be computed."""
    dice = random.Random(seed)
    count = dice.choice((1, 1, 1, 1, 2, 3))
    diameter = log_between(dice, 1, 200)
    diameters = [diameter * dice.choice((1, 1, 0.8, 1.2)) for _ in range(count)]
    particles = [particle(dice, count == 1, of_one) for of_one in diameters]
    largest = max(diameters)
    points = log_between(dice, 200, 450)  # of the smallest; shapes have fewer
    spacing = min(diameters) * (math.pi / 6 / points) ** (1 / 3)
    faces = ("absorbing", "free", "fixed")
    substrate: dict[str, Any] = {
        "material": dice.choice(MATERIALS),
        "diameter": f"{min(largest * dice.uniform(2.9, 9), 5000):.4g} um",
        "height": f"{min(largest * dice.uniform(1.9, 6), 5000):.4g} um",
        "sides": dice.choice(faces),
        "bottom": dice.choice(faces),
    }
    if dice.random() < 0.3:
        substrate["temperature"] = f"{log_between(dice, 100, 1500):.4g} K"
    resolution: dict[str, Any] = {"spacing": f"{spacing:.4g} um"}
    if dice.random() < 0.3:
        resolution["element_size"] = f"{spacing * dice.uniform(0.8, 1.6):.4g} um"
    if dice.random() < 0.3:
        resolution["growth"] = round(log_between(dice, 0.1, 1.0), 3)
    crossing = diameter / float(particles[0]["velocity"].split()[0]) * 1e3  # ns
    # as many steps as a second or two can make: a particle at 10 m/s is not followed to its rest
    end = min(1.5 * crossing, 60.0 * diameter / 25.0)
    flight = max(flight_time(table, spacing) for table in particles)
    said: dict[str, Any] = {
        "particle": particles, "substrate": substrate, "resolution": resolution,
        "end": {"time": f"{max(flight + end * dice.uniform(0.2, 1.0), 0.01):.4g} ns"},
        "effects": dice.choice(("auto", "auto", "all", "none")),
    }  # fmt: skip
    if dice.random() < 0.2:
        said["end"]["at"] = "greatest"
    if dice.random() < 0.5:
        said["contact"] = {"friction": round(dice.uniform(0, 2), 3)}
    if dice.random() < 0.3:
        said["output"] = {"every": f"{max(end * log_between(dice, 2e-2, 2), 0.001):.4g} ns"}
    if count > 1 and dice.random() < 0.7:
        said["adhesion"] = dice.choice((
            {"kind": "tied"}, {"kind": "none"},
            {"kind": "cohesive", "strength": f"{dice.uniform(1, 900):.4g} MPa", "energy": f"{log_between(dice, 0.1, 1e4):.4g} J/m2"},
            {"kind": "tied", "criterion": "plastic_strain", "threshold": round(dice.uniform(0, 2), 2)},
            {"kind": "tied", "criterion": "pressure", "threshold": f"{dice.uniform(0, 5000):.4g} MPa"},
            {"kind": "tied", "criterion": "velocity", "threshold": round(dice.uniform(0, 2), 2)},
        ))  # fmt: skip
    resolution["engine"] = ("compiled", "compiled", "enriched", "enriched", "machdyn")[seed % 5]
    if count > 1 and dice.random() < 0.5:
        said["splat"] = {"method": dice.choice(("auto", "carried", "density"))}
    return said


def toml(said: dict[str, Any]) -> str:
    """A scene as TOML: tables of texts, numbers and lists of texts."""
    lines = [f"{name} = {json.dumps(value)}" for name, value in said.items() if not isinstance(value, (dict, list))]
    for name, tables in said.items():
        for table in tables if isinstance(tables, list) else [tables] if isinstance(tables, dict) else []:
            lines.append(f"[[{name}]]" if isinstance(tables, list) else f"[{name}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def verdict(code: int | None, said: str, faults: list[str]) -> str:
    """What is wrong with an end; nothing if it is allowed."""
    if code is None or code in (-signal.SIGXCPU, -signal.SIGALRM):
        return f"no end in {PATIENCE} s"
    if code not in ENDS:
        return f"exit code {code}"
    if "Traceback" in said:
        return "a traceback"
    messages = [line for line in said.splitlines() if line.startswith("coldspray: ")]
    if code in (2, 3) and len(messages) != 1:
        return f"exit code {code} with {len(messages)} messages"
    return f"silently wrong: {'; '.join(faults)}" if faults else ""


def played(seed: int, folder: Path) -> Played:
    """Compute the scene of a seed in this process, and check its result."""
    started = time.process_time()
    resource.setrlimit(resource.RLIMIT_CPU, (int(started) + PATIENCE, resource.RLIM_INFINITY))
    signal.alarm(10 * PATIENCE)
    (folder / "scene.toml").write_text(toml(scene(seed)))
    faults: list[str] = []
    with (folder / "said.txt").open("w+") as said:
        os.dup2(said.fileno(), 1)
        os.dup2(said.fileno(), 2)
        with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
            try:
                report.section_picture = lambda result: None  # it costs as much as the run
                code = coldspray(
                    ["run", str(folder / "scene.toml"), "--out", str(folder / "out"), "--quiet", "--threads", "1"]
                )
            except SystemExit as end:
                code = end.code if isinstance(end.code, int) else 1
            except Exception:
                code = 1
                traceback.print_exc()
        if code in (0, 4):
            faults = verify.check(Result(folder / "out")).faults
        said.flush()
        return code, (folder / "said.txt").read_text(), faults, time.process_time() - started


def serve(seeds: list[int], results: Connection) -> None:
    """Compute the scenes of some seeds, one after another; send each end."""
    for seed in seeds:
        with tempfile.TemporaryDirectory() as folder:
            results.send(played(seed, Path(folder)))


def main() -> int:
    """Try the scenes. Returns 1 if one came to an end that is not allowed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1, help="of the first scene; those after it count on")
    parser.add_argument(
        "--keep", type=Path, default=Path("runs/fuzz"), help="for the table and the scenes with a bad end"
    )
    parser.add_argument("--workers", type=int, default=1)
    parser.add_argument("--again", action="store_true", help="compute bad ends of the table again")
    a = parser.parse_args()
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    table = StudyTable(a.keep / "table.csv", COLUMNS, ("seed",), "random scenes: workflows/fuzz.py")
    done = {row["seed"] for row in table.rows if not (a.again and row["end"] == "BAD")}
    waiting = [seed for seed in range(a.seed, a.seed + a.n) if str(seed) not in done]
    context = multiprocessing.get_context("spawn")
    running: dict[
        Connection, tuple[Any, list[int]]
    ] = {}  # results of a process -> it, and the seeds it has still to play
    while waiting or running:
        while waiting and len(running) < a.workers:
            seeds, waiting = waiting[:SCENES], waiting[SCENES:]
            results, sender = context.Pipe(duplex=False)
            process = context.Process(target=serve, args=(seeds, sender))
            process.start()
            sender.close()
            running[results] = process, seeds
        for results in wait(list(running)):
            process, seeds = running[results]
            try:
                end: Played = results.recv()
            except EOFError:  # it is done, or has died of the scene it was at
                process.join()
                del running[results]
                if not seeds:
                    continue
                end = process.exitcode, "", [], math.nan
                waiting = seeds[1:] + waiting
            record(table, seeds.pop(0), end, a.keep)
    chosen = [row for row in table.rows if a.seed <= int(row["seed"]) < a.seed + a.n]
    print("; ".join(f"{count} {end}" for end, count in sorted(Counter(row["end"] for row in chosen).items())))
    return int(any(row["end"] == "BAD" for row in chosen))


def record(table: StudyTable, seed: int, end: Played, keep: Path) -> None:
    """Put the end of a seed's scene into the table; keep the scene if the end is bad."""
    code, said, faults, seconds = end
    wrong = verdict(code, said, faults)
    last = said.strip().splitlines()[-1:] if code else []
    row = {"seed": seed, "end": "BAD" if wrong else ENDS[code or 0], "seconds": f"{seconds:.0f}"}
    new = table.add(row | {"message": wrong or " ".join(last)})
    if wrong:
        (keep / f"seed{seed}.toml").write_text(toml(scene(seed)))
        (keep / f"seed{seed}.txt").write_text(said)
    print(*new.values(), flush=True)


if __name__ == "__main__":
    sys.exit(main())
