"""Comparison of several runs: a table for a terminal, a picture, an HTML page."""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from ..errors import StoreError
from ..files.inputs import leaves
from ..files.outputs import write_text
from ..files.result import Result
from ..measures import BALANCE
from . import charts, parts, picture
from .figure import axes_at, blank, embedded, save
from .page import Page
from .words import Line, errors_of, fill_table, plain, shown, table_lines, title

MOST = 12  # runs that fit side by side
CURVES = (
    ("height", "height above surface (µm)", 1e6), ("crater_depth", "crater depth (µm)", 1e6),
    ("velocity_z", "mean velocity of the particle (m/s)", 1.0), ("contact_force", "contact force (mN)", 1e3),
    ("kinetic", "kinetic energy (nJ)", 1e9), ("dt", "time step (ps)", 1e12),
)  # fmt: skip


def names_of(results: Sequence[Result]) -> list[str]:
    """A short name for each run: the last parts of the path of its folder, as few as make all names different."""
    folders = [result.directory.resolve().parts for result in results]
    each = (["/".join(folder[-length:]) for folder in folders] for length in range(1, max(map(len, folders)) + 1))
    return next(names for names in each if len(set(names)) == len(set(folders)))


def differences(results: Sequence[Result]) -> list[tuple[str, list[str]]]:
    """Keys of the scenes that differ between runs: (key with dots, its value in each run); "" for a run without the key."""
    scenes = [{key: _text(value) for key, value in leaves(parts.scene_of(result))} for result in results]
    keys = dict.fromkeys(key for scene in scenes for key in scene)
    entries = [(key, [scene.get(key, "") for scene in scenes]) for key in keys]
    return [(key, values) for key, values in entries if key != "name" and len(set(values)) > 1]


def comparison_table(results: Sequence[Result]) -> Table:
    """Differences between the scenes, and all measures, with one column for each run. For two runs there is also the change in %.
    Raises StoreError if a summary is damaged, or for fewer than 2 or more than MOST runs."""
    check_count(len(results))
    table = Table(title=Text("  |  ".join(dict.fromkeys(title(result) for result in results))), title_justify="left")
    table.add_column("")
    for name, result in zip(names_of(results), results, strict=True):
        table.add_column(Text(name + ("" if result.finished else "\n(unfinished)")), justify="right")
    two = len(results) == 2
    if two:
        table.add_column("change", justify="right")
    table.add_column("")
    if differ := differences(results):
        table.add_row(Text("differences between the scenes", style="bold"))
        for key, values in differ:
            table.add_row(Text("  " + key), *(Text(value) for value in values), *[""] * two, "")
    fill_table(table, _measures(results))
    return table


def _measures(results: Sequence[Result]) -> dict[str, list[Line]]:
    """Lines of measures with their errors, by group. For two runs there is also the change (`_change`) as last cell."""
    entries, errors = [plain(result.values) for result in results], [errors_of(result.summary) for result in results]
    groups = table_lines(entries)
    for group, lines in groups.items():
        for line in lines:
            values, widths = [each.get(line.key) for each in entries], [each.get(line.key) for each in errors]
            known = zip(values, widths, line.cells, strict=True)
            line.cells[:] = [cell if value is None else shown(line.key, value, width) for value, width, cell in known]
            if len(results) == 2:  # a change of a value that should be zero means nothing
                line.cells.append("" if group == BALANCE else _change(values[0], values[1], *widths))
    return groups


def comparison_picture(results: Sequence[Result]) -> Figure:
    """The cross-sections of all runs at their last steps, coloured by temperature and by plastic strain, with one scale and one
    colour range. Raises StoreError if a run has nothing to draw."""
    check_count(len(results))
    names = [name for name in ("T", "eps_p") if all(name in picture.drawable(result) for result in results)]
    empty = [str(result.directory) for result in results if not picture.drawable(result)]
    if empty or not names:
        raise StoreError(f"{', '.join(empty) or 'the runs'}: no stored step with temperature or plastic strain to draw")
    sections, (half, low, high) = _sections(results, names)

    wide, margin, bar = 3.6, 0.12, 1.0  # inches
    tall = wide * (high - low) / (2 * half)
    width, height = len(sections) * (wide + margin) + margin + bar, len(names) * (tall + margin) + 0.75
    figure = blank(width, height, dpi=150)
    for row, name in enumerate(names):
        ends = picture.colour_range(sections, name)
        bottom = height - 0.7 - (row + 1) * tall - row * margin
        for k, section in enumerate(sections):
            axis = axes_at(figure, margin + k * (wide + margin), bottom, wide, tall)
            picture.draw(axis, section, name, ends)
            if row == 0:
                picture.scale_bar(axis, section.view, 10)
        place = axes_at(figure, width - bar + 0.02, bottom, 0.1, 0.96 * tall)
        picture.colour_bar(place, name, ends, 0.96 * tall)
    for k, (name, result, section) in enumerate(zip(names_of(results), results, sections, strict=True)):
        left = (margin + k * (wide + margin)) / width
        figure.text(left, 1 - 0.25 / height, name, fontsize=11, weight="bold", va="center", parse_math=False)
        caption = f"{title(result)}, t = {section.time * 1e9:.1f} ns"
        figure.text(left, 1 - 0.5 / height, caption, fontsize=9, va="center", parse_math=False)
    return figure


def compare(results: Sequence[Result], path: str | Path) -> Path:
    """Write the comparison: a picture if the path ends in .png, a page if it ends in .html. Returns the path. Raises StoreError if a
    run lacks needed data, the path has another ending, or the file cannot be written."""
    path = Path(path)
    if path.suffix.lower() == ".png":
        save(comparison_picture(results), path)
    elif path.suffix.lower() in (".html", ".htm"):
        write_text(path, comparison_page(results))
    else:
        raise StoreError(f"cannot write {path}: the name of a comparison must end in .png or .html")
    return path


def comparison_page(results: Sequence[Result]) -> str:
    """The comparison as an HTML page with picture, table and curves. Raises StoreError as `comparison_picture`."""
    page, names = Page(), names_of(results)
    of_name = dict(zip(names, results, strict=True))
    image = f'<img src="{embedded(comparison_picture(results))}" alt="cross-sections of the runs">'
    page.section("sections", "Cross-sections", f"<figure>{image}</figure>")
    rows = [[key, *values] for key, values in differences(results)]
    page.section("scenes", "Differences between the scenes", parts.table(["", *names], rows) if rows else "")
    heads = [*names, *["change"] * (len(names) == 2)]
    page.section("measures", "Measures", parts.side_by_side(_measures(results), heads))
    histories = {n: r.history() for n, r in of_name.items() if (r.directory / "history.csv").is_file()}
    curves = [page.chart(column, charts.compared(histories, column, label, factor)) for column, label, factor in CURVES]
    page.section("time", "Over time", f'<div class="two">{"".join(curves)}</div>' if any(curves) else "")
    warned = {name: parts.warnings(result.values.get("warnings")) for name, result in of_name.items()}
    page.section("warned", "Warnings", "".join(f"<h3>{escape(name)}</h3>{w}" for name, w in warned.items() if w))
    unfinished = ", ".join(name for name, result in of_name.items() if not result.finished)
    top = f'<p class="warn">Not finished: {escape(unfinished)}.</p>' if unfinished else ""
    under = escape(" · ".join(dict.fromkeys(title(result) for result in results)))
    return page.html(f"{len(results)} runs compared", under, top, "")


def check_count(runs: int) -> None:
    """Raise StoreError if this number of runs cannot be compared."""
    if not 2 <= runs <= MOST:
        raise StoreError(f"compare: give 2 to {MOST} folders of runs, not {runs}")


def _sections(
    results: Sequence[Result], names: Sequence[str]
) -> tuple[list[picture.CrossSection], tuple[float, float, float]]:
    """The cross-section of each run at its last step, all with pictures of one size. Returns also half the width of the pictures, and
    their bottom and top relative to the surface, um."""
    stages = [picture.stage(result) for result in results]
    steps = [picture.stored_steps(result) - 1 for result in results]
    own = [picture.view(result, [step], at) for result, step, at in zip(results, steps, stages, strict=True)]
    half = max((right - left) / 2 for left, right, _, _ in own)
    low = min(bottom - at.level for (_, _, bottom, _), at in zip(own, stages, strict=True))
    high = max(top - at.level for (_, _, _, top), at in zip(own, stages, strict=True))
    middles = ((left + right) / 2 for left, right, _, _ in own)
    seen = [(x - half, x + half, at.level + low, at.level + high) for x, at in zip(middles, stages, strict=True)]
    each = zip(results, steps, stages, seen, strict=True)
    return [picture.cross_section(result, step, names, at, here) for result, step, at, here in each], (half, low, high)


def _change(before: object, after: object, *errors: float | None) -> str:
    """The change in % as text, with a remark if it is at most the sum of both `errors`; "" without numbers or if `before` is 0."""
    numbers = all(isinstance(value, int | float) and not isinstance(value, bool) for value in (before, after))
    text = f"{round((after - before) / abs(before), 3) + 0.0:+.1%}" if numbers and before else ""  # type: ignore[operator,arg-type]
    known = [error for error in errors if error is not None]
    is_within = text and len(known) == 2 and abs(after - before) <= sum(known)  # type: ignore[operator]
    return f"{text}, within the errors" if is_within else text


def _text(value: object) -> str:
    return ", ".join(map(str, value)) if isinstance(value, list) else str(value)
