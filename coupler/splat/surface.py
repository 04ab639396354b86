"""Surfaces of a body, made from a field: marching cubes, projection on the level set, correction of the volume."""

from collections.abc import Callable

import numpy as np
from skimage.measure import marching_cubes

from ..geometry import triangles as triangulated
from ..geometry.triangles import Surface
from .field import Field


def contour(field: Field, level: float) -> Surface:
    """Vertices (k,3) m and triangles (m,3), normals outwards, of a level set (marching cubes, Lewiner 2003)."""
    vertices, triangles, _, _ = marching_cubes(field.values, level, gradient_direction="ascent")
    return field.origin + vertices.astype(float) * field.h, triangles.astype(np.int64)


def handles(surface: Surface) -> int:
    """Number of handles (genus) of one closed surface."""
    return 1 - (len(surface[0]) - len(surface[1]) // 2) // 2


def projection(field: Field, level: float, size: float) -> Callable[[np.ndarray], np.ndarray]:
    """A function that moves vertices (k,3) m to the surface on which a field has the value `level`, by two Newton steps of at most
    0.15 size. size (m): size of the elements."""
    gradient = [Field(g, field.origin, field.h) for g in np.gradient(field.values, field.h)]

    def project(x: np.ndarray) -> np.ndarray:
        x = x.copy()
        for _ in range(2):
            slope = np.stack([g.at(x) for g in gradient], axis=1)
            square = np.einsum("ij,ij->i", slope, slope)
            # lower bound on the slope: where the field is flat the distance is unknown
            pull = (level - field.at(x))[:, None] * slope / np.maximum(square, (0.05 / size) ** 2)[:, None]
            length = np.linalg.norm(pull, axis=1)
            x += pull * np.minimum(1.0, 0.15 * size / np.maximum(length, 1e-9 * size))[:, None]
        return x

    return project


def correct_volume(parts: list[Surface], target: float, max_offset: float) -> tuple[list[Surface], float]:
    """Closed surfaces, moved along normals so that they enclose `target` m3; and this displacement, m, at most `max_offset`."""
    ends = np.cumsum([0, *(len(vertices) for vertices, _ in parts)])
    triangles = np.concatenate([own + first for (_, own), first in zip(parts, ends, strict=False)])
    x, moved = triangulated.correct_volume(np.concatenate([part[0] for part in parts]), triangles, target, max_offset)
    return [(x[a:b], own) for (_, own), a, b in zip(parts, ends, ends[1:], strict=False)], moved
