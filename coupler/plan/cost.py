"""Size and cost of a run from a handful of numbers, before anything is built: the constants to tune."""

import math
import os

import numpy as np

from ..geometry.tetrahedra import COARSEST, TETS_PER_H3
from ..physics.materials import Material

# preset -> points of the particle
PRESETS = {"draft": 1000, "standard": 5000, "fine": 16000}
LEAST_POINTS = 200
LEAST_LAYERS = 2.0  # spacings across the thinnest part of a shape
# Steps with one dt and one contact search, between which nothing is written: at a Courant factor of 0.9 a dt kept for longer becomes
# unstable.
CHUNK = 10

# Facets finer than the points let the points indent them one by one: elements are larger than the spacing.
ELEMENT_SIZE_OVER_SPACING = 1.7
REFINED_RADIUS_OVER_DIAMETER = 0.55  # the part of the target with the smallest elements

WINDOW_OVER_DIAMETER = 1.75  # radius round an impact within which the target of many impacts is computed
MANY = 10  # particles from which on that is done
CAP = 3.0  # heights over velocity that an impact may take, or what is longer of ...
SLIDES = 1.5  # ... heights over the velocity towards the target: beyond 60 degrees that is more
STOPS = 2.0  # ... and times to stop: in the first the particle stops, in the second it rebounds
ON_SPLATS = 4.0  # times that, where splats lie below: overhanging ones bend slowly, particles slide down their flanks
HARDNESS_OVER_YIELD = 3.0  # Tabor (1951), The Hardness of Metals
GREATEST_OVER_REST = 0.75  # time of the greatest deformation over that of rest
# Fits (workflows/pace.py --fit) of sums over particle and target, of `loads` w. (Time to rest) v / height: a w^b of each, times
# exp(c sin^2 angle). What spacing / (c dt) has more than at rest: a w^b of each, w times cos^2 angle + SHEARED sin angle cos angle. A
# body that deforms alone is compressed most where it flows along the other, the more the finer it is: times (1 + w_p)^(e alone) of the
# particle, and (N / 1000)^(f alone), with alone = ((w_p - w_t) / (w_p + w_t))^2 and N points in a sphere of the particle's diameter.
REST_FIT = (0.75, 0.316), (0.259, 0.78), 0.953
STEP_FIT = (0.59, 1.127), (0.443, 0.976), (0.541, 0.608)
SHEARED = 2.348
CFL = {"enriched": 0.54, "compiled": 0.41, "machdyn": 0.41}  # c dt / spacing as long as nothing is deformed, by engine
STEP_ON_SPLAT = 0.69  # of an impact on a splat over that on a substrate: 0.58 to 0.78 in docs/tables/validation.csv
STRAIN_OF_FLOW = 0.3  # at which the flow stress of a damage number is taken
STRAIN_OF_RIM = 1.5  # of a particle
SPLAT_TETS_PER_H3 = 5.5  # in meshes of splats, whose surface holds a good part: 4.2 to 7 counted
# wall time of one step, one core, by engine
SECONDS_PER_POINT = {"compiled": 0.7e-6, "enriched": 1.0e-6, "machdyn": 2.6e-6}
SECONDS_PER_ELEMENT = 0.12e-6
SECONDS_PER_CONTACT_POINT = 0.3e-6
SECONDS_PER_STEP = 6e-4
SECONDS_PER_RUN = 0.3  # files and pictures; not the start of the program
SECONDS_PER_MESHED_ELEMENT = 1e-4
SECONDS_PER_SPLAT_ELEMENT = 2e-4  # of the conversion of points to elements: 1 s for 5000 ...
SECONDS_PER_CONVERSION = 0.3  # ... and of its own process
# Between impacts (`deposition`): steps of the target alone in which a new splat, or a pause, comes to rest, and of implicit conduction:
# the means of a coating of 40.
GRID = 1.6  # cost of a step with the coarse grid over one without
JOIN_STEPS = 30 * GRID
PAUSE_STEPS = 190 * GRID  # before it and after it
HEAT_STEPS = 23
SECONDS_PER_HEAT_ELEMENT = 1.3e-6  # of one of those

BYTES_PER_POINT = 3e4  # most of it while the carried surface is built
BYTES_PER_ELEMENT = 6e3
BYTES_AT_LEAST = 4e8  # the program and its libraries
# compressed, in each step that is written: 33 to 37 and 53 to 62 in coatings of 40 and 200 and in a particle of 40,000 points
FILE_BYTES_PER_ELEMENT = 36.0
FILE_BYTES_PER_POINT = 58.0
VERTICES = 6.5  # of a particle's surface over points^(2/3)


def spacing(volume: float, points: int) -> float:
    """Distance between points that fill a volume (m^3), each with its cube of it, m."""
    return (volume / points) ** (1 / 3)


def elements(
    diameter: float, height: float, element_size: float, refined_radius: float, growth: float, spread: float = 0.0
) -> int:
    """Tetrahedra of a graded mesh of a cylinder (m): element_size within refined_radius of a disc of radius spread, then growing. Sum
    of TETS_PER_H3 / h(r)^3 over the volume within a distance r below and beside the disc, at most the cylinder's, with h(r) =
    element_size + growth max(0, r - refined_radius), at most COARSEST of the smaller dimension."""
    cylinder = math.pi / 4 * diameter**2 * height
    r = np.linspace(0.0, (1.5 * cylinder / math.pi) ** (1 / 3), 401)  # at most the radius of a half ball
    volume = np.minimum(math.pi * spread**2 * r + 0.5 * math.pi**2 * spread * r**2 + 2 / 3 * math.pi * r**3, cylinder)
    middle = 0.5 * (r[1:] + r[:-1])
    h = np.minimum(element_size + growth * np.maximum(0.0, middle - refined_radius), COARSEST * min(diameter, height))
    return round(float(np.sum(TETS_PER_H3 * np.diff(volume) / h**3)))


def splat_elements(volume: float, element_size: float) -> int:
    """Tetrahedra of a splat of `volume` m^3 with edges of element_size m."""
    return round(SPLAT_TETS_PER_H3 * volume / element_size**3)


def flow_stress(material: Material, T: float, rate: float, strain: float = STRAIN_OF_FLOW) -> float:
    """Flow stress, Pa, at a plastic strain. T: K, short of melting; rate: 1/s."""
    hottest = material.T_ref + 0.95 * (material.T_m - material.T_ref)
    return material.flow_stress(strain, rate, min(T, hottest))


def loads(
    materials: tuple[Material, Material], temperatures: tuple[float, float], velocity: float, diameter: float
) -> tuple[float, float]:
    """Loads of particle and target in an impact: the energy that each absorbs over its flow stress and the particle's volume.

    Johnson's damage number rho v^2 / Y, with the particle's density and the body's flow stress, times the body's share of the energy,
    in proportion to its compliance 1 / Y; the particle's rim is heated by a strain of STRAIN_OF_RIM. materials, temperatures (K): of
    particle and target; velocity m/s, diameter m.
    """
    metal, rate, inertia = materials[0], velocity / diameter, materials[0].rho * velocity**2
    Y, Y_base = (flow_stress(m, T, rate) for m, T in zip(materials, temperatures, strict=True))
    share = Y_base / (Y + Y_base)
    T, part = temperatures[0], STRAIN_OF_RIM / 3
    for strain in (part, 2 * part, 3 * part):
        heat = metal.taylor_quinney * part * flow_stress(metal, T, rate, strain)
        T += heat / (metal.rho * metal.cp_at(min(T, metal.T_m)))
    return share * inertia / flow_stress(metal, T, rate, STRAIN_OF_RIM), (1.0 - share) * inertia / Y_base


def stopping_time(
    materials: tuple[Material, Material], temperatures: tuple[float, float], velocity: float, diameter: float
) -> float:
    """Time, s, in which a target that resists with the pressure H + rho_t v^2 / 2 stops a sphere (Poncelet 1829). (2/3) rho_p D /
    sqrt(H rho_t / 2) atan(v sqrt(rho_t / 2 H)); H: hardness of the softer of both. materials, temperatures (K): of particle and target;
    velocity m/s, diameter m."""
    rate = velocity / diameter
    H = HARDNESS_OVER_YIELD * min(flow_stress(m, T, rate) for m, T in zip(materials, temperatures, strict=True))
    particle, target = materials
    slowing = math.atan(velocity * math.sqrt(target.rho / (2.0 * H)))
    return 2.0 / 3.0 * particle.rho * diameter / math.sqrt(0.5 * H * target.rho) * slowing


def expected_time(
    cap: float, height: float, velocity: float, end_at: str, load: tuple[float, float], angle: float
) -> float:
    """Simulated time, s, that an impact may be expected to take of its `cap` s. height m, velocity m/s; end_at: "rest",
    "greatest" or "time"; load: of `loads`; angle: rad, from the normal."""
    if end_at == "time":
        return cap
    (a, b), (c, d), oblique = REST_FIT
    crossings = (a * load[0] ** b + c * load[1] ** d) * math.exp(oblique * math.sin(angle) ** 2)
    return min(cap, crossings * height / velocity * (GREATEST_OVER_REST if end_at == "greatest" else 1.0))


def time_step(
    spacing: float,
    wave_speed: float,
    load: tuple[float, float],
    points: float,
    angle: float,
    engine: str,
    slenderness: float = 1.0,
) -> float:
    """Mean time step of an impact to rest, s: the spacing shrinks as the particle deforms. spacing m, wave_speed m/s; points: of a
    sphere of its size; slenderness: height over the diameter of the sphere of equal volume; the rest as for `expected_time`."""
    (a, b), (c, d), (e, f) = STEP_FIT
    pressed = math.cos(angle) * (math.cos(angle) + SHEARED * math.sin(angle))
    alone = ((load[0] - load[1]) / sum(load)) ** 2
    excess = a * (pressed * load[0]) ** b * (1.0 + load[0]) ** (e * alone) + c * (pressed * load[1]) ** d
    excess *= (points / 1000.0) ** (f * alone)
    return spacing / wave_speed / (1.0 / CFL[engine] + excess * max(slenderness, 1.0))


def memory(points: float, n_elements: float) -> float:
    """Memory of a run, bytes."""
    return BYTES_AT_LEAST + BYTES_PER_POINT * points + BYTES_PER_ELEMENT * n_elements


def machine_memory() -> float:
    """Memory of this machine, bytes; infinite if the system does not report it."""
    try:
        return float(os.sysconf("SC_PHYS_PAGES") * os.sysconf("SC_PAGE_SIZE"))
    except (AttributeError, OSError, ValueError):
        return math.inf


def run_time(n_elements: float) -> float:
    """Time of a run but its steps, on one core, s: mesh, files, pictures; not the start of the program."""
    return SECONDS_PER_RUN + SECONDS_PER_MESHED_ELEMENT * n_elements


def step_time(steps: float, points: float, n_elements: float, engine: str) -> float:
    """Time of so many steps on one core, s."""
    return steps * (SECONDS_PER_STEP + SECONDS_PER_ELEMENT * n_elements + SECONDS_PER_POINT[engine] * points)


def target_load(points: float, n_elements: float, engine: str) -> float:
    """Cost of what the rank of the target does in a step, target and contact, over the cost of the particle."""
    own = SECONDS_PER_ELEMENT * n_elements + SECONDS_PER_CONTACT_POINT * points
    return own / (SECONDS_PER_POINT[engine] * points)
