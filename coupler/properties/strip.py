"""A strip with a coating: its curvature from the deposition stress and from the difference of thermal expansion, layer by layer.

Tsui & Clyne (1997), Thin Solid Films 306, 23: a layer arrives with a stress; then strip and layers, this one too, stretch and bend
until no force and no moment is left. At the end the temperature of the whole strip changes. Sections stay plane, and the material is
elastic and equal in both directions of the plane: the modulus is E / (1 - nu).
"""

from dataclasses import dataclass
from pathlib import Path

import meshio
import numpy as np
from numpy.typing import NDArray

from ..errors import StoreError
from ..files.outputs import MARK, replacing
from ..files.result import Result
from ..physics.materials import Material
from ..plan.record import read_plan
from ..studies.coating import disc_radius, over_depth, read
from ..studies.table import write_rows
from .measure import Properties

BELOW = 20  # slices of the strip, for its stress over depth; its curvature does not depend on their number
ALONG, ACROSS = 24, 8  # elements of a quarter of the strip in the file for other programs
NAMES = ("strip.csv", "strip.inp")


@dataclass(frozen=True)
class Strip:
    """A section of a coated strip in slices, from the bottom. The first `below` slices are the strip; each further slice is a layer.

    height (k,) m; modulus (k,) Pa: E, of metal and pores; nu (k,); arriving (k,) Pa: stress in the plane with which a layer arrives;
    expansion (k,): strain of the slice, if it is free, in the last change of temperature.
    """

    height: NDArray
    modulus: NDArray
    nu: NDArray
    arriving: NDArray
    expansion: NDArray
    below: int = 1

    @property
    def middle(self) -> NDArray:
        """Heights (k,) m of the middles of the slices above the lower face."""
        return np.asarray(np.cumsum(self.height) - 0.5 * self.height)

    def relaxed(self, force: NDArray) -> tuple[NDArray, float]:
        """The middles of the lowest k slices bear `force` (k,) N/m; the slices stretch and bend until no resultant force and moment is
        left. Returns the change of stress (k,) Pa in the middles, and of curvature (1/m, positive if the coated side is convex)."""
        z, h, k = self.middle[: len(force)], self.height[: len(force)], len(force)
        M = self.modulus[:k] / (1.0 - self.nu[:k])
        first = float(M * h @ z)
        stiffness = [[float(M @ h), first], [first, float(M * h @ (z * z + h * h / 12.0))]]
        stretch, bend = np.linalg.solve(stiffness, [-force.sum(), -force @ z])
        return M * (stretch + bend * z), float(bend)

    def deposited(self) -> tuple[NDArray, float]:
        """Stress (k,) Pa in the middles of the slices, and curvature, 1/m, after the last layer."""
        stress, curvature = np.zeros(len(self.height)), 0.0
        for last in range(self.below, len(stress)):
            force = np.zeros(last + 1)
            force[last], stress[last] = self.arriving[last] * self.height[last], self.arriving[last]
            change, bend = self.relaxed(force)
            stress[: last + 1] += change
            curvature += bend
        return stress, curvature

    def misfit(self) -> tuple[NDArray, float]:
        """Stress (k,) Pa in the middles of the slices, and curvature, 1/m, that the last change of temperature causes."""
        own = -self.modulus / (1.0 - self.nu) * self.expansion
        change, bend = self.relaxed(own * self.height)
        return own + change, bend

    def residual(self) -> tuple[NDArray, NDArray, float]:
        """Stress (k,) Pa in the middles of slices after deposition and cooling; that of the strip clamped flat; and the curvature,
        1/m."""
        (deposited, first), (cooled, second) = self.deposited(), self.misfit()
        M, z = self.modulus / (1.0 - self.nu), self.middle
        neutral = (M * self.height @ z) / (M @ self.height)
        return deposited + cooled, deposited + cooled - M * (first + second) * (z - neutral), first + second

    def values(self, length: float) -> dict[str, float]:
        """Thicknesses, mean stress of arriving layers, curvatures, height of the arc over a length (m), as of an Almen gauge; SI."""
        layers = float(self.height[self.below :].sum())
        first, second = self.deposited()[1], self.misfit()[1]
        return {
            "thickness_m": float(self.height[: self.below].sum()), "coating_m": layers,
            "arriving_Pa": float(self.arriving @ self.height) / layers, "deposited_1_m": first, "misfit_1_m": second,
            "length_m": length, "deflection_m": (first + second) * length**2 / 8.0,
        }  # fmt: skip


def strip_of(result: Result, of: Properties, thickness: float, sprayed_at: float | None = None) -> Strip:
    """A strip of a run's substrate metal, `thickness` m, with the run's coating above z = 0 in slices half an element high. A slice
    arrives with the in-plane stress of its metal times its share of metal. Its modulus is the in-plane one of `of` times min(share /
    `of.solid`, 1). sprayed_at: temperature (K) of strip and coating after the last layer, from which both cool to ambient; None: no
    such cooling. Raises StoreError without a coating above z = 0."""
    plan, splats = read_plan(result.directory), read(result)
    step, radius = 0.5 * splats.element_size, disc_radius(splats)
    rows = [row for row in reversed(over_depth(splats, radius, step)) if row["z_m"] > 0.0]
    if not rows:
        raise StoreError(f"{result.directory}: no coating lies above the substrate: there is no strip to compute")
    share = np.minimum([row["volume_m3"] / (np.pi * radius**2 * step) for row in rows], 1.0)
    stress = share * [0.5 * (row["sigma_xx"] + row["sigma_yy"]) for row in rows]
    base, metal, n = plan.target.material, plan.impacts[-1].material, len(rows)

    def column(of_strip: float, of_layers: NDArray | float) -> NDArray:
        return np.append(np.full(BELOW, of_strip), np.broadcast_to(of_layers, n))

    def expansion(each: Material) -> float:
        if sprayed_at is None or plan.ambient is None:
            return 0.0
        strain = each.strain_between(sprayed_at, plan.ambient)
        if strain == 0.0 and plan.ambient != sprayed_at:
            give = f"give thermal_expansion under [materials.{each.name}]"
            raise StoreError(f"{result.directory}: the thermal expansion of {each.name} is not known: {give}")
        return strain

    modulus = of.values["E_in_plane"].mixed * np.minimum(share / of.solid, 1.0)
    return Strip(column(thickness / BELOW, step), column(base.E, modulus), column(base.nu, metal.nu),
                 column(0.0, stress), column(expansion(base), expansion(metal)), BELOW)  # fmt: skip


def write(strip: Strip, length: float, folder: Path, about: str) -> None:
    """Write NAMES. csv: a row for each slice, z above the surface of the strip. inp: a quarter, of bricks C3D8I, of a flat strip that
    is `length` m long and a third as wide, with the stress of the strip clamped flat. In the static step the strip is free and bends.
    The initial stress is in the form of CalculiX (element, point, six components); comment lines give that of Abaqus (set of elements,
    six components; Abaqus Keywords Reference, *INITIAL CONDITIONS). All other lines are the same in both. SI units."""
    (residual, flat, _), z = strip.residual(), strip.middle - strip.height[: strip.below].sum()
    columns = {
        "z_m": z, "height_m": strip.height, "E_Pa": strip.modulus, "nu": strip.nu, "arriving_Pa": strip.arriving,
        "flat_Pa": flat, "residual_Pa": residual,
    }  # fmt: skip
    rows = [dict(zip(columns, map(float, row), strict=True)) for row in zip(*columns.values(), strict=True)]
    write_rows(folder / NAMES[0], list(columns), rows, about)
    levels, n = np.append(0.0, np.cumsum(strip.height)), len(strip.height)
    axes = np.linspace(0.0, length / 2.0, ALONG + 1), np.linspace(0.0, length / 6.0, ACROSS + 1), levels
    points = np.stack(np.meshgrid(*axes, indexing="ij"), axis=-1).reshape(-1, 3)
    index = np.arange(len(points)).reshape(ALONG + 1, ACROSS + 1, n + 1)
    around = ((0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1), (1, 0, 1), (1, 1, 1), (0, 1, 1))
    corners = [index[i : ALONG + i, j : ACROSS + j, k : n + k].ravel() for i, j, k in around]
    cells, slice_of = np.stack(corners, axis=1), np.tile(np.arange(n), ALONG * ACROSS)
    sets = {f"SLICE{k}": [np.flatnonzero(slice_of == k)] for k in range(n)}
    sides = {"XMIN": index[0].ravel(), "YMIN": index[:, 0].ravel(), "ORIGIN": index[0, 0, :1]}
    text = [f"** {MARK}"]
    for k in range(n):
        text += [f"*MATERIAL, NAME=M{k}", "*ELASTIC", f"{strip.modulus[k]:.8g}, {strip.nu[k]:.6g}"]
        text += [f"*SOLID SECTION, ELSET=SLICE{k}, MATERIAL=M{k}"]
    stress = [f"{value:.8g}, {value:.8g}, 0, 0, 0, 0" for value in flat]
    text += ["** In Abaqus these lines, without **, replace those below *INITIAL CONDITIONS:"]
    text += [f"** SLICE{k}, {stress[k]}" for k in range(n)]
    text += ["*BOUNDARY", "XMIN, 1", "YMIN, 2", "ORIGIN, 3", "*INITIAL CONDITIONS, TYPE=STRESS"]
    text += [f"{e + 1}, {point}, {stress[k]}" for e, k in enumerate(slice_of) for point in range(1, 9)]
    text += ["*STEP", "*STATIC", "*NODE FILE", "U", "*EL FILE", "S", "*END STEP", ""]
    with replacing(folder / NAMES[1]) as part:
        mesh = meshio.Mesh(points, [("hexahedron", cells)], point_sets=sides, cell_sets=sets)
        mesh.write(part, file_format="abaqus", float_fmt=".10e")  # CalculiX reads at most 20 characters
        body = part.read_text(encoding="utf-8").replace("TYPE=C3D8RH\n", "TYPE=C3D8I\n")
        part.write_text(body + "\n".join(text), encoding="utf-8")
