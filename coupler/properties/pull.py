"""Tensile test of a block of a coating: its strength across, at the substrate and in the plane, with the bonds of the impacts.

Two opposite faces move apart without friction; all other faces are free. The bodies are those of the run, elastic-plastic with the
strain and temperature of each element, at the rates of a tensile test; bonds soften and break by their law (`contact.bond`); surfaces
that only touch carry only pressure. The motion is a dynamic relaxation with its own masses (`fe.relaxed`), whose damping acts on the
difference from a uniform stretch and contraction. The motion is nearly static, and its time has no physical meaning.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import meshio
import numpy as np
from numpy.typing import NDArray

from ..contact.bond import Bond, penalty
from ..core.records import take
from ..errors import SolverError, StoreError
from ..fe.explicit import Target
from ..fe.mesh import prepare_ordered
from ..fe.relaxed import Relaxation
from ..fe.stability import HighestFrequency
from ..files.outputs import replacing
from ..files.result import Result
from ..geometry.triangles import area_vectors
from ..physics.constitutive import law_record, yield_stresses
from ..report.figure import blank, save
from ..studies.table import write_rows
from .block import Block
from .measure import cold_coating, corners, extract_sample

# Strength times thickness of the film over the central value: range of Ni, Cu, Al (docs/theory/bonds.md)
FILM = (1.0, 0.4, 2.0)
AXES = {"across": 2, "in_plane": 0, "adhesion": 2}  # direction of a pull -> axis
STRAIN = 2e-6  # strain of a step: a wave crosses a block in less than 100 steps
MOST = 0.03  # strain at which the test ends if the block has not parted
PARTED = 0.1  # of the greatest stress: a block that bears less has parted
EVERY = 50  # steps for each row of the table
DAMPING = 0.02  # over the critical damping of a step: a vibration with a period of some 300 steps is critically damped
MASSES = 1e-10  # s: time step of each element with the masses of the relaxation
RATE_TIME = 1.0  # s, time constant of the average of strain rates: the law then uses low rates, as in a tensile test
NAMES = ("pull.csv", "pull.png", "pull_across.vtu", "pull_in_plane.vtu", "pull_adhesion.vtu")
WORDS = {"across": "across the coating", "in_plane": "in the plane", "adhesion": "across, with the substrate"}


@dataclass(frozen=True)
class Pull:
    """Result of a tensile test of a block, until it parts or has the strain MOST, or a tetrahedron inverts after the peak.

    film: strength times thickness of the oxide film, over the central value of this product, None if bonds of the run never break;
    strength: greatest force over the area of the block, pores included; strain: strain at this force; has_parted: whether the block has
    parted; at_substrate: of the bonded area that has lost more than half its strength, the share at the substrate; brittle: share of
    the bonds in the work of bonds and plastic flow; energy_error: largest error of the energy balance over all work; rows: stress and
    energies against strain; opened: points, facets of joints, "damage" (1: broken) and "was_bonded" of each facet.
    """

    direction: str
    film: float | None
    strength_Pa: float
    strain: float
    has_parted: bool
    at_substrate: float
    brittle: float
    energy_error: float
    rows: list[dict[str, float]] = field(repr=False)
    opened: tuple[NDArray, NDArray, dict[str, NDArray]] = field(repr=False)


def strengths(
    result: Result, side: float | None = None, heights: tuple[float, float] | None = None, films: tuple[float, ...] = FILM,
    directions: Sequence[str] = tuple(AXES),
) -> list[Pull]:  # fmt: skip
    """Pull the block of a run (`measure.properties`) in each direction (of AXES), with each film (`Pull.film`). Direction "adhesion":
    across a block that includes the substrate, down to two elements below the lowest splat. The energy of a bond is proportional to
    `film`. Effects of the film on the impacts are not included. Tied bonds never break: the strength is then the limit of plastic
    flow between the pores. Raises StoreError, as `properties` or without bond strengths, and SolverError, as `pull`."""
    plan, splats, metals = cold_coating(result)
    films = films if plan.adhesion.criterion == "exposure" else (1.0,)
    data, law = splats.mesh.data, None
    if "bond_strength" in data:
        sound = data["bonded"][:, None]
        law = np.concatenate([data["bond_strength"] * sound, data["bond_energy"] * sound**2], axis=1)
    elif plan.adhesion.kind == "cohesive":
        raise StoreError(
            f"{result.directory}: cold.vtkhdf has no strength of bonds: run the scene again with this version"
        )
    laws = np.concatenate([law_record(metal, vars(plan.effects), RATE_TIME) for metal in metals])
    low, high, _ = corners(splats, side, heights)
    of_splats = splats.mesh.cells[splats.impact[splats.body] > 0]
    lowest, found = float(splats.mesh.points[of_splats, 2].min()) - 2.0 * splats.element_size, []
    for direction in directions:
        first = 0 if direction == "adhesion" else 1  # smallest number of an impact in the block; 0: the substrate
        sample = extract_sample(splats, metals, low if first else np.array([*low[:2], lowest]), high, law, first)
        own = np.flatnonzero(splats.impact[splats.body] >= first)[sample.block.parent]
        hardening = data["eps_p"] - data.get("eps_recovered", 0.0)
        gradient = data.get("eps_gradient", np.zeros((len(hardening), 3)))
        eps_p, T, eta = (values[own].astype(float) for values in (hardening, data["T"], gradient))
        each, ground = films if law is not None else (None,), int(np.count_nonzero(splats.impact == 0))
        found += [pull(sample.block, laws, eps_p, T, eta, direction, film, ground) for film in each]
    return found


def pull(
    block: Block, laws: NDArray, eps_p: NDArray, T: NDArray, gradient: NDArray, direction: str, film: float | None = 1.0,
    ground: int = 1,
) -> Pull:  # fmt: skip
    """Pull a block along an axis. laws: LAW record of each body; eps_p, T (m,): hardening strain and temperature (K) of each element;
    gradient (m,3) 1/m: of the strain; ground: the first `ground` bodies are the substrate and its layers. Raises SolverError if a
    tetrahedron inverts before the peak."""
    machine, greatest = Machine(block, laws, eps_p, T, gradient, AXES[direction], film), 0.0
    rows = [machine.row()]
    while rows[-1]["strain"] < MOST and rows[-1]["stress_Pa"] >= PARTED * greatest:
        try:
            rows.append(machine.row())
        except SolverError:  # an element inverts, as in a neck: after the peak the strength is known
            if rows[-1]["stress_Pa"] >= greatest:
                raise
            break
        greatest = max(greatest, rows[-1]["stress_Pa"])
    t, bond, peak = machine.t, machine.bond, max(rows, key=lambda row: row["stress_Pa"])
    was_bonded = np.arange(len(bond)) < block.joints.bonded.sum()  # touching joints come after the bonded ones
    owner = np.zeros(len(t.nodes.x), int)
    owner[t.mesh.conn] = np.unique(block.body)[t.law_of][:, None]
    lost = bond.area * ((bond.damage > 0.5) & was_bonded)
    below = np.minimum(owner[bond.nodes], owner[bond.triangles[:, 0]]) < ground
    in_bonds, in_metal, work = (rows[-1][key] for key in ("bonds_J", "plastic_J", "work_J"))
    return Pull(
        direction, film, peak["stress_Pa"], peak["strain"], rows[-1]["stress_Pa"] < PARTED * greatest,
        float(lost @ below / max(lost.sum(), 1e-300)), in_bonds / max(in_bonds + in_metal, 1e-300),
        max(abs(row["work_J"] - row["stored_or_spent_J"]) for row in rows) / work, rows,
        (t.nodes.x, bond.triangles, {"damage": bond.damage, "was_bonded": was_bonded}),
    )  # fmt: skip


class Machine:
    """A block whose two faces normal to `axis` move apart. Arguments: as of `pull`. t, bond: bodies, and bonds between them; force N,
    work J: on the faces; damped J: energy that damping has dissipated; steps: number of steps so far."""

    def __init__(
        self, block: Block, laws: NDArray, eps_p: NDArray, T: NDArray, gradient: NDArray, axis: int, film: float | None
    ):  # fmt: skip
        middle, self.axis, self.length = 0.5 * (block.low + block.high), axis, float(block.high[axis] - block.low[axis])
        mesh, order, by_reach = prepare_ordered(block.points, block.tets, tuple(middle))
        bodies, law_of = np.unique(block.body[by_reach], return_inverse=True)
        self.t = t = Target(mesh, laws[bodies], T[by_reach], law_of, fixed=(), track_wave=False)
        e = t.elements
        e.eps_p[:], e.eps_gradient[:] = eps_p[by_reach], gradient[by_reach]
        e.sigma_y[:] = yield_stresses(t.laws, t.law_of, e.eps_p, e.T, e.eps_gradient)
        self.bond = _bonds(block, np.argsort(order), t, film)
        self.relaxation = r = Relaxation(t, np.inf, MASSES)
        r.weigh(HighestFrequency(len(mesh.points), len(mesh.conn)), MASSES)
        r.add_mass(0.25 * r.dt**2 * _turning(self.bond, mesh.points).springs().load(len(mesh.points)))
        self.area, self.away = block.volume / self.length, mesh.points - middle
        at = self.away[:, axis] / self.length
        self.lower, self.upper = np.flatnonzero(at < -0.5 + 1e-9), np.flatnonzero(at > 0.5 - 1e-9)
        self.drift = np.zeros_like(self.away)
        self.drift[:, axis] = STRAIN / r.dt * self.away[:, axis]
        t.nodes.v[:] = self.drift
        self.elastic, self.force, self.work, self.damped, self.steps = t.elastic(), 0.0, 0.0, 0.0, 0

    def row(self) -> dict[str, float]:
        """Make EVERY steps. Returns their mean stress (force over the area of the block), and the energies after them, J."""
        mean = sum(self.step() for _ in range(EVERY)) / EVERY
        t, elastic = self.t, self.t.elastic() - self.elastic
        kinetic = 0.5 * float(self.relaxation.mass @ (t.nodes.v**2).sum(axis=1))
        spent = elastic + t.balance.plastic + self.bond.work + kinetic + self.damped
        return {
            "strain": self.steps * STRAIN, "stress_Pa": mean / self.area, "work_J": self.work, "elastic_J": elastic,
            "plastic_J": t.balance.plastic, "bonds_J": self.bond.dissipated, "damped_J": self.damped, "stored_or_spent_J": spent,
        }  # fmt: skip

    def step(self) -> float:
        """Make one step. Returns the force on a face, N."""
        t, axis, mass, drift = self.t, self.axis, self.relaxation.mass[:, None], self.drift
        fit = (mass * self.away * t.nodes.v).sum(axis=0) / (mass * self.away**2).sum(axis=0)
        for side in {0, 1, 2} - {axis}:
            drift[:, side] = fit[side] * self.away[:, side]
        aside = t.nodes.v - drift
        for face in (self.lower, self.upper):
            t.nodes.total[face, axis] = 0.0
        t.nodes.v[:] = drift + (1.0 - DAMPING) / (1.0 + DAMPING) * aside
        self.relaxation.advance(DAMPING)
        self.bond.forces(t.nodes.x, t.f_ext)
        self.relaxation.finish()
        aside += t.nodes.v - drift
        # (1 + a) v' = (1 - a) v + dt f / m
        self.damped += 0.5 * DAMPING * float((mass * aside * (aside + 2.0 * drift)).sum())
        before, (low, high) = self.force, (t.nodes.total[face, axis].sum() for face in (self.lower, self.upper))
        self.force = 0.5 * float(low - high)
        self.work += 0.5 * (before + self.force) * STRAIN * self.length
        self.steps += 1
        return self.force


def _turning(bond: Bond, x: NDArray) -> Bond:
    """The bonds with new weights: upper bounds of the motion of the bonded point per unit motion of each corner of the facet. A corner
    turns the facet; this adds gap / height of the facet at this corner. Facets cut by the block's faces can be low. x (n,3) m."""
    corners = x[bond.triangles]
    opposite = np.linalg.norm(np.roll(corners, -1, axis=1) - np.roll(corners, 1, axis=1), axis=2)
    twice = 2.0 * np.linalg.norm(area_vectors(x, bond.triangles), axis=1)[:, None]
    return replace(bond, weights=abs(bond.weights) + abs(bond.gap)[:, None] * opposite / twice)


def _bonds(block: Block, node: NDArray, t: Target, film: float | None) -> Bond:
    """Bonds at the bonded joints of a block, then at the touching ones, which count as broken. node: new index of each node. film: as
    in `Pull`. Width of ligaments: 2 film energy / strength. Springs limit the strength as in `physics.adhesion.ligament_bonds`."""
    size = float(np.cbrt(6.0 * np.sqrt(2.0) * t.mesh.V0.mean()))  # edge of a regular tetrahedron
    stiffness, joints = penalty(float(t.laws["K"].min()), size), block.joints
    law: dict[str, NDArray] = {}
    for k, direction in enumerate(("", "shear_") if film is not None else ()):
        strength, energy = joints.law[joints.bonded][:, [k, 2 + k]].T
        tied = strength == 0.0  # to a layer or a core
        strength, energy = np.where(tied, np.inf, strength), np.where(tied, np.inf, energy)
        width = np.where(tied, 0.0, 2.0 * (film or 0.0) * energy / np.where(tied, 1.0, strength))
        strength = np.where(width > 0.0, np.minimum(strength, 0.999 * stiffness * width), strength)
        law |= {f"{direction}strength": strength, f"{direction}energy": np.where(tied, np.inf, 0.5 * strength * width)}

    def tie(of: NDArray, **law: Any) -> Bond:
        rows, x = take(joints, of), t.nodes.x
        return Bond.tie(node[rows.nodes], node[rows.triangles], x, x, rows.area, stiffness, **law)

    touching = tie(~joints.bonded, strength=1.0, energy=0.0)
    touching.damage[:] = 1.0
    return Bond.joined([tie(joints.bonded, **law), touching])


def write_pulls(folder: Path, pulls: list[Pull], about: str) -> None:
    """Write NAMES: stress and energies against strain, figure, joints at the end of pulls with film 1 or None. Raises StoreError."""
    rows = [{"direction": p.direction, "film": p.film, **row} for p in pulls for row in p.rows]
    write_rows(folder / NAMES[0], list(rows[0]), rows, about)
    figure = blank(5.0, 3.5, 160, "constrained")
    axes = figure.subplots()
    for p in pulls:
        is_central, colour = p.film in (None, 1.0), f"C{list(WORDS).index(p.direction)}"
        strain, stress = (np.array([row[key] for row in p.rows]) for key in ("strain", "stress_Pa"))
        label = f"{WORDS[p.direction]}: {p.strength_Pa * 1e-6:.0f} MPa" if is_central else None
        axes.plot(100.0 * strain, 1e-6 * stress, color=colour, linewidth=1.8 if is_central else 0.7, label=label)
        if is_central:
            x, facets, fields = p.opened
            with replacing(folder / f"pull_{p.direction}.vtu") as part:
                data = {name: [values.astype(float)] for name, values in fields.items()}
                meshio.Mesh(x, [("triangle", facets)], cell_data=data).write(part, file_format="vtu")
    axes.set(xlabel="strain (%)", ylabel="stress (MPa)", xlim=(0.0, None), ylim=(0.0, None))
    axes.legend(fontsize=8)
    save(figure, folder / NAMES[1])
