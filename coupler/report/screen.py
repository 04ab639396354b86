"""The first screen after a run: verdict, the measures that converge, warnings; within 30 lines."""

from __future__ import annotations

import io
import shutil

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..files.result import Result
from ..files.summary import Summary
from ..measures import BANDED, axis_label, measure
from .words import alerts, bands, columns, impacts, notes, plain, shown, summary_table, table_lines, title, verdict

KEYS = (*BANDED, "numerical_dissipation", "energy_drift", "deposition_efficiency", "wall_s")
OF_EACH = (
    "verdict", "flattening_ratio", "crater_depth_m", "splat_diameter_m", "eps_p_mean", "T_mean_K", "rebound_velocity_m_s",
)  # fmt: skip
_MOST_IMPACTS = 10
_MOST_COLUMNS = 6  # impacts side by side
_MOST_REMARKS = 3
_WIDTH = 120  # columns where there is no terminal


def screen(result: Result, verbose: bool = False) -> str:
    """A finished run as text for a terminal. verbose: all measures and remarks."""
    summary, doubts = result.summary, alerts(result.summary)
    remarks, effects, warnings = notes(result)
    if not verbose:
        more = len(remarks) - _MOST_REMARKS
        remarks, effects = [*remarks[:_MOST_REMARKS], *([f"{more} more remarks: -v"] if more > 0 else [])], []
    head = [f"verdict: {text}"] if (text := verdict(summary)) else []
    head += [f"doubtful: {text}" for text in doubts]
    tail = [*remarks, *effects, *(f"warning: {text}" for text in warnings if text not in doubts)]
    stream = io.StringIO()
    width = shutil.get_terminal_size((_WIDTH, 30)).columns
    side_by_side = verbose and len(summary["impacts"]) <= _MOST_COLUMNS
    Console(file=stream, width=width).print(summary_table(result) if side_by_side else _brief(result, verbose))
    return "\n".join([*head, *(line.rstrip() for line in stream.getvalue().strip("\n").splitlines()), *tail])


def _brief(result: Result, all_impacts: bool) -> Table:
    summary = result.summary
    table = Table(box=SIMPLE_HEAD, title=Text(title(result)), title_justify="left", title_style="bold", pad_edge=False)
    table.add_column("")
    if len(summary["impacts"]) > 1:
        return _each(summary, table, len(summary["impacts"]) if all_impacts else _MOST_IMPACTS)
    blocks = columns(summary)
    for heading in blocks:
        table.add_column(heading, justify="right")
    table.add_column("")
    for lines in table_lines(list(blocks.values()), bands(summary)).values():
        for line in lines:
            if line.key in KEYS:
                table.add_row(Text(line.label), *map(Text, line.cells), Text(line.unit))
    return table


def _each(summary: Summary, table: Table, most: int) -> Table:
    """A row for each of the first `most` impacts, and what belongs to the whole run below."""
    keys = [key for key in OF_EACH if any(key in block for block in impacts(summary))]
    for key in keys:
        table.add_column(axis_label(key).replace("flattening above surface", "flattening"), justify="right")
    for number, block in enumerate(impacts(summary)[:most], 1):
        particle = " µm ".join(shown(key, block[key]) for key in ("diameter_m", "material") if key in block)
        table.add_row(f"{number}  {particle}", *(Text(shown(key, block.get(key))) for key in keys))
    more = len(summary["impacts"]) - most
    if more > 0:
        table.add_row(f"... and {more} more")
    whole = plain(summary["run"])
    said = [
        f"{measure(key).label} {shown(key, whole[key])} {measure(key).unit}".strip() for key in KEYS if key in whole
    ]
    table.caption, table.caption_justify = Text(", ".join(said)), "left"
    return table
