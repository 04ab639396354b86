"""Random scenes over the whole allowed range of every field: python workflows/fuzz.py [--n 100] [--seed 1] [--keep DIR]

Each is computed by the command, coarse and for a short time, in a forked process. Allowed ends: a result (exit code 0; 4:
not at rest in its time, which it says) in which `verify.check` finds no fault, or one message (2: the scene is refused, 3: the solver
gives up), within the time. All else (a fault, a traceback, a signal, no end) is printed and kept in DIR, and the exit code is then 1.
"""

import argparse
import contextlib
import math
import os
import random
import resource
import shutil
import signal
import sys
import tempfile
import time
import traceback
from collections import Counter
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import verify

from coupler import Result, report
from coupler.commands.main import main as coldspray
from coupler.errors import StoreError
from coupler.studies.sweep import toml_text

MATERIALS = ("Ni", "Ti", "SS304", "OFHC_Cu", "Al", "42CrMo4")
CERAMICS = ("Al2O3", "SiC", "B4C", "TiC", "WC-Co")
SHAPES = ("sphere", "hollow_sphere", "oblate", "rod", "flake", "angular")
PATIENCE = 600  # s of wall time
ENDS = {0: "a result", 2: "refused", 3: "given up", 4: "undecided"}


def log_between(dice: random.Random, low: float, high: float) -> float:
    """Evenly in the logarithm."""
    return math.exp(dice.uniform(math.log(low), math.log(high)))


def particle(dice: random.Random, alone: bool, diameter: float) -> dict[str, Any]:
    """A table [particle], any field left out now and then."""
    velocity, angle = log_between(dice, 10, 2000), dice.uniform(0, 80)
    fall = 1e-3 * velocity * math.cos(math.radians(angle))  # um/ns
    table: dict[str, Any] = {
        "material": dice.choice(MATERIALS), "diameter": f"{diameter:.4g} um", "velocity": f"{velocity:.4g} m/s",
    }  # fmt: skip
    maybe = {
        "shape": dice.choice(SHAPES), "angle": f"{angle:.4g} deg", "tilt": f"{dice.uniform(-90, 90):.4g} deg",
        "temperature": f"{log_between(dice, 100, 1700):.4g} K",
        "offset": [f"{dice.uniform(-1, 1) * diameter:.4g} um" for _ in "xy"],
        "gap": f"{dice.uniform(0, 1) * min(diameter, 20.0 * diameter / 25.0 * fall):.4g} um",  # 20 ns in flight, for 25 um
        "dwell": f"{dice.uniform(0, 10):.4g} us",
    }  # fmt: skip
    return table | {name: value for name, value in maybe.items() if dice.random() < (0.4 if alone else 0.25)}


def shape(dice: random.Random, diameter: float, spacing: float) -> dict[str, Any]:
    """Keys of a shaped or layered substrate, in a fourth of the scenes. diameter, spacing: of the particle and its points, um."""
    angle, depth = dice.uniform(20.0, 65.0), diameter * log_between(dice, 0.05, 0.8)
    across = {"angle": f"{angle:.4g} deg", "direction": f"{dice.uniform(-180.0, 180.0):.4g} deg"}
    width = max(7.0 * spacing, 2.0 * depth / math.tan(math.radians(angle))) * dice.uniform(0.95, 2.0)
    kinds: dict[str, dict[str, str]] = {
        "groove": {"width": f"{width:.4g} um", "depth": f"{max(depth, 0.1):.4g} um"} | across,
        "step": {"height": f"{max(depth, 0.1):.4g} um"} | across,
        "slope": across | {"angle": f"{dice.uniform(1.0, 30.0):.4g} deg"},
    }
    said: dict[str, Any] = {name: kinds[name] for name in kinds if dice.random() < 0.07}
    if not said and dice.random() < 0.1:
        thick = diameter * log_between(dice, 0.1, 0.8)
        layers = [
            {"material": dice.choice(MATERIALS), "thickness": f"{max(thick, 1.65 * spacing):.4g} um"} for _ in range(2)
        ]
        said = {"layer": layers[: dice.choice((1, 2))]}
    return said


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
        "material": dice.choice(MATERIALS), "diameter": f"{min(largest * dice.uniform(2.9, 9), 5000):.4g} um",
        "height": f"{min(largest * dice.uniform(1.9, 6), 5000):.4g} um", "sides": dice.choice(faces), "bottom": dice.choice(faces),
    }  # fmt: skip
    if dice.random() < 0.3:
        substrate["temperature"] = f"{log_between(dice, 100, 1500):.4g} K"
    rough = random.Random(f"rough {seed}")  # of its own, so that a seed keeps all else
    if rough.random() < 0.2:
        Sa = log_between(rough, 0.005, 0.08) * diameter
        length = max(4.0 * Sa, 7.0 * spacing) * rough.uniform(0.9, 3.0)
        substrate |= {"roughness": f"{Sa:.4g} um", "roughness_length": f"{max(length, 1.0):.4g} um"}
    hard = random.Random(f"hard {seed}")
    for table in (*particles, substrate):
        if hard.random() < 0.1:
            table["material"] = hard.choice(CERAMICS)
    for table in particles:
        if hard.random() < 0.15 and table.get("shape") != "hollow_sphere":
            table |= {
                "porosity": round(hard.uniform(0.02, 0.3), 3),
                "pore_diameter": f"{hard.uniform(2.5, 6.0) * spacing:.4g} um",
            }
    substrate |= shape(random.Random(f"shape {seed}"), diameter, spacing)
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


def verdict(code: int | None, said: str, faults: Sequence[str] = ()) -> str:
    """What is wrong with an end; nothing if it is allowed. code: None for no end; said: by the command; faults: of its result."""
    if code is None:
        return "no end in time"
    if code not in ENDS:
        return f"exit code {code}"
    if "Traceback" in said:
        return "a traceback"
    messages = [line for line in said.splitlines() if line.startswith(("coldspray: ", "usage: "))]
    if code in (2, 3) and len(messages) != 1:
        return f"exit code {code} with {len(messages)} messages"
    return f"silently wrong: {'; '.join(faults)}" if faults else ""


def ended(
    command: list[str], log: Path, patience: int, memory: int = resource.RLIM_INFINITY
) -> tuple[int | None, float]:
    """Run a command in a forked process. Returns its exit code (negative: a signal; None: no end) and the wall time, s.

    log: file of all that it says. patience: s of wall time. memory: bytes of address space.
    """
    started = time.monotonic()
    if (pid := os.fork()) == 0:
        _run(command, log, patience, memory)
    code = os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])
    with contextlib.suppress(ProcessLookupError):
        os.killpg(pid, signal.SIGKILL)  # processes that it has left
    return None if code == -signal.SIGALRM else code, time.monotonic() - started


def _run(command: list[str], log: Path, patience: int, memory: int) -> None:
    """Run a command in this forked process, and end it with the command's exit code; 99 for an exception."""
    code = 99
    try:
        os.setpgid(0, 0)
        signal.alarm(patience)
        with open(log, "w") as stream:
            os.dup2(stream.fileno(), 1)
            os.dup2(stream.fileno(), 2)
        sys.stdout, sys.stderr = (os.fdopen(os.dup(k), "w", buffering=1) for k in (1, 2))
        resource.setrlimit(resource.RLIMIT_AS, (memory, memory))
        resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
        try:
            code = coldspray(command)
        except SystemExit as end:
            code = end.code if isinstance(end.code, int) else 1
        except BaseException:
            traceback.print_exc()
        sys.stdout.flush()
        sys.stderr.flush()
    finally:
        os._exit(code)


def played(seed: int, folder: Path) -> tuple[str, str]:
    """Compute the scene of a seed, and check its result. Returns how it ended, and what is wrong with that."""
    path, out, log = folder / "scene.toml", folder.with_name("out"), folder / "log"
    path.write_text(toml_text(scene(seed)))
    code, _ = ended(["run", str(path), "--out", str(out), "--quiet", "--threads", "1"], log, PATIENCE)
    faults: list[str] = []
    if code in (0, 4):
        try:
            faults = verify.check(Result(out)).faults
        except StoreError as problem:
            faults = [str(problem)]
    return ENDS.get(code or 0, ""), verdict(code, log.read_text(errors="replace"), faults)


def tried(
    about: str, play: Callable[[int, Path], tuple[str, str]], n: int, keep: str, argv: Sequence[str] | None
) -> int:
    """Play n seeds and print how they end. Returns 1 if one came to an end that is not allowed.

    play(seed, folder): how a seed ends, and what is wrong with that, "" for nothing; what lies in the folder, which is within one of
    the seed's own, is then kept in keep/SEED.
    """
    parser = argparse.ArgumentParser(description=about, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--n", type=int, default=n)
    parser.add_argument("--seed", type=int, default=1, help="the first one; those after it count on")
    parser.add_argument("--keep", type=Path, default=Path(keep))
    a = parser.parse_args(argv)
    ends: Counter[str] = Counter()
    for seed in range(a.seed, a.seed + a.n):
        with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
            folder = Path(place) / "kept"
            folder.mkdir()
            how, wrong = play(seed, folder)
            if wrong:
                shutil.copytree(folder, a.keep / str(seed), dirs_exist_ok=True)
        ends["BAD" if wrong else how] += 1
        print(seed, how, *([f"BAD: {wrong}; see {a.keep / str(seed)}"] if wrong else []), flush=True)
    print("; ".join(f"{count} {end}" for end, count in sorted(ends.items())))
    return int("BAD" in ends)


def main(argv: Sequence[str] | None = None) -> int:
    """Try the scenes."""
    os.environ |= {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}
    report.section_picture = lambda result: None  # it costs as much as the run
    return tried(__doc__, played, 100, "runs/fuzz", argv)


if __name__ == "__main__":
    sys.exit(main())
