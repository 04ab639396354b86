"""A job: one question of a process engineer, answered by a small folder of runs, job.json and one page."""

import base64
import json
import math
from collections.abc import Callable, Sequence
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure

from .. import __version__
from ..files.outputs import MARK, write_text
from ..files.result import Result
from ..measures import STICKS
from ..plan.job import Job, choose
from ..plan.reading import Scene
from ..plan.text import duration
from ..report.page import Page, embedded
from ..report.picture import blank
from . import coating_files
from .coating import read
from .job_numbers import BAND, Number, numbers, record
from .job_parts import Bonds, Coating, Log, bonds, coatings, efficiency, folder_of, with_errors
from .trust import RULE

PAGE, RECORD = "job.html", "job.json"


def compute(job: Job, text: str, out: Path, takes: Callable[[Scene], float], jobs: int, log: Log) -> dict[str, Any]:
    """Compute what a job lacks in its folder, write job.json and job.html. text: the file of the job; takes: processor time of a scene,
    s; jobs: cores. Returns what job.json has. Raises StoreError where the folder holds another job."""
    choice, seconds, then = choose(job, takes, jobs)  # a job that is refused leaves no folder
    folder_of(text, out)
    log(f"chosen for {duration(job.data.within)}: {choice.words}; about {duration(seconds)} here")
    found = [bonds(job, choice, base, out, jobs, log) for base in job.bases] if choice.bonds else []
    sticks = job.arrived.fates()[STICKS] > 0.0 or any(efficiency(job.arrived, each)[0] > 0.0 for each in found)
    coating = coatings(job, choice, out, jobs, log) if sticks else Coating({}, {})
    found = [with_errors(job, choice, each, out, jobs, log) for each in found]
    known = {"version": __version__, **record(job, choice, seconds, then, found, coating)}
    write_text(out / RECORD, json.dumps(_finite(known), indent=1, ensure_ascii=False) + "\n")
    write_text(out / PAGE, page(job, text, out, known, found, coating))
    return known


def _finite(value: Any) -> Any:
    """A value for JSON: None in place of infinity, the fields of nested values too."""
    if isinstance(value, dict):
        return {str(key): _finite(item) for key, item in value.items()}
    if isinstance(value, list | tuple):
        return [_finite(item) for item in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def page(job: Job, text: str, out: Path, known: dict[str, Any], found: Sequence[Bonds], coating: Coating) -> str:
    """The page of a job as HTML; the first sheet, to print, has the answer, the numbers, the window and a section of the coating."""
    lines, sheet = numbers(job, found, coating), Page()
    pictures = [(embedded(window(job, found)), "The powder in the window of this pair")]
    if coating.measures:
        pictures.append((_micrograph(out, next(iter(coating.measures))), "Section of the first coating; pores black"))
    images = "".join(
        f'<figure><figcaption>{escape(words)}</figcaption><img src="{image}" alt="{escape(words)}"></figure>'
        for image, words in pictures
    )
    said = "<br>".join(map(escape, known["answer"]))
    trusted = f'<p class="caption">{escape(RULE)} Ranges in brackets: least and greatest; what they have is below the table.</p>'
    ranges, left = ("; ".join(known[key]) for key in ("errors_in", "errors_not_in"))
    errors = f'<p class="caption">{escape(f"In the ranges: {ranges}. Not in them: {left}.")}</p>'
    front = f'<p id="verdict">{said}</p>{_table(lines)}{errors}{trusted}<div class="two">{images}</div>'
    failed = [f"{name}: {why}" for name, why in known["failed"].items()]
    front += "".join(f'<p class="warn">{escape(line)}</p>' for line in failed)
    sheet.section("computed", "How it was computed", _computed(known, found, coating))
    sheet.section("time", "What more time buys", f"<p>{escape(known['more_time'])}.</p>")
    sheet.section("assumed", "What is assumed", _list(_assumed(job)))
    sheet.section("job", "The job", f"<pre>{escape(text)}</pre>")
    return sheet.html(
        f"{job.data.powder.material} on {job.data.substrate.material}: does it stick?",
        escape(_conditions(job)),
        front,
        f"{MARK} {__version__}",
    )


def _conditions(job: Job) -> str:
    gas, part, D = job.data.gas, job.data.substrate, [1e6 * job.sizes.diameter(share) for share in (0.1, 0.5, 0.9)]
    texts = (
        f"{job.data.powder.material}, D10 / D50 / D90 {' / '.join(f'{d:.0f}' for d in D)} µm",
        f"{gas.kind}, {gas.pressure / 1e5:.4g} bar, {gas.temperature - 273.15:.4g} °C",
        f"nozzle {job.nozzle.name}, {1e3 * gas.standoff:.3g} mm", f"{part.material} at {part.temperature - 273.15:.4g} °C",
    )  # fmt: skip
    return " · ".join(texts)


def _table(lines: Sequence[Number]) -> str:
    heads, rows = ("", "by formula", "computed", "trust", "how"), []
    for line in lines:
        link = f' (<a href="{escape(line.folder)}">runs</a>)' if line.folder else ""
        mark = f'<span class="mark {line.colour}"></span>{line.colour} <small>{escape(line.why)}</small>'
        cells = (
            escape(line.label),
            escape(line.formula),
            escape(line.computed),
            mark,
            f"<small>{escape(line.how)}{link}</small>",
        )
        rows.append("".join(f'<td data-head="{head}">{cell}</td>' for head, cell in zip(heads, cells, strict=True)))
    head = "".join(f"<th>{text}</th>" for text in heads)
    body = "".join(f"<tr>{row}</tr>" for row in rows)
    return f'<div class="wide stack"><table><thead><tr>{head}</tr></thead><tbody>{body}</tbody></table></div>'


def _list(texts: Sequence[str]) -> str:
    return "<ul>" + "".join(f"<li>{escape(text)}</li>" for text in texts) + "</ul>"


def _computed(known: dict[str, Any], found: Sequence[Bonds], coating: Coating) -> str:
    runs = [f"{each.folder}: search of the critical velocity on {each.base}; {each.found.words}" for each in found]
    runs += [
        f"{folder}: {c.of} particles, {c.thickness_mean_m * 1e6:.1f} µm thick in the mean"
        for folder, c in coating.measures.items()
    ]
    how = "Each folder has the scene.toml of its run: coldspray report FOLDER shows a run, coldspray run computes its scene again."
    return f"<p>{escape(known['computed'])}; about {duration(known['expected_s'])} were expected.</p>{_list(runs)}<p>{how}</p>"


def _assumed(job: Job) -> list[str]:
    track, raw = job.data.spray, job.raw.get("spray", {})
    known = {
        "feed_rate": f"{6e4 * track.feed_rate:.3g} g/min", "traverse_speed": f"{1e3 * track.traverse_speed:.4g} mm/s",
        "spot": f"{1e3 * track.spot:.3g} mm",
    }  # fmt: skip
    texts = [f"spray.{key} = {value}: the job does not say it" for key, value in known.items() if key not in raw]
    if isinstance(job.data.powder.sizes, tuple) and len(job.data.powder.sizes) == 2:
        texts.append("5 % of the powder's mass below and 5 % above the sieves, log-normal between them")
    texts += [f"nozzle {job.nozzle.name}: {job.nozzle.assumed}"] if job.nozzle.assumed else []
    return [
        *texts,
        *job.flow.notes,
        "particles are spheres, fall normal to the surface, and those of a coating all stay where they hit",
    ]


def _micrograph(out: Path, folder: str) -> str:
    splats = read(Result(out / folder))
    path = coating_files.micrograph(splats, out / "micrograph.png", 1.3 * splats.patch)
    return "data:image/png;base64," + base64.b64encode(path.read_bytes()).decode()


def window(job: Job, found: Sequence[Bonds]) -> Figure:
    """Velocity over diameter: the powder as it arrives, and the critical velocities of the pair by formula and by computed bonds."""
    spray, figure = job.arrived, blank(5.6, 3.9, 130, "constrained")
    axis, D = figure.add_subplot(), 1e6 * spray.diameter
    axis.plot(D, spray.velocity, "o-", color="k", ms=3, label="powder at impact (25 classes of equal mass)")
    curves = {
        job.data.substrate.material: [each.base_critical for each in spray.formula],
        job.data.powder.material: [each.critical for each in spray.formula],
    }
    for colour, (name, critical) in zip(("#0072b2", "#d55e00"), curves.items(), strict=False):
        if None not in critical:
            v = np.array(critical, float)
            axis.plot(D, v, "--", color=colour, label=f"critical, formula for {name}")
            axis.fill_between(D, (1 - BAND) * v, (1 + BAND) * v, color=colour, alpha=0.12, linewidth=0)
    scale = spray.critical / spray.critical[len(D) // 2]
    for colour, each in zip(("#009e73", "#cc79a7"), found, strict=False):
        low, high = each.band
        if each.failed:
            continue
        if math.isinf(each.velocity):
            axis.plot(D, low * scale, ":", color=colour, label=f"critical, bonds on {each.base}: above this line")
        else:
            axis.plot(D, each.velocity * scale, "-", color=colour, label=f"critical, bonds on {each.base}")
            axis.fill_between(
                D, low * scale, min(high, 2.0 * each.velocity) * scale, color=colour, alpha=0.15, linewidth=0
            )
    axis.set(xlabel="diameter (µm)", ylabel="velocity (m/s)", ylim=(0.0, None))
    axis.legend(fontsize=7)
    return figure
