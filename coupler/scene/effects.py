"""Names of the effects that a scene may ask for, and the grammar of the request."""

from collections.abc import Sequence
from dataclasses import dataclass, fields

from .. import units


@dataclass(frozen=True)
class Effects:
    """Which effects take part in a run; a scene asks for them by these names."""

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
    def switches(self) -> dict[str, bool]:
        """Name -> whether it takes part, as `constitutive.law_record` wants it."""
        return {name: vars(self)[name] for name in NAMES}

    @property
    def active(self) -> list[str]:
        """Names of the effects that take part."""
        return [name for name, on in self.switches.items() if on]


NAMES = tuple(field.name for field in fields(Effects))
WHOLE = ("auto", "all", "none")


def check_request(request: str | Sequence[str]) -> list[str]:
    """Problems of the key `effects` of a scene; empty if there are none."""
    if isinstance(request, str):
        return [] if request in WHOLE else [f"expected one of {', '.join(WHOLE)}, or a list of names"]
    problems, seen = [], set()
    for i, item in enumerate(request):
        name = item.lstrip("+-") if item[:1] in "+-" else item
        if item in WHOLE:
            if i > 0:
                problems.append(f'"{item}" may only be the first of the list')
        elif name not in NAMES or len(item) - len(name) > 1:
            problems.append(f"unknown effect {item[:40]!r}{units.nearest(name, NAMES)}; known: {', '.join(NAMES)}")
        elif name in seen:
            problems.append(f'"{name}" is named twice')
        seen.add(name)
    return problems
