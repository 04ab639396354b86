"""A job: one question of a process engineer. Its answer is a folder of runs, the file job.json and one HTML page."""

import math
import time
from collections.abc import Callable, Sequence
from dataclasses import replace
from html import escape
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from pydantic_core import to_json

from .. import __version__
from ..errors import ColdsprayError, SceneError
from ..files.inputs import read_json_object
from ..files.outputs import MARK, claim_folder, keep_toml, write_text
from ..files.result import Result
from ..plan.job import Coatings, Feed, Job, Search, seconds
from ..plan.reading import Scene
from ..plan.text import duration
from ..report import parts
from ..report.figure import blank, embedded, image_of
from ..report.page import Page
from . import coating_files
from .coating import read
from .critical import Bracket
from .job_numbers import BAND, Number, numbers, record
from .job_parts import Bonds, Coating, Found, bonds, coatings, efficiency, search
from .runs import Log
from .trust import RULE

PAGE, RECORD = "job.html", "job.json"
FILES = "job.toml", RECORD, PAGE, "micrograph.png"
SAFETY = 2.0  # a part begins, and a search continues, if this many times its expected time is left


def compute(job: Job, text: str, out: Path, time_of: Callable[[Scene], float], jobs: int, log: Log) -> dict[str, Any]:
    """Compute the parts of a job that are missing in its folder while there is time. Writes job.json and job.html after each part.
    Returns the contents of job.json.

    text: text of the job's file; time_of: function that gives the processor time of a scene, s; jobs: number of cores. Raises
    StoreError if the folder holds another job.
    """
    sticks, end = job.sticks, time.monotonic() + job.data.within
    job.check()
    claim_folder(out, "job", FILES)
    keep_toml(out / FILES[0], text, "job", but=["within"])
    before: Any = read_json_object(out / RECORD).get("computed_s", {}) if (out / RECORD).exists() else {}
    usual, kind = 1.0, ""  # expected time of one round of the current part, s; class of this part
    pace = {"Search": 1.0, "Coatings": 1.0}  # greatest ratio of time to expected time
    done, left, failed = dict[str, float](), dict[str, float](), dict[str, str]()
    found, coating = dict[Search, Bracket](), Coating({}, {})

    def write() -> dict[str, Any]:
        times, known = {"computed_s": done, "left_out_s": left, "failed": failed}, bonds(job, found)
        values = {"version": __version__, **record(job, times, known, coating)}
        write_text(out / RECORD, to_json(values, indent=1, inf_nan_mode="null").decode() + "\n")
        write_text(out / PAGE, page(job, text, out, values, known, coating))
        return values

    def more(last: float, rounds: int = 1) -> bool:
        pace[kind] = max(pace[kind], last / usual)
        return SAFETY * rounds * pace[kind] * usual <= end - time.monotonic()

    for part in job.parts:
        if isinstance(part, Coatings) and not sticks:
            continue
        try:
            usual, kind = seconds(job, part, time_of, jobs), type(part).__name__
        except SceneError as error:  # its points do not resolve a powder
            failed[part.words] = str(error)
            continue
        left[part.words] = part.rounds * pace[kind] * usual
        if part.words not in before and not more(0.0, part.rounds):
            continue
        log(f"{part.words}: about {duration(left[part.words])}")
        begun = time.monotonic()
        try:
            if isinstance(part, Coatings):
                finer = coatings(job, part, out, jobs, log)
                coating = finer if finer.measures else replace(coating, failed={**coating.failed, **finer.failed})
                more(time.monotonic() - begun)
            elif bracket := search(job, part, out, jobs, log, more):
                found[part] = bracket
                sticks |= efficiency(job.arrived[part.powder], Bonds(part.powder, part.base, "", bracket))[0] > 0.0
            else:
                continue
        except ColdsprayError as error:
            failed[part.words] = str(error)
        del left[part.words]
        done[part.words] = before.get(part.words, 0.0) + time.monotonic() - begun
        write()
    return write()


def page(job: Job, text: str, out: Path, known: dict[str, Any], found: Found, coating: Coating) -> str:
    """The HTML page of a job, with answer, table of numbers, deposition window and cross-section of the coating on its first sheet.
    Writes micrograph.png into `out`. text: text of the job's file; known: contents of job.json."""
    lines, sheet = numbers(job, found, coating), Page()
    pictures = [(embedded(deposition_window(job, found)), "The powder and its deposition window on this metal")]
    if coating.measures:
        splats = read(Result(out / next(iter(coating.measures))))
        picture = coating_files.micrograph(splats, out / "micrograph.png", 1.3 * splats.patch)
        pictures.append((image_of(picture.read_bytes()), "Cross-section of the first coating; pores are black"))
    images = "".join(
        f'<figure><figcaption>{escape(words)}</figcaption><img src="{image}" alt="{escape(words)}"></figure>'
        for image, words in pictures
    )
    said = "<br>".join(map(escape, known["answer"]))
    trusted = f'<p class="caption">{escape(RULE)} Ranges in brackets: smallest and largest value.</p>'
    ranges, left = ("; ".join(known[key]) for key in ("errors_in", "errors_not_in"))
    errors = f'<p class="caption">{escape(f"The ranges include: {ranges}. They do not include: {left}.")}</p>'
    front = f'<p id="verdict">{said}</p>{_table(lines)}{errors}{trusted}<div class="two">{images}</div>'
    failed = [f"{name}: {why}" for name, why in known["failed"].items()]
    front += "".join(f'<p class="warn">{escape(line)}</p>' for line in failed)
    sheet.section("computed", "How it was computed", _computed(known, found))
    sheet.section("time", "What more time would give", f"<p>{escape(known['more_time'])}.</p>")
    sheet.section("assumed", "Assumptions", parts.items(_assumed(job)))
    sheet.section("job", "The job", f"<pre>{escape(text)}</pre>")
    title = f"{' + '.join(job.powders)} on {job.surface}: does it stick?"
    return sheet.html(title, escape(_conditions(job)), front, f"{MARK} {__version__}")


def _conditions(job: Job) -> str:
    gas, part = job.data.gas, job.data.substrate
    texts = (
        *map(_powder, job.powders.values()),
        f"{gas.kind}, {gas.pressure / 1e5:.4g} bar, {gas.temperature - 273.15:.4g} °C",
        f"nozzle {job.nozzle.name}, {1e3 * gas.standoff:.3g} mm",
        f"{' on '.join(part.materials)} at {part.temperature - 273.15:.4g} °C",
    )  # fmt: skip
    return " · ".join(texts)


def _powder(powder: Feed) -> str:
    D = " / ".join(f"{1e6 * powder.sizes.diameter(share):.0f}" for share in (0.1, 0.5, 0.9))
    share = f" {powder.table.share:.0%} of the mass" if powder.table.share < 1.0 else ""
    return f"{powder.name}{share}, D10 / D50 / D90 {D} µm"


def _table(lines: Sequence[Number]) -> str:
    rows = []
    for line in lines:
        link = f' (<a href="{escape(line.folder)}">runs</a>)' if line.folder else ""
        mark = f'<span class="mark {line.colour}"></span>{line.colour} <small>{escape(line.why)}</small>'
        how = f"<small>{escape(line.how)}{link}</small>"
        rows.append((line.label, line.formula, line.computed, parts.Html(mark), parts.Html(how)))
    return parts.table(("", "by formula", "computed", "trust", "how"), rows, stack=True)


def _computed(known: dict[str, Any], found: Found) -> str:
    texts = [f"{words}: {duration(seconds)}" for words, seconds in known["computed_s"].items()]
    texts += [f"{each.folder}: {each.found.words}" for each in found.values()]
    how = "Each folder has the scene.toml of its run: coldspray report FOLDER shows a run, coldspray run computes its scene again."
    return f"{parts.items(texts)}<p>{how}</p>"


def _assumed(job: Job) -> list[str]:
    track, raw = job.data.spray, job.raw.get("spray", {})
    known = {
        "feed_rate": f"{6e4 * track.feed_rate:.3g} g/min", "traverse_speed": f"{1e3 * track.traverse_speed:.4g} mm/s",
        "spot": f"{1e3 * track.spot:.3g} mm",
    }  # fmt: skip
    texts = [f"spray.{key} = {value}: an assumed value" for key, value in known.items() if key not in raw]
    if any(isinstance(each.sizes, tuple) and len(each.sizes) == 2 for each in job.data.powders):
        texts.append("5 % of the powder's mass below and 5 % above the sieves, log-normal between them")
    angle, has_ceramic = math.degrees(track.angle), any(powder.metal.is_ceramic for powder in job.powders.values())
    oblique = f"gun at {angle:.3g} degrees: bonds are those of the oblique impact; the formula uses the normal velocity"
    blend = "after the first layer each metal hits the same metal; a coating contains the part of each that sticks by the formula"
    ceramic = "a ceramic makes no bond: by the formula none stays; in a coating, particles that embed unbroken stay"
    return [
        *texts, *job.flow.notes, oblique if angle else "particles fall normal to the surface",
        "bonds are those of spheres on a flat and thick base of one metal",
        "metal particles of a coating all stay where they hit",
        *[blend] * (len(job.powders) > 1), *[ceramic] * has_ceramic,
    ]  # fmt: skip


def deposition_window(job: Job, found: Found) -> Figure:
    """Figure with a panel for each metal powder. Curves against the diameter: impact velocity of this powder and of each ceramic;
    critical velocities of this powder from the formula and from computed bonds."""
    metals = {name: powder for name, powder in job.powders.items() if not powder.metal.is_ceramic}
    figure = blank(5.6, 3.9 * len(metals), 130, "constrained")
    for axis, (name, powder) in zip(figure.subplots(len(metals), squeeze=False).flat, metals.items(), strict=True):
        spray, D = job.arrived[name], 1e6 * job.arrived[name].diameter
        for other, at in job.arrived.items():
            if other == name or other not in metals:
                label, style = f"{other} at impact (25 classes of equal mass)", "o-" if other == name else "s:"
                axis.plot(1e6 * at.diameter, at.velocity, style, color="k", ms=3, label=label)
        scale = spray.critical / spray.critical[len(D) // 2]
        formula = {
            job.surface: [each.base_critical for each in spray.formula],
            powder.table.material: [each.critical for each in spray.formula],
        }
        curves = list[Any]()  # label, style, colour, velocity, its least and greatest value
        for colour, (metal, critical) in zip(("#0072b2", "#d55e00"), formula.items(), strict=False):
            v = job.slant * np.array(critical, float)
            curves.append((f"formula for {metal}", "--", colour, v, (1 - BAND) * v, (1 + BAND) * v))
        own = [each for each in found.values() if each.powder == name]
        for colour, each in zip(("#009e73", "#cc79a7"), own, strict=False):
            low, high, above = *each.band, math.isinf(each.velocity)
            middle = scale * (low if above else each.velocity)
            most = middle if above else np.minimum(scale * high, 2.0 * middle)
            words = f"bonds on {each.base}" + ": above this line" * above
            curves.append((words, ":" if above else "-", colour, middle, scale * low, most))
        for label, style, colour, v, low, high in curves:
            axis.plot(D, v, style, color=colour, label=f"critical, {label}")
            axis.fill_between(D, low, high, color=colour, alpha=0.13, linewidth=0)
        axis.set(xlabel="diameter (µm)", ylabel="velocity (m/s)", ylim=(0.0, None))
        axis.legend(fontsize=7)
    return figure
