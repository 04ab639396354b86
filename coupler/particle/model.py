"""Arrays of a particle, as arguments of its kernels. n: number of points of this rank; N: number of these points and of copies of
neighbours on other ranks.

The letters are those of the equations in `particle.compiled_kernels`. A side is one point of a pair with the other as its
neighbour: each pair has two sides. The force on point i by point j is
side_force_ij - side_force_ji plus the forces along x_j - x_i. side_force (s,3) N has the sides of this rank, then those of other ranks;
each depends on the state of one point only. SI units.
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
    """Neighbours of the points. Point i has the rows first[i] to first[i + 1] of the arrays (sides,); first (n+1,).

    neighbour: number of the neighbour; reverse: row of the other side of the pair, sides of other ranks after the own ones; w (1/m5):
    W'/r; gradient (sides,3) 1/m: g. For the mean of both materials: slope (kg/m): factor W' m^2 / rho of MACHDYN's forces; c (m/s):
    longitudinal wave speed.
    """

    first: Ints
    neighbour: Ints
    reverse: Ints
    w: Floats
    gradient: Floats
    slope: Floats
    c: Floats


class Control(NamedTuple):
    """What MACHDYN's hourglass control knows of the sides (sides,): distance r0 (m) and W (1/m3) in the reference configuration, and
    Young's modulus E (Pa), the mean of both materials."""

    r0: Floats
    W: Floats
    E: Floats


class Motion(NamedTuple):
    """Arrays (N,3): reference positions X (m); positions x (m) and velocities v (m/s) at n+1; velocities v_half (m/s) at n+1/2."""

    X: Floats
    x: Floats
    v: Floats
    v_half: Floats


class Deformation(NamedTuple):
    """Deformation gradients F (N,9) and their rotations R (n,9), row by row; effective (N,): sigma_y / H plus the plastic strain of the
    step, which selects MACHDYN's hourglass control."""

    F: Floats
    R: Floats
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
    """Losses by viscosity (row 0) and hourglass control (row 1). strength (1 or 2,sides) N/m: force of each side divided by distance in
    the last step, zero before the first step of a chunk; work (2,n) J: energy dissipated in the chunk, half of each pair at each of
    its points."""

    strength: Floats
    work: Floats


class Residuals(NamedTuple):
    """Residuals of sides. plastic (sides,3) m: e_p; unseen (n,) J/m3: elastic energy."""

    plastic: Floats
    unseen: Floats
