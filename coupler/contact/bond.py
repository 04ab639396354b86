"""Bonds between bodies of finite elements: nodes tied to facets by cohesive springs that soften, break and stay broken."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from typing import Annotated, Any

import numpy as np

from ..core.arrays import Links
from ..core.records import Rows, concatenate, new_rows, take
from ..errors import SolverError
from . import bond_kernels as k
from .surfaces import Interface, Surfaces

# bulk moduli per spacing: the bond is as stiff as a quarter of a layer of elements and reflects waves no more than a change of mesh
BOND_STIFFNESS = 4.0
# spacings: with a larger slip the bond can lie beside its triangle, and the contact resists its compression
MAX_SLIDE = 0.5


def penalty(bulk_modulus: float, spacing: float) -> float:
    """Stiffness of a bond, BOND_STIFFNESS K / h, Pa/m. K: softer bulk modulus, Pa; h: spacing of the tied nodes, m."""
    return BOND_STIFFNESS * bulk_modulus / spacing


@dataclass(eq=False)
class Bond:
    """Cohesive springs between nodes of one body and points on facets of another body.

    The traction is stiffness times opening up to the strength, then falls linearly until the fracture energy is dissipated: the
    envelope of Camanho & Davila (2002), NASA/TM-2002-211737, with a quadratic onset criterion and the linear mixed-mode law
    G_I/G_Ic + G_II/G_IIc = 1 at the end. Opening beyond the strength is permanent and dissipates; unloading has the initial
    stiffness. Damage never heals. The bond resists compression in full until it is broken or has slid by half a spacing
    (`release`); then the contact of the bodies resists it. A bond of infinite strength never breaks, one of zero energy breaks at
    the strength, and one of infinite energy flows at the strength.

    Arrays of n bonds: nodes (or points that are not nodes); triangles, weights: the point on a triangle to which each is bonded; gap
    (m): height of the node above the triangle at zero normal force; area (m2); stiffness (Pa/m); strength (n,2) Pa, energy (n,2) J/m2:
    normal, shear; rewelds: share of the strength that remains after slip under contact pressure; loose: mask, the contact resists their
    compression; damage, 0 to 1: lost share of the strength; opening (n,3) m: elastic opening; traction (n,2) Pa; slid (m): permanent
    slip; spent (J): dissipated energy; heated (J): part given to the bodies as heat. stored, dissipated: energies of all bonds, J.
    """

    nodes: Annotated[np.ndarray, Rows(dtype=np.int64, index_of="points")]
    triangles: Annotated[np.ndarray, Rows(3, dtype=np.int64, index_of="nodes")]
    weights: Annotated[np.ndarray, Rows(3)]
    gap: Annotated[np.ndarray, Rows()]
    area: Annotated[np.ndarray, Rows()]
    stiffness: Annotated[np.ndarray, Rows()]
    strength: Annotated[np.ndarray, Rows(2)]
    energy: Annotated[np.ndarray, Rows(2)]
    rewelds: Annotated[np.ndarray, Rows()]
    loose: Annotated[np.ndarray, Rows(dtype=bool)]
    damage: Annotated[np.ndarray, Rows()]
    opening: Annotated[np.ndarray, Rows(3)]
    traction: Annotated[np.ndarray, Rows(2)]
    slid: Annotated[np.ndarray, Rows()]
    spent: Annotated[np.ndarray, Rows()]
    heated: Annotated[np.ndarray, Rows()]
    stored: float = 0.0
    dissipated: float = 0.0

    def __post_init__(self) -> None:
        with np.errstate(divide="ignore"):
            self._inverses = 1.0 / self.strength, 1.0 / self.energy
        self._uncovered = np.full(len(self), -1.0)  # argument `depth` of `bond_kernels.bond_forces`: no contact
        self._moved = np.zeros(0, np.int64)  # rows whose node `reduce_overlap` moves to its new facet

    @classmethod
    def tie(
        cls, nodes: np.ndarray, triangles: np.ndarray, p: np.ndarray, x: np.ndarray, area: np.ndarray, stiffness: float,
        strength: float | np.ndarray = np.inf, energy: float | np.ndarray = np.inf,
        shear_strength: float | np.ndarray | None = None, shear_energy: float | np.ndarray | None = None,
        rewelds: float | np.ndarray = 0.0,
    ) -> "Bond":  # fmt: skip
        """Make bonds between the points p[nodes] and triangles (n,3) of nodes x (N,3) m. nodes (n,): indices in p (.,3) m. The bonds
        have no force in these positions. area (n,) m2: bonds of zero area are left out; stiffness (Pa/m): see `penalty`.

        strength (Pa), energy (J/m2): in the normal direction, one value or (n,); the shear values are equal to them by default.
        rewelds: as in `Bond`. Raises SolverError if strength <= 0, or if energy is not 0 and below that of the spring at its strength.
        """
        kept = area > 0.0
        nodes, triangles = np.asarray(nodes[kept], np.int64), np.ascontiguousarray(triangles[kept], np.int64)
        weights, gap = _foot(p[nodes], x[triangles])

        def columns(*values: float | np.ndarray) -> np.ndarray:
            return np.stack([np.broadcast_to(np.asarray(value, float), kept.shape)[kept] for value in values], axis=1)

        bond = new_rows(
            cls, len(nodes), nodes=nodes, triangles=triangles, weights=weights, gap=gap, area=area[kept],
            stiffness=np.full(len(nodes), float(stiffness)),
            strength=columns(strength, strength if shear_strength is None else shear_strength),
            energy=columns(energy, energy if shear_energy is None else shear_energy), rewelds=columns(rewelds)[:, 0],
        )  # fmt: skip
        _check(bond)
        return bond

    @classmethod
    def between(cls, where: Interface, surfaces: Surfaces, x: np.ndarray, stiffness: float, **law: Any) -> "Bond":
        """Bonds between the nodes and the facets of an interface. law: strength, energy and the other arguments of `tie`."""
        return cls.tie(where.nodes, surfaces.facets[where.facet], x, x, where.area, stiffness, **law)

    def __len__(self) -> int:
        return len(self.nodes)

    @property
    def broken(self) -> np.ndarray:
        """Mask (n,) of the bonds that carry neither tension nor shear."""
        return self.damage >= 1.0

    def forces(self, x: np.ndarray, f: np.ndarray, active: int | None = None) -> None:
        """Add the forces at positions x (N,3) m to f (N,3) N, and update the damage. active: number of active nodes (default: all);
        bonds between inactive nodes keep their state and add no forces."""
        self.forces_on(x, f, x, f, self._uncovered, len(x) if active is None else active)

    def forces_on(
        self, xp: np.ndarray, f_point: np.ndarray, x: np.ndarray, f: np.ndarray, depth: np.ndarray, active: int
    ) -> None:  # fmt: skip
        """As `forces`, for bonds whose points xp are not nodes: forces on the points are added to f_point. depth (n,) m:
        penetration of each point in its contact (`bond_kernels.bond_forces`)."""
        ties = k.Ties(
            self.nodes, self.triangles, self.weights, self.gap, self.area, self.stiffness, *self._inverses, self.rewelds,
            self.loose, self.damage, self.opening, self.traction, self.slid, self.spent,
        )  # fmt: skip
        self.stored, lost = k.bond_forces(xp, x, ties, depth, active, f_point, f)
        self.dissipated += lost

    def heat(self) -> np.ndarray:
        """Heat (n,) J of fracture since the last call."""
        heat, self.heated = self.spent - self.heated, self.spent.copy()
        return heat

    @property
    def work(self) -> float:
        """Sum of the stored and the dissipated energy of all bonds, J."""
        return self.stored + self.dissipated

    @property
    def resistance(self) -> np.ndarray:
        """Energy (n,) J that each bond can still absorb in tension; infinite for a bond that does not break."""
        with np.errstate(invalid="ignore"):
            return np.where(self.broken, 0.0, self.area * self.energy[:, 0] * self.soundness)

    @property
    def stored_by_each(self) -> np.ndarray:
        """Stored energy (n,) J of each bond."""
        return 0.5 * self.area * (self.traction**2).sum(axis=1) / self.stiffness

    @property
    def soundness(self) -> np.ndarray:
        """Remaining share (n,) of the fracture energy of each bond: the square of the remaining share of its strength."""
        return (1.0 - self.damage) ** 2

    def springs(self) -> Links:
        """The bonds as springs, also those that are broken."""
        return Links.of(self.nodes, self.triangles, self.weights, self.stiffness * self.area)

    def release(self) -> float:
        """Remove broken bonds, and make bonds with a slip above MAX_SLIDE loose: from now on the contact resists their compression.

        Returns the energy (J) that the compression of these bonds stored.
        """
        if len(self) == 0:
            return 0.0
        broken = self.broken
        far = self.slid > MAX_SLIDE * np.sqrt(self.area)
        released = (broken | far) & ~self.loose
        squeezed = np.minimum(self.traction[released, 0], 0.0)
        energy = float(np.sum(0.5 * self.area[released] * squeezed**2 / self.stiffness[released]))
        self.loose |= far
        self.stored -= energy
        if broken.any():
            self._keep(~broken)
        return energy

    def compression(self, x: np.ndarray, rows: np.ndarray) -> np.ndarray:
        """Compression (k,) m of the bonds `rows` (k,): how much closer than its `gap` each node is to its triangle. x (N,3) m."""
        return np.asarray(self.gap[rows] - _foot(x[self.nodes[rows]], x[self.triangles[rows]])[1])

    def move(self, x: np.ndarray, rows: np.ndarray, triangles: np.ndarray) -> None:
        """Move bonds `rows` (k,) to triangles (k,3) of the same body, without force in the positions x (N,3) m: their stored energy
        is dissipated. `reduce_overlap` moves nodes that lie behind their triangle to its surface."""
        if len(rows) == 0:
            return
        lost = float(self.stored_by_each[rows].sum())
        self.stored, self.dissipated = self.stored - lost, self.dissipated + lost
        self.triangles[rows] = triangles
        self.weights[rows], self.gap[rows] = _foot(x[self.nodes[rows]], x[triangles])
        self.opening[rows], self.traction[rows] = 0.0, 0.0
        self._moved = np.union1d(self._moved, rows[self.gap[rows] < 0.0]).astype(np.int64)

    def stiffen(self, x: np.ndarray, rows: np.ndarray, factors: np.ndarray) -> None:
        """Multiply the stiffness of bonds `rows` (k,) by factors (k,) > 1, but only until stiffness times area (N/m) is the median of
        all bonds. Bonds that become stiffer start again without force in the positions x (N,3) m (`move`)."""
        if len(rows) == 0:
            return
        springs = self.stiffness * self.area
        factors = np.minimum(factors, np.median(springs) / springs[rows])
        rows, factors = rows[factors > 1.0], factors[factors > 1.0]
        self.move(x, rows, self.triangles[rows])
        self.stiffness[rows] *= factors

    def reduce_overlap(self, share: float) -> None:
        """Multiply by `share` the gap of each bond whose gap was negative after `move`."""
        self.gap[self._moved] *= share
        if share == 0.0:
            self._moved = self._moved[:0]

    def drop(self, gone: np.ndarray) -> None:
        """Remove the bonds that a mask (n,) selects. Their stored energy is dissipated."""
        lost = float(self.stored_by_each[gone].sum())
        self.stored, self.dissipated = self.stored - lost, self.dissipated + lost
        self._keep(~gone)

    def _keep(self, which: np.ndarray) -> None:
        """Keep only the bonds that a mask (n,) selects."""
        moved = (np.cumsum(which) - 1)[self._moved[which[self._moved]]]
        vars(self).update(vars(take(self, which)))
        self._moved = moved

    def renumber(self, node: np.ndarray) -> None:
        """Change to a new numbering of the nodes. node (N,): new index of each node."""
        self.nodes, self.triangles = node[self.nodes].astype(np.int64), node[self.triangles].astype(np.int64)

    @classmethod
    def joined(cls, bonds: Sequence["Bond"]) -> "Bond":
        """One set of bonds made of one or more sets, in their order. The energies of the sets are added."""
        stored, dissipated = sum(b.stored for b in bonds), sum(b.dissipated for b in bonds)
        return replace(concatenate(bonds), stored=stored, dissipated=dissipated)


def _foot(p: np.ndarray, corners: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Barycentric coordinates (n,3) and height (n,) m of points p (n,3) above the planes of triangles (n,3,3).

    For a point beyond the edge of its triangle one coordinate is slightly negative, so that its bond begins without slip.
    """
    a, b, c = corners[:, 0], corners[:, 1], corners[:, 2]
    normal = np.cross(b - a, c - a)
    twice = np.linalg.norm(normal, axis=1)
    unit = normal / twice[:, None]
    wa = np.einsum("ij,ij->i", unit, np.cross(c - b, p - b)) / twice
    wb = np.einsum("ij,ij->i", unit, np.cross(a - c, p - c)) / twice
    return np.stack([wa, wb, 1.0 - wa - wb], axis=1), np.einsum("ij,ij->i", unit, p - a)


def _check(bond: Bond) -> None:
    """Raise SolverError if strength <= 0, stiffness <= 0, energy < 0, or 0 < energy < energy of the spring at a finite strength."""
    strength, energy, stiffness = bond.strength, bond.energy, bond.stiffness
    if not (np.all(strength > 0.0) and np.all(energy >= 0.0) and np.all(stiffness > 0.0)):
        raise SolverError(
            "a bond needs positive strength and stiffness, and an energy of zero or more: correct [adhesion]"
        )
    # J/m2 in the spring at the strength; infinite for infinite strength
    full = strength**2 / (2.0 * stiffness[:, None])
    short = (energy > 0.0) & (energy < full) & np.isfinite(full)
    if short.any():
        least = float(full[short].max())
        raise SolverError(
            f"[adhesion]: a bond has {float(energy[short].min()):.3g} J/m2, but its spring stores {least:.3g} J/m2 at its strength:"
            " increase the energy, set 0 (brittle bond), reduce the strength, or use a finer preset"
        )
