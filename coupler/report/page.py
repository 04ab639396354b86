"""The HTML report of one run: a single file that contains all its parts. Any browser opens it without a network."""

import json
import math
from collections.abc import Callable, Mapping, Sequence
from dataclasses import replace
from html import escape
from importlib.resources import files
from pathlib import Path
from string import Template

import numpy as np
from matplotlib.figure import Figure
from numpy.typing import NDArray
from plotly.offline import get_plotlyjs  # type: ignore[import-untyped]

from ..errors import StoreError
from ..files.outputs import write_text
from ..files.result import COLD, Result
from ..files.summary import Summary
from ..measures import measure
from . import charts, parts, picture
from .fields import FIELDS
from .figure import axes_at, blank, embedded
from .profiles import profiles
from .solid import frames, solid
from .words import alerts, title, verdict

PICTURES = 5  # of the cross-section
FRONT_WARNINGS = 3
PICTURE_PIXELS = 260  # along the particle: a picture has a third of the width of the page


class Page:
    """A report under construction: sections with headings, and the data of its curves and its 3D view."""

    def __init__(self) -> None:
        self.sections: list[tuple[str, str, str]] = []  # id, heading, HTML
        self.charts: dict[str, charts.Figure] = {}
        self.solid: dict[str, object] | None = None

    def section(self, name: str, heading: str, body: str) -> None:
        """Add a section, unless its body is empty."""
        if body:
            self.sections.append((name, heading, body))

    def chart(self, name: str, figure: charts.Figure | None, heading: str = "") -> str:
        """Add a curve. Returns its HTML element; "" if there is no figure."""
        if figure is None:
            return ""
        self.charts[name] = figure
        head = f"<h3>{escape(heading)}</h3>" if heading else ""
        return f'<figure>{head}<div class="chart" id="{name}"></div></figure>'

    def html(self, heading: str, under: str, top: str, footer: str) -> str:
        """The text of the HTML file. heading: text; under (below the heading), top (above the sections), footer: HTML."""
        data = json.dumps({"charts": self.charts, "solid": self.solid}, allow_nan=False, separators=(",", ":"))
        text = {kind: (files(__package__) / f"page.{kind}").read_text("utf-8") for kind in ("html", "css", "js")}
        nav = "".join(f'<a href="#{name}">{escape(word)}</a>' for name, word, _ in self.sections)
        each = (f'<section id="{name}"><h2>{escape(word)}</h2>\n{body}</section>' for name, word, body in self.sections)
        return Template(text["html"]).substitute(
            title=escape(heading), under=under, top=top, css=text["css"], nav=nav, sections="\n".join(each), footer=footer,
            data=data.replace("<", "\\u003c"), plotly=get_plotlyjs() if self.charts or self.solid else "", js=text["js"],
        )  # fmt: skip


def write_report(
    result: Result, path: str | Path | None = None, stage: Callable[[str], None] = lambda text: None,
    coating: Sequence[tuple[str, str]] = (),
) -> Path:  # fmt: skip
    """Write the HTML report of a run, finished or not. path: default `report.html` in the folder of the run. stage(text): function
    called with the name of each step. coating: measures of the coating as (label, text), from `studies.coating.lines`. Returns the
    path. Raises StoreError if a file of the run is damaged or the report cannot be written."""
    path = Path(path) if path is not None else result.directory / "report.html"
    write_text(path, report(result, stage, coating))
    return path


def report(
    result: Result, stage: Callable[[str], None] = lambda text: None, coating: Sequence[tuple[str, str]] = ()
) -> str:
    """The HTML report of a run as text. stage, coating: as in `write_report`."""
    page, summary, values = Page(), result.summary, result.values
    history = result.history() if (result.directory / "history.csv").is_file() else {}
    conditions = parts.conditions(result)
    count, places = len(summary.get("impacts", [])), {tuple(body["offset"]) for body in result.plan.get("impacts", [])}
    front = parts.front(summary) if summary else parts.so_far(history)
    if len(places) > 1 and coating:
        front = parts.definitions(coating) + (front if count <= parts.SIDE_BY_SIDE else "")
    front = f'<div class="two"><div>{front}</div>{conditions}</div>' if count < 2 else front + conditions
    warned = (values if result.finished else result.plan).get("warnings") or []
    warned = [str(text) for text in warned if text not in alerts(summary)]
    more = f"{len(warned) - FRONT_WARNINGS} more warnings below" if len(warned) > FRONT_WARNINGS else ""
    page.section("warnings", "Further warnings", parts.warnings(warned[FRONT_WARNINGS:]))
    page.section("impacts", "Impacts", parts.each_impact(summary))
    page.section("measures", "Measures" if count < 2 else "Whole run", parts.measures(summary))
    if names := picture.drawable(result):
        at, picked = picture.stage(result), picks(result)
        seen = picture.view(result, picked, at)
        stage("computing the cross-sections")
        sections = [picture.cross_section(result, step, names, at, seen, PICTURE_PIXELS) for step in picked]
        ranges = {name: picture.colour_range(sections, name) for name in names}
        stage("preparing the 3D view")
        page.solid = solid(result, frames(picture.stored_steps(result)), ranges, at)
        page.section("in3d", "In 3D", SOLID)
        stage("drawing the cross-sections")
        main = picture.with_phases(sections[-1], {name: ranges[name] for name in names if name in ("T", "eps_p")})
        lower, caption = replace(sections[-1], view=(*seen[:3], picture.view(result, picked[-1:], at)[3])), {}
        shown = picture.with_phases(sections[0], ranges)
        page.section("sections", "Cross-sections", _pictures(sections, shown, _named_times(summary)))
        if len(result.times(COLD)):
            section, colours = picture.cold_section(result, at, lower.view)
            caption = {"after cooling to ambient temperature": section.time}
            page.section(
                "cold", "Residual stress", parts.cold(summary, coating) + _pictures([section], colours, caption)
            )
            lower, main = section, picture.with_phases(section, {name: colours[name] for name in ("eps_p", "in_plane")})
            page.section("properties", "Properties", parts.properties(result))
        front = _pictures([lower], main, caption) + front
        stage("drawing the profiles")
        page.section("depth", "Along the axis", _depth(page, result, picked, at))
    else:
        front = '<p class="note">No step of particle, surface and target is stored yet.</p>' + front
    page.section("energy", "Energy", _energy(page, history))
    motion = [page.chart(name, charts.over_time(history, name)) for name in ("lengths", "velocity", "force", "step")]
    over_time = f'<div class="two">{"".join(motion)}</div>{parts.pace(values)}' if any(motion) else ""
    page.section("motion", "Motion and time step", over_time)
    page.section("effects", "Effects and materials", parts.effects(result) + parts.material_data(result))
    page.section("scene", "Scene", _scene(result))
    front += parts.warnings([*warned[:FRONT_WARNINGS], *([more] if more else [])])
    top = _state(result, history) + front + parts.provenance(summary)
    return page.html(title(result), _under(result), top, FOOTER)


def picks(result: Result) -> list[int]:
    """Indices of the stored steps to draw, PICTURES at most. One impact: steps at equal intervals up to the greatest deformation, and
    the last step. Several: steps at their greatest deformations, and the last step. Without a summary: evenly spaced steps."""
    times = result.times("surface")[: picture.stored_steps(result)]
    last = len(times) - 1
    peaks = list(_named_times(result.summary).values())
    if not peaks:
        return sorted({round(k) for k in np.linspace(0, last, min(PICTURES, last) + 1)[min(1, last) :]})
    turns = [int(np.argmin(np.abs(times - peak))) for peak in peaks]
    if len(turns) > 1:
        return sorted({turns[round(k)] for k in np.linspace(0, len(turns) - 1, min(PICTURES - 1, len(turns)))} | {last})
    wanted = [times[turns[0]] * share for share in np.linspace(0, 1, PICTURES)[1:]]
    return sorted({int(np.argmin(np.abs(times - time))) for time in wanted} | {last})


FOOTER = "Times, lengths and stresses in the units shown; z = 0 is the undeformed surface."
SOLID = """<div class="controls" id="solid-controls">
<label>Colours <select id="field"></select></label>
<label><input type="checkbox" id="whole"> whole, not cut open</label>
<button id="play" type="button">Play</button>
<label>Time <input type="range" id="time" min="0" step="1"> <output id="now"></output></label>
</div>
<div id="solid"></div><img id="solid-picture" alt="Particle and target in 3D">
<p class="caption"><span class="controls-note">Drag to rotate, use the wheel to zoom and the right button to move.</span>
Colours mean the same at all times; values above
their range have the last colour.</p>"""


def _named_times(summary: Summary) -> dict[str, float]:
    """The time of the greatest deformation of each impact by its label, s after the start of the run."""
    entries, times, start = summary.get("impacts", []), {}, 0.0
    for number, entry in enumerate(entries, 1):
        time, lasted = ((entry.get(block) or {}).get("time_s") for block in ("greatest", "end"))
        if isinstance(time, int | float):
            times["greatest deformation" + (f" of impact {number}" if len(entries) > 1 else "")] = start + float(time)
        start += float(lasted) if isinstance(lasted, int | float) else 0.0
    return times


def _under(result: Result) -> str:
    texts = [str(result.plan.get("name", result.directory.resolve().name))]
    for key, text in (("sim_time_s", "{:.1f} ns simulated"), ("wall_s", "computed in {:.0f} s")):
        if isinstance(value := result.values.get(key), float):
            texts.append(text.format(value * measure(key).factor))
    return escape(" · ".join(texts))


def _state(result: Result, history: Mapping[str, NDArray]) -> str:
    """The verdict, and reasons to doubt the result: unfinished, undecided, or an alert."""
    notes: list[tuple[str, str, str]] = []  # id, head and text as HTML
    if not result.finished:
        reached = f" It has reached {history['time'][-1] * 1e9:.1f} ns." if len(history.get("time", ())) else ""
        text = f": it is still running or was stopped.{reached} This page shows the data so far."
        notes.append(("unfinished", "This run is not finished", text))
    if result.undecided is not None:
        hint = ". <code>coldspray resume</code> continues it." if result.at_limit else ""
        notes.append(("undecided", "This run is undecided", f": {escape(result.undecided)}{hint}"))
    notes += [("doubtful", "This result is doubtful", f": {escape(text)}") for text in alerts(result.summary)]
    state = "".join(f'<p class="warn" id="{name}"><b>{head}</b>{text}</p>' for name, head, text in notes)
    decided = verdict(result.summary)
    lines = "<br>".join(map(escape, decided))
    return (f'<p id="verdict"><b>Verdict</b>: {lines}</p>' if decided else "") + state


def _pictures(
    sections: Sequence[picture.CrossSection], ranges: Mapping[str, picture.Range], named: Mapping[str, float]
) -> str:
    """Pictures of the cross-section: a row for each time, a picture for each field. named: time (s) by label, for captions."""
    pictures = []
    for section in sections:
        time = f"t = {section.time * 1e9:.1f} ns"
        words = "".join(f", {escape(word)}" for word, t in named.items() if math.isclose(t, section.time, rel_tol=1e-6))
        labels = {picture.PHASE: "phases", **{name: field.label for name, field in FIELDS.items()}}
        panels = ((embedded(_panel(section, name, ends)), labels[name]) for name, ends in ranges.items())
        images = "".join(f'<img src="{image}" alt="cross-section at {time}: {label}">' for image, label in panels)
        caption = f"<figcaption><b>{time}</b>{words}</figcaption>"
        pictures.append(f'<figure>{caption}<div class="three">{images}</div></figure>')
    return "".join(pictures)


def _panel(section: picture.CrossSection, name: str, ends: picture.Range) -> Figure:
    """A cross-section coloured by one field, with the colour bar or the legend below it."""
    left, right, bottom, top = section.view
    wide, bar = 4.0, 0.66  # inches
    tall = wide * (top - bottom) / (right - left)
    figure = blank(wide, tall + bar, 150)
    axis = axes_at(figure, 0, bar, wide, tall)
    picture.draw(axis, section, name, ends)
    picture.scale_bar(axis, section.view, 10)
    if name == picture.PHASE:
        picture.name_phases(axis, section.phases, loc="upper center", bbox_to_anchor=(0.5, 0.0), ncols=3)
    else:
        place = axes_at(figure, 0.25, 0.73 * bar, wide - 0.5, 0.17 * bar)
        picture.colour_bar(place, name, ends, wide - 0.5, across=True)
    return figure


def _depth(page: Page, result: Result, steps: Sequence[int], at: picture.Stage) -> str:
    reach, names = 1.5 * at.diameter / picture.MICRO, ("T", "eps_p", "von_mises", "stress")
    lines = [profile for step in steps for profile in profiles(result, step, names, at, reach)]
    last = [profile for profile in lines if profile.time == max(line.time for line in lines)]
    span = (min(float(profile.depth[0]) for profile in lines) * picture.MICRO, reach * picture.MICRO)
    figures = {f"depth-{k}": charts.with_depth(lines, k, f.words, f.factor, span) for k, f in FIELDS.items()}
    figures["depth-stress"] = charts.stress_with_depth(last, span)
    places = "".join(page.chart(name, figure) for name, figure in figures.items())
    caption = (
        "Values on the vertical line through the middle of the splat, from its top down. The gap in each curve is the "
        "interface; the dashed line is the undeformed surface. Normal stresses: at the last time; tension is positive."
    )
    colours = charts.shades(profile.time for profile in lines)
    key = "".join(f'<span><i style="background:{c}"></i>{time * 1e9:.1f} ns</span>' for time, c in colours.items())
    head = f'<p class="caption">{caption}</p><p class="key">{key}</p>'
    return f'{head}<div class="four">{places}</div>' if places else ""


def _energy(page: Page, history: Mapping[str, NDArray]) -> str:
    stack = page.chart("ledger", charts.energy(history))
    if not stack:
        return ""
    caption = (
        "The initial kinetic energy of the particle becomes these terms, in % for each impact. The "
        "stack is the sum of all terms of the ledger; its difference from 100 % is the drift, shown below."
    )
    drift = page.chart("drift", charts.over_time(history, "drift"), "Drift of the ledger")
    return f'<p class="caption">{caption}</p>{stack}{drift}'


def _scene(result: Result) -> str:
    try:
        text = result.scene_text
    except StoreError:
        return ""
    return (
        '<p class="caption">With all default values. Save it as a file and compute it again with '
        "<code>coldspray run</code>.</p>"
        '<div class="code"><button class="copy" type="button" data-of="scene-text">Copy</button>'
        f'<pre id="scene-text">{escape(text)}</pre></div>'
    )
