"""From points to a surface as in doi:10.1016/j.jestch.2023.101579, with open3d, for comparison.

Alpha shape, Poisson-disk sampling, Poisson reconstruction, quadric decimation, subdivision. The parameters are the paper's,
or are marked where it gives none.
"""

import numpy as np

from ..errors import SplatError
from ..geometry.library import open3d
from ..geometry.triangles import enclosed_volume

ALPHA = 0.025  # of the bounding box's diagonal: three spacings of the paper's 89,094 points
MIN_ALPHA = 2.0  # spacings, ours: on a coarse cloud ALPHA is less than one spacing and leaves no surface
SAMPLES = 400
DEPTH = 9  # of the octree of the Poisson reconstruction
TRIANGLES = 800  # after decimation, ours: two for each sample


def poisson_surface(x: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (k,3) m and outward triangles (m,3) of a surface through the outermost of points x (n,3) m.

    It lies half a spacing inside the body. Raises SplatError where a stage gives no surface.
    """
    o3d = open3d()
    o3d.utility.random.seed(1)
    unit = spacing  # open3d has absolute tolerances for numbers near one
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(x / unit))
    alpha = max(ALPHA * float(np.linalg.norm(np.ptp(x, axis=0))) / unit, MIN_ALPHA)
    skin = o3d.geometry.TriangleMesh.create_from_point_cloud_alpha_shape(cloud, alpha)
    if len(skin.triangles) == 0:
        raise SplatError(f"the alpha shape with {alpha:.2g} spacings is empty")
    skin.compute_vertex_normals()
    samples = skin.sample_points_poisson_disk(SAMPLES)
    mesh, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(samples, depth=DEPTH, n_threads=1)
    mesh = mesh.simplify_quadric_decimation(TRIANGLES).remove_unreferenced_vertices().subdivide_loop(1)
    vertices, triangles = np.asarray(mesh.vertices) * unit, np.asarray(mesh.triangles).astype(np.int64)
    if len(triangles) == 0:
        raise SplatError("the Poisson reconstruction left no surface")
    if enclosed_volume(vertices, triangles) < 0.0:
        triangles = triangles[:, ::-1]
    return vertices, triangles
