"""Effective stiffness and conductivity of a block under uniform boundary conditions, by conjugate gradients.

Three conditions are used. "kinematic": the displacement E x on all faces gives an upper bound. "static": a uniform traction on all
faces gives the lower bound (Hill (1963), J. Mech. Phys. Solids 11, 357; Huet (1990), ibid. 38, 813). "mixed": on the faces some
components of the displacement E x are prescribed, and there is no traction in the other directions (for shear as in Pahr & Zysset
(2008), Biomech. Model. Mechanobiol. 7, 463); the result lies between the bounds (Hazanov & Huet (1994), J. Mech. Phys. Solids 42,
1995). Conduction has the same three conditions: a linear temperature on all faces; a uniform flux; a temperature on two opposite
faces while the other faces are insulated.
"""

from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import block_array, csr_array, diags_array
from scipy.sparse.csgraph import connected_components
from scipy.sparse.linalg import cg

from ..core.records import take
from ..errors import SolverError
from ..fe.statics import gradient_products
from ..geometry.triangles import area_vectors
from .block import Block, Joints

VOIGT = ((0, 0), (1, 1), (2, 2), (1, 2), (0, 2), (0, 1))
TOLERANCE = 1e-6  # relative residual: the relative error of the energy is then some 1e-9
ITERATIONS = 3000  # more are needed only if a part is connected as by a hinge: uniform traction turns it without limit
LEAST = 1e-3  # smallest over largest eigenvalue of a stiffness: it is lower if a part is connected as by a hinge
ROUNDS = 6  # rounds of the search for the surfaces that bear pressure: the last ones change only surfaces with almost no pressure
# Stiffness of a touching facet over that of an element: it softens the block by less than 1e-3. The gap, as metal, is in series with
# it. Otherwise a spring on a face of the block, where nodes on both sides are prescribed, would bear more than metal does.
TOUCHING = 100.0


@dataclass(frozen=True)
class Problem:
    """Equations of a block of n nodes. K: matrix of the equations, W/K or N/m, component after component; x (n,3) m; bonds: nodes
    that have the same value as the opposite point; components: 3 for displacement, 1 for temperature; on_face (3,n): nodes on the faces
    normal to each axis; area (3,n) m2: outward area of these faces that belongs to each node; volume (m3)."""

    K: csr_array
    x: NDArray
    bonds: Joints
    components: int
    on_face: NDArray
    area: NDArray
    volume: float

    def uniform(self, vectors: NDArray) -> NDArray:
        """Products (loads, components n) of vectors (n,3) with the unit tensor of each load (in shear with two entries of 1/2); for
        conduction the components of the vectors. If the vectors are positions, these are the linear fields of unit strains or
        gradients; if they are areas, the forces of uniform stresses, or the fluxes."""
        if self.components == 1:
            return np.asarray(vectors.T)
        unit = np.zeros((6, 3, 3))
        for k, (i, j) in enumerate(VOIGT):
            unit[k, i, j] += 0.5
            unit[k, j, i] += 0.5
        return np.asarray(np.einsum("kij,nj->kin", unit, vectors).reshape(6, -1))

    def kinematic(self) -> NDArray:
        """Stiffness (6,6) Pa or conductivity (3,3) W/mK if linear fields are prescribed on all faces (upper bound)."""
        prescribed = np.tile(self.on_face.any(axis=0), self.components)
        return self._driven([prescribed] * (6 if self.components == 3 else 3))

    def mixed(self) -> NDArray:
        """Stiffness (6,6) Pa or conductivity (3,3) W/mK under mixed conditions; 0 between loads that prescribe different components."""
        if self.components == 1:
            return self._driven(list(self.on_face))
        prescribed = np.zeros((6, 3, len(self.x)), bool)
        prescribed[:3] = self.on_face
        for k, (i, j) in enumerate(VOIGT[3:], 3):
            third = 3 - i - j
            prescribed[k, third] = self.on_face.any(axis=0)
            prescribed[k, j], prescribed[k, i] = self.on_face[i], self.on_face[j]
        return self._driven(list(prescribed.reshape(6, -1)))

    def static(self) -> NDArray | None:
        """Stiffness (6,6) Pa or conductivity (3,3) W/mK under uniform tractions or fluxes on the metal of the faces (lower bound). If
        pores make a resultant force or moment, tractions that vary linearly over the same faces balance it. All tractions act only
        where the mixed conditions prescribe values, so that the result stays below the mixed one. Only the largest connected part bears
        load. None if this part does not reach all six faces, or is connected as by a hinge and could turn without limit."""
        loads = self.uniform(self.area.T).T
        T, free = self._leads(np.zeros(len(loads), bool))
        K = csr_array(T.T @ self.K @ T)
        part = connected_components(K, directed=False)[1]
        kept = np.flatnonzero(part == np.bincount(part).argmax())  # other parts bear no load
        K, loads, basis = K[kept][:, kept], (T.T @ loads)[kept], np.linalg.qr(self._rigid()[free[kept]])[0]
        normal = loads[:, :3]  # a normal load has opposite signs on two opposite faces: the part must reach both
        if (normal.max(axis=0) <= 0.0).any() or (normal.min(axis=0) >= 0.0).any():
            return None
        for load in loads.T:
            acting = abs(load)[:, None] * basis
            load -= acting @ np.linalg.lstsq(basis.T @ acting, basis.T @ load, rcond=1e-9)[0]
        answer = np.zeros_like(loads)
        for k in range(loads.shape[1]):
            answer[:, k], failed = _solved(K, loads[:, k])
            if failed:
                return None
        stress, energy = (each @ loads / self.volume for each in (self.uniform(self.x)[:, free[kept]], answer.T))
        if self.components == 1:  # each direction alone, as in the mixed conditions
            stress, energy = np.diag(stress.diagonal()), np.diag(energy.diagonal())
        unit = np.linalg.inv(stress)
        compliance = unit.T @ energy @ unit
        stiffness = np.linalg.inv(0.5 * (compliance + compliance.T))
        least, *_, most = np.linalg.eigvalsh(stiffness)
        return stiffness if least > LEAST * most else None

    def _driven(self, prescribed: list[NDArray]) -> NDArray:
        """Matrix (loads, loads) of stiffness or conductivity if the linear fields are prescribed on the components `prescribed` of each
        load; 0 between loads with different `prescribed`. Raises SolverError."""
        answer = self.uniform(self.x).copy()
        alike = np.array([next(k for k, own in enumerate(prescribed) if (own == each).all()) for each in prescribed])
        for first in dict.fromkeys(alike):
            answer[alike == first] = self.answers(prescribed[first], answer[alike == first])
        energy = answer @ (self.K @ answer.T) / self.volume
        return np.where(np.equal.outer(alike, alike), 0.5 * (energy + energy.T), 0.0)

    def answers(self, prescribed: NDArray, fields: NDArray) -> NDArray:
        """The fields (loads, components n) of least energy that are equal to `fields` (loads, components n) where the mask `prescribed`
        (components n,) is True. Raises SolverError."""
        T, free = self._leads(prescribed)
        K, own, found = csr_array(T.T @ self.K @ T), prescribed[free], fields[:, free]
        inner, outer = K[~own][:, ~own], K[~own][:, own]
        for part in found:
            part[~own], failed = _solved(inner, -outer @ part[own])
            if failed:
                raise SolverError(
                    f"the equations of the block are not solved in {ITERATIONS} iterations: choose a smaller block (--side)"
                )
        return np.asarray((T @ found.T).T)

    def _leads(self, prescribed: NDArray) -> tuple[csr_array, NDArray]:
        """Matrix (components n, f) from the free values to all values, and indices (f,) of the free values. A bonded value that is
        not prescribed follows from the values of the opposite facet, whose nodes can in turn follow from an earlier body."""
        first = len(self.x) * np.arange(self.components)[:, None]
        nodes = (first + self.bonds.nodes).ravel()
        leaders = (first[..., None] + self.bonds.triangles).reshape(-1, 3)
        weights, led = np.tile(self.bonds.weights, (self.components, 1)), np.zeros(len(prescribed), bool)
        bonded = ~prescribed[nodes]
        nodes, leaders, weights = nodes[bonded], leaders[bonded], weights[bonded]
        led[nodes] = True
        free = np.flatnonzero(~led)
        at = np.concatenate([free, np.repeat(nodes, 3)]), np.concatenate([free, leaders.ravel()])
        step = csr_array(
            (np.concatenate([np.ones(len(free)), weights.ravel()]), at), shape=(len(prescribed), len(prescribed))
        )
        T = step
        while abs(T[:, led]).sum() > 0.0:
            T = T @ step
        return csr_array(T[:, free]), free

    def _rigid(self) -> NDArray:
        """Fields (components n, modes) without energy: translations and rotations of displacement, a constant temperature."""
        n = len(self.x)
        if self.components == 1:
            return np.ones((n, 1))
        x, modes = self.x - self.x.mean(axis=0), np.zeros((3, n, 6))
        for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1))):
            modes[k, :, k] = 1.0
            modes[i, :, 3 + k], modes[j, :, 3 + k] = -x[:, j], x[:, i]
        return modes.reshape(3 * n, 6)


def elastic(block: Block, lame: NDArray, shear: NDArray, strain: float = -1.0) -> Problem:
    """The linear elastic problem of a block. lame, shear (m,) Pa: Lame's constants of each tetrahedron. Bonded nodes move with the
    opposite points. Touching surfaces slide without friction. They are closed where they bear pressure, else open, in a block that is
    pressed (strain -1) or stretched (1) equally in all directions under mixed conditions (see the module). They stay so under all
    loads. The problem is therefore linear, and the three conditions of the module give bounds. Raises SolverError."""
    of_lame, of_shear = (gradient_products(block.points, block.tets, each) for each in (lame, shear))
    laplacian = of_shear[0][0] + of_shear[1][1] + of_shear[2][2]
    rows = [
        [of_lame[i][j] + of_shear[j][i] + (laplacian if i == j else 0.0 * laplacian) for j in range(3)]
        for i in range(3)
    ]
    K = csr_array(block_array(rows, format="csr"))
    touching = take(block.joints, ~block.joints.bonded)
    jump = _jump(touching, len(block.points))
    across = csr_array(block_array([[diags_array(touching.normal[:, i]) @ jump for i in range(3)]], format="csr"))
    size = float(np.cbrt(block.volume / len(block.tets)))
    spring = float((lame + 2.0 * shear).max()) * touching.area / (size / TOUCHING + abs(touching.gap))
    closed, problem = np.ones(len(spring), bool), _problem(block, K, 3)
    for _ in range(ROUNDS if len(spring) else 0):
        pressed = across[closed]
        problem = replace(problem, K=csr_array(K + pressed.T @ diags_array(spring[closed]) @ pressed))
        opening = strain * (across @ problem.answers(problem.on_face.ravel(), block.points.T.reshape(1, -1))[0])
        before, closed = closed, opening < 0.0
        if (before == closed).all():
            break
    return problem


def conducting(block: Block, conductivity: NDArray, conductance: float) -> Problem:
    """The conduction problem of a block. conductivity (m,) W/mK: conductivity of each tetrahedron; conductance (W/(m2 K)): of
    surfaces that touch without a bond. Bonded nodes have the temperature of the opposite points."""
    products = gradient_products(block.points, block.tets, conductivity)
    K = products[0][0] + products[1][1] + products[2][2]
    touching = take(block.joints, ~block.joints.bonded)
    jump = _jump(touching, len(block.points))
    spring = conductance * touching.area / (1.0 + conductance * abs(touching.gap) / float(conductivity.max()))
    return _problem(block, csr_array(K + jump.T @ diags_array(spring) @ jump), 1)


def _jump(joints: Joints, n: int) -> csr_array:
    """Matrix (k,n): nodal values (n,) -> value at each node of the joints minus the value at the opposite point."""
    rows = np.repeat(np.arange(len(joints.nodes)), 4)
    columns = np.column_stack([joints.nodes, joints.triangles]).ravel()
    values = np.column_stack([np.ones(len(joints.nodes)), -joints.weights]).ravel()
    return csr_array((values, (rows, columns)), shape=(len(joints.nodes), n))


def _problem(block: Block, K: csr_array, components: int) -> Problem:
    """The `Problem` of a block, with the nodes on its faces."""
    n = len(block.points)
    area, on_face, vectors = np.zeros((3, n)), np.zeros((3, n), bool), area_vectors(block.points, block.walls)
    for axis in range(3):
        area[axis] = np.bincount(block.walls.ravel(), np.repeat(vectors[:, axis] / 3.0, 3), n)
        on_face[axis, block.walls[abs(vectors[:, axis]) > 0.5 * np.linalg.norm(vectors, axis=1)]] = True
    return Problem(K, block.points, take(block.joints, block.joints.bonded), components, on_face, area, block.volume)


def _solved(K: csr_array, load: NDArray) -> tuple[NDArray, bool]:
    """The solution, and whether it was not found within ITERATIONS. The matrix may be singular where the load does no work."""
    diagonal = K.diagonal()
    scale = diags_array(1.0 / np.where(diagonal > 0.0, diagonal, 1.0))
    x, unfinished = cg(K, load, rtol=TOLERANCE, maxiter=ITERATIONS, M=scale)
    return x, bool(unfinished)
