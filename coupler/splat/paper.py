"""The way of the paper (doi:10.1016/j.jestch.2023.101579) from points to a surface, with open3d, for comparison.

Alpha shape, Poisson-disk sampling, Poisson reconstruction, quadric decimation, subdivision. Its numbers are the paper's;
where it gives none they are said here. The only place that imports open3d.
"""

import numpy as np

from ..errors import SplatError

ALPHA = 0.025  # of the bounding box's diagonal: three spacings of the paper's 89,094 points ...
LEAST_ALPHA = 2.0  # ... but less than one of a coarse cloud's, where nothing would be left
SAMPLES = 400
DEPTH = 9  # of the octree of the Poisson reconstruction
TRIANGLES = 800  # after decimation, two for each sample: the paper gives no number


def paper_surface(x: np.ndarray, spacing: float) -> tuple[np.ndarray, np.ndarray]:
    """Vertices (k,3) m and outward triangles (m,3) of a surface through the outermost of points x (n,3) m.

    It lies half a spacing inside the body. Raises SplatError where a stage leaves nothing.
    """
    try:
        import open3d as o3d
    except ImportError as problem:
        raise SplatError(f"method 'paper' needs the package open3d: {problem}") from problem

    o3d.utility.set_verbosity_level(o3d.utility.VerbosityLevel.Error)
    o3d.utility.random.seed(1)
    unit = spacing  # absolute tolerances want numbers near one
    cloud = o3d.geometry.PointCloud(o3d.utility.Vector3dVector(x / unit))
    alpha = max(ALPHA * float(np.linalg.norm(np.ptp(x, axis=0))) / unit, LEAST_ALPHA)
    skin = o3d.geometry.TriangleMesh.create_from_point_cloud_alpha_shape(cloud, alpha)
    if len(skin.triangles) == 0:
        raise SplatError(f"the alpha shape with {alpha:.2g} spacings is empty")
    skin.compute_vertex_normals()
    samples = skin.sample_points_poisson_disk(SAMPLES)
    made, _ = o3d.geometry.TriangleMesh.create_from_point_cloud_poisson(samples, depth=DEPTH, n_threads=1)
    made = made.simplify_quadric_decimation(TRIANGLES).subdivide_loop(1)
    vertices, triangles = np.asarray(made.vertices) * unit, np.asarray(made.triangles).astype(np.int64)
    if len(triangles) == 0:
        raise SplatError("the Poisson reconstruction left no surface")
    a, b, c = (vertices[triangles[:, i]] for i in range(3))
    if np.einsum("ij,ij->", a, np.cross(b, c)) < 0.0:
        triangles = triangles[:, ::-1]
    return vertices, triangles
