"""Validity of the material models in a run: extreme values of each impact, and warnings if they lie outside the range of the fits.

Limits of the strength: strain rate, temperature and strain of the data of the strength set, if its source gives them; else the
strain rate of Hopkinson bars and nine tenths of the melting point (`plan.remarks.NEAR_MELTING`). Limit of the pressure: that of a
shock with the largest particle velocity for which the linear fit U = c0 + s u of a Hugoniot is commonly given (Marsh 1980, LASL
Shock Hugoniot Data); without Mie-Grueneisen, the compression at which a linear equation of state has an error of a twentieth.
"""

import re
from dataclasses import dataclass, field

import numpy as np

from ..fe.explicit import Target
from ..physics.materials import Material
from ..plan.remarks import BEYOND_FIT, NEAR_MELTING
from ..ranks.distributed import DistributedParticle

FITTED_VELOCITY = 2000.0  # m/s, particle velocity behind the shock
LINEAR_ERROR = 0.05


@dataclass
class Extreme:
    """Largest values in a body so far. rate: 99th percentile of plastic strain rates above zero, 1/s; melting: temperature divided by
    the melting point; strain: 99th percentile of plastic strains above zero; compression: 1 - J."""

    rate: float = 0.0
    melting: float = 0.0
    strain: float = 0.0
    compression: float = 0.0

    def note(self, rate: np.ndarray, melting: np.ndarray, eps_p: np.ndarray, J: np.ndarray) -> None:
        """Update the largest values with the present ones of all points or elements. J: volume ratios of points or nodes."""
        self.rate = max(self.rate, _percentile(rate))
        self.melting = max(self.melting, float(np.max(melting, initial=0.0)))
        self.strain = max(self.strain, _percentile(eps_p))
        self.compression = max(self.compression, 1.0 - float(np.min(J, initial=1.0)))


def _percentile(values: np.ndarray) -> float:
    """99th percentile of the values above zero, 0 if there are none."""
    above = values[values > 0.0]
    return float(np.percentile(above, 99)) if len(above) else 0.0


@dataclass
class Extremes:
    """Extreme strain rates, strains and temperatures of particle and target, for the check of validity. Of a particle with a core
    only the shell counts; of the target only the substrate with its layers, as each splat counts in its own impact."""

    particle: Extreme = field(default_factory=Extreme)
    target: Extreme = field(default_factory=Extreme)

    def note(self, particle: DistributedParticle, target: Target, ground: np.ndarray) -> None:
        """Include the present values of the particle and of the active part of the target. ground: mask (bodies,) of the substrate and
        its layers."""
        n, m, p, e = target.active_nodes, target.active_elements, particle.points, target.elements
        shell = particle.law_of == 0
        self.particle.note(p.rate[shell], p.T[shell] / particle.law["T_m"][0], p.eps_p[shell], p.J[shell])
        own, J = ground[target.law_of[:m]], target.nodes.J[:n][ground[target.metals.of_node[:n]]]
        melting = e.T[:m] / target.laws["T_m"][target.law_of[:m]]
        self.target.note(e.rate[:m][own], melting[own], e.eps_p[:m][own], J)

    def warnings(self, impact: int, materials: dict[str, Material], mie_gruneisen: bool) -> list[str]:
        """Warnings about exceeded limits of models. impact: number of the impact, from 1; materials: of "particle" and "target"."""
        texts, left = [], []
        for body, kept in vars(self).items():
            metal, where = materials[body], f"impact {impact}: in the {body}"
            left += _beyond_fit(body, metal, kept)
            limit = greatest_compression(metal, mie_gruneisen)
            if kept.compression > limit:
                shock, linear = "the fit of the shock equation of state", "the range of a linear equation of state"
                law = shock if mie_gruneisen else linear
                GPa = pressure(metal, kept.compression) / 1e9
                texts.append(
                    f"{where} the compression is {kept.compression:.1%} ({GPa:.3g} GPa), beyond {law}"
                    f" (up to {limit:.1%}, {pressure(metal, limit) / 1e9:.3g} GPa)"
                )
        return [f"impact {impact}: {BEYOND_FIT}: {'; '.join(left)}", *texts] if left else texts


def _beyond_fit(body: str, metal: Material, kept: Extreme) -> list[str]:
    """A text about the values of a body outside the fitted range of its strength law, as a list; empty if all are inside."""
    fitted, T = metal.strength.fitted, kept.melting * metal.T_m
    parts = []
    if kept.rate > metal.fitted_rate:
        parts.append(f"strain rate {kept.rate:.1e} 1/s (99th percentile; fitted up to {metal.fitted_rate:.0e})")
    if fitted.temperature and T > fitted.temperature[1]:
        parts.append(f"temperature {T:.0f} K (fitted up to {fitted.temperature[1]:.0f} K)")
    elif kept.melting > NEAR_MELTING:
        parts.append(f"temperature {kept.melting:.2f} of the melting point (valid up to {NEAR_MELTING:g})")
    if fitted.strain and kept.strain > fitted.strain:
        parts.append(f"strain {kept.strain:.2g} (99th percentile; fitted up to {fitted.strain:g})")
    return [f"{body} ({metal.name}, {metal.strength.set or metal.strength.law}) {', '.join(parts)}"] if parts else []


def merged(texts: list[str]) -> list[str]:
    """The warnings of a whole run, without repetitions. A warning of an impact begins with "impact N: ". If such warnings differ only
    in N, bodies or other numbers, only that with the largest first number after "impact N: " remains, with a note about the others.

    Each warning that does not belong to an impact appears once, unchanged.
    """
    groups: dict[str, list[str]] = {}
    for text in dict.fromkeys(texts):
        own = _OF_IMPACT.match(text)
        same = _BODY.sub("in the #", _NUMBER.sub("#", text[own.end() :])) if own else text
        groups.setdefault(same, []).append(text)
    lines = []
    for same_texts in groups.values():
        worst = max(same_texts, key=_first_number)
        others = [text for text in same_texts if text is not worst]
        impacts = {text.partition(":")[0] for text in others} - {worst.partition(":")[0]}
        bodies = {body for text in others for body in _BODY.findall(text)}
        where = (
            f"in {len(impacts)} other impact{'s' if len(impacts) > 1 else ''}" if impacts else "".join(sorted(bodies))
        )
        lines.append(worst + (f" (and less {where})" if others else ""))
    return lines


_BODY = re.compile(r"in the (?:particle|target)\b")
_NUMBER = re.compile(r"(?<![A-Za-z0-9_.])\d[\d.]*(?:e[+-]?\d+)?")
_NAMES = re.compile(r"\([^)]*\)")  # material and strength set of a body, which may have numbers
_OF_IMPACT = re.compile(r"impact \d+: ")


def _first_number(text: str) -> float:
    own = _OF_IMPACT.match(text)
    number = _NUMBER.search(_NAMES.sub("", text[own.end() if own else 0 :]))
    return float(number[0].rstrip(".")) if number else 0.0


def greatest_compression(metal: Material, mie_gruneisen: bool) -> float:
    """Largest compression 1 - J for which the equation of state of a metal is valid."""
    if mie_gruneisen:
        return float(FITTED_VELOCITY / (metal.c0 + metal.s * FITTED_VELOCITY))  # u / U across the shock
    return float(LINEAR_ERROR / (2.0 * metal.s)) if metal.s > 0.0 else 1.0


def pressure(metal: Material, compression: float) -> float:
    """Pressure (Pa) on the Hugoniot at 1 - J = compression."""
    return float(metal.K * compression / (1.0 - metal.s * compression) ** 2)
