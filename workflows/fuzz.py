"""Random scenes over the whole allowed range of every field: python workflows/fuzz.py [--n 100] [--seed 1] [--keep DIR]

Each that reads as a scene is computed by the command, coarse and for a short time, many by one process, which saves starting it.
Allowed ends: a result (exit code 0), or a refusal in one message (2: the scene, 3: the solver), within the time. After anything
else (a traceback, a signal, no end) the scene is tried again in a process of its own; if that ends no better it is printed
and kept in DIR, and the exit code is then 1.
"""

import argparse
import contextlib
import json
import math
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import threading
import time
import traceback
from pathlib import Path
from typing import Any

MATERIALS = ("Ni", "Ti", "SS304", "OFHC_Cu", "Al", "42CrMo4")
SHAPES = ("sphere", "hollow_sphere", "oblate", "rod", "flake", "angular")
PATIENCE = 120  # s of processor time; of wall time ten times as many
SCENES = 25  # by one process, at most: what it forgets to give back stays small


def log_between(dice: random.Random, low: float, high: float) -> float:
    """Evenly in the logarithm."""
    return math.exp(dice.uniform(math.log(low), math.log(high)))


def particle(dice: random.Random, alone: bool, diameter: float) -> dict[str, Any]:
    """A table [particle], any field left out now and then."""
    table: dict[str, Any] = {
        "material": dice.choice(MATERIALS),
        "diameter": f"{diameter:.4g} um",
        "velocity": f"{log_between(dice, 10, 2000):.4g} m/s",
    }
    maybe = {
        "shape": dice.choice(SHAPES),
        "angle": f"{dice.uniform(0, 80):.4g} deg",
        "tilt": f"{dice.uniform(-90, 90):.4g} deg",
        "temperature": f"{log_between(dice, 100, 1700):.4g} K",
        "offset": [f"{dice.uniform(-1, 1) * diameter:.4g} um" for _ in "xy"],
        "gap": f"{dice.uniform(0, 1) * diameter:.4g} um",
        "dwell": f"{dice.uniform(0, 10):.4g} us",
    }
    return table | {name: value for name, value in maybe.items() if dice.random() < (0.4 if alone else 0.25)}


def scene(seed: int) -> dict[str, Any]:
    """The scene of a seed: fields over their ranges, but sizes that go together, so that most can be computed."""
    dice = random.Random(seed)
    count = dice.choice((1, 1, 1, 1, 2, 3))
    diameter = log_between(dice, 1, 200)
    diameters = [diameter * dice.choice((1, 1, 0.8, 1.2)) for _ in range(count)]
    particles = [particle(dice, count == 1, of_one) for of_one in diameters]
    largest = max(diameters)
    points = log_between(dice, 200, 900)  # of the smallest; shapes have fewer
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
    said: dict[str, Any] = {
        "particle": particles, "substrate": substrate, "resolution": resolution,
        "end": {"time": f"{max(end * dice.uniform(0.2, 1.0), 0.01):.4g} ns"} | ({"at": "greatest"} if dice.random() < 0.2 else {}),
        "effects": dice.choice(("auto", "auto", "all", "none")),
    }  # fmt: skip
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
    if count > 1 and dice.random() < 0.5:
        said["splat"] = {"method": dice.choice(("auto", "carried", "density", "stuffing", "paper"))}
    return said


def toml(said: dict[str, Any]) -> str:
    """A scene as TOML: tables of texts, numbers and lists of texts."""
    lines = [f"{name} = {json.dumps(value)}" for name, value in said.items() if not isinstance(value, (dict, list))]
    for name, tables in said.items():
        for table in tables if isinstance(tables, list) else [tables] if isinstance(tables, dict) else []:
            lines.append(f"[[{name}]]" if isinstance(tables, list) else f"[{name}]")
            lines += [f"{key} = {json.dumps(value)}" for key, value in table.items()]
    return "\n".join(lines) + "\n"


def verdict(code: int | None, err: str) -> str:
    """What is wrong with an end; nothing if it is allowed."""
    if code is None or code == -signal.SIGXCPU:
        return f"no end in {PATIENCE} s"
    if code not in (0, 2, 3):
        return f"exit code {code}"
    if "Traceback" in err:
        return "a traceback"
    said = [line for line in err.splitlines() if line.startswith("coldspray: ")]
    if code and len(said) != 1:
        return f"exit code {code} with {len(said)} messages"
    return ""


def read(text: str) -> tuple[int | None, str, float]:
    """As `tried`, for a text that is no scene: refused, as the command would; None for one that is."""
    from coupler.errors import SceneError
    from coupler.plan.reading import Scene

    try:
        Scene.from_text(text, "scene.toml")
    except SceneError as error:
        return error.exit_code, f"coldspray: {error}", 0.0
    except Exception:
        return 1, traceback.format_exc(), 0.0
    return None, "", 0.0


def tried(text: str, folder: Path) -> tuple[int | None, str, float]:
    """Exit code (None: no end), what it said, and the seconds of wall time it took, in a process of its own."""
    path, started = folder / "scene.toml", time.perf_counter()
    path.write_text(text)
    try:
        done = subprocess.run(
            [sys.executable, "-m", "coupler", *command(folder)],
            capture_output=True,
            text=True,
            timeout=10 * PATIENCE,
            env=os.environ | ONE_THREAD,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE + 5)),
        )
    except subprocess.TimeoutExpired:
        return None, "", time.perf_counter() - started
    return done.returncode, done.stderr, time.perf_counter() - started


ONE_THREAD = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def command(folder: Path) -> list[str]:
    """What is said to coldspray of the scene in a folder."""
    return ["run", str(folder / "scene.toml"), "--out", str(folder / "out"), "--force", "--quiet"]


class Worker:
    """A process that computes one scene after another."""

    def __init__(self) -> None:
        self.process: subprocess.Popen[str] | None = None
        self.count = 0

    def tried(self, text: str, folder: Path) -> tuple[int | None, str, float]:
        """As the function `tried`, with seconds of processor time."""
        if self.process is None:
            arguments = [sys.executable, str(Path(__file__).resolve()), "--serve"]
            self.process = subprocess.Popen(
                arguments, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True, env=os.environ | ONE_THREAD
            )
            self.count = 0
        (folder / "scene.toml").write_text(text)
        assert self.process.stdin is not None
        assert self.process.stdout is not None
        late = threading.Timer(10 * PATIENCE, self.process.kill)
        late.start()
        try:
            self.process.stdin.write(f"{folder}\n")
            self.process.stdin.flush()
            answer = self.process.stdout.readline()
        finally:
            late.cancel()
        said = (folder / "said.txt").read_text() if (folder / "said.txt").exists() else ""
        self.count += 1
        if not answer:
            code = self.process.wait()
            self.process = None
            return (None if code == -signal.SIGKILL else code), said, float("nan")
        if self.count == SCENES:
            self.close()
        code, seconds = json.loads(answer)
        return code, said, seconds

    def close(self) -> None:
        if self.process is not None:
            assert self.process.stdin is not None
            self.process.stdin.close()
            self.process.wait()
            self.process = None


def serve() -> None:
    """Compute the scenes in the folders that come in, one a line; answer with exit code and seconds of processor time."""
    from coupler.commands.main import main as coldspray

    out = os.fdopen(os.dup(1), "w")
    for line in sys.stdin:
        folder, started = Path(line.strip()), time.process_time()
        resource.setrlimit(resource.RLIMIT_CPU, (int(started) + PATIENCE, resource.RLIM_INFINITY))
        with (folder / "said.txt").open("w") as said:
            os.dup2(said.fileno(), 1)
            os.dup2(said.fileno(), 2)
            with contextlib.redirect_stderr(said), contextlib.redirect_stdout(said):
                try:
                    code = coldspray(command(folder))
                except SystemExit as end:
                    code = end.code if isinstance(end.code, int) else 1
                except BaseException:
                    code = 1
                    traceback.print_exc()
        print(json.dumps([code, time.process_time() - started]), file=out, flush=True)


def main() -> int:
    """Try the scenes. Returns 1 if one came to an end that is not allowed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1, help="of the first scene; those after it count on")
    parser.add_argument(
        "--keep", type=Path, default=Path("runs/fuzz"), help="where scenes with a bad end go (default: runs/fuzz)"
    )
    parser.add_argument("--serve", action="store_true", help=argparse.SUPPRESS)
    parser.add_argument("--quiet", action="store_true", help="print bad ends and the sum only")
    a = parser.parse_args()
    if a.serve:
        serve()
        return 0
    worker = Worker()
    ends: dict[str, int] = {}
    bad = 0
    for seed in range(a.seed, a.seed + a.n):
        text = toml(scene(seed))
        code, err, seconds = read(text)
        if code is None:
            with tempfile.TemporaryDirectory() as place:
                code, err, seconds = worker.tried(text, Path(place))
                if verdict(code, err):
                    code, err, seconds = tried(text, Path(place))
        wrong = verdict(code, err)
        end = f"BAD: {wrong}" if wrong else {0: "a result", 2: "refused", 3: "the solver gave up"}[int(code or 0)]
        ends[end] = ends.get(end, 0) + 1
        last = err.strip().splitlines()
        if wrong:
            bad += 1
            a.keep.mkdir(parents=True, exist_ok=True)
            (a.keep / f"seed{seed}.toml").write_text(text)
            (a.keep / f"seed{seed}.txt").write_text(err)
        if wrong or not a.quiet:
            print(f"{seed} {end} ({seconds:.0f} s)", last[-1][:200] if last else "", flush=True)
    worker.close()
    print("; ".join(f"{count} {end}" for end, count in sorted(ends.items())))
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
