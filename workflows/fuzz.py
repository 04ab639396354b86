"""Random scenes over the whole allowed range of every field: python workflows/fuzz.py [--n 100] [--seed 1] [--keep DIR]

`coldspray run` computes each scene, coarse and for a short time, in a forked process. Allowed ends within the time limit: a result
in which `verify.check` finds no fault (exit code 0; 4: not at rest, with a message), or one message (2: the scene is refused, 3: the
solver gives up). Every other end (a fault, a traceback, a signal, no end) is printed and kept in DIR; the exit code is then 1.
"""

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

import meshio
import numpy as np
import verify
from pages import options

from coupler import Result, report
from coupler.commands.main import main as coldspray
from coupler.errors import StoreError
from coupler.geometry.triangles import together
from coupler.particle import packing
from coupler.scene.toml import toml_text

MATERIALS = ("Ni", "Ti", "SS304", "OFHC_Cu", "Al", "42CrMo4")
CERAMICS = ("Al2O3", "SiC", "B4C", "TiC", "WC-Co")
POLYMERS = ("PEEK", "ABS", "PA6")
SAMPLES = 41  # of the maps of heights in x and y
SHAPES = ("sphere", "hollow_sphere", "oblate", "rod", "flake", "angular")
PATIENCE = 600  # s of wall time
ENDS = {0: "a result", 2: "refused", 3: "given up", 4: "undecided"}


def log_between(dice: random.Random, low: float, high: float) -> float:
    """A random number between low and high; its logarithm is uniformly distributed."""
    return math.exp(dice.uniform(math.log(low), math.log(high)))


def particle(dice: random.Random, alone: bool, diameter: float) -> dict[str, Any]:
    """A table [particle]; each optional field is left out in some tables."""
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


def pores(dice: random.Random, diameter: float, spacing: float) -> dict[str, Any]:
    """Keys of one or two pores in a particle. diameter, spacing: of the particle and its points, um."""
    pore = dice.uniform(3.0, 4.5) * spacing
    volume = dice.choice((1, 1, 2)) * (pore / diameter) ** 3
    return {"porosity": round(volume / (1.0 + volume), 4), "pore_diameter": f"{pore:.4g} um"}


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
    if not said and dice.random() < 0.15:
        thickness = f"{max(diameter * log_between(dice, 0.1, 0.8), 1.75 * spacing):.4g} um"
        layers = [{"material": dice.choice(MATERIALS), "thickness": thickness} for _ in range(2)]
        said = {"layer": layers[: dice.choice((1, 2))]}
    return said


def roughness(dice: random.Random, diameter: float, spacing: float) -> dict[str, Any]:
    """Keys of a rough substrate, in a fifth of the scenes. diameter, spacing: of the particle and its points, um."""
    if dice.random() >= 0.2:
        return {}
    Sa = log_between(dice, 0.005, 0.08) * diameter
    length = max(4.0 * Sa, 7.0 * spacing) * dice.uniform(0.9, 3.0)
    return {"roughness": f"{Sa:.4g} um", "roughness_length": f"{max(length, 1.0):.4g} um"}


def surface(dice: random.Random, substrate: dict[str, Any]) -> dict[str, Any]:
    """Changes of the table [substrate] in a sixth of the scenes: a polymer as its material, a file of heights, or both."""
    said: dict[str, Any] = {"material": dice.choice(POLYMERS)} if dice.random() < 0.08 else {}
    across = float(substrate["diameter"].split()[0]) * dice.uniform(0.98, 1.3)
    name, pitch = dice.choice((("map.csv", across / (SAMPLES - 1)), ("patch.stl", across / 2.0)))
    if dice.random() < 0.1 and "layer" not in substrate:
        height = across * log_between(dice, 0.002, 0.06)
        said["height_map"] = {"file": name, "unit": f"{pitch:.4g} um", "height": f"{height:.4g} um"}
    return said


def write_files(dice: random.Random, folder: Path) -> None:
    """Write the files that scenes name: heights of about 1, as a matrix and as an open surface over -1 to 1; a closed surface with none
    to two pores; the mass flow against the radius of a spot."""
    axis = np.linspace(-1.0, 1.0, SAMPLES)
    x, y = np.meshgrid(axis, -axis)
    waves = [[dice.uniform(-6.0, 6.0), dice.uniform(-6.0, 6.0), dice.uniform(-3.0, 3.0)] for _ in range(3)]
    z = sum(np.sin(a * x + b * y + c) for a, b, c in waves)
    np.savetxt(folder / "map.csv", z, delimiter=",")
    corner = np.arange(SAMPLES**2).reshape(SAMPLES, SAMPLES)
    a, b, c, d = (part.ravel() for part in (corner[:-1, :-1], corner[1:, :-1], corner[1:, 1:], corner[:-1, 1:]))
    triangles = np.concatenate([np.column_stack([a, b, c]), np.column_stack([a, c, d])])
    points = np.column_stack([x.ravel(), y.ravel(), z.ravel()])
    meshio.Mesh(points, [("triangle", triangles)]).write(folder / "patch.stl")
    points, faces = packing.surface(1.0, 0.1)
    bodies = [(points * [dice.uniform(0.8, 1.3) for _ in "xyz"], faces)]
    for x0 in dice.choice(((), (0.0,), (-0.22, 0.22))):
        bodies.append((points * dice.uniform(0.2, 0.45) + [x0, dice.uniform(-0.1, 0.1), 0.0], faces))
    points, faces = together(bodies)
    meshio.Mesh(points, [("triangle", faces)]).write(folder / "powder.stl")
    np.savetxt(folder / "spot.csv", [[r, max(1.0 - (r / 4.0) ** 2, 0.0)] for r in range(5)], delimiter=",")


def bond(dice: random.Random) -> dict[str, Any]:
    """A table [adhesion]."""
    return dice.choice((
        {"kind": "tied"}, {"kind": "none"},
        {"kind": "cohesive", "strength": f"{dice.uniform(1, 900):.4g} MPa", "energy": f"{log_between(dice, 10, 1e4):.4g} J/m2"},
        {"kind": "tied", "criterion": "plastic_strain", "threshold": round(dice.uniform(0, 2), 2)},
        {"kind": "tied", "criterion": "pressure", "threshold": f"{dice.uniform(0, 5000):.4g} MPa"},
        {"kind": "tied", "criterion": "velocity", "threshold": round(dice.uniform(0, 2), 2)},
    ))  # fmt: skip


def flight_time(table: dict[str, Any], spacing: float) -> float:
    """Time in ns from the start of a particle to its contact. spacing: um; without a key `gap`, the gap is half a spacing."""
    said = table.get("gap", f"{spacing / 2} um"), table["velocity"], table.get("angle", "0 deg")
    gap, velocity, angle = (float(text.split()[0]) for text in said)
    return 1e3 * gap / (velocity * math.cos(math.radians(angle)))


def powder(dice: random.Random, diameter: float, spacing: float) -> dict[str, Any]:
    """Keys of a powder. diameter, spacing: of a particle and of the points of the smallest one, um."""
    low, high = f"{diameter * dice.uniform(0.82, 1.0):.4g} um", f"{diameter * dice.uniform(1.05, 1.25):.4g} um"
    middle, velocity = f"{diameter:.4g} um", log_between(dice, 250, 1100)
    said: dict[str, Any] = {"material": dice.choice(MATERIALS if dice.random() < 0.75 else CERAMICS)}
    said |= dice.choice((
        {"diameter": middle}, {"diameter": middle, "spread": round(dice.uniform(1.0, 1.5), 2), "smallest": low, "largest": high},
        {"sizes": f"{low[:-3]}-{high}"}, {"sizes": [low, middle, high], "smallest": low},
    ))  # fmt: skip
    slow = f"{0.8 * velocity:.4g} m/s"
    said["velocity"] = dice.choice((f"{velocity:.4g} m/s", [[low, f"{velocity:.4g} m/s"], [high, slow]]))
    maybe = {
        "velocity_spread": f"{dice.uniform(0, 0.1) * velocity:.4g} m/s", "temperature": f"{dice.uniform(250, 750):.4g} K",
        "shapes": {"sphere": 1, dice.choice(SHAPES): round(dice.uniform(0, 2), 2)}, "files": "powder*.stl",
    }  # fmt: skip
    said |= {name: value for name, value in maybe.items() if dice.random() < 0.25}
    if "files" not in said and "hollow_sphere" not in said.get("shapes", ()) and dice.random() < 0.25:
        said |= pores(dice, diameter, spacing)
    return said


def spray(dice: random.Random) -> dict[str, Any]:
    """A table [spray]; in two of three tables the gun moves."""
    spot = dice.uniform(2, 10)
    said: dict[str, Any] = {
        "feed_rate": f"{log_between(dice, 1, 100):.3g} g/min", "spot": f"{spot:.3g} mm",
        "traverse_speed": f"{log_between(dice, 5, 1000):.4g} mm/s",
        "distribution": dice.choice(("uniform", "gaussian", "spot.csv")), "angle": f"{dice.uniform(0, 60):.3g} deg",
    }  # fmt: skip
    if dice.random() < 0.67:
        said["passes"] = dice.choice((1, 2, 2, 3))
        said["length"] = f"{dice.uniform(0.8, 5) * 4 * spot:.4g} mm"
        said |= {"step": f"{dice.uniform(0.05, 0.6) * spot:.3g} mm"} if dice.random() < 0.7 else {}
        said |= {"first": f"{dice.uniform(-0.6, 0.3) * spot:.3g} mm"} if dice.random() < 0.3 else {}
    kept = ("passes", "length", "step", "first")
    return {name: value for name, value in said.items() if name in kept or dice.random() < 0.6}


def coating(seed: int) -> dict[str, Any]:
    """The scene of a seed with a table [coating]: two or three particles of one to three powders. About half of the scenes end cold."""
    dice = random.Random(f"coating {seed}")
    diameter, count = log_between(dice, 3, 80), dice.choice((2, 2, 2, 3))
    spacing = 0.8 * diameter * (math.pi / 6 / log_between(dice, 205, 320)) ** (1 / 3)
    kinds = dice.choice((1, 2, 2, min(count, 3)))
    radius = diameter * dice.uniform(0.0, 1.2)
    table: dict[str, Any] = {
        "number": count, "layers": dice.choice((1, 1, count)), "radius": f"{radius:.4g} um",
        "positions": dice.choice(("random", "even")), "seed": seed,
    }  # fmt: skip
    if kinds == 1 or dice.random() < 0.3:
        table |= powder(dice, diameter, spacing)
    if kinds > 1:
        shares = [dice.uniform(0.8, 1.2) for _ in range(kinds)]
        parts = [{"share": round(share / sum(shares), 4)} for share in shares]
        table["powder"] = [powder(dice, diameter, spacing) | part for part in parts]
    substrate: dict[str, Any] = {
        "material": dice.choice(MATERIALS), "diameter": f"{diameter * dice.uniform(4.5, 6) + 2 * radius:.4g} um",
        "height": f"{diameter * dice.uniform(2.7, 4):.4g} um",
    }  # fmt: skip
    substrate |= {"temperature": f"{dice.uniform(200, 700):.4g} K"} if dice.random() < 0.2 else {}
    substrate |= shape(dice, diameter, spacing)
    substrate |= roughness(dice, diameter, spacing) if "layer" not in substrate else {}
    substrate |= surface(dice, substrate)
    said: dict[str, Any] = {
        "coating": table, "substrate": substrate,
        "resolution": {"spacing": f"{spacing:.4g} um", "engine": dice.choice(("compiled", "enriched", "enriched", "machdyn"))},
    }  # fmt: skip
    if dice.random() < 0.6:
        said["spray"] = spray(dice)
    if "passes" not in said.get("spray", ()) and dice.random() < 0.5:
        table["dwell"] = f"{log_between(dice, 0.1, 1000):.4g} us"
    if dice.random() < 0.6:
        time = {"time": f"{dice.uniform(0.3, 1.2) * diameter:.4g} ns"}
        said["end"] = dice.choice(({"at": "greatest"}, time, time, {"ambient": "350 K"}))
    if dice.random() < 0.3 or "42CrMo4" in str(said) or substrate["material"] in POLYMERS:
        said["adhesion"] = bond(dice)
    return said


def scene(seed: int) -> dict[str, Any]:
    """The scene of a seed. Fields vary over their ranges, but sizes fit together, so that most scenes run. A third are coatings."""
    if seed % 3 == 0:
        return coating(seed)
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
    substrate |= roughness(random.Random(f"rough {seed}"), diameter, spacing)  # own dice: other fields stay the same
    hard = random.Random(f"hard {seed}")
    for table in (*particles, substrate):
        if hard.random() < 0.1:
            table["material"] = hard.choice(CERAMICS)
    for table, of_one in zip(particles, diameters, strict=True):
        if hard.random() < 0.15 and table.get("shape") != "hollow_sphere":
            table |= pores(hard, of_one, spacing)
        elif hard.random() < 0.07:
            table |= {"shape": "file", "file": "powder.stl"}
    substrate |= shape(random.Random(f"shape {seed}"), diameter, spacing)
    if "layer" in substrate:  # layers are flat
        substrate.pop("roughness", None)
    substrate |= surface(random.Random(f"surface {seed}"), substrate)
    resolution: dict[str, Any] = {"spacing": f"{spacing:.4g} um"}
    if dice.random() < 0.3:
        resolution["element_size"] = f"{spacing * dice.uniform(0.8, 1.6):.4g} um"
    if dice.random() < 0.3:
        resolution["growth"] = round(log_between(dice, 0.1, 1.0), 3)
    crossing = diameter / float(particles[0]["velocity"].split()[0]) * 1e3  # ns
    # as many steps as take a second or two of computing time: a run of a particle at 10 m/s ends before it is at rest
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
        said["adhesion"] = bond(dice)
    resolution["engine"] = ("compiled", "compiled", "enriched", "enriched", "machdyn")[seed % 5]
    if count > 1 and dice.random() < 0.5:
        said["splat"] = {"method": dice.choice(("auto", "carried", "density"))}
    return said


def verdict(code: int | None, said: str, faults: Sequence[str] = ()) -> str:
    """Text: what is wrong with an end; "" if it is allowed. code: exit code, None: no end; said: output; faults: of the result."""
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
    """Compute the scene of a seed, check its result, and measure it if it is a coating. Returns how it ended, and what is wrong."""
    path, out, log = folder / "scene.toml", folder.with_name("out"), folder / "log"
    said = scene(seed)
    path.write_text(toml_text(said))
    write_files(random.Random(f"files {seed}"), folder)
    code, _ = ended(["run", str(path), "--out", str(out), "--quiet", "--threads", "1"], log, PATIENCE)
    faults: list[str] = []
    if code in (0, 4):
        try:
            faults = verify.check(Result(out)).faults
        except StoreError as problem:
            faults = [str(problem)]
    wrong = verdict(code, log.read_text(errors="replace"), faults)
    if not wrong and code == 0 and "coating" in said:
        log = folder / "log_coating"
        measured, _ = ended(["coating", str(out)], log, PATIENCE)
        wrong = verdict(measured, text := log.read_text(errors="replace"), ["nan"] if "nan" in text.lower() else [])
    return ENDS.get(code or 0, ""), f"coating: {wrong}" if wrong and log.name != "log" else wrong


def tried(
    about: str, play: Callable[[int, Path], tuple[str, str]], n: int, keep: str, argv: Sequence[str] | None
) -> int:
    """Play n seeds and print how they end. Returns 1 if one came to an end that is not allowed.

    play(seed, folder): returns how a seed ends, and what is wrong with this end, "" for nothing. If something is wrong, the folder is
    copied to keep/SEED. The parent of the folder belongs to this seed alone.
    """
    a = options(about, argv=argv, n=n, seed=1, keep=Path(keep))
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
