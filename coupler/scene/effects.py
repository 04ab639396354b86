"""Names of the effects that a scene may ask for, and the grammar of the request."""

from collections.abc import Sequence

from .. import units

NAMES = (
    "thermal_softening",
    "rate_hardening",
    "plastic_heating",
    "temperature_dependent_cp",
    "temperature_dependent_k",
    "friction",
    "friction_heat",
    "mie_gruneisen",
    "thermal_expansion",
    "adhesion",
    "absorbing_boundaries",
    "conduction",
    "particle_conduction",
    "interface_conduction",
    "cooling",
)
WHOLE = ("auto", "all", "none")


def check_request(request: str | Sequence[str]) -> list[str]:
    """Problems of what a scene says under `effects`; empty if it can be understood."""
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
