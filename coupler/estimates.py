"""Size and cost of a run from a handful of numbers, before anything is built: the constants to tune."""

import math
import os

# preset -> points of the particle
PRESETS = {"draft": 1000, "standard": 4000, "fine": 16000}
LEAST_POINTS = 200

# Facets finer than the points let the points indent them one by one: elements are larger than the spacing.
ELEMENT_SIZE_OVER_SPACING = 1.6
REFINED_RADIUS_OVER_DIAMETER = 0.55  # the part of the target with the smallest elements
GROWTH = 0.35  # element size gained per unit of distance outside it
TETS_PER_H3 = 4.2  # tetrahedra in a volume h^3, counted in gmsh's meshes: half as many as regular ones of edge h

CFL = 0.15  # dt = CFL spacing / wave speed: a mean over a run in which the spacing shrinks
SHARE_OF_CAP = 0.5  # a run to rest takes about this share of the time allowed to it
SECONDS_PER_POINT = 3e-6  # wall time of one step, one core
SECONDS_PER_ELEMENT = 0.25e-6
SECONDS_PER_STEP = 3e-4

BYTES_PER_POINT = 6e3
BYTES_PER_ELEMENT = 3e3
BYTES_AT_LEAST = 4e8  # the program and its libraries


def sphere_volume(diameter: float) -> float:
    """Volume of a sphere, m^3. diameter: m."""
    return math.pi / 6 * diameter**3


def spacing(volume: float, points: int) -> float:
    """Distance between points that fill a volume (m^3), each with its cube of it, m."""
    return (volume / points) ** (1 / 3)


def elements(diameter: float, height: float, element_size: float, refined_radius: float) -> int:
    """Tetrahedra of a graded mesh of a cylinder (m): element_size inside refined_radius, growing outside.

    Closed form of the integral of TETS_PER_H3 / h(r)^3 over a half ball that has the volume of the cylinder,
    h(r) = element_size + GROWTH max(0, r - refined_radius).
    """
    outer = (3 / 8 * diameter**2 * height) ** (1 / 3)
    inner = min(refined_radius, outer)
    h0, h1 = element_size, element_size + GROWTH * (outer - inner)
    a = GROWTH * inner - h0

    def primitive(h: float) -> float:  # of (h + a)^2 / h^3, where r = (h + a) / GROWTH
        return math.log(h) - 2 * a / h - a**2 / (2 * h**2)

    near = inner**3 / (3 * h0**3)
    far = (primitive(h1) - primitive(h0)) / GROWTH**3
    return round(TETS_PER_H3 * 2 * math.pi * (near + far))


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
