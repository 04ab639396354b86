"""Kinematics, residuals and side forces of the enriched scheme, in blocks of points whose values lie side by side in memory: loops
without branches and without scattered access to memory compile to vector instructions.

As in `fe.blocks`, all functions must be inlined into the function that allocates w: only there the compiler sees that its rows do not
overlap. Without vector instructions pass 1 takes 1.2 times as long. The letters are those of `particle.compiled_kernels` and
`particle.enriched`. SI units.
"""

from typing import NamedTuple

from numpy.typing import NDArray

from ..compiling import njit
from ..core.arrays import Floats, Laws, Matrix, Symmetric, Vector
from ..geometry.matrix_kernels import (
    ROUNDING,
    ZERO,
    add_outer,
    applied,
    inverse,
    matrix_of,
    polar,
    product,
    scaled,
    sum_of,
    transposed,
    write_matrix,
)
from ..geometry.vector_kernels import apart, dot, vector_of
from .compiled_kernels import FAR, NEAR, SWEEPS, TURNED, cayley, correction, trial
from .model import Deformation, Motion, Sides, State

BLOCK = 8  # points in a block: their values fit into the first-level cache
MOST_SIDES = 18  # largest number of neighbours: the two nearest layers of a face-centred cubic lattice
# Rows of a side: X_j - X_i (m); x_j - x_i, then e (m), then side_force (N); e_p (m); g (1/m); w (1/m5)
DX, DU, EP, G, W = 0, 3, 6, 9, 12
SIDE = 13  # number of these rows
ROWS = 61 + SIDE * MOST_SIDES
_inlined = njit(cache=True, nogil=True, forceinline=True, error_model="numpy", fastmath=ROUNDING)


class Block(NamedTuple):
    """Values of a block of points by name, one column for each point: views of one array (ROWS,BLOCK)."""

    F: NDArray  # (9,BLOCK) deformation gradient at n, then at n+1, row by row
    R: NDArray  # (9,BLOCK) its rotation at n, then at n+1
    before: NDArray  # (9,BLOCK) stretch U at n
    U: NDArray  # (9,BLOCK) R^T F at n+1: the stretch, when R is exact
    B: NDArray  # (9,BLOCK) inverse of U; then Q, minus the derivative of the point's energy by F, J
    S: NDArray  # (6,BLOCK) deviator at n, then trial deviator, then stress at n+1, Pa; xx xy xz yy yz zz
    omega: NDArray  # (3,BLOCK) correction of the rotation, rad; then moment sum e_p x w e of the residuals, 1/m3
    square: NDArray  # omega . omega; then sum w e^2, 1/m3
    turns: NDArray  # 1, or 0 when the rotation is exact
    span: NDArray  # sum w r^2, 1/m3
    J: NDArray
    shear: NDArray  # shear modulus, Pa
    back: NDArray  # ratio of the radial return
    mean: NDArray  # mean stress, Pa
    sides: NDArray  # (SIDE MOST_SIDES,BLOCK) SIDE rows for each side. Sides that a point does not have: g and w are 0


@_inlined
def block_of(w: Floats) -> Block:
    """The rows of w (ROWS,BLOCK) by name."""
    return Block(
        w[0:9], w[9:18], w[18:27], w[27:36], w[36:45], w[45:51], w[51:54],
        w[54], w[55], w[56], w[57], w[58], w[59], w[60], w[61:],
    )  # fmt: skip


@_inlined
def nine(rows: Floats, i: int) -> Matrix:
    """The matrix, row by row, in column i of nine rows (9,BLOCK)."""
    return rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], rows[5, i], rows[6, i], rows[7, i], rows[8, i]


@_inlined
def write_nine(rows: Floats, i: int, a: Matrix) -> None:
    """Write the matrix a to column i of nine rows (9,BLOCK)."""
    rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i] = a[0], a[1], a[2], a[3], a[4]
    rows[5, i], rows[6, i], rows[7, i], rows[8, i] = a[5], a[6], a[7], a[8]


@_inlined
def six_of(rows: Floats, i: int) -> Symmetric:
    """The symmetric tensor in column i of six rows (6,BLOCK)."""
    return rows[0, i], rows[1, i], rows[2, i], rows[3, i], rows[4, i], rows[5, i]


@_inlined
def three(rows: Floats, k: int, i: int) -> Vector:
    """The vector in column i of the rows k to k + 2."""
    return rows[k, i], rows[k + 1, i], rows[k + 2, i]


@_inlined
def write_three(rows: Floats, k: int, i: int, a: Vector) -> None:
    """Write the vector a to column i of the rows k to k + 2."""
    rows[k, i], rows[k + 1, i], rows[k + 2, i] = a


@_inlined
def gather(
    first: int, hi: int, laws: Laws, s: Sides, m: Motion, d: Deformation, state: State, plastic: Floats, b: Block
) -> int:
    """Fill b with F, R and stress at n and the sides of the points first to first + BLOCK - 1. Returns their largest number of sides.

    A block with fewer points is filled up with copies of the last point, hi - 1: the results of a point do not depend on its block.
    """
    most = 0
    for i in range(BLOCK):
        a = min(first + i, hi - 1)
        begin = s.first[a]
        count = s.first[a + 1] - begin
        for q in range(count):
            k, row = begin + q, SIDE * q
            j = s.neighbour[k]
            write_three(b.sides, row + DX, i, apart(m.X, a, j))
            write_three(b.sides, row + DU, i, apart(m.x, a, j))
            write_three(b.sides, row + EP, i, vector_of(plastic, k))
            write_three(b.sides, row + G, i, vector_of(s.gradient, k))
            b.sides[row + W, i] = s.w[k]
        for q in range(count, MOST_SIDES):
            write_three(b.sides, SIDE * q + G, i, (0.0, 0.0, 0.0))
            b.sides[SIDE * q + W, i] = 0.0
        most = max(most, count)
        write_nine(b.F, i, matrix_of(d.F, a))
        write_nine(b.R, i, matrix_of(d.R, a))
        for c in range(6):
            b.S[c, i] = state.stress[a, c]
        b.shear[i] = laws[state.law_of[a]].G
    return most


@_inlined
def deform(most: int, b: Block) -> None:
    """Write U at n to b.before, and F, R and U at n+1 to b. R is found for each point as in `compiled_kernels.rotation`."""
    for i in range(BLOCK):
        write_nine(b.before, i, product(transposed(nine(b.R, i)), nine(b.F, i)))
        write_nine(b.F, i, ZERO)
        b.turns[i] = 1.0
    for q in range(most):
        row = SIDE * q
        for i in range(BLOCK):
            write_nine(b.F, i, add_outer(nine(b.F, i), three(b.sides, row + DU, i), three(b.sides, row + G, i)))
    for sweep in range(SWEEPS):
        for i in range(BLOCK):
            U = product(transposed(nine(b.R, i)), nine(b.F, i))
            write_nine(b.U, i, U)
            b.omega[0, i], b.omega[1, i], b.omega[2, i], b.square[i] = correction(U)
        turning = False
        for i in range(BLOCK):
            if b.square[i] < TURNED * TURNED:
                b.turns[i] = 0.0
            turning = turning or b.turns[i] > 0.0
        if not turning:
            break
        for i in range(BLOCK):
            c = b.turns[i]
            write_nine(b.R, i, product(nine(b.R, i), cayley(c * b.omega[0, i], c * b.omega[1, i], c * b.omega[2, i])))
        for i in range(BLOCK):
            if sweep == 0 and not b.square[i] < FAR * FAR:
                write_nine(b.R, i, polar(nine(b.F, i)))
            if b.square[i] < NEAR * NEAR:
                b.turns[i] = 0.0


@_inlined
def strain(b: Block) -> None:
    """Write the trial deviator to b.S, J to b.J and the inverse of U at n+1 to b.B."""
    for i in range(BLOCK):
        U = nine(b.U, i)
        # dt Udot B at n+1/2 is (U - U_n) ((U + U_n) / 2)^-1 = 4 U (U + U_n)^-1 - 2; the last term has no deviator
        both, _ = inverse(sum_of(U, nine(b.before, i)))
        S = trial(six_of(b.S, i), 8.0 * b.shear[i], product(U, both))
        b.S[0, i], b.S[1, i], b.S[2, i], b.S[3, i], b.S[4, i], b.S[5, i] = S
        B, b.J[i] = inverse(U)
        write_nine(b.B, i, B)


@_inlined
def residuals(most: int, b: Block) -> None:
    """Write to b: the elastic residuals e = R^T (x_j - x_i - F (X_j - X_i)) - e_p of up to `most` sides of each point, to the rows DU;
    sum e_p x w e to omega, sum w e^2 to square, sum w |X_j - X_i|^2 to span, and sum w e (x) (X_j - X_i) to U."""
    for i in range(BLOCK):
        b.square[i] = b.span[i] = b.omega[0, i] = b.omega[1, i] = b.omega[2, i] = 0.0
        write_nine(b.U, i, ZERO)
    for q in range(most):
        row = SIDE * q
        for i in range(BLOCK):
            X, x, p, w = (
                three(b.sides, row + DX, i), three(b.sides, row + DU, i), three(b.sides, row + EP, i), b.sides[row + W, i]
            )  # fmt: skip
            f0, f1, f2 = applied(nine(b.F, i), X[0], X[1], X[2])
            e0, e1, e2 = applied(transposed(nine(b.R, i)), x[0] - f0, x[1] - f1, x[2] - f2)
            e = e0 - p[0], e1 - p[1], e2 - p[2]
            write_three(b.sides, row + DU, i, e)
            b.square[i] += w * dot(e, e)
            b.span[i] += w * dot(X, X)
            w0, w1, w2 = w * e[0], w * e[1], w * e[2]
            b.omega[0, i] += p[1] * w2 - p[2] * w1
            b.omega[1, i] += p[2] * w0 - p[0] * w2
            b.omega[2, i] += p[0] * w1 - p[1] * w0
            write_nine(b.U, i, add_outer(nine(b.U, i), (w0, w1, w2), X))


@_inlined
def forces(most: int, V: float, across: float, b: Block) -> None:
    """After the radial return, write the plastic residuals to the rows EP, side_force = stiffness w R e - Q g to the rows DU, and Q to
    b.B. V (m3): volume of a point; across: stiffness of a residual divided by the shear modulus."""
    for i in range(BLOCK):
        R, c, stiffness = nine(b.R, i), -V * b.J[i], V * across * b.shear[i] / b.span[i] * b.back[i]
        t = 0.5 * stiffness / c  # a skew stress that balances the moment of the residuals
        t0, t1, t2 = t * b.omega[0, i], t * b.omega[1, i], t * b.omega[2, i]
        b.S[0, i], b.S[3, i], b.S[5, i] = b.S[0, i] + b.mean[i], b.S[3, i] + b.mean[i], b.S[5, i] + b.mean[i]
        xx, xy, xz, yy, yz, zz = six_of(b.S, i)
        P = product(product(R, (xx, xy - t2, xz + t1, xy + t2, yy, yz - t0, xz - t1, yz + t0, zz)), nine(b.B, i))
        H = product(R, nine(b.U, i))  # the forces of the residuals act on F, too
        write_nine(b.B, i, sum_of(scaled(c, P), scaled(stiffness, H)))
        b.span[i] = stiffness
    for q in range(most):
        row = SIDE * q
        for i in range(BLOCK):
            e, p, g = three(b.sides, row + DU, i), three(b.sides, row + EP, i), three(b.sides, row + G, i)
            lost, c = 1.0 - b.back[i], b.span[i] * b.sides[row + W, i]
            write_three(b.sides, row + EP, i, (p[0] + lost * e[0], p[1] + lost * e[1], p[2] + lost * e[2]))
            r, s = applied(nine(b.R, i), c * e[0], c * e[1], c * e[2]), applied(nine(b.B, i), g[0], g[1], g[2])
            write_three(b.sides, row + DU, i, (r[0] - s[0], r[1] - s[1], r[2] - s[2]))


@_inlined
def scatter(
    first: int, hi: int, s: Sides, d: Deformation, state: State, plastic: Floats, side_force: Floats, b: Block
) -> None:
    """Write F, R, stress, plastic residuals and forces of the sides of a block to the arrays of all points."""
    for i in range(min(BLOCK, hi - first)):
        a = first + i
        begin = s.first[a]
        for q in range(s.first[a + 1] - begin):
            k, row = begin + q, SIDE * q
            if b.back[i] < 1.0:  # else they have not changed
                plastic[k, 0], plastic[k, 1], plastic[k, 2] = three(b.sides, row + EP, i)
            side_force[k, 0], side_force[k, 1], side_force[k, 2] = three(b.sides, row + DU, i)
        write_matrix(d.F, a, nine(b.F, i))
        write_matrix(d.R, a, nine(b.R, i))
        for c in range(6):
            state.stress[a, c] = b.S[c, i]
