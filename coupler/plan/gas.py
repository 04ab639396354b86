"""The table [gas] of a scene. The gas gives velocity and temperature to particles that have none in the scene."""

import textwrap
from collections.abc import Iterable, Mapping, Sequence
from functools import cache

from .. import units
from ..errors import ColdsprayError
from ..physics.materials import Material, mixed
from ..scene.messages import in_words
from ..scene.model import MOST_IMPACTS, SceneData, particle_tables
from ..scene.spray import GasConditions
from ..scene.tables import Core, Particle
from ..scene.values import DIAMETER, read_table
from ..spray import nozzles
from ..spray.flight import DRAG_LAWS, Flight, fly_together
from ..spray.gas import GASES, Flow
from ..spray.nozzles import Nozzle
from .derived import Derived

_STAND_IN = {"velocity": "500 m/s", "temperature": "300 K"}  # values if another problem prevents the computation
_SLOWEST, _FASTEST = 10.0, 2000.0  # limits of the velocity in a scene, m/s
_MOST_LINES = 6  # about velocities and temperatures from the gas
_INDENT = " " * 13
_UNITS = {"velocity": ("m/s", 4), "temperature": ("K", 4)}  # unit and digits; the model is accurate to a few per cent


def read(table: object) -> tuple[GasConditions | None, list[str]]:
    """Read gas conditions from texts with units. Returns (conditions, problems). If there are problems, conditions is None."""
    conditions, entries = read_table(GasConditions, table)
    return conditions, [in_words(entry, False, GasConditions) for entry in entries]


def flow(conditions: GasConditions, nozzle: Nozzle) -> Flow:
    """The gas flow of a scene. Raises ColdsprayError if there is no such flow; the message begins with the name of the field."""
    c = conditions
    return Flow(GASES[c.kind], nozzle, c.pressure, c.temperature, c.standoff, c.ambient, c.bow_shock)


def flights(conditions: GasConditions, flow: Flow, metal: Material, diameters: Sequence[float]) -> list[Flight]:
    """Flights of spheres of a metal (diameters m) in a flow. Raises ColdsprayError if a flight cannot be computed."""
    return fly_together(flow, metal, diameters, conditions.powder_temperature, DRAG_LAWS[conditions.drag])


@cache
def _flights(conditions: GasConditions, nozzle: Nozzle, metal: Material, D: tuple[float, ...]) -> dict[float, Flight]:
    return dict(zip(D, flights(conditions, flow(conditions, nozzle), metal, D), strict=True))


def arrival(
    conditions: GasConditions, nozzle: Nozzle, material: Material, diameter: float, among: Iterable[float]
) -> dict[str, str]:
    """Velocity and temperature of a sphere (diameter m) at impact, by these keys, as texts such as "600 m/s". among: all diameters (m)
    of the scene; their flights are computed together. Raises ColdsprayError; the message begins with the name of the field."""
    flown = _flights(conditions, nozzle, material, tuple(sorted(set(among))))[diameter]
    if not _SLOWEST <= flown.velocity <= _FASTEST:
        head = f"pressure = {units.rounded(conditions.pressure, 'bar')}: {material.name} of {units.rounded(diameter, 'um')}"
        limits = f"a scene needs {_SLOWEST:g} to {_FASTEST:g} m/s: change the gas or the nozzle"
        raise ColdsprayError(f"{head} reaches {flown.velocity:.3g} m/s; {limits}")
    arriving = {"velocity": flown.velocity, "temperature": flown.temperature}
    return {field: units.rounded(value, *_UNITS[field]) for field, value in arriving.items()}


def fill(raw: dict[str, object], catalogue: Mapping[str, Material]) -> list[str]:
    """Add missing velocities and temperatures to the particles of a scene with a table [gas]. raw: the scene as nested dicts, changed
    in place; a value that cannot be computed is replaced by a valid one. catalogue: the materials. Returns the problems of nozzles
    and flow; the check of the scene reports all other problems."""
    tables = raw["nozzles"]
    assert isinstance(tables, dict)
    known, problems = nozzles.from_tables(tables)
    if "gas" not in raw:
        return problems
    conditions, _ = read(raw["gas"])
    if conditions is not None and conditions.nozzle not in known:
        if conditions.nozzle not in tables:  # otherwise the errors of its table are reported
            problems.append(f'gas.nozzle = "{conditions.nozzle[:40]}": {nozzles.unknown(conditions.nozzle, known)}')
        conditions = None
    particles = particle_tables(raw)
    if len(particles) > MOST_IMPACTS:  # the check of the scene refuses it
        conditions = None
    sizes = [_diameter(particle) for particle in particles]
    among = [size for size in sizes if size is not None]
    for particle, size in zip(particles, sizes, strict=True):
        arriving, material = _STAND_IN, _flying(particle, size, catalogue)
        if conditions is not None and material is not None and size is not None:
            try:
                arriving = arrival(conditions, known[conditions.nozzle], material, size, among)
            except ColdsprayError as error:
                problems.append(f"gas.{error}")
        particle |= {field: text for field, text in arriving.items() if field not in particle}
    return list(dict.fromkeys(problems))


def _flying(particle: Mapping[str, object], size: float | None, catalogue: Mapping[str, Material]) -> Material | None:
    """The material of a particle in flight, as `Derived.flying`; None if its tables have errors. size: its diameter, m."""
    shell, table = catalogue.get(str(particle.get("material"))), particle.get("core")
    if shell is None or size is None or table is None:
        return shell
    core, _ = read_table(Core, table)
    inner = catalogue.get(core.material) if core is not None else None
    share = core.share_by_volume(size, shell.rho, inner.rho) if core is not None and inner is not None else 1.0
    return mixed(shell, inner, share) if inner is not None and share < 1.0 else None


def describe(scene: SceneData) -> list[str]:
    """Lines about the gas for `coldspray check`; none if the scene has no table [gas]."""
    if scene.gas is None:
        return []
    c = scene.gas
    nozzle = nozzles.from_tables(scene.nozzles)[0][c.nozzle]
    where = f"{c.kind} {units.rounded(c.pressure, 'bar')}, {units.rounded(c.temperature, 'degC')}, nozzle {nozzle.name}"
    head = f"  gas        {where}, {units.rounded(c.standoff, 'mm')} to the target:"
    gives = list(dict.fromkeys(_gives(scene, c, nozzle, particle) for particle in scene.particles))
    more = [f"... and {len(gives) - _MOST_LINES} more"] if len(gives) > _MOST_LINES else []
    lines = [head, *(_INDENT + text for text in [*gives[:_MOST_LINES], *more])]
    lines = [f"{head} {gives[0]}"] if len(scene.particles) == 1 else lines
    shapes = list(dict.fromkeys(p.shape.replace("_", " ") for p in scene.particles if p.shape != "sphere"))
    notes = flow(c, nozzle).notes
    if shapes:
        notes.insert(0, f"drag and heat are those of the sphere of equal volume, not of the shape {', '.join(shapes)}")
    return lines + [_INDENT + line for note in notes for line in textwrap.wrap(note, 110 - len(_INDENT))]


def _gives(scene: SceneData, conditions: GasConditions, nozzle: Nozzle, particle: Particle) -> str:
    """Text about the velocity and the temperature that the gas gives a particle, and whether the scene uses them."""
    material, among = Derived(scene).flying(particle), [p.diameter for p in scene.particles]
    arriving = arrival(conditions, nozzle, material, particle.diameter, among)
    of_scene = {"velocity": f"{particle.velocity:.4g} m/s", "temperature": f"{particle.temperature:.4g} K"}
    away = [field for field in arriving if units.rounded(dict(particle)[field], *_UNITS[field]) != arriving[field]]
    used = f"replaced by {' and '.join(of_scene[field] for field in away)} of the scene" if away else "used here"
    which = f"{particle.material} {units.rounded(particle.diameter, 'um')}: " if len(scene.particles) > 1 else ""
    return f"{which}gives {arriving['velocity']}, {arriving['temperature']}, {used}"


def _diameter(particle: Mapping[str, object]) -> float | None:
    """The diameter of a particle, m; None if the scene gives no valid diameter."""
    try:
        return DIAMETER.read(particle.get("diameter"))
    except ValueError:
        return None
