"""A sweep: one scene for each of many diameters, velocities, temperatures and materials, each a run in its own folder.

OUT/<point>.toml is the scene, OUT/<point>/ the folder of its `coldspray run`, OUT/<point>.json how that ended. A point that
has its .json is finished with, well or badly; one that has not is run, or gone on with. So a sweep that was killed is started
again by the same command, whoever runs it: `Sweep.run`, or workflows/Snakefile, whose rules call this file.
"""

import fcntl
import itertools
import json
import math
import os
import re
import signal
import subprocess
import sys
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from types import FrameType
from typing import TypeVar

from .. import units
from ..errors import SceneError
from ..files.inputs import InputError, read_json_object, read_text, read_toml
from ..files.outputs import claim_folder, write_text
from ..plan.reading import Scene
from ..scene.model import safe_name

T = TypeVar("T")
AXES = {"diameter": "um", "velocity": "m/s", "temperature": "K"}  # and the unit of each in the names of points
MOST_POINTS = 10_000
SUBSTRATE = (8.0, 4.0)  # diameter and height over the particle's diameter: 200 x 100 um for 25 um
_KEYS = ("name", "points", "scene")
_POINT_KEYS = ("material", *AXES, "substrate_diameter", "substrate_height")
_STOPPED = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)  # somebody wanted to stop: no verdict on the point
_STATUS = {0: "done", 4: "undecided"}  # by the exit code of a run; "failed" else
_EXAMPLES = {
    "material": '["Ni"]',
    "diameter": '["10 um", "25 um"]',
    "velocity": '["500 m/s"]',
    "temperature": '["300 K"]',
}


@dataclass(frozen=True)
class Sweep:
    """The points of a sweep. name: of the folder runs/<name>; points: name of each -> its scene as TOML.

    refused: points whose scene cannot be computed -> why. They are marked as failed, not left out.
    """

    name: str
    points: dict[str, str]
    refused: dict[str, str]

    @classmethod
    def load(cls, path: str | Path) -> "Sweep":
        """Read a sweep's file (TOML, as workflows/map_ni.toml). Raises SceneError with every problem of it."""
        path = Path(path)
        try:
            data = read_toml(path)
        except InputError as error:
            raise SceneError([error.reason], str(path)) from None
        return cls.from_dict(data, str(path))

    @classmethod
    def from_dict(cls, data: Mapping[str, object], source: str = "sweep") -> "Sweep":
        """A sweep from nested dicts, as TOML has them. Raises SceneError with every problem of it.

        data["points"]: lists of `material`, `diameter`, `velocity` and `temperature` (["300 K"] unless given), as a scene's
        particle has them, all combined; substrate_diameter, substrate_height: over the particle's diameter.
        data["scene"]: what all scenes share, as a scene has it.
        """
        problems = _unknown(data, _KEYS, "")
        name = data.get("name", safe_name(source))
        if not isinstance(name, str) or not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9_.-]{0,63}", name):
            problems.append("name: use letters, digits, '_', '.', '-' (at most 64, a letter or digit first)")
        points, shared = data.get("points"), data.get("scene", {})
        for key, table in (("points", points), ("scene", shared)):
            if not isinstance(table, Mapping):
                problems.append(f"{key}: expected a table [{key}]")
        if problems or not (isinstance(points, Mapping) and isinstance(shared, Mapping) and isinstance(name, str)):
            raise SceneError(problems, source)
        problems = _unknown(points, _POINT_KEYS, "points.")
        materials, sizes = _values(points, "material", _name, problems), _sizes(points, problems)
        values = {
            axis: _values(points, axis, partial(units.parse, dimension=units.dimension_of(unit)), problems)
            for axis, unit in AXES.items()
        }
        problems += _shared_problems(shared)
        count = len(materials) * math.prod(map(len, values.values()))
        if count > MOST_POINTS:
            problems.append(f"points: {count} combinations; at most {MOST_POINTS} are possible")
        if problems:
            raise SceneError(problems, source)
        scenes: dict[str, str] = {}
        refused: dict[str, str] = {}
        first: SceneError | None = None
        for material, on_axes in itertools.product(materials, itertools.product(*values.values())):
            at = dict(zip(AXES, on_axes, strict=True))
            point, scene = point_name(material, **at), _scene(shared, material, at, sizes)
            scenes[point] = toml_text(scene)
            try:
                Scene.from_dict(scene, point)
            except SceneError as error:
                refused[point], first = str(error), first or error
        if first is not None and len(refused) == len(scenes):  # not a point's fault
            raise SceneError([f"no point can be computed; the first: {problem}" for problem in first.problems], source)
        return cls(name, scenes, refused)

    def write(self, out: str | Path, point: str) -> Path:
        """Write the scene of a point into `out`, unless it is there. Returns its path. Raises StoreError."""
        return _write(Path(out), point, self.points[point])

    def run(self, out: str | Path | None = None, jobs: int = 1, log: Callable[[str], None] = print) -> Path:
        """Run every point that has not been, `jobs` at a time, each on one core. Returns the folder, runs/<name> by default.

        A point that fails is marked and does not stop the others. log: told of each point as it ends.
        """
        folder = Path(out) if out is not None else Path("runs") / self.name
        done = itertools.count(1)

        def compute_point(point: str) -> None:
            ended = run_point(folder, point, self.points[point])
            log(f"{next(done)}/{len(self.points)} {point}: {_status(ended)}")

        with ThreadPoolExecutor(max(jobs, 1)) as pool:
            waiting = [pool.submit(compute_point, point) for point in self.points]
            try:
                for future in waiting:
                    future.result()
            except BaseException:
                pool.shutdown(wait=False, cancel_futures=True)
                raise
        return folder


def point_name(material: str, diameter: float, velocity: float, temperature: float) -> str:
    """What a point is called: point_name("Ni", 25e-6, 500.0, 300.0) is "Ni_25um_500ms_300K"; SI units."""
    return f"{material}_{diameter * 1e6:.6g}um_{velocity:.6g}ms_{temperature:.6g}K"


def run_point(folder: Path, point: str, text: str, again: bool = False) -> dict[str, object]:
    """Run a scene (TOML) as a point of a folder, unless it has been; how it ended, as `compute`. again: go on with an undecided one."""
    known, scene = folder / f"{point}.json", _write(folder, point, text)
    fresh = known.is_file() and known.stat().st_mtime_ns >= scene.stat().st_mtime_ns
    ended = how_ended(known) if fresh and not again else None
    return compute(scene, known) if ended is None else ended


def _write(folder: Path, point: str, text: str) -> Path:
    """The file of a point's scene, written unless it is there. Raises StoreError."""
    path = folder / f"{point}.toml"
    if not path.is_file() or read_text(path) != text:
        claim_folder(folder, "sweep", [path.name])
        write_text(path, text)
    return path


def compute(scene: Path, status: Path) -> dict[str, object]:
    """Run a scene into the folder of its name, or go on there, on one core; write how it ended to `status` and return it.

    {"status": "done", "undecided" or "failed", "reason": the message, "exit_code": int}. A run that was stopped from outside raises
    KeyboardInterrupt and leaves no status, so that the next attempt goes on with it.
    """
    folder = scene.with_suffix("")
    folder.mkdir(parents=True, exist_ok=True)
    _wait_for(folder)
    verb = ["resume", folder] if _begun(scene, folder) else ["run", scene, "--out", folder, "--force"]
    command = [sys.executable, "-m", "coupler", *map(str, verb), "--threads", "1", "--quiet"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as run:
        try:
            _, errors = run.communicate()
        except BaseException:
            run.terminate()  # it writes a checkpoint
            run.communicate()
            raise
    code = run.returncode
    if code in {*(-number for number in _STOPPED), *(128 + number for number in _STOPPED)}:
        raise KeyboardInterrupt
    ended = {"status": _STATUS.get(code, "failed"), "reason": _reason(code, errors), "exit_code": code}
    write_text(status, json.dumps(ended, indent=1) + "\n")
    return ended


def main(arguments: list[str]) -> int:
    """`python -m coupler.studies.sweep SCENE STATUS`: what workflows/Snakefile calls for each point. Returns the exit code."""
    scene, status = map(Path, arguments)

    def stop(number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    for number in _STOPPED:
        signal.signal(number, stop)
    try:
        print(f"{scene.stem}: {_status(compute(scene, status))}")
    except KeyboardInterrupt:
        return 128 + signal.SIGTERM
    return 0


def _unknown(table: Mapping[str, object], known: tuple[str, ...], where: str) -> list[str]:
    return [
        f"{where}{key}: unknown key{units.nearest(str(key), known)}; known: {', '.join(known)}"
        for key in table
        if key not in known
    ]


def _values(points: Mapping[str, object], axis: str, read: Callable[[object], T], problems: list[str]) -> list[T]:
    """The values of an axis, each once. read: of an item, raises ValueError. Every problem is added to `problems`."""
    entry = points.get(axis, ["300 K"] if axis == "temperature" else None)
    items = [entry] if isinstance(entry, str) else entry
    if not isinstance(items, list) or not items:
        problems.append(f"points.{axis}: expected a list, such as {_EXAMPLES[axis]}")
        return []
    values = []
    for item in items:
        try:
            values.append(read(item))
        except ValueError as error:
            problems.append(f"points.{axis} = {json.dumps(item, default=str)[:60]} {error}")
    return list(dict.fromkeys(values))


def _name(item: object) -> str:
    if isinstance(item, str) and re.fullmatch(r"[A-Za-z0-9_.-]{1,40}", item):
        return item
    raise ValueError("is not the name of a material")


def _sizes(points: Mapping[str, object], problems: list[str]) -> tuple[float, float]:
    sizes = []
    for key, default in zip(("substrate_diameter", "substrate_height"), SUBSTRATE, strict=True):
        value = points.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int | float) or not 1.0 <= value <= 1000.0:
            problems.append(f"points.{key}: expected a number, the target's over the particle's diameter, 1 to 1000")
            value = default
        sizes.append(float(value))
    return sizes[0], sizes[1]


def _shared_problems(shared: Mapping[str, object]) -> list[str]:
    particle = shared.get("particle", {})
    if not isinstance(particle, Mapping):
        return ["scene.particle: expected one table [scene.particle]; a point is one impact"]
    problems = [
        f"scene.particle.{key}: give it as a list under [points]" for key in ("material", *AXES) if key in particle
    ]
    return problems + (["scene.gas: a sweep gives velocities and temperatures itself"] if "gas" in shared else [])


def _scene(
    shared: Mapping[str, object], material: str, at: dict[str, float], sizes: tuple[float, float]
) -> dict[str, object]:
    values = {axis: units.show(value, AXES[axis]) for axis, value in at.items()}
    D, (particle, substrate) = at["diameter"], (_subtable(shared, name) for name in ("particle", "substrate"))
    size = {"diameter": units.show(sizes[0] * D, "um"), "height": units.show(sizes[1] * D, "um")}
    return {**shared, "particle": {**particle, "material": material, **values}, "substrate": {**size, **substrate}}


def _subtable(shared: Mapping[str, object], name: str) -> Mapping[str, object]:
    table = shared.get(name, {})
    return table if isinstance(table, Mapping) else {}


def toml_text(table: Mapping[str, object], above: str = "") -> str:
    """Nested dicts as lines of dotted keys."""
    lines = ""
    for key, value in table.items():
        name = above + (key if re.fullmatch(r"[A-Za-z0-9_-]+", key) else json.dumps(key))
        lines += toml_text(value, f"{name}.") if isinstance(value, Mapping) else f"{name} = {json.dumps(value)}\n"
    return lines


def _wait_for(folder: Path) -> None:
    """Until no other process writes to the folder: one of a sweep whose head was killed may go on to its end."""
    descriptor = os.open(folder, os.O_RDONLY | os.O_CLOEXEC)
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX)  # the lock that a run holds; see coupler.files.store
    except OSError:  # a file system without locks: as there
        pass
    finally:
        os.close(descriptor)


def _begun(scene: Path, folder: Path) -> bool:
    """Whether the folder holds a run of this very scene."""
    try:
        return read_text(folder / "scene.toml") == Scene.load(scene).to_toml()
    except (InputError, SceneError):
        return False


def _reason(code: int, errors: str) -> str:
    """The message of a run that failed or is undecided: from its last line with the program's name, or the signal that killed it."""
    if code == 0:
        return ""
    if code < 0:
        return f"killed by {signal.Signals(-code).name}"
    at = errors.rfind("coldspray: ")
    text = errors[at + len("coldspray: ") :] if at >= 0 else (errors.strip().splitlines() or [f"exit code {code}"])[-1]
    return " ".join(text.split())


def how_ended(path: Path) -> dict[str, object] | None:
    """How a point ended; None if its file is damaged."""
    try:
        ended = read_json_object(path)
    except InputError:
        return None
    return ended if isinstance(ended.get("status"), str) else None


def _status(ended: Mapping[str, object]) -> str:
    return f"{ended['status']}" + (f": {ended['reason']}" if ended.get("reason") else "")


if __name__ == "__main__":
    raise SystemExit(main(sys.argv[1:]))
