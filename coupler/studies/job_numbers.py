"""The numbers of a job with ranges, trust marks and origins. They are the contents of job.json and the table of its page."""

import math
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass, replace
from statistics import fmean
from typing import Any

from ..plan.job import Feed, Job
from ..plan.text import duration
from ..report.words import with_error
from .coating import FATES
from .coating_seeds import seed_error
from .job_parts import Bonds, Coating, Found, Range, efficiency, ends, sticking, thickness
from .trust import mark

BAND = 0.2  # relative uncertainty of the critical velocity by the formula, as in `coldspray window`
AGREE = 0.5  # share of the mass: two values on different sides of it disagree
FLOWN, CRITICAL = "velocity at impact", "critical velocity"
RESOLUTION, STRENGTH, CHANCE = "resolution of the impacts", "strength of the powder", "random particles of the coating"
NOT_IN = (
    RESOLUTION, STRENGTH, CHANCE, "oxide film (its strength is known within a factor of two)", "friction", "gas and drag",
    "resolution of the coatings", "shape of the powder",
)  # fmt: skip
BLOCK = "block of the coating, all splats bonded"
NEXT = 3  # parts that are named with their times
APART = "Formula and computed bonds disagree."
FIRST, LATER = "Share of the powder that sticks on", "Deposition efficiency after the first layer"
EMBEDDED, DEPOSITED = "Share of the powder that embeds", "Share of the mass of the coating"
# by "formula" and by "computed": mass fraction of each powder that stays; None: that of a powder is not known
Shares = Mapping[str, Mapping[str, Range] | None]
NEEDS = (
    "By bonds no size sticks. A first layer then needs more than impacts on a clean flat surface: roughness, several hits on the same"
    " place, or a thinner oxide film."
)
COATING = "Porosity", "Roughness Sa", "Residual stress in the plane"


@dataclass(frozen=True)
class Number:
    """A line of the table of numbers. formula, computed: value with its range as text, "" if there is none; values: the same in SI,
    for job.json; colour, why: its trust mark (`trust.Mark`); how: method; folder: folder of its runs, relative to the folder of the
    job."""

    label: str
    formula: str
    computed: str
    values: dict[str, Range | None]
    colour: str
    why: str
    how: str
    folder: str = ""


def numbers(job: Job, bonds: Found, coating: Coating) -> list[Number]:
    """All lines of the table of numbers, in their order. In a blend the lines of a powder begin with its name."""
    lines, shares, several = list[Number](), dict[str, dict[str, Range | None]](), len(job.powders) > 1
    for name, powder in job.powders.items():
        own = [flown(job, name)]
        if powder.metal.is_ceramic:
            own.append(_embedded(powder, coating))
        for _, base in (pair for pair in job.hits if pair[0] == name):
            own += on_metal(job, name, base, bonds.get((name, base)))
        shares[name] = own[-1].values
        lines += [replace(line, label=f"{name}: {line.label}") if several else line for line in own]
    stays: dict[str, Mapping[str, Range] | None] = {}
    for by in ("formula", "computed"):
        known = {name: share for name, values in shares.items() if (share := values[by])}
        stays[by] = known if len(known) == len(shares) else None
    return lines + (_deposited(job, stays) if several else []) + of_coating(job, stays, coating)


def _embedded(powder: Feed, coating: Coating) -> Number:
    """The table line of the share of a ceramic that stays: mean, least and greatest value of the seeds."""
    phase, folder = " on ".join(powder.table.materials), next(iter(coating.measures), "")
    rows = [row for each in coating.measures.values() for row in each.phases if row["metal"] == phase]
    shares = [float(row["efficiency"]) for row in rows]
    stays = (fmean(shares), min(shares), max(shares)) if shares else None
    counts = [(sum(int(row.get(fate, 0)) for row in rows), word) for fate, word in FATES.items()]
    values: dict[str, Range | None] = {"formula": (0.0, 0.0, 0.0), "computed": stays}
    told = ", ".join(f"{number} {word}" for number, word in counts if number)
    how = f"a ceramic makes no bond: its particles embed, bounce or break in the coatings{f' ({told})' if told else ''}"
    return Number(EMBEDDED, "0%", _shown(stays, ".0%"), values, *mark((), powder.metal.name, 0.0), how, folder)


def _deposited(job: Job, shares: Shares) -> list[Number]:
    """The table lines of the share of each powder in the coating."""
    lines = []
    for name, powder in job.powders.items():
        values = {by: _part(job, shares[by], name) for by in shares}
        texts = {by: _shown(value, ".0%") for by, value in values.items()}
        how, marked = f"{powder.table.share:.0%} of the mass that is fed", mark((), powder.metal.name, 0.0)
        lines.append(Number(f"{name}: {DEPOSITED}", texts["formula"], texts["computed"], values, *marked, how))
    return lines


def _part(job: Job, stays: Mapping[str, Range] | None, name: str) -> Range | None:
    """Mass fraction of a powder in the coating. Its least value: least mass of this powder beside the greatest masses of the others."""
    if stays is None or not sum(each[0] for each in stays.values()):
        return None
    mass = {other: [job.powders[other].table.share * x for x in each] for other, each in stays.items()}
    own = mass.pop(name)
    rest = [sum(each[k] for each in mass.values()) for k in (0, 2, 1)]
    value, least, most = (x / (x + y) if x else 0.0 for x, y in zip(own, rest, strict=True))
    return value, least, most


def flown(job: Job, powder: str) -> Number:
    """The table line of the velocities of a powder at impact."""
    spray, metal = job.arrived[powder], job.powders[powder].metal.name
    k = [int(len(spray.share) * share) for share in (0.1, 0.5, 0.9)]
    v, T = (", ".join(f"{values[i]:.0f}" for i in k) for values in (spray.velocity, spray.temperature))
    slowest, middle, fastest = sorted(spray.velocity[k].tolist())
    values: dict[str, Range | None] = {"computed": (middle, slowest, fastest)}
    label, how = "Velocity at impact of D10, D50, D90", f"flight through nozzle {job.nozzle.name}; at impact {T} K"
    return Number(label, "", f"{v} m/s", values, *mark((FLOWN,), metal, middle), how)


def on_metal(job: Job, powder: str, base: str, found: Bonds | None) -> list[Number]:
    """The table lines about a metal that a powder hits: critical velocity, and mass fraction that sticks. found: result of computed
    bonds, None if there is none."""
    spray, own, metal = job.arrived[powder], job.powders[powder].table.material, job.powders[powder].metal.name
    k, folder, is_own = len(spray.formula) // 2, found.folder if found else "", base == own
    formula, v, name = spray.formula[k], float(spray.velocity[k]), job.metals[base].name
    known = {own: formula.critical} | ({} if is_own else {base: formula.base_critical})
    limits = {who: job.slant * value for who, value in known.items() if value is not None}
    by_formula = " and ".join(f"{value:.0f}{'' if is_own else f' ({who})'}" for who, value in limits.items())
    how = "Schmidt's formula" + ("; bonds computed through the oxide films" if found else "") + ", particle of D50"
    band = (max(limits.values()), (1.0 - BAND) * min(limits.values()), (1.0 + BAND) * max(limits.values()))
    by_bonds = (found.velocity, *found.band) if found else None
    marked = mark((CRITICAL,) if found else (), metal, v, name)
    label = f"Critical velocity on {base}" + (", after the first layer" if is_own else ", the first layer")
    values = {"formula": band, "computed": by_bonds}
    critical = Number(label, f"{by_formula} m/s", critical_words(found), values, *marked, how, folder)
    share = sticking(spray, job.slant, (1.0 - BAND) * job.slant, (1.0 + BAND) * job.slant, not is_own)
    of_bonds = efficiency(spray, found) if found else None
    marked = mark((CRITICAL, FLOWN) if found else (), metal, v, name)
    label = f"Deposition efficiency after the first layer, {base} on {base}" if is_own else f"{FIRST} {base}"
    how = "mass that flies faster than its critical velocity, and slower than twice that (erosion)"
    values = {"formula": share, "computed": of_bonds}
    return [critical, Number(label, _shown(share, ".0%"), _shown(of_bonds, ".0%"), values, *marked, how, folder)]


def critical_words(found: Bonds | None) -> str:
    """The critical velocity from computed bonds as text with its range."""
    if found is None:
        return "not computed"
    low, high = ends(found.found)
    least, most = found.band
    if math.isinf(high):
        other = f" ({least:.0f} with another strength)" if least < low else ""
        return f"above {low:.0f} m/s{other}" if low else "no verdict"
    if found.found.low is None:
        return f"below {high:.0f} m/s"
    return f"{found.velocity:.0f} m/s ({least:.0f} to {'-' if math.isinf(most) else f'{most:.0f}'})"


def of_coating(job: Job, shares: Shares, coating: Coating) -> list[Number]:
    """The table lines about the coating; none if no coating is computed. shares: deposited mass fraction of each powder (`Shares`)."""
    if not coating.measures:
        return []
    name, (folder, first) = job.main.metal.name, next(iter(coating.measures.items()))
    arrived = job.arrived[job.main.name].velocity
    v = float(arrived[len(arrived) // 2])
    each, worth = coating.measures.values(), [each.values for each in coating.properties.values()]
    pores, spot = [c.porosity_open + c.porosity_closed for c in each], f"{1e3 * job.data.spray.spot * job.slant:.3g} mm"
    layers = {by: thickness(job, stays, fmean(pores)) if stays else None for by, stays in shares.items()}
    quantities = (CRITICAL, FLOWN) if layers["computed"] else ()
    how = f"feed × efficiency / (density × (1 - porosity) × gun speed × spot), mean over the spot of {spot}"
    by_formula, by_bonds = (_shown(layers[by], ".3g", 1e6, " µm") for by in ("formula", "computed"))
    lines = [Number("Thickness of one pass", by_formula, by_bonds, layers, *mark(quantities, name, v), how, folder)]
    voids = f"open and closed pores thicker than {1e6 * first.void_limit_m:.2f} µm"
    for label, of, seeds, factor, unit, how in (
        ("Porosity", ("density",), pores, 100.0, "%", voids),
        ("Roughness Sa", (), [c.Sa_m for c in each], 1e6, "µm", "mean distance of the surface from its mean height"),
        ("Residual stress in the plane", ("stress",), [c.stress_in_plane_Pa for c in each], 1e-6, "MPa", "cold mean; compression < 0"),
        ("Young's modulus in the plane", (), [w["E_in_plane"].mixed for w in worth], 1e-9, "GPa", BLOCK),
        ("Heat conductivity across", (), [w["k_across"].mixed for w in worth], 1.0, "W/mK", BLOCK),
    ):  # fmt: skip
        if not seeds:
            continue
        over = seed_error(seeds)
        mean, error = factor * over.mean, factor * over.error
        text = with_error(mean, error) if over.seeds > 1 else f"{mean:.3g}"
        values: dict[str, Range | None] = {"computed": (over.mean, over.least, over.greatest)}
        lines.append(Number(label, "", f"{text} {unit}", values, *mark(of, name, v), how, folder))
    return lines


def _shown(values: Range | None, digits: str, factor: float = 1.0, unit: str = "") -> str:
    """A range as text; "" if there is no range."""
    value, low, high = (f"{factor * x:{digits}}{unit}" for x in values or (0.0, 0.0, 0.0))
    return "" if values is None else value + f" ({low} to {high})" * (low != high)


def answer(lines: Sequence[Number]) -> list[str]:
    """The answer of the job in sentences. Disagreements between formula and computed bonds come first."""
    texts = []
    for line in lines:
        if DEPOSITED in line.label:
            computed = f"{line.computed} computed" if line.computed else "not computed"
            texts.append(f"{line.label}: {line.formula or 'none'} by the formula, {computed}; {line.how}.")
        if FIRST not in line.label and LATER not in line.label:
            continue
        by_formula, by_bonds = line.values["formula"], line.values["computed"]
        apart = by_formula and by_bonds and (by_formula[0] > AGREE) != (by_bonds[0] > AGREE)
        text = f"{line.label}: {line.formula} by the formula, {line.computed or 'not computed'} by bonds."
        none = by_bonds and by_bonds[2] == 0.0 and FIRST in line.label
        texts.append(f"{APART} " * bool(apart) + text + f" {NEEDS}" * bool(none))
    ours = [line for line in lines if line.label in COATING]
    coating = ", ".join(f"{line.label[0].lower()}{line.label[1:]} {line.computed}" for line in ours)
    texts.sort(key=lambda text: not text.startswith(APART))
    return [*texts, f"Coating, if all its metal particles stick: {coating}." if coating else "No coating is computed."]


def errors_in(bonds: Found, coating: Coating) -> dict[str, str]:
    """The errors that the ranges of the numbers include: name of the error -> text."""
    sets, seeds = dict.fromkeys(name for each in bonds.values() for name in each.sets), len(coating.measures)
    known = (
        ("formula", True, f"by the formula: ± {BAND:.0%} of the critical velocity"),
        ("bracket", bonds, "by bonds: the last interval of the search"),
        (RESOLUTION, any(each.error is not None for each in bonds.values()), f"the {RESOLUTION}"),
        (STRENGTH, sets, f"the {STRENGTH} ({', '.join(sets)})"),
        (CHANCE, seeds > 1, f"for the coating: standard error of the mean of {seeds} coatings of different particles"),
    )
    return {name: text for name, there, text in known if there}


def record(job: Job, parts: Mapping[str, Any], bonds: Found, coating: Coating) -> dict[str, Any]:
    """The contents of job.json, SI. parts: "computed_s" -> part -> time, s; "left_out_s" -> part -> expected time, s; "failed" -> part
    -> reason."""
    lines, texts = numbers(job, bonds, coating), errors_in(bonds, coating)
    shares = {name: powder.table.share for name, powder in job.powders.items()}
    left = [f"{words} ({duration(seconds)})" for words, seconds in parts["left_out_s"].items()]
    more = "; ".join([*left[:NEXT], f"{len(left) - NEXT} further parts"] if len(left) > NEXT else left)
    return {
        "job": job.name, "powders": shares, "answer": answer(lines), "numbers": [asdict(line) for line in lines],
        "errors_in": list(texts.values()), "errors_not_in": [name for name in NOT_IN if name not in texts], **parts,
        "more_time": f"more time would add: {more}" if left else "more time changes nothing: a job computes no more than this",
        "failed": parts["failed"] | dict(coating.failed), "bonds": [asdict(each) for each in bonds.values()],
    }  # fmt: skip
