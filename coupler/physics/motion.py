"""What both domains do with positions, velocities and forces: arrays (n,3), rows [lo, hi), SI units (numba)."""

from numba import njit

from ..state.arrays import Floats


@njit(cache=True, nogil=True)
def kick(lo: int, hi: int, dt: float, f: Floats, inv_mass: Floats, v: Floats) -> None:
    """v += dt f / m; held nodes have inv_mass 0."""
    for a in range(lo, hi):
        w = dt * inv_mass[a]
        v[a, 0] += w * f[a, 0]
        v[a, 1] += w * f[a, 1]
        v[a, 2] += w * f[a, 2]


@njit(cache=True, nogil=True)
def drift(lo: int, hi: int, dt: float, v: Floats, x: Floats) -> None:
    """x += dt v."""
    for a in range(lo, hi):
        x[a, 0] += dt * v[a, 0]
        x[a, 1] += dt * v[a, 1]
        x[a, 2] += dt * v[a, 2]


@njit(cache=True, nogil=True)
def work_of(lo: int, hi: int, dt: float, f_old: Floats, f: Floats, v: Floats) -> float:
    """Work of forces over a step, sum of dt (f_old + f)/2 . v with v at mid-step, in J."""
    total = 0.0
    for a in range(lo, hi):
        for d in range(3):
            total += (f_old[a, d] + f[a, d]) * v[a, d]
    return 0.5 * dt * total
