"""The ladder: one scene computed at many settings of resolution and scheme, each in one thread, and what each cost.

A row of the table is one run. Costs are processor time of one thread (`time.process_time`, and that of the process that makes
splats), which other work on the machine disturbs less than wall time; the wall time is kept beside it.
"""

import csv
import json
import math
import resource
import shutil
import sys
import time
import tomllib
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from ..errors import SceneError, SolverError, StoreError
from ..measures import BANDED
from ..plan import cost as estimates
from ..plan.bands import KNOB_AXES
from ..scene.model import Scene

POINTS = (500, 1000, 2000, 3500, 5000)
REFERENCE = 16000
KNOBS_AT = 1000
FEWEST_POINTS = 200
MEASURES = (*BANDED, "eps_p_max", "T_max_K")
COLUMNS = (
    "axis", "setting", "points", "points_used", "elements", "steps", "dt_mean_s", "sim_time_s", "cpu_s", "cpu_loop_s", "wall_s",
    *MEASURES, "numerical_dissipation", "energy_drift", "failed",
)  # fmt: skip
COURANT, STRETCH = 0.4, 0.9  # the defaults of `coupler.sph.particle.Numerics`: a dt factor multiplies both
# Knobs of the scheme: axis -> what is tried, by its name in the table, as changes of the defaults.
_TRIED: tuple[dict[str, dict[str, float]], ...] = (
    {"1.2 spacings": {"element": 1.2}, "2.5 spacings": {"element": 2.5}},
    {f"{f:g} dt": {"courant": f * COURANT, "stretch": f * STRETCH} for f in (0.5, 1.25, 2.0)},
    {"Q1 0": {"Q1": 0.0}, "Q1 0.2": {"Q1": 0.2}},
    {"hourglass 0.3": {"hourglass": 0.3}, "hourglass 3": {"hourglass": 3.0}},
    {"k 0.3": {"contact_stiffness": 0.3}, "k 3": {"contact_stiffness": 3.0}},
)
KNOBS = dict(zip(KNOB_AXES, _TRIED, strict=True))
EFFECTS = ("all", "none")


@dataclass(frozen=True)
class Setting:
    """One rung. points: of the largest particle; element: smallest edge of the target's elements over the spacing;
    effects: in place of the scene's; numerics: as `coupler.run` takes them."""

    axis: str
    name: str
    points: int
    element: float | None = None
    effects: str | None = None
    numerics: Mapping[str, float] = field(default_factory=dict)

    @property
    def key(self) -> tuple[str, str, str]:
        """What tells it from the other rungs."""
        return self.axis, self.name, str(self.points)


def settings(
    points: Sequence[int] = POINTS, reference: int = REFERENCE, knobs_at: int | None = KNOBS_AT
) -> list[Setting]:
    """The rungs, the cheap ones first. knobs_at: points at which the knobs and effects are tried; None: they are not.

    Raises StoreError for a reference that is no finer than what it is to judge.
    """
    if reference <= max([*points, knobs_at or 0]):
        raise StoreError(
            f"--reference {reference} has to be finer than all that it judges: more than {max([*points, knobs_at or 0])}"
        )
    found = [Setting("points", f"{n} points", n) for n in sorted(set(points))]
    for axis, tried in KNOBS.items() if knobs_at else ():
        for name, change in tried.items():
            numerics = {k: v for k, v in change.items() if k != "element"}
            found.append(Setting(axis, name, knobs_at or 0, change.get("element"), None, numerics))
    found += [Setting("effects", f"effects {which}", knobs_at, None, which) for which in EFFECTS if knobs_at]
    return [*found, Setting("reference", f"{reference} points", reference)]


def scene_at(scene: Scene, setting: Setting) -> Scene:
    """The scene at this setting: its own resolution gives way."""
    data = tomllib.loads(scene.to_toml())
    spacing = estimates.spacing(max(p.volume for p in scene.particles), setting.points)
    old = data.get("resolution", {})
    data["resolution"] = {"spacing": f"{spacing * 1e6!r} um", **({"growth": old["growth"]} if "growth" in old else {})}
    if setting.element is not None:
        data["resolution"]["element_size"] = f"{setting.element * spacing * 1e6!r} um"
    if setting.effects is not None:
        data["effects"] = setting.effects
    return Scene.from_dict(data, scene.name)


class Table:
    """The rows of a ladder, a CSV file that grows with each; `about` is its first line."""

    def __init__(self, path: Path, about: str):
        self.path, self.about = path, about
        self.rows: list[dict[str, str]] = []
        if path.exists():
            self.rows = read(path)

    def has(self, setting: Setting) -> bool:
        return any((row["axis"], row["setting"], row["points"]) == setting.key for row in self.rows)

    def add(self, row: Mapping[str, Any]) -> None:
        told = {name: row.get(name, "") for name in COLUMNS}
        self.rows.append({k: f"{v:.6g}" if isinstance(v, float) else str(v) for k, v in told.items()})
        self.write(self.rows)

    def write(self, rows: Sequence[Mapping[str, str]]) -> None:
        self.path.parent.mkdir(parents=True, exist_ok=True)
        part = self.path.with_suffix(".part")
        with part.open("w", newline="", encoding="utf-8") as file:
            file.write(f"# {self.about}\n")
            writer = csv.DictWriter(file, COLUMNS, lineterminator="\n")
            writer.writeheader()
            writer.writerows(rows)
        part.replace(self.path)


def rows_of(path: Path) -> list[dict[str, str]]:
    """The rows of a CSV file with comments. Raises StoreError if it cannot be read."""
    try:
        text = path.read_text(encoding="utf-8")
    except (OSError, UnicodeDecodeError) as error:
        raise StoreError(f"cannot read {path}: {error}") from None
    return list(csv.DictReader(line for line in text.splitlines() if not line.startswith("#")))


def read(path: Path) -> list[dict[str, str]]:
    """The rows of a ladder's table. Raises StoreError for a file that is none."""
    rows = rows_of(path)
    if any(set(row) != set(COLUMNS) or None in row.values() for row in rows):
        raise StoreError(f"{path} is no table of a ladder, or one of another version: move it away to begin again")
    return rows


class Clock:
    """Processor time of this process and of the children it has waited for, s; of the loop alone by `probe`."""

    def __init__(self) -> None:
        self._start = spent()
        self._impact: Any = None
        self._spans: list[list[float]] = []

    def probe(self, impact: Any) -> None:
        """Called after every chunk of steps: what lies between the chunks of one impact is its loop."""
        now = time.process_time()
        if impact is not self._impact:
            self._impact = impact
            self._spans.append([now, now])
        self._spans[-1][1] = now

    @property
    def whole(self) -> float:
        return spent() - self._start

    @property
    def loop(self) -> float:
        return sum(last - first for first, last in self._spans)


def spent() -> float:
    """Processor time so far of this process and its finished children, s."""
    children = resource.getrusage(resource.RUSAGE_CHILDREN)
    return time.process_time() + children.ru_utime + children.ru_stime


def climb(
    scene: Scene,
    out: Path,
    rungs: Sequence[Setting],
    table: Table,
    progress: Callable[[], Any],
    say: Callable[[str], None],
) -> Table:
    """Compute what the table lacks. progress(): one for each run; say(text): a line about each.

    A run that was stopped by Ctrl-C goes on from its checkpoint. A setting that fails, or that only a rescue brought through,
    is a row with its reason and no measures.
    """
    missing = [rung for rung in rungs if not table.has(rung)]
    if missing:
        _warm_up(out, say)
    for number, rung in enumerate(missing, start=1):
        at = "" if rung.axis in ("points", "reference") else f" at {rung.points} points"
        say(f"{number} of {len(missing)}: {rung.axis}, {rung.name}{at}")
        try:
            made = scene_at(scene, rung)
        except SceneError as error:  # such as elements too coarse for the crater
            row = {**dict(zip(("axis", "setting", "points"), rung.key, strict=True)), "cpu_s": 0.0}
            row["failed"] = "; ".join(error.problems)[:200]
        else:
            row = compute(made, rung, out / "runs" / _folder(rung), progress())
        table.add(row)
        say(f"  {row['failed'] or 'finished'}, {row['cpu_s']:.3g} s of processor time")
    return table


def compute(scene: Scene, rung: Setting, folder: Path, progress: Any = None) -> dict[str, Any]:
    """One rung, its row. folder: of its run; removed when the row is known."""
    from ..deposition.run import resume, run

    note, clock = folder / "spent.json", Clock()
    before = _spent_before(note)
    how: dict[str, Any] = {
        "progress": progress, "threads": 1, "numerics": rung.numerics, "probe": clock.probe, "checkpoint_every": math.inf,
    }  # fmt: skip
    row: dict[str, Any] = {"axis": rung.axis, "setting": rung.name, "points": rung.points}
    try:
        s = (resume(folder, **how) if before else run(scene, folder, force=True, **how)).summary
    except SolverError as problem:
        row |= {"failed": " ".join(str(problem).split())[:200]}
    except KeyboardInterrupt:
        folder.mkdir(parents=True, exist_ok=True)
        note.write_text(json.dumps([clock.whole + before.get("whole", 0.0), clock.loop + before.get("loop", 0.0)]))
        raise
    else:
        row |= {name: s[name] for name in COLUMNS if name in s}
        row |= {"points": rung.points, "points_used": s["points"], "failed": ""}
        if s["rescues"]:  # the run went on with other numerics than the setting's
            row |= dict.fromkeys(MEASURES, "") | {"failed": str(s["warnings"][-1]).split(";")[0][:200]}
    finally:
        if progress is not None:
            progress.stop()
    shutil.rmtree(folder, ignore_errors=True)
    return row | {"cpu_s": clock.whole + before.get("whole", 0.0), "cpu_loop_s": clock.loop + before.get("loop", 0.0)}


def _spent_before(note: Path) -> dict[str, float]:
    try:
        whole, loop = json.loads(note.read_text())
    except (OSError, ValueError):
        return {}
    return {"whole": float(whole), "loop": float(loop)}


def _warm_up(out: Path, say: Callable[[str], None]) -> None:
    """Load or compile all kernels, so that no row pays for it."""
    say("compiling")
    text = (
        '[[particle]]\nmaterial = "Ni"\ndiameter = "10 um"\nvelocity = "500 m/s"\n'
        '[substrate]\nmaterial = "SS304"\ndiameter = "60 um"\nheight = "30 um"\n'
        '[end]\ntime = "1 ns"\n[resolution]\nspacing = "1.1 um"\n'
    )
    rung = Setting("warm-up", "warm-up", 500)
    compute(Scene.from_text(text, "warm-up"), rung, out / "runs" / "warm-up")


def _folder(rung: Setting) -> str:
    return "_".join(rung.key).replace(" ", "-")


def finished(rows: Sequence[Mapping[str, str]]) -> Iterator[Mapping[str, str]]:
    """The rows that have measures."""
    return (row for row in rows if not row["failed"])


def announce(quiet: bool) -> Callable[[str], None]:
    """Where lines about the ladder go."""
    return lambda text: None if quiet else print(text, file=sys.stderr, flush=True)
