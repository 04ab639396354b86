"""The text on the terminal after a run, at most 30 lines: verdict, measures that converge, warnings."""

import io
import shutil

from rich.box import SIMPLE_HEAD
from rich.console import Console
from rich.table import Table
from rich.text import Text

from ..files.result import Result
from .words import alerts, brief, error_note, of_run, remarks, summary_table, title, verdict

_MOST_IMPACTS = 10
_MOST_COLUMNS = 6  # impacts side by side
_MOST_REMARKS = 3
_WIDTH = 120  # columns where there is no terminal


def screen(result: Result, verbose: bool = False) -> str:
    """A finished run as text for a terminal. verbose: include all measures and remarks."""
    summary, doubts = result.summary, alerts(result.summary)
    notes, effects, warnings = remarks(summary), result.values.get("effects"), result.values.get("warnings") or ()
    if verbose and effects:
        notes.append(f"effects: {', '.join(map(str, effects))}")
    elif not verbose and (more := len(notes) - _MOST_REMARKS) > 0:
        notes[_MOST_REMARKS:] = [f"{more} more remarks: use -v"]
    decided = verdict(summary)
    head = [f"verdict: {text}" if k == 0 else f"  {text}" for k, text in enumerate(decided)]
    head += [f"doubtful: {text}" for text in doubts]
    measured = [text] if (text := error_note(summary)) else []
    tail = [*measured, *notes, *(f"warning: {text}" for text in map(str, warnings) if text not in doubts)]
    stream = io.StringIO()
    width = shutil.get_terminal_size((_WIDTH, 30)).columns
    if verbose and len(summary["impacts"]) <= _MOST_COLUMNS:  # side by side
        Console(file=stream, width=width, force_jupyter=False, force_terminal=False).print(summary_table(result))
    else:
        console = Console(file=stream, width=width, highlight=False, force_jupyter=False, force_terminal=False)
        console.print(Text(title(result)), _brief(result, verbose), Text(of_run(summary)), sep="\n")
    return "\n".join([*head, *(line.rstrip() for line in stream.getvalue().strip().splitlines()), *tail])


def _brief(result: Result, all_impacts: bool) -> Table:
    summary, count = result.summary, len(result.summary["impacts"])
    table = Table(box=SIMPLE_HEAD, pad_edge=False)
    head, *rows = brief(summary, None if all_impacts else _MOST_IMPACTS)
    for k, text in enumerate(head):
        table.add_column(text, justify="right" if 0 < k < len(head) - (count == 1) else "left")
    for row in rows:
        table.add_row(*map(Text, row))
    if 1 < count > len(rows):
        table.add_row(f"... and {count - len(rows)} more")
    return table
