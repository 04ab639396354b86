"""Names of the effects of a scene, and the check of its key `effects`."""

from dataclasses import dataclass, fields
from typing import Any

from .. import units


@dataclass(frozen=True)
class Effects:
    """The effects of a run by name; True means on. A scene uses the same names."""

    thermal_softening: bool
    rate_hardening: bool
    gradient_hardening: bool
    plastic_heating: bool
    temperature_dependent_cp: bool
    temperature_dependent_k: bool
    friction: bool
    friction_heat: bool
    dissipation_heat: bool
    mie_gruneisen: bool
    thermal_expansion: bool
    adhesion: bool
    absorbing_boundaries: bool
    conduction: bool
    particle_conduction: bool
    interface_conduction: bool
    cooling: bool
    recovery: bool

    @property
    def active(self) -> list[str]:
        """Names of the effects that are on."""
        return [name for name, on in vars(self).items() if on]


NAMES = tuple(field.name for field in fields(Effects))
WHOLE = ("auto", "all", "none")
GRADIENTS = "gradient_hardening"  # by default only on with bonds by exposure, whose verdicts depend on it


def requested(request: object) -> dict[str, bool]:
    """The effects that a scene sets itself; True means on. `plan.effects.decide` chooses all others by the number of each effect.
    Raises ValueError with all problems of the request.

    request is the key `effects` of the scene:
    - "auto": the scene sets no effect;
    - "none": all effects are off;
    - "all": all effects are on, but the scene does not set GRADIENTS;
    - a list of names: only these effects are on;
    - a list that begins with "auto", "all" or "none": this choice with changes, such as ["auto", "-friction"];
    - a list in which all names have a sign, such as ["-friction"]: "auto" with these changes.
    """
    is_list = isinstance(request, list) and all(isinstance(item, str) and item for item in request)
    items: list[Any] = request if is_list else [request]  # type: ignore[assignment]
    base = "auto" if items and all(str(item).startswith(("+", "-")) for item in items) else "none"
    if items and items[0] in WHOLE:
        base, *items = items
    elif not is_list:
        raise ValueError(f"expected one of {', '.join(WHOLE)}, or a list of names")
    asked, problems = dict[str, bool](), list[str]()
    for item in items:
        name = item.lstrip("+-")
        if item in WHOLE:
            problems.append(f'"{item}" may only be the first element of the list')
        elif name not in NAMES or len(item) - len(name) > 1:
            problems.append(f"unknown effect {item[:40]!r}{units.nearest(name, NAMES)}; known: {', '.join(NAMES)}")
        elif name in asked:
            problems.append(f'"{name}" is named twice')
        asked[name] = not item.startswith("-")
    if problems:
        raise ValueError("; ".join(problems))
    whole = {} if base == "auto" else dict.fromkeys(NAMES, base == "all")
    if base == "all":
        del whole[GRADIENTS]
    return whole | asked
