"""Arrays of a particle, as arguments of its kernels. n: number of points of this rank; N: number of these points and of copies of
neighbours on other ranks.

The letters are those of the equations in `particle.compiled_kernels`. A side is one point of a pair with the other as its
neighbour: each pair has two sides. SI units.
"""

from typing import NamedTuple

from ..core.arrays import Floats, Ints


class Scheme(NamedTuple):
    """Constants of the scheme. V (m3): volume of each point; h (m): radius of the kernel; H (Pa): modulus of the linear hardening by
    which LAMMPS stores the yield stress; Q1, Q2, hourglass: coefficients of MACHDYN."""

    V: float
    h: float
    H: float
    Q1: float
    Q2: float
    hourglass: float


class Sides(NamedTuple):
    """Neighbours of the points. Point i has the rows first[i] to first[i + 1] of the arrays (sides,); first (n+1,). neighbour: number
    of the neighbour; pair: row of the pair, ~row if i is the second point of the pair; w (1/m5): W'/r; gradient (sides,3) 1/m: g."""

    first: Ints
    neighbour: Ints
    pair: Ints
    w: Floats
    gradient: Floats


class Pairs(NamedTuple):
    """Pairs of points. points (m,2): first and second point; sides (m,2): rows of their sides, sides of other ranks after the own
    ones; r0 m, w 1/m5, W 1/m3 (m,): distance, W'/r and W in the reference configuration; gradient (m,6) 1/m: g_ij and g_ji. For the
    mean of both materials: slope (m,) kg/m: factor W' m^2 / rho of MACHDYN's forces; c (m/s), E (Pa) (m,): longitudinal wave speed
    and Young's modulus."""

    points: Ints
    sides: Ints
    r0: Floats
    w: Floats
    W: Floats
    gradient: Floats
    slope: Floats
    c: Floats
    E: Floats


class Motion(NamedTuple):
    """Arrays (N,3): reference positions X (m); positions x (m) and velocities v (m/s) at n+1; velocities v_half (m/s) at n+1/2."""

    X: Floats
    x: Floats
    v: Floats
    v_half: Floats


class Deformation(NamedTuple):
    """Deformation gradients F (N,9) and their rotations R (n,9), row by row; Q (N,9) J: minus the derivative of a point's energy by F,
    the forces are Q g; effective (N,): sigma_y / H plus the plastic strain of the step, which selects MACHDYN's hourglass control."""

    F: Floats
    R: Floats
    Q: Floats
    effective: Floats


class State(NamedTuple):
    """State of the law at n points. law_of (n,): number of the law of each point; sigma_y (Pa); eps_p; rate (1/s); T (K); J; p (Pa);
    energy and plastic work (J per reference m3); stress (n,6) Pa: unrotated Cauchy stress in the order of LAMMPS, xx xy xz yy yz zz;
    eps_gradient (n,3) 1/m."""

    law_of: Ints
    stress: Floats
    sigma_y: Floats
    eps_p: Floats
    rate: Floats
    T: Floats
    J: Floats
    p: Floats
    energy: Floats
    work: Floats
    eps_gradient: Floats


class Losses(NamedTuple):
    """Losses of m pairs; columns: viscosity, hourglass control. strength (m,2) N/m: force divided by distance in the last step, zero
    before the first step of a chunk; work (m,2) J: energy dissipated in the chunk."""

    strength: Floats
    work: Floats


class Residuals(NamedTuple):
    """Residuals of sides. plastic (sides,3) m: e_p; force (s,3) N: force of own sides, then of sides of other ranks; unseen (n,)
    J/m3: elastic energy."""

    plastic: Floats
    force: Floats
    unseen: Floats
