"""Passes of the conduction among points (`particle.heat`), over ranges [lo, hi) of points (numba).

start (n+1,), columns (m,), weights (m,4): the operators G (x, y, z, 1/m) and R of `heat.PointConduction` in one list of rows. The other
way around: start, rows, weights of their transposed. D, kD (n,6): symmetric tensors xx yy zz yz xz xy. SI units.
"""

from ..compiling import njit
from ..core.arrays import Arrays, Floats, Ints, Laws
from ..core.loops import ranges
from ..physics.constitutive import conductivity, heat_capacity

LEAST_POINTS = 200  # in a range of a loop that threads share
SMOOTHING = 0.5  # c, in units of V tr(k J F^-1 F^-T) / spacing^2
LEAST_J = 0.1  # volume ratio: a smaller one is an error of the gradient


@njit(cache=True, nogil=True, error_model="numpy")
def pull_back(
    lo: int, hi: int, start: Ints, columns: Ints, weights: Floats, x: Floats, volume: Floats, D: Floats
) -> None:
    """V J F^-1 F^-T = V cof(F)^T cof(F) / J into D, with F = G x."""
    for i in range(lo, hi):
        f00 = f01 = f02 = f10 = f11 = f12 = f20 = f21 = f22 = 0.0
        for s in range(start[i], start[i + 1]):
            j = columns[s]
            g0, g1, g2 = weights[s, 0], weights[s, 1], weights[s, 2]
            f00, f01, f02 = f00 + g0 * x[j, 0], f01 + g1 * x[j, 0], f02 + g2 * x[j, 0]
            f10, f11, f12 = f10 + g0 * x[j, 1], f11 + g1 * x[j, 1], f12 + g2 * x[j, 1]
            f20, f21, f22 = f20 + g0 * x[j, 2], f21 + g1 * x[j, 2], f22 + g2 * x[j, 2]
        a0, a1, a2 = f11 * f22 - f21 * f12, f21 * f02 - f01 * f22, f01 * f12 - f11 * f02
        b0, b1, b2 = f12 * f20 - f22 * f10, f22 * f00 - f02 * f20, f02 * f10 - f12 * f00
        c0, c1, c2 = f10 * f21 - f20 * f11, f20 * f01 - f00 * f21, f00 * f11 - f10 * f01
        J = max(f00 * a0 + f10 * a1 + f20 * a2, LEAST_J)
        V = volume[i]
        D[i, 0], D[i, 1] = V * ((a0 * a0 + a1 * a1 + a2 * a2) / J), V * ((b0 * b0 + b1 * b1 + b2 * b2) / J)
        D[i, 2], D[i, 3] = V * ((c0 * c0 + c1 * c1 + c2 * c2) / J), V * ((b0 * c0 + b1 * c1 + b2 * c2) / J)
        D[i, 4], D[i, 5] = V * ((a0 * c0 + a1 * c1 + a2 * c2) / J), V * ((a0 * b0 + a1 * b1 + a2 * b2) / J)


@njit(cache=True, nogil=True)
def weigh(
    lo: int, hi: int, laws: Laws, spacing: float, volume: Floats, T: Floats, D: Floats, reach: Floats, kD: Floats, c: Floats,
    capacity: Floats, q: Floats,
) -> None:  # fmt: skip
    """kD W m, c W/K and capacity J/K of points at T (n,) K; q (n,4): what flows at the most where neighbours differ by 1 K.

    reach (n,4): sums of the absolute weights of each row.
    """
    law = laws[0]
    for i in range(lo, hi):
        capacity[i] = law.rho * volume[i] * heat_capacity(law, T[i])
        k = conductivity(law, T[i])
        for d in range(6):
            kD[i, d] = k * D[i, d]
        xx, yy, zz, yz, xz, xy = kD[i, 0], kD[i, 1], kD[i, 2], abs(kD[i, 3]), abs(kD[i, 4]), abs(kD[i, 5])
        c[i] = SMOOTHING * (xx + yy + zz) / (spacing * spacing)
        g0, g1, g2 = reach[i, 0], reach[i, 1], reach[i, 2]
        q[i, 0], q[i, 1], q[i, 2] = (
            xx * g0 + xy * g1 + xz * g2,
            xy * g0 + yy * g1 + yz * g2,
            xz * g0 + yz * g1 + zz * g2,
        )
        q[i, 3] = c[i] * reach[i, 3]


@njit(cache=True, nogil=True)
def fastest(lo: int, hi: int, start: Ints, rows: Ints, weights: Floats, q: Floats, capacity: Floats) -> float:
    """A bound on the fastest decay, 1/s (Gershgorin, with the absolute values of the operators)."""
    most = 0.0
    for i in range(lo, hi):
        total = 0.0
        for s in range(start[i], start[i + 1]):
            j = rows[s]
            for d in range(4):
                total += abs(weights[s, d]) * q[j, d]
        most = max(most, total / capacity[i])
    return most


@njit(cache=True, nogil=True)
def flow_of_points(
    lo: int, hi: int, start: Ints, columns: Ints, weights: Floats, T: Floats, kD: Floats, c: Floats, q: Floats
) -> None:
    """kD G T and c R T into q (n,4)."""
    for i in range(lo, hi):
        g0 = g1 = g2 = r = 0.0
        for s in range(start[i], start[i + 1]):
            t = T[columns[s]]
            g0, g1, g2, r = (
                g0 + weights[s, 0] * t,
                g1 + weights[s, 1] * t,
                g2 + weights[s, 2] * t,
                r + weights[s, 3] * t,
            )
        xx, yy, zz, yz, xz, xy = kD[i, 0], kD[i, 1], kD[i, 2], kD[i, 3], kD[i, 4], kD[i, 5]
        q[i, 0], q[i, 1], q[i, 2] = (
            xx * g0 + xy * g1 + xz * g2,
            xy * g0 + yy * g1 + yz * g2,
            xz * g0 + yz * g1 + zz * g2,
        )
        q[i, 3] = c[i] * r


@njit(cache=True, nogil=True)
def collect(
    lo: int,
    hi: int,
    dt: float,
    start: Ints,
    rows: Ints,
    weights: Floats,
    q: Floats,
    capacity: Floats,
    gained: Floats,
    T: Floats,
) -> None:
    """Heat of the flow q over dt s, minus G^T q[:, :3] + R^T q[:, 3], added to gained (n,) J, and its rise of T (n,) K."""
    for i in range(lo, hi):
        a0 = a1 = a2 = r = 0.0
        for s in range(start[i], start[i + 1]):
            j = rows[s]
            a0, a1, a2 = a0 + weights[s, 0] * q[j, 0], a1 + weights[s, 1] * q[j, 1], a2 + weights[s, 2] * q[j, 2]
            r += weights[s, 3] * q[j, 3]
        heat = dt * (-(a0 + a1 + a2) - r)
        gained[i] += heat
        T[i] += heat / capacity[i]


@njit(cache=True, nogil=True)
def prepare(team: Ints, n: int, of_tensor: Arrays, of_point: Arrays, of_bound: Arrays, rates: Floats) -> None:
    """`pull_back`, `weigh` and `fastest` of n points in all threads; rates (PARTS,) 1/s: the last, part by part."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        pull_back(lo, hi, *of_tensor)
        weigh(lo, hi, *of_point)
    for lo, hi, part in ranges(team, 1, n, LEAST_POINTS):
        rates[part] = fastest(lo, hi, *of_bound)


@njit(cache=True, nogil=True)
def conduct(team: Ints, n: int, of_flow: Arrays, of_heat: Arrays) -> None:
    """`flow_of_points` and `collect` of n points in all threads."""
    for lo, hi, _ in ranges(team, 0, n, LEAST_POINTS):
        flow_of_points(lo, hi, *of_flow)
    for lo, hi, _ in ranges(team, 1, n, LEAST_POINTS):
        collect(lo, hi, *of_heat)
