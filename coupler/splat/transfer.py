"""Transfer of the state from the points of a cloud to the nodes and elements of its mesh.

Linear moving least squares (Lancaster & Salkauskas 1981), then corrections that conserve sums. Velocities: a rigid motion a + omega
x r restores linear and angular momentum, and a factor of the non-rigid part restores the kinetic energy. Temperature, plastic
strain, all other scalars of the metal, and energy: a uniform shift restores their sum, weighted by mass. A fitted value exceeds the
range of its points by at most EXTRAPOLATION of this range, and no temperature is below that of the coldest point.
"""

from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from ..core.records import rows_of
from ..geometry.tetrahedra import lumped, volumes
from ..physics.metal import carried
from .cloud import Cloud
from .kernels import least_squares_weights

NEIGHBOURS = 16  # the twelve nearest neighbours of a face-centred cubic lattice and four more
MAX_SCALING = 0.1  # of velocities, to conserve the kinetic energy: a larger factor would amplify noise
EXTRAPOLATION = 0.3  # largest excess of a fitted value beyond the range of its points, as a share of this range
RIDGE = 0.02  # spacings: a set of points with a smaller thickness counts as a plane


class Fit:
    """Linear moving least-squares fit of fields from points x (n,3) m to points y (m,3) m. spacing (m): that of the points x."""

    def __init__(self, x: np.ndarray, y: np.ndarray, spacing: float):
        near = cKDTree(x).query(y, k=min(NEIGHBOURS, len(x)))[1]
        self.near = np.ascontiguousarray(near, np.int64)
        self.phi = np.empty(self.near.shape)
        y, x = np.ascontiguousarray(y), np.ascontiguousarray(x)
        least_squares_weights(y, x, self.near, (RIDGE * spacing) ** 2, self.phi)

    def __call__(self, values: np.ndarray) -> np.ndarray:
        """Fitted values (m,) or (m,k) at y, from values (n,) or (n,k) at x."""
        if values.ndim == 2:
            return np.stack([self(column) for column in values.T], axis=1)
        around = values[self.near]
        low, high = around.min(axis=1), around.max(axis=1)
        slack = EXTRAPOLATION * (high - low)
        return np.clip(np.einsum("ij,ij->i", self.phi, around), low - slack, high + slack)


def with_momentum(v: np.ndarray, x: np.ndarray, mass: np.ndarray, P: np.ndarray, L: np.ndarray) -> np.ndarray:
    """v (n,3) plus the rigid motion with which the momentum is P (3,) kg m/s, the angular momentum about the origin L (3,) kg m2/s."""
    return v + rigid(x, mass, P - mass @ v, L - mass @ np.cross(x, v))


def rigid(x: np.ndarray, mass: np.ndarray, P: np.ndarray, L: np.ndarray) -> np.ndarray:
    """Velocities (n,3) m/s of the rigid motion that has the momentum P and, about the origin, the angular momentum L."""
    centre = mass @ x / mass.sum()
    r = x - centre
    inertia = np.eye(3) * float(mass @ np.einsum("ij,ij->i", r, r)) - np.einsum("i,ij,ik->jk", mass, r, r)
    return P / mass.sum() + np.cross(np.linalg.solve(inertia, L - np.cross(centre, P)), r)


def with_energy(v: np.ndarray, x: np.ndarray, mass: np.ndarray, kinetic: float) -> np.ndarray:
    """Velocities (n,3) with the same momenta and the energy `kinetic`, J: the non-rigid part is scaled, at most by MAX_SCALING."""
    whole = rigid(x, mass, mass @ v, mass @ np.cross(x, v))
    own = v - whole
    moving, rest = (0.5 * float(mass @ np.einsum("ij,ij->i", w, w)) for w in (own, whole))
    scale = np.sqrt(max(kinetic - rest, 0.0) / moving) if moving > 0.0 else 1.0
    return whole + float(np.clip(scale, 1.0 - MAX_SCALING, 1.0 + MAX_SCALING)) * own


def with_sum(values: np.ndarray, weights: np.ndarray, total: float, floor: float | None = None) -> np.ndarray:
    """Values (n,) after a uniform shift, so that weights @ values is `total`, and no value is below `floor`.

    Values at the floor stay there, and the others are shifted further. If `total` is too small for this, all values are the floor.
    """
    whole = weights.sum()
    if floor is None:
        return values + (total - weights @ values) / whole
    if total <= floor * whole:
        return np.full_like(values, floor)
    shift = (total - weights @ values) / whole
    shifted = np.maximum(values + shift, floor)
    for _ in range(100):
        off = total - weights @ shifted
        free = shifted > floor
        if abs(off) <= 1e-14 * abs(total) or not free.any():
            break
        shifted = np.where(free, np.maximum(shifted + off / weights[free].sum(), floor), shifted)
    return shifted


def transfer(cloud: Cloud, points: np.ndarray, tets: np.ndarray) -> tuple[dict[str, Any], dict[str, float]]:
    """Fields of `cloud.Body` on a mesh of points (n,3) m and tets (m,4), from the fields of the cloud; and their relative errors.

    The errors are those of sums weighted by mass: temperature, plastic strain, energy, linear and angular momentum, kinetic energy.
    Keys that end in `_raw`: before the correction. stress_square: error of the uncorrected volume integral of sigma : sigma.
    """
    volume = volumes(points, tets)  # m3
    at_elements = Fit(cloud.x, points[tets].mean(axis=1), cloud.spacing)
    at_nodes = Fit(cloud.x, points, cloud.spacing)
    weights = cloud.mass / cloud.mass.sum()
    fields: dict[str, Any] = {}
    J = None if cloud.J is None else at_elements(cloud.J)
    reference = volume if J is None else volume / J
    share = reference / reference.sum()
    node_share = lumped(tets, share, len(points))
    errors: dict[str, float] = {}
    fields["J"] = J

    def add_field(name: str, source: np.ndarray, raw: np.ndarray, over: np.ndarray, floor: float | None = None) -> None:
        mean, span = float(weights @ source), float(np.abs(source).max())
        fields[name] = corrected = with_sum(raw, over, mean, floor)
        errors[f"{name}_raw"] = float(over @ raw - mean) / span if span else 0.0
        errors[name] = float(over @ corrected - mean) / span if span else 0.0

    for name, source in carried(cloud).items():
        fields[name] = raw = at_elements(source)
        if raw.ndim == 1:
            least = rows_of(cloud)[name].least
            floor = float(source.min()) if least is None else least
            add_field(name, source, np.maximum(raw, floor), share, floor)
    if cloud.energy is not None:
        add_field("energy", cloud.energy, at_nodes(cloud.energy), node_share)
    if cloud.stress is not None:
        fields["stress"] = stress = at_elements(cloud.stress)
        before = float(cloud.current_volume @ _square(cloud.stress))
        errors["stress_square"] = float(volume @ _square(stress)) / before - 1.0 if before else 0.0
    if cloud.velocity is not None:
        mass, node_mass = cloud.mass, node_share * cloud.mass.sum()
        P, L = mass @ cloud.velocity, mass @ np.cross(cloud.x, cloud.velocity)
        raw = at_nodes(cloud.velocity)
        speed = np.linalg.norm(cloud.velocity, axis=1)
        P_size, L_size = float(mass @ speed), float(mass @ (speed * np.linalg.norm(cloud.x, axis=1)))
        kinetic = 0.5 * float(mass @ speed**2)
        v = with_energy(with_momentum(raw, points, node_mass, P, L), points, node_mass, kinetic)
        fields["velocity"] = v = with_momentum(v, points, node_mass, P, L)  # again, against rounding
        errors["momentum_raw"] = float(np.linalg.norm(node_mass @ raw - P)) / (P_size or 1.0)
        errors["momentum"] = float(np.linalg.norm(node_mass @ v - P)) / (P_size or 1.0)
        errors["angular_momentum"] = float(np.linalg.norm(node_mass @ np.cross(points, v) - L)) / (L_size or 1.0)
        own = 0.5 * float(node_mass @ np.einsum("ij,ij->i", v, v))
        errors["kinetic_energy"] = own / kinetic - 1.0 if kinetic else 0.0
    return fields, errors


def _square(stress: np.ndarray) -> np.ndarray:
    """The double contraction sigma : sigma (n,) of Voigt tensors (n,6)."""
    normal, shear = (np.einsum("ij,ij->i", part, part) for part in (stress[:, :3], stress[:, 3:]))
    return normal + 2.0 * shear
