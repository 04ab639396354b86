"""Names of the effects of a scene, and the check of its key `effects`."""

from collections.abc import Sequence
from dataclasses import asdict, dataclass, fields

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
    def switches(self) -> dict[str, bool]:
        """All effects by name, True for on, as `constitutive.law_record` needs them."""
        return asdict(self)

    @property
    def active(self) -> list[str]:
        """Names of the effects that are on."""
        return [name for name, on in self.switches.items() if on]


NAMES = tuple(field.name for field in fields(Effects))
WHOLE = ("auto", "all", "none")


def check_request(request: str | Sequence[str]) -> list[str]:
    """Problems of the key `effects` of a scene."""
    if isinstance(request, str):
        return [] if request in WHOLE else [f"expected one of {', '.join(WHOLE)}, or a list of names"]
    problems, seen = [], set()
    for i, item in enumerate(request):
        name = item.lstrip("+-") if item[:1] in "+-" else item
        if item in WHOLE:
            if i > 0:
                problems.append(f'"{item}" may only be the first element of the list')
        elif name not in NAMES or len(item) - len(name) > 1:
            problems.append(f"unknown effect {item[:40]!r}{units.nearest(name, NAMES)}; known: {', '.join(NAMES)}")
        elif name in seen:
            problems.append(f'"{name}" is named twice')
        seen.add(name)
    return problems
