"""Size and cost of a run from a handful of numbers, before anything is built: the constants to tune."""

import math
import os

# preset -> points of the particle
PRESETS = {"draft": 1000, "standard": 5000, "fine": 16000}
LEAST_POINTS = 200

# Facets finer than the points let the points indent them one by one: elements are larger than the spacing.
ELEMENT_SIZE_OVER_SPACING = 1.7
REFINED_RADIUS_OVER_DIAMETER = 0.55  # the part of the target with the smallest elements
GROWTH = 0.35  # element size gained per unit of distance outside it
COARSEST = 1 / 6  # largest element over the target's smaller dimension
TETS_PER_H3 = 4.2  # tetrahedra in a volume h^3, counted in gmsh's meshes: half as many as regular ones of edge h

CFL = 0.21  # dt = CFL spacing / wave speed: a mean over a run in which the spacing shrinks
CAP = 3.0  # heights over velocity that an impact may take
# an impact takes about this share of the time allowed to it: rest and greatest deformation come after 1.0 and 0.75 D / v
SHARE_OF_CAP = {"rest": 0.33, "greatest": 0.25}
SPLAT_TETS_PER_H3 = 5.5  # in meshes of splats, whose surface holds a good part: 4.2 to 7 counted
SECONDS_PER_POINT = 2.6e-6  # wall time of one step, one core
SECONDS_PER_ELEMENT = 0.12e-6
SECONDS_PER_CONTACT_POINT = 0.3e-6
SECONDS_PER_STEP = 6e-4
SECONDS_PER_SPLAT_ELEMENT = 2e-4  # of the conversion of points to elements: 1 s for 5000
SPLIT_FROM = 0.45  # the target's cost over the particle's: from here on a rank of its own serves it best

BYTES_PER_POINT = 3e4  # most of it while the carried surface is built
BYTES_PER_ELEMENT = 6e3
BYTES_AT_LEAST = 4e8  # the program and its libraries


def sphere_volume(diameter: float) -> float:
    """Volume of a sphere, m^3. diameter: m."""
    return math.pi / 6 * diameter**3


def spacing(volume: float, points: int) -> float:
    """Distance between points that fill a volume (m^3), each with its cube of it, m."""
    return (volume / points) ** (1 / 3)


def elements(diameter: float, height: float, element_size: float, refined_radius: float, growth: float = GROWTH) -> int:
    """Tetrahedra of a graded mesh of a cylinder (m): element_size near the impact, growing outside refined_radius.

    Sum of TETS_PER_H3 / h(r)^3 over shells of a half ball that has the volume of the cylinder, h(r) = element_size +
    growth max(0, r - refined_radius), at most COARSEST of the smaller dimension.
    """
    outer = (3 / 8 * diameter**2 * height) ** (1 / 3)
    shells, total = 400, 0.0
    for i in range(shells):
        r = (i + 0.5) / shells * outer
        h = min(element_size + growth * max(0.0, r - refined_radius), COARSEST * min(diameter, height))
        total += TETS_PER_H3 * 2 * math.pi * r**2 * (outer / shells) / h**3
    return round(total)


def splat_elements(volume: float, element_size: float) -> int:
    """Tetrahedra of a splat of `volume` m^3 with edges of element_size m."""
    return round(SPLAT_TETS_PER_H3 * volume / element_size**3)


def expected_time(cap: float, height: float, velocity: float, end_at: str) -> float:
    """Simulated time, s, that an impact may be expected to take of its `cap` s. height m, velocity m/s; end_at: "rest",
    "greatest" or "time"."""
    return cap if end_at == "time" else min(cap, SHARE_OF_CAP[end_at] * CAP * height / velocity)


def memory(points: float, n_elements: float) -> float:
    """Memory of a run, bytes."""
    return BYTES_AT_LEAST + BYTES_PER_POINT * points + BYTES_PER_ELEMENT * n_elements


def machine_memory() -> float:
    """Memory of this machine, bytes; infinite where the system does not tell."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def wall_time(steps: float, points: float, n_elements: float) -> float:
    """Wall time of a run on one core, s."""
    return steps * (SECONDS_PER_POINT * points + SECONDS_PER_ELEMENT * n_elements + SECONDS_PER_STEP)


def home_load(points: float, n_elements: float) -> float:
    """Cost of what the rank of the target does in a step, target and contact, over the cost of the particle."""
    return (SECONDS_PER_ELEMENT * n_elements + SECONDS_PER_CONTACT_POINT * points) / (SECONDS_PER_POINT * points)


def placement(load: float) -> str:
    """Where two ranks are best used: apart where the target costs about as much as the particle."""
    return "split" if load > SPLIT_FROM else "spread"
