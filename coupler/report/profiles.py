"""Fields along the vertical line through the middle of the splat, from its top down into the substrate."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from ..files.fields import Fields
from ..files.result import Result
from ..geometry.points import in_tets
from ..geometry.sections import crossing, section_of_triangles
from .fields import at_nodes, from_points
from .picture import MICRO, Stage

SAMPLES = 60  # in each body


@dataclass(frozen=True)
class Profile:
    """Values along a vertical line in one body. time (s); depth (k,) m: depth below the undeformed surface, increasing; values: (k,
    ...) of each field, SI; stress in the order xx yy zz xy yz xz."""

    time: float
    depth: NDArray
    values: dict[str, NDArray]


def profiles(result: Result, step: int, names: Sequence[str], at: Stage, reach: float) -> list[Profile]:
    """Profiles in particle and target at a stored step, from the top down, along the vertical through the middle of the particle; NaN
    where the particle is hollow. names: fields; a body without a field has no values for it. at: gives the undeformed surface and the
    size of a void. reach: greatest depth, m. Raises StoreError if a file is missing or damaged."""
    level = at.level / MICRO
    particle, surface, target = (result.fields(step, domain) for domain in ("particle", "surface", "target"))
    x, y = (float(surface.points[:, k].min() + surface.points[:, k].max()) / 2 for k in (0, 1))

    def on_axis(z: NDArray) -> NDArray:
        return np.column_stack([np.full_like(z, x), np.full_like(z, y), z])

    def profile(fields: Fields, z: NDArray, nodes: NDArray, weight: NDArray) -> Profile:
        known = {name: at_nodes(fields, name)[nodes] for name in names if name in fields.data}
        values = {name: np.einsum("kj,kj...->k...", weight, at) for name, at in known.items()}
        return Profile(fields.time, level - z, values)

    lines = []
    crossings = on_vertical(surface.points, surface.cells, x, y)
    for low, high in zip(crossings[0::2], crossings[1::2], strict=False):
        z = np.linspace(high, low, SAMPLES)
        lines.append(profile(particle, z, *from_points(particle.points, on_axis(z), at.void)))
    lines.reverse()  # from the top down

    # Elements grow with depth, and so do the distances of the samples.
    top = float(target.points[:, 2].max()) + 1e-9
    z = top - (top - level + reach) * np.linspace(0, 1, 4 * SAMPLES) ** 1.5
    owner, share = in_tets(target.points, target.cells, on_axis(z))
    inside = owner >= 0
    lines.append(profile(target, z[inside], target.cells[owner[inside]], share[inside]))
    return [line for line in lines if len(line.depth)]


def on_vertical(points: NDArray, triangles: NDArray, x: float, y: float) -> list[float]:
    """Ascending heights (m) at which the vertical line at x, y (m) crosses a closed surface. The line enters the body at the first
    height, leaves it at the second, and so on. points (n, 3) m; triangles (m, 3)."""
    ends, _ = crossing(points, section_of_triangles(points, triangles, y), y)
    (x0, z0), (x1, z1) = ends[:, 0].T, ends[:, 1].T
    # A corner on the line counts as right of it: thus the line crosses a closed outline an even number of times
    crossed = (x0 >= x) != (x1 >= x)
    z = z0[crossed] + ((x - x0) * (z1 - z0))[crossed] / (x1 - x0)[crossed]
    return sorted(z.tolist())
