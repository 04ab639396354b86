"""Damaged files of every kind that a command reads: python workflows/fuzz_files.py [--n 2000] [--seed 1] [--keep DIR]

A command reads each damaged file in a forked process with limits on memory and time. (Files that are not regular, and misleading
contents, are tested in tests/files.) Allowed ends: a result (exit code 0), one message (2, 3), or an undecided run (4). After any other
end (a traceback, a warning of a library, a signal, no end) the damage is printed, the log is kept in DIR, and the exit code is 1.
"""

import importlib
import os
import random
import re
import shlex
import shutil
import sys
import tempfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

ROOT = Path(__file__).parents[1]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]
for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import h5py  # noqa: E402
import made_up_run  # noqa: E402
import meshio  # noqa: E402
import numpy as np  # noqa: E402
import sweeps  # noqa: E402
from fuzz import ended, tried, verdict  # noqa: E402

from coupler.files import checkpoint  # noqa: E402
from coupler.files.inputs import read_toml  # noqa: E402
from coupler.files.store import Store  # noqa: E402
from coupler.particle import packing  # noqa: E402
from coupler.plan.planning import plan  # noqa: E402
from coupler.plan.reading import Scene  # noqa: E402
from coupler.plan.record import plan_text  # noqa: E402
from coupler.studies.sweep import Sweep  # noqa: E402

PRELOADED = (
    "coupler.report.page", "coupler.report.animation", "coupler.report.compare", "coupler.studies.maps",
    "coupler.studies.coating_files",
    "coupler.plan.planning", "coupler.plan.text", "coupler.spray.flight", "coupler.splat.convert", "coupler.files.clouds",
    "sklearn.gaussian_process", "matplotlib.backends.backend_agg", "plotly.offline", "rich.console", "coupler.deposition.run",
)  # fmt: skip
MEMORY = 6 * 1024**3  # bytes of address space
PATIENCE = 120  # s of wall time
VALUES = (
    "nan", "inf", "-inf", "-1", "0", "-0.0", "1e999", "-1e999", "1e308", "-1e308", "1e-320", "9" * 400, "1" * 5000,
    "18446744073709551616", "2147483648", '"text"', '""', "'", "true", "null", "[]", "{}", "[[]]", '"25 um"', '"nan um"', '"1e308 m"',
    '"-5 K"', "\u0663", "\x00", "1_0", "0x10", ",", "{a=1}", '"' + "x" * 3000 + '"',
)  # fmt: skip
TINY = """preset = "draft"
particle = { material = "Ni", diameter = "10 um", velocity = "500 m/s" }
substrate = { material = "SS304", diameter = "60 um", height = "30 um" }
resolution = { spacing = "1.1 um" }
end = { time = "12 ns" }
"""
KNOWN = read_toml(ROOT / "workflows" / "fuzz_files.toml")
KINDS: dict[str, dict[str, Any]] = KNOWN["kinds"]


def prepare(folder: Path) -> None:
    """Write one undamaged file of each kind."""
    folder.mkdir(parents=True, exist_ok=True)
    shutil.copy(ROOT / "workflows" / "fast_ni.toml", folder / "scene.toml")
    shutil.copy(ROOT / "workflows" / "coating_ni.toml", folder / "coating.toml")
    text = (ROOT / "coupler" / "spray" / "nozzles.toml").read_text().replace("[D42PBI]", "[nozzles.Mine]")
    (folder / "nozzles.toml").write_text(text)
    rng = np.random.default_rng(1)
    grid = np.stack(np.meshgrid(*[np.arange(6.0)] * 3, indexing="ij"), -1).reshape(-1, 3)
    grid = grid[((grid - 2.5) ** 2).sum(1) < 7.0] + rng.uniform(-0.1, 0.1, 3)
    n = len(grid)
    rows = ["x,y,z,T,eps_p", *(",".join(f"{v:.6g}" for v in (*p, 300.0 + i, 0.1)) for i, p in enumerate(grid))]
    (folder / "cloud.csv").write_text("\n".join(rows) + "\n")
    fields = {"T": np.full(n, 400.0), "stress": np.full((n, 6), 1e8), "velocity": grid}
    np.savez_compressed(folder / "cloud.npz", points=grid * 1e-6, **fields)
    vertices = [("vertex", np.arange(n)[:, None])]
    meshio.Mesh(grid * 1e-6, vertices, {"T": np.full(n, 300.0)}).write(folder / "cloud.vtu")
    head = f"ply\nformat ascii 1.0\nelement vertex {n}\n" + "".join(f"property float {axis}\n" for axis in "xyz")
    body = "".join(f"{a:.6g} {b:.6g} {c:.6g}\n" for a, b, c in grid * 1e-6)
    (folder / "cloud.ply").write_text(f"{head}end_header\n{body}")
    x, t = packing.surface(2.0, 0.6)
    for name in ("text.stl", "shape.stl", "shape.obj", "shape.ply"):
        options = {} if name == "shape.obj" else {"binary": name != "text.stl"}
        meshio.Mesh(x, [("triangle", t.astype(np.int32))]).write(folder / name, **options)
        of_file = f'[particle]\nshape = "file"\nfile = "{name}"'
        scene = (folder / "scene.toml").read_text().replace("[particle]", of_file, 1)
        (folder / f"{name}.toml").write_text(scene)
    made_up_run.write(folder / "runs" / "one", 2, 300, 20.0, summary=made_up_run.summary())
    made_up_run.write(folder / "good", 2, 300, 20.0, summary=made_up_run.summary())
    tiny = Scene.from_text(TINY)
    Store.create(folder / "begun", tiny.to_toml(), plan_json=plan_text(plan(tiny))).close()
    for name in ("runs/one", "good"):  # add the column of the impact, and the field of the body
        table = folder / name / "history.csv"
        head, *lines = table.read_text().splitlines()
        table.write_text("\n".join([f"{head},impact", *(f"{line},1" for line in lines)]) + "\n")
        with h5py.File(folder / name / "target.vtkhdf", "r+", locking=False) as file:
            data, offsets = file["VTKHDF/CellData"], file["VTKHDF/Steps/CellDataOffsets"]
            data["body"], offsets["body"] = np.zeros(len(data["T"]), np.float32), offsets["T"][()]
    sweeps.made(folder / "sweep", Sweep.from_dict(sweeps.points()))
    made_up_run.write(folder / "broken", 2, 300, 20.0)
    store = {"columns": ["time"], "history": np.ones((3, 1)), "steps": {"target": 1}}
    for _ in range(2):
        checkpoint.write(folder / "broken", {"records": [], "store": store, "n": 3}, {"version": "0", "scene": "x"})


# --- mutations: functions of random numbers (dice) and a file (its path or bytes), which they damage; they return what was done


def spoil(dice: random.Random, data: bytearray) -> str:
    """Damage as by a faulty disk or transfer, at a random byte."""
    at, length = dice.randrange(len(data)), dice.choice((1, 8, 200, 4096))
    here, rest = bytes(data[at : at + length]), bytes(data[at + length :])
    how, new = dice.choice((
        ("a bit flipped", bytes([here[0] ^ 1 << dice.randrange(8)]) + here[1:] + rest), ("cut", b""), ("bytes missing", rest),
        ("zeros", bytes(len(here)) + rest), ("garbage", dice.randbytes(length) + here + rest), ("bytes twice", here + here + rest),
    ))  # fmt: skip
    data[at:] = new
    return f"{how} at {at}, length {length}"


def number(dice: random.Random, data: bytearray) -> str:
    """Replace a number or a text by another value."""
    spots = list(re.finditer(rb'"[^"\n]{0,80}"|-?\d+\.?\d*(?:e[+-]?\d+)?', bytes(data)))
    if not spots:
        return spoil(dice, data)
    spot, value = dice.choice(spots), dice.choice(VALUES)
    data[spot.start() : spot.end()] = value.encode()
    return f"{spot.group()[:40]!r} became {value[:40]!r}"


def lines(dice: random.Random, data: bytearray) -> str:
    """Replace a line by a copy of another line."""
    rows = bytes(data).split(b"\n")
    i, j = dice.randrange(len(rows)), dice.randrange(len(rows))
    rows[j] = rows[i]
    data[:] = b"\n".join(rows)
    return f"line {i} in the place of {j}"


def whole(dice: random.Random, data: bytearray) -> str:
    text = bytes(data)
    how, new = dice.choice((
        ("empty", b""), ("byte-order mark", b"\xef\xbb\xbf" + text), ("UTF-16", text.decode("latin-1").encode("utf-16")),
        ("nested lists", b"a = " + b"[" * 600 + b"]" * 600), ("nested JSON", b'{"a": ' * 600 + b"1" + b"}" * 600),
        ("dotted", b"a." * 100_000 + b"a = 1"), ("JSON list", b"[1, 2]"), ("2 MB of #", b"#" * 2_000_000), ("null bytes", bytes(1000)),
        ("carriage returns", text.replace(b"\n", b"\r")), ("huge integer", b'{"points": ' + b"9" * 400 + b"}"),
        ("windows lines", text.replace(b"\n", b"\r\n")), ("long line", b"x" * 300_000 + b"\n" + text),
    ))  # fmt: skip
    data[:] = new
    return how


BYTES = (*(spoil,) * 6, whole)
TEXT = (*(number,) * 4, lines, *BYTES)


def hdf5(dice: random.Random, path: Path) -> str:
    """Keep a valid HDF5 file, but change its contents to what no run writes."""
    with h5py.File(path, "r+", locking=False) as file:
        names: list[str] = []
        file.visititems(lambda name, item: names.append(name) if isinstance(item, h5py.Dataset) else None)
        name = dice.choice(names)
        data, how = file[name], dice.choice(("value", "value", "all", "steps", "resized"))
        if how in ("value", "all"):
            odd = (np.nan, np.inf, 1e308, -1e30, 0.0) if data.dtype.kind == "f" else (-1, 2**40, 2**62, 0, 255)
            new = dice.choice(odd)
            with np.errstate(all="ignore"):
                values = data[()]
                values[... if how == "all" else dice.randrange(len(values))] = np.array(new).astype(data.dtype)
                data[()] = values
        elif how == "steps":
            file["VTKHDF/Steps"].attrs["NSteps"] = dice.choice((0, -1, 10**12, "two", [1, 2], 1.5, float("nan")))
        elif how == "resized" and data.chunks is not None:
            data.resize(dice.choice((0, 1, len(data) + 1, 10**9)), axis=0)
    return f"{name}: {how}"


def crafted(dice: random.Random, path: Path) -> str:
    """Change the header of a checkpoint, and write checksums that match."""
    with np.load(path) as file:
        arrays = dict(file)
    header = bytearray(arrays.pop("header").tobytes())
    how = number(dice, header)
    with path.open("wb") as stream:
        np.savez(stream, header=np.frombuffer(bytes(header), np.uint8), **arrays)
    return f"checksums fit, {how}"


def mutate(dice: random.Random, path: Path) -> str:
    """Damage a file, and say how."""
    own: dict[str, Callable[[random.Random, Path], str]] = {".vtkhdf": hdf5, ".ckpt": crafted}
    if path.suffix in own and dice.random() < 0.7:
        return own[path.suffix](dice, path)
    ways = TEXT if path.suffix in (".toml", ".json", ".csv", ".vtu", ".ply", ".obj", ".stl") else BYTES
    data, said = bytearray(path.read_bytes()), []
    for _ in range(dice.choice((1, 1, 2, 3))):
        if data:
            said.append(dice.choice(ways)(dice, data))
    path.write_bytes(data)
    return "; ".join(said)


# --- running them


def case(seed: int, sound: Path, folder: Path) -> tuple[str, list[str]]:
    """Make the files of a seed in a folder. Returns what was done, and the command."""
    dice = random.Random(seed)
    name = dice.choices([*KINDS], [kind["weight"] for kind in KINDS.values()])[0]
    shutil.copytree(sound, folder)
    path, commands = folder / KINDS[name]["source"], KINDS[name]["commands"]
    said = mutate(dice, path)
    words = {"FILE": path, "RUN": path.parent, "PARENT": path.parent.parent, "GOOD": folder / "good", "SWEEP": folder / "sweep",
             "BROKEN": folder / "broken", "SHAPE": path.with_name(f"{path.name}.toml")}  # fmt: skip
    chosen = shlex.split(dice.choice(KNOWN["commands"][commands] if isinstance(commands, str) else commands))
    command = [str(folder / word) if word.startswith("OUT") else str(words.get(word, word)) for word in chosen]
    return f"{name}: {said}", command


def main(argv: Sequence[str] | None = None) -> int:
    """Try the mutations."""
    for module in PRELOADED:  # once, not in every process
        importlib.import_module(module)
    with tempfile.TemporaryDirectory(prefix="fuzz-") as place:
        sound = Path(place) / "sound"
        prepare(sound)

        def played(seed: int, folder: Path) -> tuple[str, str]:
            said, command = case(seed, sound, folder.with_name("case"))
            log = folder / "log"
            code, _ = ended(command, log, PATIENCE, MEMORY)
            text = log.read_text(errors="replace")
            wrong = verdict(code, text, ["a warning of a library"] if "Warning" in text else [])
            return said.split(":")[0], f"{said}\n  {' '.join(command)}\n  {wrong}" if wrong else ""

        return tried(__doc__, played, 2000, "runs/fuzz-files", argv)


if __name__ == "__main__":
    raise SystemExit(main())
