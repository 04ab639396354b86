"""Operations on positions, velocities and forces (n,3) for both domains. A kernel works on rows [lo, hi). SI units (numba)."""

from ..compiling import njit
from ..core.arrays import Bools, Floats, Ints, Vector
from ..core.loops import ranges

LEAST = 2000  # rows in a range of a shared loop, at least


@njit(cache=True, nogil=True)
def kick(lo: int, hi: int, dt: float, f: Floats, inv_mass: Floats, v: Floats) -> None:
    """Accelerate: v += dt f / m; fixed nodes have inv_mass 0."""
    for a in range(lo, hi):
        w = dt * inv_mass[a]
        v[a, 0] += w * f[a, 0]
        v[a, 1] += w * f[a, 1]
        v[a, 2] += w * f[a, 2]


@njit(cache=True, nogil=True)
def drift(lo: int, hi: int, dt: float, v: Floats, x: Floats) -> None:
    """Move: x += dt v."""
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


@njit(cache=True, nogil=True)
def book(lo: int, hi: int, dt: float, f_old: Floats, f: Floats, v: Floats, more: Floats) -> float:
    """Return the work (J) of the rows as `work_of`. Then copy f to f_old, add `more` (external forces) to f, and set `more` to 0."""
    work = work_of(lo, hi, dt, f_old, f, v)
    for a in range(lo, hi):
        for d in range(3):
            f_old[a, d] = f[a, d]
            f[a, d], more[a, d] = f[a, d] + more[a, d], 0.0
    return work


@njit(cache=True, nogil=True)
def book_all(team: Ints, dt: float, f_old: Floats, f: Floats, v: Floats, more: Floats, work: Floats) -> None:
    """Do `book` for all rows, in all threads, and write the work of each part of the rows to work (PARTS,) J."""
    for lo, hi, part in ranges(team, 0, len(f), LEAST):
        work[part] = book(lo, hi, dt, f_old, f, v, more)


@njit(cache=True, nogil=True)
def begin_step(lo: int, hi: int, dt: float, mass: Floats, f: Floats, x: Floats, v: Floats, ahead: Floats) -> None:
    """First part of a velocity Verlet step (`fix smd/integrate_tlsph`): v at n+1/2, x at n+1, estimate of v at n+1 in `ahead`."""
    for a in range(lo, hi):
        half = 0.5 * dt / mass[a]
        for d in range(3):
            v[a, d] += half * f[a, d]
            ahead[a, d] = v[a, d] + half * f[a, d]
            x[a, d] += dt * v[a, d]


@njit(cache=True, nogil=True)
def begin_all(team: Ints, dt: float, mass: Floats, f: Floats, x: Floats, v: Floats, ahead: Floats) -> None:
    """Do `begin_step` for all rows, in all threads."""
    for lo, hi, _ in ranges(team, 0, len(f), LEAST):
        begin_step(lo, hi, dt, mass, f, x, v, ahead)


@njit(cache=True, nogil=True)
def end_all(
    team: Ints, dt: float, is_last: bool, mass: Floats, f_old: Floats, f: Floats, more: Floats, x: Floats, v: Floats, ahead: Floats,
    work: Floats,
) -> None:  # fmt: skip
    """Do `book_all`, then compute v at n+1. Unless the step is the last one, do `begin_step` of the next step. In all threads."""
    for lo, hi, part in ranges(team, 0, len(f), LEAST):
        work[part] = book(lo, hi, dt, f_old, f, v, more)
        for a in range(lo, hi):
            half = 0.5 * dt / mass[a]
            for d in range(3):
                v[a, d] += half * f[a, d]
        if not is_last:
            begin_step(lo, hi, dt, mass, f, x, v, ahead)


@njit(cache=True, nogil=True)
def add_up(
    team: Ints, n: int, dt: float, f_old: Floats, f: Floats, v: Floats, more: Floats, total: Floats, work: Floats
) -> None:
    """Write f + more to the first n rows of total. Write the work of f (`work_of`) on each part of these rows to work (PARTS,) J."""
    for lo, hi, part in ranges(team, 0, n, LEAST):
        work[part] = work_of(lo, hi, dt, f_old, f, v)
        for a in range(lo, hi):
            for d in range(3):
                total[a, d] = f[a, d] + more[a, d]


@njit(cache=True, nogil=True)
def sum_over(lo: int, hi: int, f: Floats) -> Vector:
    """Sum of the rows lo to hi - 1 of f."""
    x = y = z = 0.0
    for a in range(lo, hi):
        x += f[a, 0]
        y += f[a, 1]
        z += f[a, 2]
    return x, y, z


@njit(cache=True, nogil=True)
def sum_at(rows: Ints, f: Floats) -> Vector:
    """Sum of those rows of f that the array `rows` lists."""
    x = y = z = 0.0
    for q in range(len(rows)):
        a = rows[q]
        x += f[a, 0]
        y += f[a, 1]
        z += f[a, 2]
    return x, y, z


@njit(cache=True, nogil=True)
def add_drag(rows: Ints, matrix: Floats, v: Floats, drag: Floats, total: Floats) -> float:
    """Write the forces of dashpots, -matrix (k,3,3) kg/s times v of `rows` (k,), to drag (k,3) N, and add them to total.

    Returns the sum of (old drag + new drag) . v, W.
    """
    power = 0.0
    for q in range(len(rows)):
        a, m = rows[q], matrix[q]
        for d in range(3):
            force = -(m[d, 0] * v[a, 0] + m[d, 1] * v[a, 1] + m[d, 2] * v[a, 2])
            power += (force + drag[q, d]) * v[a, d]
            drag[q, d] = force
            total[a, d] += force
    return power


@njit(cache=True, nogil=True)
def damp(
    lo: int, hi: int, free: Bools, dt: float, damping: float, f: Floats, along: Floats, v: Floats, momentum: Floats
) -> None:
    """Update v and the momentum M v of the free rows by a damped step: (1 + a) v' = (1 - a) v + dt M^-1 f.

    Afterwards M v is complete, but v contains only the part `along` (m/s2) of M^-1 f; `kick` adds the other part, f divided by the
    masses of the nodes. damping: a, relative to the critical damping of the step; a does not change the stable time step.
    """
    keep, add = (1.0 - damping) / (1.0 + damping), dt / (1.0 + damping)
    for a in range(lo, hi):
        if free[a]:
            for d in range(3):
                v[a, d] = keep * v[a, d] + add * along[a, d]
                momentum[a, d] = keep * momentum[a, d] + add * f[a, d]


@njit(cache=True, nogil=True)
def moving(
    team: Ints, free: Bools, mass: Floats, f: Floats, along: Floats, momentum: Floats, v: Floats, before: Floats, sums: Floats
) -> None:  # fmt: skip
    """Sums over the free rows, by parts, in sums (PARTS,3): momentum . v (J), -v . (f - before) (W) and f . M^-1 f (N m/s2). M^-1 f
    is f divided by the masses of the nodes, plus `along` (m/s2). Then f is copied to `before`."""
    for lo, hi, part in ranges(team, 0, len(free), LEAST):
        twice = power = unbalanced = 0.0
        for a in range(lo, hi):
            if free[a]:
                for d in range(3):
                    twice += momentum[a, d] * v[a, d]
                    power -= v[a, d] * (f[a, d] - before[a, d])
                    unbalanced += f[a, d] * (f[a, d] / mass[a] + along[a, d])
                    before[a, d] = f[a, d]
        sums[part, 0], sums[part, 1], sums[part, 2] = twice, power, unbalanced
