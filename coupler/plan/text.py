"""The plan as text for `coldspray check`."""

import math
from pathlib import Path
from textwrap import fill

from .. import units
from . import cost as estimates
from .model import ImpactPlan, Plan, TargetPlan
from .remarks import BEYOND_FIT

_MOST_LINES = 12  # about impacts
_FEW = 3  # lines about impacts, and names of effects, in brief
_FEWER = 2  # lines of other lists, in brief
_MOST_SHAPES = 3


def describe(plan: Plan, here: str = "", brief: bool = False) -> str:
    """The plan as text of some 50 lines of up to 120 columns. here: lines about time and accuracy on this machine, instead of the
    plan's estimate; brief: within 30 lines, without the reasons for the effects."""
    target, show, expected = plan.target, units.rounded, estimates.forecast(plan)
    dt = min(impact.dt_expected for impact in plan.impacts)
    points = sorted({i.points for i in plan.impacts})
    many = f"{_round(points[0])} to {_round(points[-1])}" if len(points) > 1 else f"{points[0]}"
    middle = f" of {_at(*target.centre)}" if any(target.centre) else ""
    if target.spread > 0.0:
        middle = f" of a disc of radius {show(target.spread, 'um')}{middle and ' about' + middle.removeprefix(' of')}"
    lines = [
        f"{plan.name} ({plan.preset})",
        *_impacts(plan, _FEW if brief else _MOST_LINES),
        *_shortened(_shapes(plan), brief),
        *_shortened([*plan.gas], brief),
        *([fill(plan.spray, 119, initial_indent="  spray      ", subsequent_indent=" " * 13)] if plan.spray else []),
        f"  target     {target.material.name} cylinder {show(target.diameter, 'um', 4)}"
        f" x {show(target.height, 'um', 4)}, {show(target.temperature, 'K', 4)},"
        f" sides {target.sides}, bottom {target.bottom}"
        + (f", rough: Sa {show(target.roughness[0], 'um')}" if target.roughness else "")
        + _heights(target)
        + "".join(f", {metal.name} {show(thickness, 'um')}" for metal, thickness in target.layers),
        *_strength(plan, brief),
        f"  friction   {plan.friction:g}",
        *_splats(plan),
        *_window(plan),
        _ends(plan),
        "",
        f"  points     about {many}, spacing {show(plan.impact.spacing, 'um')}, engine {plan.engine}",
        f"  elements   about {_round(target.elements_estimate)}, smallest {show(target.element_size, 'um')}"
        f" within {show(target.refined_radius, 'um')}{middle}",
        f"  steps      about {_round(sum(expected.steps))} of {show(dt, 'ps')} (dt)",
        f"  memory     about {expected.memory / 1e9:.2g} GB; files about {_bytes(expected.files)}",
        here or f"  wall time  about {duration(expected.whole)} on one core, after compilation",
    ]
    rows, notes = plan.decisions, [line for text in plan.warnings for line in _note(text, brief)]
    if brief:
        off = [row.name for row in rows if not row.on]
        more = f" and {len(off) - _FEW} more" if len(off) > _FEW else ""
        without = f"; off: {', '.join(off[:_FEW])}{more}" if off else ""
        lines.append(f"  effects    {len(rows) - len(off)} of {len(rows)} on{without} (-v: why)")
        return "\n".join([*lines, *notes])
    lines += [
        "  retry      a failed impact is computed again from its start, with half the time step, then with a quarter",
        "",
        "  effect                    on   because",
        *(f"  {row.name:25} {'yes' if row.on else 'no':4} {row.number} = {row.value:.3g}: {row.why}" for row in rows),
    ]
    return "\n".join([*lines, *(["", *notes] if notes else [])])


def _heights(target: TargetPlan) -> str:
    """Range of the heights of a shaped surface; "" for all others."""
    if target.ground is None:
        return ""
    low, high, _ = target.ground.extremes(target.diameter, target.element_size)
    return f", heights {low * 1e6:.3g} to {high * 1e6:.3g} um"


def _strength(plan: Plan, brief: bool) -> list[str]:
    """Lines about the strength set of each metal and the hardness of the powder; without `brief` also about sources."""
    metals = {m.name: m for m in (*(m for impact in plan.impacts for m in impact.materials), *plan.target.materials)}
    hardened = max(impact.initial_strain for impact in plan.impacts)
    powder = f"initial plastic strain {hardened:.3g}" if hardened > 0.0 else "as hard as in its strength set"
    texts = {"strength": f"{', '.join(f'{name} {m.strength.label}' for name, m in metals.items())}; powder {powder}"}
    hard = [f"{name} (taylor_alpha {m.taylor_alpha:g})" for name, m in metals.items() if m.taylor_alpha]
    if plan.effects.gradient_hardening and hard:
        texts["strength"] += f"; gradients of plastic strain harden {', '.join(hard)}"
    if not brief:
        sources = [f"{m.name}: {m.source or 'none'}; strength: {m.strength.source or 'none'}" for m in metals.values()]
        texts |= {"source" + " " * k: text for k, text in enumerate(sources)}
    return [fill(text, 119, initial_indent=f"  {k:11}", subsequent_indent=" " * 13) for k, text in texts.items()]


def _note(warning: str, brief: bool) -> list[str]:
    """Lines of a warning; with `brief` without the names of the strength sets that are fitted at the strain rate."""
    sets = ""
    if warning.startswith(BEYOND_FIT):
        warning, _, sets = warning.partition("; ")
    lines = [fill(f"note: {warning}", 119, initial_indent="  ", subsequent_indent="    ")]
    if sets and not brief:
        lines.append(fill(sets, 119, initial_indent="    ", subsequent_indent="    "))
    return lines


def _shortened(lines: list[str], brief: bool) -> list[str]:
    return [*lines[:_FEWER], "             ..."] if brief and len(lines) > _FEWER else lines


def _impacts(plan: Plan, most: int) -> list[str]:
    if len(plan.impacts) == 1:
        return [f"  particle   {_particle(plan.impact)}{_pause(plan.impact)}"]
    lines = [
        f"  impact {n:<4}{_particle(impact)}{f', at {_at(*impact.offset)}' if any(impact.offset) else ''}{_pause(impact)}"
        for n, impact in enumerate(plan.impacts[:most], start=1)
    ]
    more = len(plan.impacts) - len(lines)
    return [*lines, f"             ... and {more} more"] if more else lines


def _particle(impact: ImpactPlan) -> str:
    show = units.rounded
    flies = f"{show(math.hypot(*impact.velocity), 'm/s', 4)} at {show(impact.angle, 'deg')} from the normal"
    sort = f"{impact.material.name} {_shape(impact)} {show(impact.diameter, 'um')}"
    return f"{sort}, {flies}, {show(impact.temperature, 'K', 4)}"


def _shape(impact: ImpactPlan) -> str:
    shape = Path(impact.file).name if impact.file else impact.shape.replace("_", " ")
    if impact.core is not None:
        shape += f" with {100.0 * impact.core.share:.3g} vol% {impact.core.material.name} core,"
    return f"{shape} with {len(impact.pores.centres)} pores," if impact.pores else shape


def _at(x: float, y: float) -> str:
    return f"({units.rounded(x, 'um').removesuffix(' um')}, {units.rounded(y, 'um').removesuffix(' um')}) um"


def _pause(impact: ImpactPlan) -> str:
    unit = next((u for u, size in (("s", 1.0), ("ms", 1e-3), ("us", 1e-6)) if impact.dwell >= size), "ns")
    return f", then a pause of {units.rounded(impact.dwell, unit)}" if impact.dwell else ""


def _splats(plan: Plan) -> list[str]:
    """Lines about the conversion and the adhesion of splats; no lines for a single particle without adhesion."""
    if len(plan.impacts) == 1 and plan.adhesion.kind == "none":
        return []
    each = [impact.splat_elements for impact in plan.impacts if impact.splat_elements]
    text = "none expected: all particles are below the critical velocity"
    if each:
        count = " to ".join(dict.fromkeys(str(_round(number)) for number in (min(each), max(each))))
        size = units.rounded(plan.splat_element_size, "um")
        text = f"about {count} elements of {size} each, method {plan.splat_method}"
    return [f"  adhesion   {plan.adhesion.words}", f"  splats     {text}"]


def _window(plan: Plan) -> list[str]:
    """Line about the computed part of the target; no line if the whole target is computed."""
    lengths = sorted({impact.window for impact in plan.impacts if math.isfinite(impact.window)})
    if not lengths:
        return []
    most = max(each.stop - each.first for each in plan.batches)
    side = f"; {len(plan.batches)} batches of up to {most} impacts at the same time" if most > 1 else ""
    return [f"  window     {_range(lengths, 'um')} around each impact: only this part of the target is computed{side}"]


def _ends(plan: Plan) -> str:
    several = len(plan.impacts) > 1
    last = sorted({i.end_time for i in plan.impacts})
    often = sorted({max(i.output_every, estimates.CHUNK * i.dt_expected) for i in plan.impacts})
    ends = {"rest": "at rest, at most ", "greatest": "at greatest deformation, at most ", "time": ""}
    cold = "" if plan.ambient is None else f"; at the end all bodies cool to {units.rounded(plan.ambient, 'K', 4)}"
    when = f"every {_range(often)}" if math.isfinite(often[0]) else f"at the end{' of each' if several else ''}"
    head = f"  {'each ends  ' if several else 'ends       '}{ends[plan.impact.end_at]}"
    return f"{head}{_range(last)}{cold}; a step written {when}"


def _bytes(number: float) -> str:
    return f"{number / 1e9:.2g} GB" if number > 0.95e9 else f"{max(number / 1e6, 1.0):.2g} MB"


def _range(values: list[float], unit: str = "ns") -> str:
    """The first and the last of ascending SI values as text; one value if they are equal."""
    first, last = (units.rounded(value, unit) for value in (values[0], values[-1]))
    return first if first == last else f"{first.removesuffix(f' {unit}')} to {last}"


def _shapes(plan: Plan) -> list[str]:
    lines = []
    for particle in (impact for impact in plan.impacts if impact.shape != "sphere"):
        lengths = " x ".join(units.rounded(length, "um").removesuffix(" um") for length in particle.lengths)
        tilt = f" tilted {units.rounded(particle.tilt, 'deg')}" if particle.tilt else ""
        which = f"{_shape(particle)}: " if len(plan.impacts) > 1 else ""
        volume = f"{units.rounded(particle.diameter, 'um')} is the diameter of the sphere of equal volume"
        lines.append(f"             {which}{lengths} um{tilt}; {volume}")
    lines = list(dict.fromkeys(lines))
    return lines if len(lines) <= _MOST_SHAPES else [*lines[:_MOST_SHAPES], "             ... and others"]


def duration(seconds: float) -> str:
    """A wall time as text: "8 s", "3 min", "2.5 h"."""
    if seconds < 90:
        return f"{max(seconds, 1):.0f} s"
    return f"{seconds / 60:.0f} min" if seconds < 5400 else f"{seconds / 3600:.2g} h"


def _round(number: int) -> int:
    """The number rounded to two significant digits, for estimates."""
    step = 10 ** max(len(str(number)) - 2, 0)
    return round(number / step) * step
