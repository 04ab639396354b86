"""Matrices of small static problems on linear tetrahedra, assembled by scikit-fem: elasticity and conduction."""

import numpy as np
from scipy.sparse import csr_array
from skfem import Basis, BilinearForm, ElementTetP0, ElementTetP1, MeshTet


def gradient_products(points: np.ndarray, tets: np.ndarray, weight: np.ndarray) -> list[list[csr_array]]:
    """Matrices [i][j], each (n,n), for the axes i and j; entries: integral of weight dN_a/dx_i dN_b/dx_j dV. weight (m,): weight of
    each tetrahedron."""
    mesh = MeshTet(np.ascontiguousarray(points.T), np.ascontiguousarray(tets.T), sort_t=False)
    basis = Basis(mesh, ElementTetP1(), intorder=1)
    w = basis.with_element(ElementTetP0()).interpolate(weight)

    def product(i: int, j: int) -> csr_array:
        return csr_array(BilinearForm(lambda u, v, of: of.w * v.grad[i] * u.grad[j]).assemble(basis, w=w))

    return [[product(i, j) for j in range(3)] for i in range(3)]
