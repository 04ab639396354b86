"""Runs side by side: a table for a terminal, a figure, a page."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from html import escape
from pathlib import Path

from matplotlib.figure import Figure
from rich.table import Table
from rich.text import Text

from ..errors import StoreError
from ..files.result import Result
from . import charts, parts
from .page import Page, embedded, write_text
from .picture import (
    Cut,
    beyond,
    blank,
    colour_bar,
    colour_range,
    cut,
    draw,
    drawable,
    save,
    scale_bar,
    stage,
    stored_steps,
    window,
)
from .words import cell, grouped, plain, title, words

MOST = 12  # runs: more do not stand beside each other
CURVES = (
    ("height", "height above surface (µm)", 1e6),
    ("crater_depth", "crater depth (µm)", 1e6),
    ("velocity_z", "mean velocity of the particle (m/s)", 1.0),
    ("contact_force", "contact force (mN)", 1e3),
    ("kinetic", "kinetic energy (nJ)", 1e9),
    ("dt", "time step (ps)", 1e12),
)


def names_of(results: Sequence[Result]) -> list[str]:
    """A short name for each run: the last parts of its folder that tell it from the others."""
    folders = [result.directory.resolve().parts for result in results]
    longest = max(len(folder) for folder in folders)
    for length in range(1, longest):
        names = ["/".join(folder[-length:]) for folder in folders]
        if len(set(names)) == len(set(folders)):
            return names
    return ["/".join(folder) for folder in folders]


def differences(results: Sequence[Result]) -> list[tuple[str, list[str]]]:
    """Keys of the scenes, dotted, that are not the same in all runs, with what each run has ("" if nothing)."""
    scenes = [_flat(parts.scene_of(result)) for result in results]
    keys = dict.fromkeys(key for scene in scenes for key in scene)
    found = [(key, [scene.get(key, "") for scene in scenes]) for key in keys]
    return [(key, values) for key, values in found if key != "name" and len(set(values)) > 1]


def measured(result: Result) -> dict[str, object]:
    """The measures of a run, those of its end where it has several; none of an unfinished one."""
    return plain(result.values)


def comparison_table(results: Sequence[Result]) -> Table:
    """Scenes where they differ and all measures, a column for each run; of two runs also the change in %.

    Raises StoreError if a summary is damaged or the runs are too few or too many.
    """
    _check(results)
    entries = [measured(result) for result in results]
    table = Table(title=Text("  |  ".join(dict.fromkeys(title(result) for result in results))), title_justify="left")
    table.add_column("")
    for name, result in zip(names_of(results), results, strict=True):
        table.add_column(Text(name + ("" if result.finished else "\n(unfinished)")), justify="right")
    two = len(results) == 2
    if two:
        table.add_column("change", justify="right")
    table.add_column("")
    differ = differences(results)
    if differ:
        table.add_row(Text("scene, where it differs", style="bold"))
        for key, values in differ:
            table.add_row(Text("  " + key), *(Text(value) for value in values), *[""] * two, "")
    for group, keys in grouped(key for entry in entries for key in entry):
        table.add_section()
        table.add_row(Text(group, style="bold"))
        for key in keys:
            label, unit = words(key)
            cells = [cell(key, entry) for entry in entries]
            if two:  # of what ought to be zero a change says nothing
                cells.append("" if group.startswith("balance") else _change(entries[0].get(key), entries[1].get(key)))
            table.add_row(Text("  " + label), *(Text(cell) for cell in cells), Text(unit))
    return table


def comparison_picture(results: Sequence[Result]) -> Figure:
    """The last cut of each run, by temperature and by plastic strain, with one scale and one range of colours.

    Raises StoreError if a run has nothing that can be drawn.
    """
    _check(results)
    names = [name for name in ("T", "eps_p") if all(name in drawable(result) for result in results)]
    empty = [str(result.directory) for result in results if not drawable(result)]
    if empty or not names:
        raise StoreError(f"{', '.join(empty) or 'the runs'}: no stored step with temperature or plastic strain to draw")
    cuts, (half, low, high) = _cuts(results, names)

    wide, margin, bar = 3.6, 0.12, 1.0  # inches
    tall = wide * (high - low) / (2 * half)
    size = (len(cuts) * (wide + margin) + margin + bar, len(names) * (tall + margin) + 0.75)
    figure = blank(*size, dpi=150)
    for row, name in enumerate(names):
        ends = colour_range(cuts, name)
        bottom = size[1] - 0.7 - (row + 1) * tall - row * margin
        for k, one in enumerate(cuts):
            left = margin + k * (wide + margin)
            axis = figure.add_axes((left / size[0], bottom / size[1], wide / size[0], tall / size[1]))
            draw(axis, one, name, ends)
            if row == 0:
                scale_bar(axis, one.window, 10)
        place = ((size[0] - bar + 0.02) / size[0], bottom / size[1], 0.1 / size[0], 0.96 * tall / size[1])
        colour_bar(figure.add_axes(place), name, ends, beyond(cuts, name, ends))
    for k, (name, result, one) in enumerate(zip(names_of(results), results, cuts, strict=True)):
        left = (margin + k * (wide + margin)) / size[0]
        figure.text(left, 1 - 0.25 / size[1], name, fontsize=11, weight="bold", va="center", parse_math=False)
        said = f"{title(result)}, t = {one.time * 1e9:.1f} ns"
        figure.text(left, 1 - 0.5 / size[1], said, fontsize=9, va="center", parse_math=False)
    return figure


def compare(results: Sequence[Result], path: str | Path) -> Path:
    """Write the comparison: a figure if the path ends in .png, a page if it ends in .html. Returns the path.

    Raises StoreError if a run lacks what is needed, the path ends otherwise or cannot be written.
    """
    path = Path(path)
    if path.suffix.lower() == ".png":
        save(comparison_picture(results), path)
    elif path.suffix.lower() in (".html", ".htm"):
        write_text(path, comparison_page(results))
    else:
        raise StoreError(f"cannot write {path}: a comparison ends in .png or .html")
    return path


def comparison_page(results: Sequence[Result]) -> str:
    """The comparison as one HTML file with figure, table and curves."""
    _check(results)
    page, names = Page(), names_of(results)
    picture = (
        f'<figure><img src="{embedded(comparison_picture(results))}" alt="cuts of the runs side by side"></figure>'
    )
    page.section("cuts", "Cuts", picture)
    differ = differences(results)
    rows = [[key, *values] for key, values in differ]
    page.section("scenes", "Scenes, where they differ", parts.table(["", *names], rows) if rows else "")
    page.section("measures", "Measures", parts.several([measured(result) for result in results], names))
    histories = {
        name: result.history()
        for name, result in zip(names, results, strict=True)
        if (result.directory / "history.csv").is_file()
    }
    curves = [page.chart(column, charts.compared(histories, column, said, factor)) for column, said, factor in CURVES]
    page.section("time", "Over time", f'<div class="two">{"".join(curves)}</div>' if any(curves) else "")
    warned = [
        f"<h3>{escape(name)}</h3>{parts.warnings(result.values['warnings'])}"
        for name, result in zip(names, results, strict=True)
        if result.values.get("warnings")
    ]
    page.section("warned", "Warnings", "".join(warned))
    unfinished = [name for name, result in zip(names, results, strict=True) if not result.finished]
    top = f'<p class="warn">Not finished: {escape(", ".join(unfinished))}.</p>' if unfinished else ""
    under = escape(" · ".join(dict.fromkeys(title(result) for result in results)))
    return page.html(f"{len(results)} runs side by side", under, top, "")


def _check(results: Sequence[Result]) -> None:
    if not 2 <= len(results) <= MOST:
        raise StoreError(f"a comparison needs 2 to {MOST} folders of results, got {len(results)}")


def _cuts(results: Sequence[Result], names: Sequence[str]) -> tuple[list[Cut], tuple[float, float, float]]:
    """The last cut of each run in windows of one size, and half its width, its bottom and top over the surface, um."""
    stages = [stage(result) for result in results]
    steps = [stored_steps(result) - 1 for result in results]
    own = [window(result, [step], at) for result, step, at in zip(results, steps, stages, strict=True)]
    half = max((right - left) / 2 for left, right, _, _ in own)
    low = min(bottom - at.level for (_, _, bottom, _), at in zip(own, stages, strict=True))
    high = max(top - at.level for (_, _, _, top), at in zip(own, stages, strict=True))
    cuts = []
    for result, step, at, (left, right, _, _) in zip(results, steps, stages, own, strict=True):
        middle = (left + right) / 2
        seen = (middle - half, middle + half, at.level + low, at.level + high)
        cuts.append(cut(result, step, names, at, seen))
    return cuts, (half, low, high)


def _change(before: object, after: object) -> str:
    if (
        isinstance(before, bool)
        or not (isinstance(before, int | float) and isinstance(after, int | float))
        or not before
    ):
        return ""
    return f"{(after - before) / abs(before):+.1%}"


def _flat(table: Mapping[str, object], above: str = "") -> dict[str, str]:
    """A scene's keys, dotted, and their values as text; a particle's keys are named alike whether one or several."""
    found: dict[str, str] = {}
    for key, value in table.items():
        if isinstance(value, Mapping):
            found |= _flat(value, f"{above}{key}.")
        elif isinstance(value, list) and value and all(isinstance(item, Mapping) for item in value):
            for number, item in enumerate(value):
                found |= _flat(item, f"{above}{key}{f'[{number + 1}]' if len(value) > 1 else ''}.")
        else:
            found[above + key] = ", ".join(map(str, value)) if isinstance(value, list) else str(value)
    return found
