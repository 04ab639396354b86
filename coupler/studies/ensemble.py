"""Probability distributions of an ensemble, and values drawn from them with a quasi-random sequence."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass

import numpy as np
from scipy import stats

from .. import units

# keys of the table of a distribution, by its kind
KINDS = {
    "normal": ("mean", "deviation"), "log-normal": ("median", "spread"), "uniform": ("from", "to"), "choice": ("values",),
}  # fmt: skip
LIMITS = ("smallest", "largest")
_EXAMPLES = (
    '{ mean = "600 m/s", deviation = "40 m/s" }, { median = "25 um", spread = 1.4 }, { from = "0 um", to = "10 um" },'
    " { values = [...] }"
)


@dataclass(frozen=True)
class Distribution:
    """Distribution of one number of a scene, or a choice among values. kind: key in KINDS; numbers: values of its two parameters, SI;
    unit: unit in which values are written, "" for plain numbers; limits: smallest and largest value, SI; values: values of a
    choice."""

    kind: str
    numbers: tuple[float, float] = (0.0, 1.0)
    unit: str = ""
    limits: tuple[float, float] = (-np.inf, np.inf)
    values: tuple[object, ...] = ()

    @staticmethod
    def is_table(table: Mapping[str, object]) -> bool:
        """Whether a table describes a distribution (and not keys of a scene)."""
        return any(keys[0] in table and not isinstance(table[keys[0]], Mapping) for keys in KINDS.values())

    def at(self, share: float) -> object:
        """The quantile at the fraction `share` (0 to 1), as text with its unit or as number."""
        if self.values:
            return self.values[min(int(share * len(self.values)), len(self.values) - 1)]
        a, b = self.numbers
        law = stats.norm(a, b) if self.kind == "normal" else stats.uniform(a, b - a)
        if self.kind == "log-normal":
            law = stats.lognorm(np.log(b), scale=a)
        low, high = map(law.cdf, self.limits)
        value = float(law.ppf(low + share * (high - low)))
        return units.rounded(value, self.unit, 6) if self.unit else float(f"{value:.6g}")


def distribution_of(table: object) -> Distribution:
    """Read a distribution: { mean, deviation }, { median, spread } (log-normal; spread: geometric standard deviation), { from, to } or
    { values = [...] }. The first two may have limits `smallest` and `largest`. Raises ValueError."""
    kind = next(
        (k for k, keys in KINDS.items() if isinstance(table, Mapping) and all(key in table for key in keys)), None
    )
    if kind is None or not isinstance(table, Mapping):
        raise ValueError(f"expected a distribution: {_EXAMPLES}")
    keys, known = KINDS[kind], (*KINDS[kind], *(LIMITS if kind in ("normal", "log-normal") else ()))
    if unknown := [key for key in table if key not in known]:
        raise ValueError(f"{unknown[0]}: unknown key; known: {', '.join(known)}")
    if kind == "choice":
        values = table["values"]
        if not isinstance(values, list) or not values:
            raise ValueError("values: expected a list")
        return Distribution(kind, values=tuple(values))
    numbers = {key: _number(key, table[key]) for key in known if key in table}
    found = {unit for key, (_, unit) in numbers.items() if key != "spread"}
    dimensions = {units.dimension_of(unit) if unit else "" for unit in found}
    if len(dimensions) > 1:
        raise ValueError(f"{', '.join(numbers)} must have units of the same dimension")
    a, b = (numbers[key][0] for key in keys)
    if kind == "normal" and numbers["deviation"][1] == "degC":
        raise ValueError("deviation: give the value in K")
    is_sound, problem = {
        "normal": (b > 0.0, "deviation must be above zero"), "uniform": (a < b, "the value of from must be below that of to"),
        "log-normal": (a > 0.0 and b > 1.0, "median must be above zero and spread above 1"),
    }[kind]  # fmt: skip
    low, high = (numbers[key][0] if key in numbers else end for key, end in zip(LIMITS, (-np.inf, np.inf), strict=True))
    if not is_sound or low >= high:
        raise ValueError("smallest must be below largest" if is_sound else problem)
    return Distribution(kind, (a, b), numbers[keys[0]][1], (low, high))


def _number(key: str, value: object) -> tuple[float, str]:
    """A number in SI and the unit in which it is given. Raises ValueError."""
    if isinstance(value, int | float) and not isinstance(value, bool):
        return float(value), ""
    unit = value.partition(" ")[2].strip() if isinstance(value, str) else ""
    try:
        return units.parse(value, units.dimension_of(unit)), unit
    except (LookupError, ValueError):
        raise ValueError(f'{key}: expected a number, or a number with its unit, such as "600 m/s"') from None


def draws(laws: Sequence[Distribution], count: int, seed: int) -> list[list[object]]:
    """`count` points of a scrambled Halton sequence (Owen 2017, arXiv:1706.02808), mapped by the quantiles of the distributions. A
    longer series begins with the shorter one: an ensemble can be extended."""
    shares = stats.qmc.Halton(len(laws), scramble=True, rng=np.random.default_rng(seed)).random(count)
    return [[law.at(float(share)) for law, share in zip(laws, row, strict=True)] for row in shares]
