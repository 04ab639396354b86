"""The web pages: forms for gas, impact, coating and job; one run; all runs; metals."""

from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime
from functools import partial
from pathlib import Path
from typing import Any
from urllib.parse import quote

from nicegui import events, run, ui

from ..errors import ColdsprayError
from ..files.inputs import read_text
from ..files.result import PROPERTIES_FILE
from ..physics import materials
from ..scene.json_schema import job_schema, scene_schema
from ..spray import nozzles
from ..units import parse, show
from . import figures
from .form import Entries, Form, entries_of
from .previews import Now, Preview, now, preview
from .workspace import COATING, FINISHED, JOB, QUEUED, RUNNING, STOPPED, UNDECIDED, Row, Workspace

UPLOAD = 1_000_000  # bytes
COLOURS = {RUNNING: "primary", QUEUED: "grey", FINISHED: "positive", UNDECIDED: "warning", STOPPED: "warning"}
MARKS = {"green": "positive", "amber": "warning", "red": "negative"}
GAS = ("gas.kind", "gas.nozzle", "gas.pressure", "gas.temperature", "gas.standoff")


@dataclass(frozen=True)
class Input:
    """A page with a form. template: name of the example (`coldspray new`) with which the form begins; verb: command that computes the
    input, "" for none; main: the most important fields, which are always visible."""

    path: str
    title: str
    template: str
    verb: str
    main: tuple[str, ...]

    @property
    def entries(self) -> Entries:
        """Return the schema entries of all possible fields of the form."""
        return entries_of(job_schema() if self.template == "job" else scene_schema())


INPUTS = (
    Input("/", "Gas and window", "job", "", (
        "powder.material", "powder.sizes", *GAS, "substrate.material")),
    Input("/impact", "Impact", "single", "run", (
        "particle.material", "particle.diameter", "particle.velocity", "particle.temperature", "particle.angle",
        "substrate.material", "substrate.temperature", "preset")),
    Input("/coating", "Coating", "coating", "run", (
        "coating.material", "coating.number", "coating.layers", "coating.radius", "coating.diameter", "gas.pressure",
        "gas.temperature", "substrate.material")),
    Input("/job", "Job", "job", "job", (
        "powder.material", "powder.sizes", "gas.pressure", "gas.temperature", "gas.nozzle", "spray.feed_rate",
        "spray.traverse_speed", "substrate.material", "within")),
)  # fmt: skip
LINKS = {page.path: page.title for page in INPUTS} | {"/runs": "Runs", "/metals": "Metals"}


@contextmanager
def frame(path: str) -> Iterator[None]:
    """Context manager for page content: makes a header with links to all pages, and sets the width. path: address of this page."""
    ui.colors(primary="#1f78c8")
    ui.query(".nicegui-content").classes("p-3 sm:p-5 items-stretch max-w-[1500px] mx-auto")
    with ui.header(elevated=False).classes("bg-primary text-white px-3 py-2 gap-x-5 gap-y-1 items-center"):
        ui.label("coldspray").classes("font-bold text-lg")
        for to, title in LINKS.items():
            here = "border-b-2 border-white" if to == path else "opacity-80"
            ui.link(title, to).classes(f"text-white no-underline {here}")
    with ui.column().classes("w-full gap-3"):
        yield


async def tried(action: Callable[..., Any], *arguments: Any) -> Any:
    """The result of an action in a thread; an error that a user can correct is shown, and the result is None."""
    try:
        return await run.io_bound(action, *arguments)
    except (ColdsprayError, OSError) as error:
        ui.notify(str(error), type="negative", multi_line=True, timeout=10_000, close_button=True)
        return None


def add_pages(workspace: Workspace) -> None:
    """Register all pages at the web server."""
    for page in INPUTS:
        ui.page(page.path)(partial(_input, page, page.entries, workspace))
    ui.page("/run/{name:path}")(partial(_run, workspace))
    ui.page("/runs")(partial(_runs, workspace))
    ui.page("/metals")(partial(_metals, workspace))


# ---- forms ---------------------------------------------------------------------------------------------------


def _input(page: Input, entries: Entries, workspace: Workspace, copy: str = "") -> None:
    """Make a form and a preview of its values. copy: name of a scene or a results folder whose text the form has at the start."""
    turn = 0

    async def check() -> None:
        nonlocal turn
        turn = mine = turn + 1
        try:
            toml = form.toml()
            problems = workspace.outside(toml)
        except ValueError as error:
            toml, problems = "", [str(error)]
        path = workspace.root / f"{name.value or 'unnamed'}.toml"
        seen = Preview(problems) if problems else await run.io_bound(preview, toml, path, page.verb, workspace.here)
        if mine == turn and seen is not None:
            rest.set_text(form.show(seen.problems))
            start.set_enabled(not seen.problems)
            side.classes(add="opacity-40" if seen.problems else "", remove="" if seen.problems else "opacity-40")
            if not seen.problems:
                answer.refresh(seen, name.value)

    async def begin() -> None:
        if await tried(workspace.begin, page.verb, name.value, form.toml()):
            ui.navigate.to(f"/run/{quote(name.value)}")

    with frame(page.path):
        try:
            base = _copied(workspace, copy) if copy else workspace.templates[page.template]
        except ColdsprayError as error:
            ui.label(str(error)).classes("text-negative")
            return
        with ui.element("div").classes("grid grid-cols-1 lg:grid-cols-[minmax(0,440px)_minmax(0,1fr)] gap-5 w-full"):
            with ui.column().classes("gap-2 w-full"):
                form = Form(base, entries, page.main, check)
                rest = ui.label().classes("text-negative whitespace-pre-wrap")
                with ui.row().classes("w-full items-center") as bar:
                    name = ui.input("name", value=workspace.free(page.template)).props("dense outlined")
                    start = ui.button("Run", icon="play_arrow", on_click=begin)
                bar.set_visibility(bool(page.verb))
            with ui.column().classes("w-full gap-3") as side:
                answer = ui.refreshable(_answer)
                answer(Preview(), "")
        if not page.verb:
            _nozzles()
    ui.timer(0.05, check, once=True)


def _copied(workspace: Workspace, name: str) -> str:
    """The text from which a run was computed: the scene with the name of the run, or else the scene or job in the run's folder."""
    folder = workspace.folder(name)
    places = [workspace.inside(f"{name}.toml"), folder / "scene.toml", folder / "job.toml"]
    return read_text(next((path for path in places if path.is_file()), places[1]))


def _answer(seen: Preview, name: str) -> None:
    if seen.numbers:
        with ui.element("div").classes("grid grid-cols-1 sm:grid-cols-2 gap-x-5 gap-y-2 w-full"):
            for line in seen.numbers:
                with ui.row().classes("items-baseline gap-2 no-wrap"):
                    ui.icon("circle", color=MARKS[line.colour], size="12px")
                    with ui.column().classes("gap-0"):
                        ui.label(line.label).classes("text-sm opacity-80")
                        ui.label(line.formula or line.computed).classes("text-lg leading-tight")
                        ui.label(f"trust mark {line.colour}: {line.why}").classes("text-xs opacity-60")
    if seen.lines:
        ui.label(seen.lines).classes("whitespace-pre-wrap")
    if seen.drawn:
        with ui.element("div").classes("grid grid-cols-1 xl:grid-cols-2 gap-3 w-full"):
            for figure in seen.drawn:
                ui.plotly(figure).classes("w-full h-[420px]")
    if seen.classes:
        download = partial(ui.download.content, seen.classes, "window.csv")
        save = ui.button("Save csv", icon="download", on_click=download)
        save.props("flat dense").tooltip("saves a row for each size class; the camera icon saves the picture")
    if seen.more:
        with ui.expansion("Plan of the computation (coldspray check)", value=not seen.drawn).classes("w-full"):
            ui.label(seen.more).classes("whitespace-pre overflow-x-auto font-mono text-xs w-full")


def _nozzles() -> None:
    lengths = ("throat", "exit", "inlet", "converging", "diverging", "barrel")
    known = [vars(nozzle) for nozzle in nozzles.library().values()]
    rows = [{**each, **{key: show(each[key], "mm") for key in lengths}} for each in known]
    with ui.expansion("Nozzles, with their assumed values").classes("w-full border-t border-gray-400/40"):
        _table(("name", *lengths, "assumed", "source"), rows)


def _table(heads: Sequence[str], rows: Iterable[Mapping[str, Any]], **more: Any) -> ui.table:
    """Make a table that shows all rows at once. heads: column headings; the first column holds the names of the rows."""
    columns = [{"name": key, "label": key, "field": key, "align": "left", "sortable": True} for key in heads]
    cells = [{key: value for key, value in row.items() if isinstance(value, str)} for row in rows]
    table = ui.table(columns=columns, rows=cells, row_key=heads[0], pagination={"rowsPerPage": 0}, **more)
    return table.classes("w-full").props("flat dense wrap-cells hide-pagination")


# ---- runs ----------------------------------------------------------------------------------------------------


def _run(workspace: Workspace, name: str) -> None:
    """Make the page of a run: its state, its results so far, and its report after the end of the run."""
    seen: Now | None = None

    async def refresh() -> None:
        nonlocal seen
        before, seen = seen, await run.io_bound(now, workspace, folder)
        if seen is None or before == seen:
            return
        body.refresh(seen)
        if before is None or (before.pictures, before.energy) != (seen.pictures, seen.energy):
            pictures.refresh(seen)
        if before is None or before.row.state != seen.row.state:
            head.refresh(seen.row)
            if seen.row.state in (FINISHED, UNDECIDED):
                address = await tried(_report, workspace, folder, seen.row)
                report.props(f'src="{address}"').set_visibility(bool(address))
                tab.props(f'href="{address}"').set_visibility(bool(address))

    async def copy() -> None:
        if text := await tried(_copied, workspace, name):
            page = "/job" if "[powder]" in text else "/coating" if "[coating]" in text else "/impact"
            ui.navigate.to(f"{page}?copy={quote(name, safe='')}")

    async def act(action: Callable[..., Any], *arguments: Any) -> None:
        await tried(action, *arguments)
        await refresh()

    @ui.refreshable
    def head(row: Row) -> None:
        with ui.row().classes("items-center gap-3"):
            ui.label(row.name).classes("text-xl font-bold")
            ui.badge(row.state, color=COLOURS.get(row.state, "negative")).classes("text-sm")
            if row.state in (RUNNING, QUEUED):
                ui.button("Stop", icon="stop", on_click=lambda: act(workspace.stop, folder))
            if row.state in (STOPPED, UNDECIDED):
                ui.button("Go on", icon="play_arrow", on_click=lambda: act(workspace.resume, folder))
            ui.button("Copy scene", icon="content_copy", on_click=copy).props("flat")
            if row.state == FINISHED and row.kind == COATING:
                measure = ("coating", str(folder))
                ui.button("Measure coating", on_click=lambda: act(workspace.call, *measure)).props("flat")
                seeds = ("coating", str(folder), "--seeds", "3")
                ui.button("3 more seeds", on_click=lambda: act(workspace.start, folder, *seeds)).props("flat")

    @ui.refreshable
    def body(seen: Now) -> None:
        ui.label(seen.row.words).classes("opacity-80")
        ui.label(seen.text).classes("whitespace-pre overflow-x-auto font-mono text-xs w-full")
        if parts := workspace.rows(folder):
            _rows_table(parts)

    @ui.refreshable
    def pictures(seen: Now) -> None:
        with ui.element("div").classes("grid grid-cols-1 lg:grid-cols-2 gap-3 w-full"):
            for address in seen.pictures:
                ui.image(address).classes("w-full bg-white rounded").props("fit=contain")
            if seen.energy:
                ui.plotly(seen.energy).classes("w-full h-[520px]")

    with frame("/runs"):
        try:
            folder = workspace.folder(name)
            first = workspace.row(folder)
        except ColdsprayError as error:
            ui.label(str(error)).classes("text-negative")
            return
        head(first)
        body(Now(first, ""))
        pictures(Now(first, ""))
        tab = ui.link("Open the report in a new tab", "#", new_tab=True)
        tab.set_visibility(False)
        report = ui.element("iframe").classes("w-full h-[85vh] border rounded bg-white")
        report.set_visibility(False)
    ui.timer(2.0, refresh)


def _report(workspace: Workspace, folder: Path, row: Row) -> str:
    """Web address of the report of a finished run or job. The report of a run is rewritten first if results, properties or other seeds
    are newer."""
    if row.kind == JOB:
        return workspace.address(folder / "job.html")
    page, told = folder / "report.html", [folder / "summary.json", folder / PROPERTIES_FILE]
    told += folder.glob("seeds/*/summary.json")
    written = page.stat().st_mtime if page.is_file() else 0.0
    if written < max(path.stat().st_mtime for path in told if path.is_file()):
        workspace.call("report", str(folder))
    return workspace.address(page)


def _rows_table(rows: list[Row], **more: Any) -> ui.table:
    table = _table(("name", "state", "changed", "result"), map(_cells, rows), **more)
    link = '<a :href="props.row.to">{{ props.value }}</a>'
    table.add_slot("body-cell-name", f'<q-td :props="props" class="whitespace-nowrap">{link}</q-td>')
    badge = '<q-td :props="props"><q-badge :color="props.row.colour">{{ props.value }}</q-badge></q-td>'
    table.add_slot("body-cell-state", badge)
    return table


def _cells(row: Row) -> dict[str, str]:
    changed = f"{datetime.fromtimestamp(row.changed):%Y-%m-%d %H:%M}"
    colour, to = COLOURS.get(row.state, "negative"), f"/run/{quote(row.name)}"
    return {"name": row.name, "state": row.state, "result": row.words, "changed": changed, "to": to, "colour": colour}


def _runs(workspace: Workspace) -> None:
    """Make the page of all results folders, where the user can filter, compare and delete them."""

    async def compare() -> None:
        out = workspace.runs / "comparison.html"
        chosen = [str(workspace.folder(row["name"])) for row in table.selected]
        if await tried(workspace.call, "compare", *chosen, "--out", str(out)) is not None:
            ui.navigate.to(f"/files/{out.name}?{out.stat().st_mtime_ns}", new_tab=True)

    async def delete() -> None:
        names = [row["name"] for row in table.selected]
        with ui.dialog() as dialog, ui.card():
            ui.label(f"Delete {', '.join(names)} and all its results? This cannot be undone.")
            with ui.row():
                ui.button("Keep", on_click=lambda: dialog.submit(False)).props("flat")
                ui.button("Delete", color="negative", on_click=lambda: dialog.submit(True))
        if names and await dialog:
            for name in names:
                await tried(lambda name: workspace.delete(workspace.folder(name)), name)
            ui.navigate.reload()

    with frame("/runs"):
        rows = workspace.rows()
        if not rows:
            ui.label(f"There are no results in {workspace.runs} yet. The pages Impact, Coating and Job compute them.")
        with ui.row().classes("items-center gap-2 w-full"):
            word = ui.input("filter").props("dense outlined clearable")
            ui.button("Compare", icon="compare", on_click=compare).props("flat")
            ui.button("Delete", icon="delete", on_click=delete).props("flat")
        table = _rows_table(rows, selection="multiple")
        word.bind_value_to(table, "filter")

    async def refresh() -> None:
        new = await run.io_bound(workspace.rows)
        if new is not None and (cells := [_cells(row) for row in new]) != table.rows:
            table.rows = cells

    ui.timer(3.0, refresh)


# ---- metals --------------------------------------------------------------------------------------------------


def _metals(workspace: Workspace) -> None:
    """Make the page of the metals: sources and flow curves of the library, and a form for the user's own table of metals."""

    def draw() -> None:
        values: dict[str, float] = {}
        for field, dimension in ((rate, "rate"), (temperature, "temperature")):
            try:
                values[dimension] = parse(field.value, dimension)
                field.error = None
            except ValueError as error:
                field.error = str(error)
        entries = [materials.entry(name) for name in names.value or ()]
        chosen = [metal for each in entries for metal in each.materials]
        if len(values) == 2:
            curves.update_figure(figures.flow_stresses(chosen, values["rate"], values["temperature"]))
        table.rows = [
            {"set": m.strength.set, "metal": m.name, "law": m.strength.law, "fitted": m.strength.fitted.words,
             "source": m.strength.source} for m in chosen
        ]  # fmt: skip
        metals = [each.material for each in entries]
        sources.set_text("\n\n".join(f"{metal.name}: {metal.source} {metal.note}" for metal in metals))

    async def own(event: events.UploadEventArguments) -> None:
        lines.set_text(await tried(_own_metals, workspace, event.file.name, await event.file.read()) or "")

    with frame("/metals"):
        with ui.element("div").classes("grid grid-cols-1 sm:grid-cols-3 gap-4 w-full"):
            known = materials.names()
            names = ui.select(known, label="metals", value=known[:1], multiple=True, on_change=draw)
            rate = ui.input("strain rate", value="1e6 1/s", on_change=draw)
            temperature = ui.input("temperature", value="300 K", on_change=draw)
            for field in (names, rate, temperature):
                field.props("dense outlined hide-bottom-space debounce=300")
            names.props("use-chips")
        curves = ui.plotly(figures.shell((), "", "", "")).classes("w-full h-[440px]")
        table = _table(("set", "metal", "law", "fitted", "source"), [])
        sources = ui.label().classes("text-sm opacity-80 whitespace-pre-wrap")
        with ui.expansion("Your own table of metals", icon="upload").classes("w-full border-t border-gray-400/40"):
            ui.label(
                "A .csv with a row for each metal becomes a .toml in the workspace. Enter the name of that"
                " file in the field library of a scene, and the names of its metals in the fields material."
            )
            upload = ui.upload(on_upload=own, auto_upload=True, max_file_size=UPLOAD, max_files=1)
            upload.props("accept=.csv flat bordered")
            lines = ui.label().classes("whitespace-pre-wrap text-sm")
        draw()


def _own_metals(workspace: Workspace, name: str, content: bytes) -> str:
    """Import an uploaded table of metals into the workspace. Returns the text of `coldspray materials --import`."""
    if not name.endswith(".csv"):
        raise ColdsprayError(f"{name}: upload a .csv file, or copy a .toml file into {workspace.root}")
    path = workspace.save(name.removesuffix(".csv"), content.decode("utf-8", "replace"), ".csv")
    try:
        return workspace.call("materials", "--import", path.name)
    except ColdsprayError:
        path.unlink()
        raise
