"""Checks of relations between several fields of a scene, mostly of numbers derived from them."""

import math
from collections.abc import Iterator, Mapping
from functools import partial

from .. import units
from ..errors import ColdsprayError, SceneError
from ..physics import materials
from ..physics.adhesion import PARTICLE_BOND_STIFFNESS, Adhesion, critical_velocity, oxide_film
from ..physics.materials import Material
from ..scene.ground import Substrate
from ..scene.messages import shown, text_of
from ..scene.model import SceneData
from ..scene.tables import Particle
from . import cost as estimates
from .derived import Derived
from .ground import ground_of

_LEAST_WINDOW = 0.6  # radius over the width of a particle: the footprint of a splat
STEEPEST = 0.25  # Sa over the correlation length: root mean square slope 0.63, time steps of elements are 0.7 of those of a flat mesh
_CELLS_OF_PORE = 3.0  # spacings across a pore: walls that are closer at the start get no contact (`impact.folding`)
_CELLS_OF_SHAPE = 4.0  # elements in a correlation length or a groove
# of a shaped surface: above 70 degrees elements below it become thinner than those of a flat target
STEEPEST_FLANK = math.radians(65.0)
_HIGHEST = 0.4  # height or depth of a shape over the height of the target
_DEEPEST = 0.05  # Sa over the height of the target: at smaller values the heights of elements change by a fifth at most
_EXTENT = ("diameter", "shape", "tilt")
_MOST_RECORDS = 5000
_HOTTEST = 0.95  # temperature over melting point: above it the Johnson-Cook law has almost no strength

_um = partial(units.rounded, unit="um")

Problem = tuple[tuple[str, ...], str]  # the fields of the check, the message


def _wrong(field: str, value: float, unit: str, text: str, *looked: str) -> Problem:
    """The problem of a wrong value (SI) of `field`: all checked fields, and the message. looked: the other checked fields."""
    return (field, *looked), f"{field} = {text_of(value, unit)}: {text}"


def problems_of(scene: SceneData, catalogue: Mapping[str, Material], broken: set[str]) -> Iterator[Problem]:
    """Problems in the relations between several fields, each with the names of the checked fields. catalogue: materials by name;
    broken: names materials.NAME of tables with errors."""
    d = Derived(scene)
    bodies: list[tuple[str, str, float]] = []  # name of the table, material, temperature (K)
    for where, particle in zip(scene.labels, scene.particles, strict=True):
        named = zip((where, f"{where}.core"), particle.materials, strict=False)
        bodies += [(table, name, particle.temperature) for table, name in named]
    base = scene.substrate
    bodies += [("substrate", base.material, base.temperature)]
    bodies += [(f"substrate.layer[{k}]", layer.material, base.temperature) for k, layer in enumerate(base.layer, 1)]
    for where, name, temperature in bodies:
        material = catalogue.get(name)
        if material is None:
            if f"materials.{name}" not in broken:  # otherwise the errors of its table are reported
                text = f"{where}.material = {shown(name)}: {materials.unknown(name, catalogue)}"
                yield (f"{where}.material",), text
        elif temperature > _HOTTEST * material.T_m:
            text = f"must be below {_HOTTEST:g} times the melting point of {material.name}, {_HOTTEST * material.T_m:.0f} K"
            field = f"{where.removesuffix('.core')}.temperature"
            yield _wrong(field, temperature, "K", text, f"{where}.material")
    known = [metal for _, name, _ in bodies if (metal := catalogue.get(name)) is not None]
    if d.ambient is not None and known:
        metal = min(known, key=lambda metal: metal.T_m)
        if d.ambient > _HOTTEST * metal.T_m:
            text = f"must be below {_HOTTEST * metal.T_m:.0f} K, {_HOTTEST:g} times the melting point of {metal.name}"
            yield _wrong("end.ambient", d.ambient, "K", text)
    for where, particle in zip(scene.labels, scene.particles, strict=True):
        yield from _hardness(where, particle, catalogue.get(particle.material))
        yield from _pores(where, particle, d.spacing)
        if particle.core is not None and {*particle.materials} <= catalogue.keys():
            yield from _core(d, where, particle)
    yield from _room(d)
    yield from _surface(d)
    yield from _layers(d)
    yield from _resolution(d)
    asked = not isinstance(scene.effects, str) and {"gradient_hardening", "+gradient_hardening"} & set(scene.effects)
    if scene.resolution.engine == "machdyn" and asked:
        text = "it computes no gradients of plastic strain (gradient_hardening): use enriched or compiled"
        yield ("resolution.engine", "effects"), f"resolution.engine = machdyn: {text}"
    if asked and known and not any(metal.taylor_alpha for metal in known):
        names = sorted({metal.name for metal in known})
        text = f"effects: gradient_hardening needs taylor_alpha and burgers of {' or '.join(names)}"
        yield ("effects", *(f"materials.{name}" for name in names)), text
    yield from _adhesion(d, catalogue)
    if scene.coating is None and (d.spray.passes or d.spray.angle):
        text = "spray.passes and spray.angle are for the particles of a table [coating]: give dwell and angle of each particle"
        yield ("spray.passes", "spray.angle"), text
    if d.spray.heat_transfer and d.spray.gas_temperature is None and scene.gas is None:
        yield ("spray.heat_transfer",), "spray.heat_transfer: needs spray.gas_temperature, or a table [gas]"
    if scene.output.at == "ends" and scene.output.every is not None:
        yield ("output.at", "output.every"), 'output.every: has no effect with output.at = "ends": remove one of them'
    records = sum(d.usual_time_of(p) / d.output_every_of(p) for p in scene.particles)
    if records > _MOST_RECORDS:
        least = units.rounded(sum(map(d.usual_time_of, scene.particles)) / _MOST_RECORDS, "ns")
        text = f"would write {records:.3g} steps; at most {_MOST_RECORDS} are possible: give at least {least}"
        looked = "end.time", *_fields(scene, "diameter", "velocity", "shape", "tilt")
        yield _wrong("output.every", d.output_every_of(scene.particle), "ns", text, *looked)


def _hardness(where: str, particle: Particle, material: Material | None) -> Iterator[Problem]:
    """Check that the strength law of the metal can give the hardness or the yield strength of the powder."""
    field = "yield_strength" if particle.hardness is None else "hardness"
    if particle.hardness is not None and particle.yield_strength is not None:
        yield (f"{where}.hardness", f"{where}.yield_strength"), f"{where}: give only one of hardness and yield_strength"
    elif material is not None:
        try:
            material.initial_strain(particle.hardness, particle.yield_strength)
        except ValueError as error:
            value = text_of(dict(particle)[field], "HV" if field == "hardness" else "MPa")
            yield (f"{where}.{field}", f"{where}.material"), f"{where}.{field} = {value}: {error}"


def _pores(where: str, particle: Particle, spacing: float) -> Iterator[Problem]:
    """Check that the pores of a particle fit into it, and that points resolve them."""
    looked = (*(f"{where}.{name}" for name in (*_EXTENT, "pore_seed")), "preset", "resolution.spacing")
    try:
        pores = particle.pores()
    except ValueError as error:
        yield (f"{where}.porosity", f"{where}.pore_diameter", *looked), f"{where}.porosity: {error}"
        return
    if pores is not None and pores.diameter < _CELLS_OF_PORE * spacing:
        finer = _um(pores.diameter / _CELLS_OF_PORE)
        text = f"too small for points {_um(spacing)} apart: enlarge them, or set resolution.spacing to at most {finer}"
        yield _wrong(f"{where}.pore_diameter", pores.diameter, "um", text, f"{where}.porosity", *looked)


def _core(d: Derived, where: str, particle: Particle) -> Iterator[Problem]:
    """Check that points resolve the core and the shell of a particle, whose materials are known."""
    core = d.core_of(particle)
    assert core is not None
    assert particle.core is not None
    key = f"{where}.core.{'diameter' if particle.core.share is None else 'share'}"
    size = core.share ** (1.0 / 3.0) * particle.diameter
    looked = (key, *(f"{where}.{name}" for name in _EXTENT), "preset", "resolution.spacing", "resolution.engine")
    if (wall := 0.5 * (particle.diameter - size)) <= 0.0:
        text = f"a core of {_um(size)} leaves no shell in a particle of {_um(particle.diameter)}: give a smaller core"
        yield looked, f"{key}: {text}"
    elif (least := min(wall, size / _CELLS_OF_PORE)) < d.spacing:
        part = f"core of {_um(size)}" if least < wall else f"shell of {_um(wall)}"
        text = f"points {_um(d.spacing)} apart do not resolve a {part}: set resolution.spacing to at most {_um(least)}"
        yield looked, f"{key}: {text}"
    if particle.shape == "hollow_sphere":
        yield (f"{where}.core", f"{where}.shape"), f'{where}.core: a particle with shape = "hollow_sphere" has no core'
    if d.scene.resolution.engine == "machdyn":
        yield looked, f"{where}.core: engine machdyn computes particles of one material: use enriched or compiled"


def _fields(scene: SceneData, *names: str) -> tuple[str, ...]:
    return tuple(f"{label}.{name}" for label in scene.labels for name in names)


def _size(particle: Particle) -> str:
    return f"a particle of {_um(particle.width)}"


def _room(d: Derived) -> Iterator[Problem]:
    """Check that the target is large enough for each particle and its crater."""
    scene, substrate = d.scene, d.scene.substrate
    across = [(p.width + 2 * p.diameter, p) for p in scene.particles]
    deep = [(2 * p.diameter, p) for p in scene.particles]
    for name, extent, needs in (("diameter", substrate.diameter, across), ("height", substrate.height, deep)):
        least, particle = max(needs, key=lambda need: need[0])
        if extent < least * (1 - 1e-9):
            text = f"too small for {_size(particle)} and its crater; at least {_um(least)} is needed"
            yield _wrong(f"substrate.{name}", extent, "um", text, *_fields(scene, *_EXTENT))
    widest = max(scene.particles, key=lambda p: p.width)
    least = _LEAST_WINDOW * widest.width
    if substrate.window is not None and substrate.window < least * (1 - 1e-9):
        needed = f"at least {_um(least)} is needed, twice the diameter is recommended"
        text = f"smaller than the area that {_size(widest)} covers: {needed}"
        yield _wrong("substrate.window", substrate.window, "um", text, *_fields(scene, *_EXTENT))
    for where, particle in zip(scene.labels, scene.particles, strict=True):
        D, gap, away = particle.diameter, d.gap_of(particle), math.hypot(*particle.offset)
        placed = [f"{where}.{name}" for name in (*_EXTENT, "offset")]
        room = (substrate.diameter - D - particle.width) / 2
        if away and away > room:
            reach = f"reach the target's edge; at most {_um(max(room, 0.0))} is possible"
            text = f"{where}.offset: at {_um(away)} from the axis, {_size(particle)} and its crater {reach}"
            yield (*placed, "substrate.diameter"), text
        if gap > D:
            text = f"{where}.gap: larger than the diameter of {_size(particle)}: give a smaller gap"
            yield (f"{where}.gap", f"{where}.diameter"), text
        drift = gap * math.tan(particle.angle)  # along x during the flight over the gap
        landing = math.hypot(particle.offset[0] + drift, particle.offset[1])
        if away <= room < landing:
            moves = (
                f"at {math.degrees(particle.angle):.3g} degrees the particle moves {_um(drift)} sideways over the gap"
            )
            lands = f"lands {_um(landing)} from the axis, outside the target; at most {_um(max(room, 0.0))} is possible"
            text = f"{moves}, and {lands}: give a smaller gap or a wider target"
            yield _wrong(f"{where}.gap", gap, "um", text, *placed, f"{where}.angle", "substrate.diameter")
        flight, limit = gap / (particle.velocity * math.cos(particle.angle)), scene.end.time
        if limit is not None and flight >= limit:
            over = f"the gap of {_um(gap)}, which takes {units.rounded(flight, 'ns')}"
            text = f"shorter than the flight over {over}: {where} would not reach the target; give a longer time or a smaller gap"
            yield _wrong("end.time", limit, "ns", text, f"{where}.gap", f"{where}.velocity", f"{where}.angle")


def _surface(d: Derived) -> Iterator[Problem]:
    """Check that a mesh can represent the slopes and the heights of the surface, and that its elements resolve them."""
    body, size = d.scene.substrate, d.element_size
    coarse, coarseness = _CELLS_OF_SHAPE * size, f"not resolved by elements of {_um(size)}"
    if body.roughness > 0.0:
        steepest = body.roughness / STEEPEST
        if body.roughness_length < max(steepest, coarse) * (1 - 1e-9):
            why = "steeper than a mesh can represent" if steepest > coarse else coarseness
            text = f"the surface is {why}: give at least {_um(max(steepest, coarse))}, or a lower roughness"
            yield _wrong("substrate.roughness_length", body.roughness_length, "um", text, "substrate.roughness")
        if body.roughness > _DEEPEST * body.height:
            text = f"too rough for a target of {_um(body.height)}: give at most a twentieth of its height"
            yield _wrong("substrate.roughness", body.roughness, "um", text, "substrate.height")
    problems = list(_flanks(body, coarse, coarseness))
    yield from problems
    if problems:
        return
    shapes = [f"substrate.{name}" for name in ("groove", "step", "slope", "height_map") if dict(body)[name] is not None]
    try:
        ground = ground_of(body, size)
    except ColdsprayError as error:
        yield ("substrate.height_map",), f"substrate.height_map: {error}"
        return
    if ground is None:
        return
    low, high, slope = ground.extremes(body.diameter, size)
    if slope > 1.05 * math.tan(STEEPEST_FLANK):  # of the sum; `_flanks` has checked each angle
        most = f"{math.degrees(STEEPEST_FLANK):.3g} degrees"
        text = f"the surface is as steep as {math.degrees(math.atan(slope)):.3g} degrees, a mesh can represent {most}: give smaller"
        yield (*(f"{shape}.angle" for shape in shapes), *shapes), f"{' with '.join(shapes)}: {text} angles or heights"
    if max(-low, high) > _HIGHEST * body.height:
        reach = f"the surface reaches from {_um(low)} to {_um(high)}"
        most = f"at most {_HIGHEST:g} of substrate.height = {text_of(body.height, 'um')} is possible"
        text = f"{' with '.join(shapes)}: {reach}; {most}: give smaller heights, or a higher substrate"
        yield (*shapes, "substrate.height"), text


def _layers(d: Derived) -> Iterator[Problem]:
    """Check that elements fit into each layer and into the substrate below, and that the layers are flat."""
    body, size = d.scene.substrate, d.element_size
    for k, layer in enumerate(body.layer, 1):
        if layer.thickness < size * (1 - 1e-9):
            text = f"thinner than an element: give at least {_um(size)}, or a smaller resolution.element_size"
            yield _wrong(f"substrate.layer[{k}].thickness", layer.thickness, "um", text, "resolution.element_size")
    thick = sum(layer.thickness for layer in body.layer)
    if body.layer and body.height - thick < size:
        text = f"its layers are {_um(thick)} thick, and an element of {_um(size)} must fit below: increase it"
        yield _wrong("substrate.height", body.height, "um", text, "substrate.layer")
    shaped = [name for name in ("roughness", "groove", "step", "slope", "height_map") if dict(body)[name]]
    if body.layer and shaped:
        field = f"substrate.{shaped[0]}"
        yield ("substrate.layer", field), f"{field}: layers need a flat surface: remove {field} or substrate.layer"


def _flanks(body: Substrate, coarse: float, coarseness: str) -> Iterator[Problem]:
    """Check the angle of each straight shape, and the width of a groove. coarse: least width (m) that the elements resolve; coarseness:
    text for a narrower groove."""
    for name, shape in (("groove", body.groove), ("step", body.step), ("slope", body.slope)):
        if shape is not None and shape.angle > STEEPEST_FLANK * (1 + 1e-9):
            text = f"steeper than a mesh can represent: give at most {math.degrees(STEEPEST_FLANK):.3g} deg"
            yield _wrong(f"substrate.{name}.angle", shape.angle, "deg", text)
    if (groove := body.groove) is not None:
        flanks = 2.0 * groove.depth / math.tan(groove.angle)
        if groove.width < max(flanks, coarse) * (1 - 1e-9):
            angle = f"{math.degrees(groove.angle):.3g} degrees"
            why = f"its flanks of {angle} need {_um(flanks)}" if flanks > coarse else coarseness
            text = f"{why}: give at least {_um(max(flanks, coarse))}, or a smaller depth or resolution.element_size"
            yield _wrong("substrate.groove.width", groove.width, "um", text, "resolution.element_size")


def _resolution(d: Derived) -> Iterator[Problem]:
    """Check that points and elements are fine enough for the smallest particle, and that the machine has enough memory."""
    scene = d.scene
    smallest = min(scene.particles, key=lambda p: p.diameter)
    flattest = min(scene.particles, key=lambda p: p.form.thinnest)
    thinnest, spacing = flattest.form.thinnest, text_of(d.spacing, "um")
    needs = (*_fields(scene, "diameter"), "preset", "resolution.spacing")
    given = f"resolution.spacing = {spacing}:"
    if scene.resolution.spacing is None:
        largest = max(scene.particles, key=lambda p: p.volume)
        given = f'preset = "{scene.preset}": with {_size(largest)} its finest spacing is {spacing}, which'
    if d.points_of(smallest) < estimates.LEAST_POINTS:
        widest = estimates.spacing(smallest.volume, estimates.LEAST_POINTS)
        text = f"gives {_size(smallest)} {d.points_of(smallest)} points; at least {estimates.LEAST_POINTS} are needed"
        finer = f"set resolution.spacing to at most {_um(widest)}, or leave the smallest particles out"
        yield needs, f"{given} {text}: {finer}"
    elif thinnest < estimates.LEAST_LAYERS * d.spacing:
        text = f"is too coarse for {_um(thinnest)}, the thinnest part of this {flattest.shape}"
        finer = f"set resolution.spacing to at most {_um(thinnest / estimates.LEAST_LAYERS)}"
        yield (*needs, *_fields(scene, "shape")), f"{given} {text}: {finer}"
    coarsest = smallest.diameter / 4
    for field, requested in (("resolution", scene.resolution.element_size), ("splat", scene.splat.element_size)):
        if requested is not None and requested > coarsest:
            feature = "crater" if field == "resolution" else "splat"
            text = f"too coarse for the {feature} of {_size(smallest)}; give at most {_um(coarsest)}"
            yield _wrong(f"{field}.element_size", requested, "um", text, *_fields(scene, "diameter"))
    # during the last impact all earlier splats are elements
    splats = sum(map(d.splat_elements_of, scene.particles[:-1]))
    memory, there = estimates.memory(d.points, d.elements + splats), estimates.machine_memory()
    if memory > there:
        joined = f", {splats:.3g} of them in {len(scene.particles) - 1} splats," if splats else ""
        offsets = _fields(scene, "offset") if len(scene.particles) > 1 else ()
        sizes = ("resolution.element_size", "splat.element_size", "substrate.diameter", "substrate.height")
        sought = f"{d.points:.3g} points and {d.elements + splats:.3g} elements{joined}"
        text = f"{sought} need about {memory / 1e9:.3g} GB of memory, but this machine has {there / 1e9:.3g} GB"
        give = "give a larger spacing and element_size, or a coarser preset"
        yield (*needs, *offsets, *sizes), f"resolution: {text}; {give}"


def _adhesion(d: Derived, catalogue: Mapping[str, Material]) -> Iterator[Problem]:
    """Check the table [adhesion], and that the materials have the data for its criterion."""
    try:
        law = d.adhesion_law
    except SceneError as error:
        for problem in error.problems:
            field = f"adhesion.{problem.split()[0]}"
            yield (field, "adhesion.kind", "adhesion.criterion"), f"adhesion.{problem}"
        return
    scene = d.scene
    known = [catalogue[name] for name in dict.fromkeys(p.material for p in scene.particles) if name in catalogue]
    without = ", ".join(metal.name for metal in known if metal.sigma_TS is None and not metal.is_ceramic)
    if scene.adhesion.kind is None and law.kind == "none" and len(scene.particles) > 1 and (without or d.is_on_polymer):
        why = f"the critical velocity of {without} is not known (no sigma_TS)"
        if d.is_on_polymer:
            why = f"no bond of metals forms on {scene.substrate.materials[0]}, a polymer"
        give = 'give kind = "cohesive" with strength and energy, "tied", or "none" for no adhesion'
        yield ("adhesion.kind", "particle"), f"adhesion: several particles need a law of adhesion, and {why}: {give}"
    for pair in law.pairs:
        if unknown := [name for name in pair.metals if name not in catalogue]:
            yield ("adhesion.pair",), f"adhesion.pair: {materials.unknown(unknown[0], catalogue)}"
    for each in (law, *(law.between(*pair.metals) for pair in law.pairs)):
        yield from _bond_energy(d, each, catalogue)
    if law.criterion == "exposure":
        for name in sorted(
            {*scene.substrate.materials, *(name for p in scene.particles for name in p.materials)} & set(catalogue)
        ):
            try:
                oxide_film(catalogue[name], catalogue[name])
            except ColdsprayError as error:
                yield ("adhesion.criterion",), f'adhesion.criterion = "exposure": {error}'
    if law.criterion != "velocity" or law.kind == "none":
        return
    hits = {p.material: (label, p.temperature) for label, p in zip(scene.labels, scene.particles, strict=True)}
    for name, (label, temperature) in hits.items():
        try:
            if name in catalogue and not catalogue[name].is_ceramic:
                critical_velocity(catalogue[name], temperature)
            elif name in catalogue and any(catalogue[name].name in pair.metals for pair in law.pairs):
                raise ColdsprayError(f"{name} is a ceramic, and has no critical velocity: choose another criterion")
        except ColdsprayError as error:
            yield ("adhesion.criterion", f"{label}.material"), f'adhesion.criterion = "velocity": {error}'


def _bond_energy(d: Derived, law: Adhesion, catalogue: Mapping[str, Material]) -> Iterator[Problem]:
    """Check that a bond's fracture energy is at least the energy that its springs store at its strength (`contact.bond.Bond`)."""
    names = [*d.scene.substrate.materials, *(name for particle in d.scene.particles for name in particle.materials)]
    metals = [catalogue[name] for name in names if name in catalogue]
    if law.kind != "cohesive" or not metals:
        return
    stiffness = PARTICLE_BOND_STIFFNESS * min(metal.K for metal in metals) / d.spacing
    directions = {"": (law.strength, law.energy), "shear_": (law.shear_strength, law.shear_energy)}
    for prefix, (strength, energy) in directions.items():
        strength, energy = strength or law.strength, law.energy if energy is None else energy
        if strength is None or not energy or (prefix and law.shear_strength is None and law.shear_energy is None):
            continue
        least = strength**2 / (2.0 * stiffness)
        if energy < least:
            stored = f"the springs of a bond store {least:.3g} J/m2 at its strength of {text_of(strength, 'MPa')}"
            give = "increase it, set 0 (brittle bond), reduce the strength, or use a finer preset"
            looked = f"adhesion.{prefix}strength", "resolution.spacing", "preset"
            yield _wrong(f"adhesion.{prefix}energy", energy, "J/m2", f"too small: {stored}: {give}", *looked)
