"""Read the results of a run, without a solver. Damaged files raise StoreError (`files.fields`)."""

import csv
from collections.abc import Iterator
from contextlib import contextmanager
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING, Any, overload

import numpy as np
from numpy.typing import NDArray

from ..errors import StoreError
from ..units import nearest
from .fields import CELL_TYPES, Fields, opened, read_step, times_of
from .inputs import SCENE_LIMIT, read_json_object, read_text, require_memory, similar
from .summary import Summary, Values, impact_values, read_summary, run_values

if TYPE_CHECKING:
    import pandas
    import pyvista

DOMAINS = ("particle", "surface", "target")
HISTORY = "history.csv"
PROPERTIES_FILE = "properties/properties.json"  # of the coating at the end of the run
COLD = "cold"  # the bodies after the closing stage, one step
STORED = (*DOMAINS, COLD)
_CSV_MEMORY = 12  # memory while reading over the size of the file


class Result:
    """The folder of a run, finished or not.

    Keys of the summary are attributes: of the run, of its last impact, and of the measures at the end of this impact:
    `result.deposition_efficiency`, `result.rebounded`, `result.flattening_ratio`. None: the value is invalid, for the reason in
    `result.refused`, or does not apply. Raises StoreError if the folder does not exist or has no run.
    """

    def __init__(self, directory: str | Path):
        self.directory = Path(directory).absolute()  # the working folder may change
        if not self.directory.is_dir():
            of_scene = "; a scene's results are in runs/NAME" if self.directory.is_file() else ""
            raise StoreError(f"{directory} is not a results folder{of_scene or similar(directory, is_folder=True)}")
        known = ["scene.toml", "summary.json", HISTORY, *(f"{domain}.vtkhdf" for domain in STORED)]
        if not any((self.directory / name).is_file() for name in known):
            raise StoreError(f"{directory} holds no results of a run (none of {', '.join(known)})")
        self._summary: Summary = {}
        self._summary_at: tuple[int, int] | None = None  # time and size of the file that `_summary` is read from
        self._rows_at: tuple[int, int] | None = None  # time and size of the history that `_known_rows` are read from
        self._known_rows: tuple[list[str], NDArray[np.float64]] = [], np.zeros((0, 0))

    def __repr__(self) -> str:
        return f"Result({str(self.directory)!r}, {'finished' if self.finished else 'unfinished'})"

    def _repr_html_(self) -> str:
        """HTML for a notebook: verdict, measures and cross-section."""
        html: str = import_module("coupler.report.notebook").html(self)  # which itself imports this module
        return html

    @property
    def finished(self) -> bool:
        return (self.directory / "summary.json").is_file()

    @property
    def undecided(self) -> str | None:
        """Why the run ended before its end criterion was met; None if it was met, or the run is not finished."""
        reason = self.values.get("undecided")
        return str(reason) if reason is not None else None

    @property
    def has_verdict(self) -> bool:
        """False for a finished run in which it is unknown if the last particle sticks or rebounds. Such a run can continue."""
        return self.values.get("rebounded", False) is not None

    @property
    def at_own_end(self) -> bool:
        """Whether the run met its end criterion without a verdict on its last particle. It continues only with a later end time."""
        return self.finished and self.undecided is None and not self.has_verdict

    @property
    def at_limit(self) -> bool:
        """Whether the run is undecided because it reached its time limit. A longer run can give a verdict."""
        return "time limit" in (self.undecided or "")

    @property
    def summary(self) -> Summary:
        """Contents of summary.json (docs/guide/files.md); empty before the end of the run. Raises StoreError if damaged."""
        path = self.directory / "summary.json"
        now = (path.stat().st_mtime_ns, path.stat().st_size) if self.finished else None
        if now != self._summary_at:  # a resumed run writes another one
            self._summary, self._summary_at = read_summary(path) if now else {}, now
        return self._summary

    def impact(self, i: int = -1) -> Values:
        """Impact i (from 0; the last by default) in one table: its own keys and the measures of its end. Raises StoreError if the run
        is not finished, IndexError if there is no such impact."""
        if not self.summary:
            raise StoreError(f"the run in {self.directory} is not finished: it has no summary.json")
        return impact_values(self.summary, i)

    @property
    def values(self) -> Values:
        """The last impact (`impact(-1)`) and the whole run in one table; empty while the run is not finished."""
        return run_values(self.summary)

    @property
    def plan(self) -> Values:
        """The plan of the run from plan.json; empty if the file is missing or damaged."""
        try:
            plan = read_json_object(self.directory / "plan.json").get("plan")
        except StoreError:
            return {}
        return plan if isinstance(plan, dict) else {}

    def __getattr__(self, name: str) -> Any:
        if name.startswith("_"):
            raise AttributeError(name)
        known = self._known()
        if name in known:
            return known[name]
        if not known:
            why = f"the run in {self.directory} is not finished (no summary.json)"
            raise AttributeError(f"{name!r} is not known: {why}; history() and fields() give the data so far")
        raise AttributeError(f"the summary in {self.directory} has no {name!r}{nearest(name, known)}")

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._known()]

    def _known(self) -> Values:
        return {**self.summary, **self.summary["impacts"][-1], **self.values} if self.summary else {}

    @property
    def scene_text(self) -> str:
        """The scene with all default values, as TOML."""
        return read_text(self.directory / "scene.toml", SCENE_LIMIT)

    def times(self, domain: str = "particle") -> NDArray[np.float64]:
        """Times of the stored steps of a domain, (steps,), s; empty if no step is stored."""
        path = fields_file(self.directory, domain)
        if not path.is_file():
            return np.zeros(0)
        with opened(path) as root:
            return times_of(root)

    def fields(self, step: int = -1, domain: str = "particle") -> Fields:
        """Points, cells and data of a domain at a stored step; -1 is the last. domain: "particle", "surface", "target" or "cold" (the
        bodies after the closing stage). Raises StoreError if the file is missing or damaged, IndexError if there is no such step."""
        path = fields_file(self.directory, domain)
        if not path.is_file():
            raise StoreError(f"{path} is missing: the run stored no fields of the {domain}")
        with opened(path) as root:
            times = times_of(root)
            if not -len(times) <= step < len(times):
                raise IndexError(f"{path} has {len(times)} stored steps; there is no step {step}")
            return read_step(root, step % len(times), times)

    def mesh(self, step: int = -1, domain: str = "particle") -> "pyvista.UnstructuredGrid":
        """A domain at a stored step as a pyvista mesh. Its field_data["time"] is the time, s. Raises the errors of `fields`, and
        StoreError if pyvista is not installed."""
        with _optional("pyvista"):
            import pyvista

        fields = self.fields(step, domain)
        grid = pyvista.UnstructuredGrid({CELL_TYPES[fields.cells.shape[1]]: fields.cells}, fields.points)
        at_points, in_cells = fields.split()
        grid.point_data.update(at_points)
        grid.cell_data.update(in_cells)
        grid.field_data["time"] = [fields.time]
        return grid

    def properties(self, **options: Any) -> Any:
        """Effective stiffness and conductivities of the cold coating, as `coupler.properties.measure.Properties`. Options and errors
        are those of the function `properties` of that module."""
        # loaded here: it computes, and reading results needs no solver
        return import_module("coupler.properties.measure").properties(self, **options)

    def history_frame(self) -> "pandas.DataFrame":
        """history.csv as a pandas table. Raises the errors of `history`, and StoreError if pandas is not installed."""
        with _optional("pandas"):
            import pandas

        return pandas.DataFrame(self.history())

    @overload
    def history(self) -> dict[str, NDArray[np.float64]]: ...
    @overload
    def history(self, column: str) -> NDArray[np.float64]: ...
    def history(self, column: str | None = None) -> dict[str, NDArray[np.float64]] | NDArray[np.float64]:
        """Columns of history.csv, SI units: all as dict of arrays (rows,), or one array. An incomplete last line is left out. Raises
        StoreError if the file is missing or damaged, or lacks rows of a finished run, KeyError for an unknown column."""
        names, values = self._rows()
        written = self.summary.get("history_rows", len(values)) if self.finished else len(values)
        if written != len(values):
            lacks = f"it has {len(values)} rows, but the run wrote {written} rows"
            raise StoreError(f"{self.directory / HISTORY} is damaged: {lacks}; compute the run again")
        table = {name: values[:, number].copy() for number, name in enumerate(names)}
        if column is None:
            return table
        if column not in table:
            raise KeyError(f"history has no column {column!r}{nearest(column, table)}; it has {', '.join(names)}")
        return table[column]

    def _rows(self) -> tuple[list[str], NDArray[np.float64]]:
        """Names and values (rows, columns) of history.csv; the file is read again if it has changed."""
        path = self.directory / HISTORY
        stat = path.stat() if path.is_file() else None  # a missing file: `read_text` raises
        now = (stat.st_mtime_ns, stat.st_size) if stat is not None else None
        if now is not None and now == self._rows_at:
            return self._known_rows
        text = read_text(path)
        require_memory(_CSV_MEMORY * len(text), f"to read {path}")
        whole = text[: text.rfind("\n") + 1]  # without an incomplete last line
        try:
            rows = list(csv.reader(whole.splitlines()))
            names = rows[0] if rows else []
            if any(len(row) != len(names) for row in rows):
                raise ValueError("lines of different length")
            values = np.array([[float(cell) for cell in row] for row in rows[1:]]).reshape(-1, len(names))
        except (ValueError, csv.Error) as error:
            raise StoreError(f"{path} is damaged: {error}") from error
        self._rows_at, self._known_rows = now, (names, values)
        return names, values


def fields_file(directory: Path, domain: str) -> Path:
    """The file with the fields of a domain in the folder of a run. Raises ValueError for an unknown domain."""
    if domain not in STORED:
        raise ValueError(f"unknown domain {domain!r}; known domains: {', '.join(STORED)}")
    return directory / f"{domain}.vtkhdf"


@contextmanager
def _optional(name: str) -> Iterator[None]:
    try:
        yield
    except ModuleNotFoundError as error:
        raise StoreError(f"this needs the package {name}: pip install {name}") from error


def first_step(result: Result, number: int) -> int:
    """Index of the stored step of the target at the start of an impact. number: number of the impact, 2 or more."""
    impacts, times, steps = result.history("impact"), result.history("time"), result.times("target")
    before = times[impacts == number - 1].max()
    return min(int(np.searchsorted(steps, before + 0.5e-15, side="right")), len(steps) - 1)


def impact_at(result: Result, time: float) -> int:
    """Number (from 1) of the impact whose particle is stored at a time (s)."""
    if not (result.directory / HISTORY).is_file():
        return 1
    history = result.history()
    row = int(
        history["time"].searchsorted(time - 0.25e-15)
    )  # the first step of an impact is 1e-15 s later than the last before
    return int(history["impact"][: row + 1][-1])
