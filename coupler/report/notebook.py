"""A result in a notebook: verdict and measures, as on the terminal after a run, and the cross-section."""

from html import escape

from ..files.inputs import reading
from ..files.result import Result
from .figure import embedded
from .picture import section_figure
from .screen import screen
from .words import title

_DPI = 72  # a picture of about 100 kB


def html(result: Result) -> str:
    """The HTML of a result. It raises no Exception: a message takes the place of a part that is missing or damaged."""
    parts = []
    for name, part in (("measures", _measures), ("section", _section)):
        try:
            with reading(result.directory):
                parts.append(part(result))
        except Exception as problem:  # a notebook would show a traceback instead of the result
            parts.append(f"<p>no {name}: {escape(str(problem))}</p>")
    return "\n".join(parts)


def _measures(result: Result) -> str:
    if result.finished:
        text = screen(result)
    else:
        times, resume = result.times(), f"coldspray resume {result.directory.name}"
        reached = f"{len(times)} steps are stored, until {times.max(initial=0.0) * 1e9:.1f} ns"
        text = f"{title(result)}\nnot finished: {reached}; if it was stopped, {resume} continues it"
    return f'<pre style="white-space: pre-wrap">{escape(text)}</pre>'


def _section(result: Result) -> str:
    return f'<img alt="section" src="{embedded(section_figure(result), _DPI)}">'
