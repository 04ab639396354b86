"""Effective properties of a coating from its run: choice of the block, its stiffness and conductivities, and their errors."""

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..errors import StoreError
from ..files.result import Result
from ..geometry.tetrahedra import volumes
from ..measures import PROPERTIES
from ..physics.materials import Material
from ..plan.model import Plan
from ..plan.record import read_plan
from ..studies.coating import COLUMN, SeedError, disc_radius, read
from ..studies.coating_seeds import seed_error
from ..studies.splats import Columns, Splats
from .block import Block, extract_block
from .homogenise import Problem, conducting, elastic

# Conductance of facets that touch through their oxide films, greatest and least, W/(m2 K): two interfaces of metal and oxide in series,
# each from 1.1 GW/(m2 K), within 40 % of the physical maximum (Wilson, Apgar, Hsieh, Martin & Cahill (2015), Phys. Rev. B 91,
# 115414), to 30 MW/(m2 K) (Monachon, Weber & Dames (2016), Annu. Rev. Mater. Res. 46, 433; second-hand). The film itself, some nm of
# oxide of 1 W/mK and more, resists less; so does the constriction at surfaces that have flowed into each other.
CONDUCTANCE = (5.5e8, 1.5e7)
# The same for electricity: contact or insulation. By tunnelling, a film of 1 nm has some 1e-12 Ohm m2, comparable to a splat of 10 um;
# a film of 3 nm has 1e-8 (Holm (1967), Electric Contacts, 4th ed.; second-hand). Values over the conductance of an element:
CONTACT, INSULATED = 1e3, 1e-6
INSULATOR = 1e-6  # electrical conductivity of a ceramic over that of a metal of equal k
LORENZ = 2.44e-8  # W Ohm/K2: law of Wiedemann and Franz, Sommerfeld's value
ROOM = 300.0  # K
LEAST_SPLATS, FEW_SPLATS = 2.0, 30.0  # splats in a block: with fewer the block is refused, or a warning is given
GROUND, TOP = 0.99, 0.1  # quantiles of the heights of substrate and coating between which a block lies


@dataclass(frozen=True)
class Bracket:
    """One property: the value of the bulk metal, and the values of the block under each condition, SI unit. static: None if a part of
    the block is loose; the lower bound is then zero. error: standard error of the mixed value, from the four quarters of the block;
    size: mixed value of the block minus the mean of the quarters; both None for conductivities, or if the quarters are too small."""

    unit: str
    bulk: float
    kinematic: float
    mixed: float
    static: float | None
    error: float | None = None
    size: float | None = None


@dataclass(frozen=True)
class Properties:
    """Effective properties of a block of a cold coating.

    side, height (m): dimensions of the block; splats: number of splats that fill its volume; solid: fraction of its volume that is
    metal; open_share: share of its vertical columns in which metal ends below the top of the block; bonded: fraction of the joint area
    that is bonded; gap: volume in joints, which counts as metal, divided by the volume of the block; stiffness: 6x6 matrix (Pa) in
    Voigt's order (xx yy zz yz xz xy) for each condition; that of "static" is None where `Bracket` has None; values: bracket of each
    property; warnings: texts. Where surfaces only touch, stiffness and moduli are those of the block while it is pressed, and
    under keys with "_stretched" those while it is stretched (`homogenise.elastic`).
    """

    side_m: float
    height_m: float
    elements: int
    splats: float
    solid: float
    open_share: float
    bonded: float
    gap: float
    stiffness: dict[str, list[list[float]] | None]
    values: dict[str, Bracket]
    warnings: list[str]


def properties(
    result: Result, side: float | None = None, heights: tuple[float, float] | None = None, conductance: float | None = None
) -> Properties:  # fmt: skip
    """Effective properties of the cold coating of a run.

    side (m): edge of the block in the plane of the surface (default: the square in the disc that `coating` measures); heights (m):
    lowest and highest z of the block (default: quantile GROUND of heights of the substrate, TOP of heights of the coating); conductance
    (W/(m2 K)): of facets that touch (default: CONDUCTANCE). Raises StoreError without a cold coating, or for too small a block.
    """
    _, splats, metals = cold_coating(result)
    low, high, open_share = corners(splats, side, heights)
    whole, half = extract_sample(splats, metals, low, high), 0.5 * (high - low) * [1.0, 1.0, 0.0]
    sides = [half * [i, j, 0.0] for i in (0.0, 1.0) for j in (0.0, 1.0)] if whole.splats >= 4.0 * LEAST_SPLATS else []
    quarters = [extract_sample(splats, metals, low + aside, high - half + aside) for aside in sides]
    return _measured(whole, quarters, CONDUCTANCE if conductance is None else (conductance, conductance), open_share)


def cold_coating(result: Result) -> tuple[Plan, Splats, list[Material]]:
    """The plan of a run, its cold coating and the metal of each body. Raises StoreError if the run has no cold coating."""
    splats, folder = read(result), result.directory
    if not splats.is_cold:
        raise StoreError(f'{folder} has no cold coating: add at = "cold" under [end], and run the scene again')
    if not {"bonded", "touching"} <= set(splats.mesh.data):
        remedy = "run the scene again with this version"
        raise StoreError(f"{folder}: cold.vtkhdf does not say which nodes are bonded: {remedy}")
    plan = read_plan(folder)
    ground = plan.target.materials
    made = list(enumerate(splats.impact))[len(ground) :]
    return plan, splats, [*ground, *(plan.impacts[i - 1].materials[-1 if b in splats.cores else 0] for b, i in made)]


def of_seeds(several: Sequence[Properties]) -> dict[str, SeedError]:
    """The error of each mixed property from runs with different seeds; no errors for a single run."""
    if len(several) < 2:
        return {}
    shared = [key for key in several[0].values if all(key in each.values for each in several)]
    return {key: seed_error([each.values[key].mixed for each in several]) for key in shared}


@dataclass(frozen=True)
class Sample:
    """A block, the metals of all bodies, and the number of splats that fill its volume."""

    block: Block
    metals: list[Material]
    splats: float

    def of_each(self, value: Callable[[Material], float]) -> NDArray:
        """The values (m,) of a metal's property for each tetrahedron. value: function that gives the property of a metal."""
        return np.array([value(metal) for metal in self.metals])[self.block.body]

    def mean(self, value: Callable[[Material], float]) -> float:
        """Mean of a metal's property over the volume of the metal."""
        return float(np.average(self.of_each(value), weights=volumes(self.block.points, self.block.tets)))


def corners(splats: Splats, side: float | None, heights: tuple[float, float] | None) -> tuple[NDArray, NDArray, float]:
    """Lowest and highest corner (3,) m of the requested block, and the share of its vertical columns in which metal ends below the
    block's top. Raises StoreError if the block reaches into the substrate, lies above the coating, or is narrower than a column."""
    half = disc_radius(splats) / np.sqrt(2.0) if side is None else 0.5 * side
    columns = Columns(splats, (0.0, 0.0), np.sqrt(2.0) * half, 2.0 * COLUMN * splats.element_size)
    inside = np.maximum(abs(columns.x), abs(columns.y)) <= half
    if not inside.any():
        raise StoreError(f"--side: {2e6 * half:.3g} um is smaller than an element of the coating: give a larger value")
    ground, top = columns.highest(columns.substrate)[inside], columns.highest(columns.matter)[inside]
    least = float(np.quantile(ground, GROUND))
    bottom, roof = (least, max(float(np.quantile(top, TOP)), least)) if heights is None else heights
    if bottom < least or bottom >= min(roof, top.max()):
        raise StoreError(
            f"--heights: give two ascending heights; the lower must be above the substrate ({1e6 * least:.1f} um) and below the top of"
            f" the coating ({1e6 * top.max():.1f} um)"
        )
    return np.array([-half, -half, bottom]), np.array([half, half, roof]), float((top < roof).mean())


def extract_sample(
    splats: Splats, metals: list[Material], low: NDArray, high: NDArray, law: NDArray | None = None, first: int = 1
) -> Sample:
    """The block between two corners (3,) m. law (n,k): values of the bond of each node; first: least impact number in the block, 0
    (substrate) or 1. Raises StoreError if a block without the substrate has room for fewer than LEAST_SPLATS splats."""
    mesh, impact = splats.mesh, splats.impact[splats.body]
    own = impact >= first
    of_splat = np.abs(volumes(mesh.points, mesh.cells[impact > 0])).sum() / max(
        len(np.unique(splats.impact[splats.impact > 0])), 1
    )
    count = float(np.prod(high - low) / of_splat)
    if first and count < LEAST_SPLATS:
        edges = " x ".join(f"{1e6 * edge:.0f}" for edge in high - low)
        raise StoreError(
            f"a block of {edges} um contains {count:.1f} splats, but {LEAST_SPLATS:.0f} are needed: choose a larger block (--side,"
            " --heights), or spray more particles"
        )
    marks = [mesh.data["bonded"] > 0, mesh.data["touching"] > 0, *(() if law is None else law.T)]
    at_nodes = np.stack(marks, axis=1).astype(float)
    block = extract_block(mesh.points, mesh.cells[own], splats.body[own], at_nodes, low, high, splats.element_size)
    return Sample(block, metals, count)


def _measured(whole: Sample, quarters: list[Sample], conductance: tuple[float, float], open_share: float) -> Properties:
    """The properties of a block, with the error from its quarters."""
    block, joints = whole.block, whole.block.joints
    bulk = {"E": whole.mean(lambda metal: metal.E), "G": whole.mean(lambda metal: metal.G)}
    stiffness: dict[str, list[list[float]] | None] = {}
    values: dict[str, Bracket] = {}
    for state, strain in (("", -1.0), ("_stretched", 1.0))[: 2 - joints.bonded.all()]:
        problem = _elastic(whole, strain)
        kinematic, mixed, static = problem.kinematic(), problem.mixed(), problem.static()
        parts = [moduli(_elastic(quarter, strain).mixed()) for quarter in quarters]
        most, least = moduli(kinematic), {} if static is None else moduli(static)
        for name, value in moduli(mixed).items():
            several = np.array([part[name] for part in parts])
            error = float(several.std(ddof=1)) / math.sqrt(len(parts)) if parts else None
            size = value - float(several.mean()) if parts else None
            values[name + state] = Bracket("Pa", bulk[name[0]], most[name], value, least.get(name), error, size)
        for condition, C in (("kinematic", kinematic), ("mixed", mixed), ("static", static)):
            stiffness[condition + state] = None if C is None else C.tolist()
    area, edges = float(joints.area.sum()), (block.high - block.low).tolist()
    few = f"the block contains {whole.splats:.0f} splats, too few for a reliable error: give runs with other seeds"
    return Properties(
        side_m=edges[0], height_m=edges[2], elements=len(block.tets), splats=whole.splats,
        solid=block.solid, open_share=open_share, bonded=float(joints.area @ joints.bonded) / area if area else 0.0,
        gap=float(joints.area @ abs(joints.gap)) / block.volume, stiffness=stiffness,
        values=values | _conduction(whole, conductance), warnings=[few] if whole.splats < FEW_SPLATS else [],
    )  # fmt: skip


def moduli(stiffness: NDArray) -> dict[str, float]:
    """Young's and shear moduli, Pa, of a stiffness (6,6) Pa: in the plane (from the mean compliance of x and y) and across it."""
    least = 1e-12 * abs(stiffness).max() * np.eye(6)  # so that an inverse exists if parts are loose
    S = np.linalg.inv(stiffness + least).diagonal().tolist()
    return {
        "E_in_plane": 2.0 / (S[0] + S[1]), "E_across": 1.0 / S[2],
        "G_in_plane": 1.0 / S[5], "G_across": 2.0 / (S[3] + S[4]),
    }  # fmt: skip


def _elastic(sample: Sample, strain: float) -> Problem:
    return elastic(sample.block, sample.of_each(lambda m: m.K - 2.0 / 3.0 * m.G), sample.of_each(lambda m: m.G), strain)


def _conduction(sample: Sample, conductance: tuple[float, float]) -> dict[str, Bracket]:
    """Thermal conductivities, W/(m K), and electrical conductivities, S/m. conductance: greatest and least thermal conductance of
    touching surfaces, W/(m2 K). The electrical conductivity of the bulk metal follows from the law of Wiedemann and Franz; a ceramic is
    an insulator."""
    block, values = sample.block, {}

    def electric_k(m: Material) -> float:  # the part of k that electrons conduct
        return m.k_at(ROOM) * (INSULATOR if m.is_ceramic or m.is_polymer else 1.0)

    mean = sample.mean(lambda m: m.k_at(ROOM))
    of_element = mean / float(np.cbrt(block.volume / len(block.tets)))
    electric = (CONTACT * of_element, INSULATED * of_element)
    for name, factor, conductances, k_of in (
        ("k", 1.0, conductance, lambda m: m.k_at(ROOM)), ("sigma", 1.0 / (LORENZ * ROOM), electric, electric_k),
    ):  # fmt: skip
        bulk, mean = sample.of_each(k_of), sample.mean(k_of)
        for end, h in zip(("", "_at_least"), conductances[: 2 - block.joints.bonded.all()], strict=False):
            problem = conducting(block, bulk, h)
            kinematic, mixed, static = problem.kinematic(), problem.mixed(), problem.static()
            for direction, axes in (("in_plane", [0, 1]), ("across", [2])):
                most, between = (factor * float(C.diagonal()[axes].mean()) for C in (kinematic, mixed))
                lowest = None if static is None else factor * float(static.diagonal()[axes].mean())
                values[f"{name}_{direction}{end}"] = Bracket(PROPERTIES[name][1], factor * mean, most, between, lowest)
    return values
