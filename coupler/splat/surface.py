"""From a field to the surfaces of a body: marching cubes, an even remesh on the level set, a correction of the volume."""

import numpy as np
from skimage.measure import marching_cubes

from ..geometry import triangles as triangulated
from ..geometry.graph import connected_parts
from ..geometry.triangles import compact, enclosed_volume
from .field import Field

Surface = tuple[np.ndarray, np.ndarray]


def contour(field: Field, level: float) -> Surface:
    """Vertices (k,3) m and outward triangles (m,3) of a level set (marching cubes, Lewiner 2003)."""
    vertices, triangles, _, _ = marching_cubes(field.values, level, gradient_direction="ascent")
    return field.origin + vertices.astype(float) * field.h, triangles.astype(np.int64)


def shells(surface: Surface, smallest: float) -> list[Surface]:
    """The closed parts of a surface that enclose `smallest` m3 or more, largest first; a cavity has a negative volume."""
    vertices, triangles = surface
    pairs = np.concatenate([triangles[:, :2], triangles[:, 1:]])
    count, label = connected_parts(pairs, len(vertices))
    parts = []
    for component in range(count):
        own = triangles[label[triangles[:, 0]] == component]
        if len(own) == 0:
            continue
        part = compact(vertices, own)
        if abs(enclosed_volume(*part)) >= smallest:
            parts.append(part)
    return sorted(parts, key=lambda part: -enclosed_volume(*part))


def handles(surface: Surface) -> int:
    """Through-holes of one closed piece of surface, its genus."""
    return 1 - (len(surface[0]) - len(surface[1]) // 2) // 2


class LevelSet:
    """The surface where a field has the value `level`. size: m, of elements."""

    def __init__(self, field: Field, level: float, size: float):
        self.field, self.level, self.size = field, level, size
        self.gradient = [Field(g, field.origin, field.h) for g in np.gradient(field.values, field.h)]

    def project(self, x: np.ndarray) -> np.ndarray:
        """Vertices (k,3) m moved to the level set by two Newton steps, each at most 0.15 size."""
        x = x.copy()
        for _ in range(2):
            slope = np.stack([g.at(x) for g in self.gradient], axis=1)
            square = np.einsum("ij,ij->i", slope, slope)
            # a lower bound on the slope: where the field is flat the distance is unknown
            pull = (self.level - self.field.at(x))[:, None] * slope
            pull /= np.maximum(square, (0.05 / self.size) ** 2)[:, None]
            length = np.linalg.norm(pull, axis=1)
            x += pull * np.minimum(1.0, 0.15 * self.size / np.maximum(length, 1e-9 * self.size))[:, None]
        return x


def correct_volume(parts: list[Surface], target: float, max_offset: float) -> tuple[list[Surface], float]:
    """Shells moved along their normals until they enclose `target` m3 together, and the offset, m (at most `max_offset`)."""
    ends = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    triangles = np.concatenate([own + first for (_, own), first in zip(parts, ends, strict=False)])
    x, moved = triangulated.correct_volume(np.concatenate([part[0] for part in parts]), triangles, target, max_offset)
    return [(x[a:b], own) for (_, own), a, b in zip(parts, ends, ends[1:], strict=False)], moved
