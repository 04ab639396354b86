"""Random scenes over the whole allowed range of every field: python workflows/fuzz.py [--n 100] [--seed 1] [--keep DIR]

Each that reads as a scene is computed by the command in a process of its own, coarse and for a short time. Allowed ends: a
result (exit code 0), or a
refusal in one message (2: the scene, 3: the solver), within the time. Anything else (a traceback, a signal, no end) is printed
with its scene and kept in DIR; the exit code is then 1.
"""

import argparse
import json
import math
import os
import random
import resource
import signal
import subprocess
import sys
import tempfile
import time
import traceback
from pathlib import Path
from typing import Any

MATERIALS = ("Ni", "Ti", "SS304", "OFHC_Cu", "Al", "42CrMo4")
SHAPES = ("sphere", "hollow_sphere", "oblate", "rod", "flake", "angular")
PATIENCE = 120  # s of processor time; of wall time ten times as many


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
    particles = [particle(dice, count == 1, diameter * dice.choice((1, 1, 0.8, 1.2))) for _ in range(count)]
    points = log_between(dice, 180, 900)
    spacing = diameter * (math.pi / 6 / points) ** (1 / 3)
    faces = ("absorbing", "free", "fixed")
    substrate: dict[str, Any] = {
        "material": dice.choice(MATERIALS),
        "diameter": f"{min(diameter * dice.uniform(2.9, 9), 5000):.4g} um",
        "height": f"{min(diameter * dice.uniform(1.9, 4), 5000):.4g} um",
        "sides": dice.choice(faces),
        "bottom": dice.choice(faces),
    }
    if dice.random() < 0.3:
        substrate["temperature"] = f"{log_between(dice, 100, 1500):.4g} K"
    resolution: dict[str, Any] = {"spacing": f"{spacing:.4g} um"}
    if dice.random() < 0.3:
        resolution["element_size"] = f"{spacing * dice.uniform(0.8, 4):.4g} um"
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
    from coupler.scene import Scene

    try:
        Scene.from_text(text, "scene.toml")
    except SceneError as error:
        return error.exit_code, f"coldspray: {error}", 0.0
    except Exception:
        return 1, traceback.format_exc(), 0.0
    return None, "", 0.0


def tried(text: str, folder: Path) -> tuple[int | None, str, float]:
    """Exit code (None: no end), what it said, and the seconds it took."""
    path, started = folder / "scene.toml", time.perf_counter()
    path.write_text(text)
    command = [sys.executable, "-m", "coupler", "run", str(path), "--out", str(folder / "out"), "--force", "--quiet"]
    one = {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    try:
        done = subprocess.run(
            command,
            capture_output=True,
            text=True,
            timeout=10 * PATIENCE,
            env=os.environ | one,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_CPU, (PATIENCE, PATIENCE + 5)),
        )
    except subprocess.TimeoutExpired:
        return None, "", time.perf_counter() - started
    return done.returncode, done.stderr, time.perf_counter() - started


def main() -> int:
    """Try the scenes. Returns 1 if one came to an end that is not allowed."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--n", type=int, default=100)
    parser.add_argument("--seed", type=int, default=1, help="of the first scene; those after it count on")
    parser.add_argument(
        "--keep", type=Path, default=Path("runs/fuzz"), help="where scenes with a bad end go (default: runs/fuzz)"
    )
    parser.add_argument("--quiet", action="store_true", help="print bad ends and the sum only")
    a = parser.parse_args()
    ends: dict[str, int] = {}
    bad = 0
    for seed in range(a.seed, a.seed + a.n):
        text = toml(scene(seed))
        code, err, seconds = read(text)
        if code is None:
            with tempfile.TemporaryDirectory() as place:
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
    print("; ".join(f"{count} {end}" for end, count in sorted(ends.items())))
    return int(bad > 0)


if __name__ == "__main__":
    sys.exit(main())
