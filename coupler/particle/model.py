"""Arrays of a particle, as arguments of its kernels. n: number of points of this rank; N: n plus the number of copies of points on
other ranks that are neighbours of these points.

The letters are those of the equations in `particle.compiled_kernels`. A side ij is a point i together with one neighbour j: each
pair of neighbours has two sides, ij and ji. The force on point i by point j is side_force_ij - side_force_ji; pass 2 of
`compiled_kernels` adds the forces along x_j - x_i. side_force (s,3) N has a row for each side of the points of this rank, then for the
sides that it gets from other ranks; the row ij is computed with point i. SI units.
"""

from typing import NamedTuple

from ..core.arrays import Floats, Ints


class Scheme(NamedTuple):
    """Constants of the scheme. V (m3): volume of each point; h (m): distance at which the kernel is zero; H (Pa): hardening modulus:
    LAMMPS stores the yield stress as the plastic strain sigma_y / H; Q1, Q2, hourglass: coefficients of MACHDYN."""

    V: float
    h: float
    H: float
    Q1: float
    Q2: float
    hourglass: float


class Step(NamedTuple):
    """A time step of dt (s) from n to n+1. is_last: the last of a chunk, whose forces also act in the half step after it."""

    dt: float
    is_last: bool


class Sides(NamedTuple):
    """Neighbours of the points, in arrays (sides,). The rows first[i] to first[i + 1] - 1 belong to point i, in the order of the
    neighbours' numbers. From row later[i] on, the neighbours have greater numbers than i. Shapes: first (n+1,), later (n,).

    neighbour: index of the neighbour; reverse: row of the other side of the pair in side_force; w (1/m5): W'/r, with the derivative W'
    of the kernel at the reference distance r; gradient (sides,3) 1/m: weights g_ij, where the sum over j of (u_j - u_i) (x) g_ij is the
    gradient of a field u. From the mean properties of the two points: slope (kg/m): factor W' m^2 / rho of MACHDYN's forces; c (m/s):
    longitudinal wave speed.
    """

    first: Ints
    later: Ints
    neighbour: Ints
    reverse: Ints
    w: Floats
    gradient: Floats
    slope: Floats
    c: Floats


class Control(NamedTuple):
    """Data of each side for MACHDYN's hourglass control, (sides,): distance r0 (m) and kernel W (1/m3) in the reference configuration,
    and Young's modulus E (Pa), the mean of both points."""

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
    step; hourglass control is viscous where `effective` is large, else elastic."""

    F: Floats
    R: Floats
    effective: Floats


class State(NamedTuple):
    """State of the law at n points. law_of (n,): index of the law of each point; sigma_y (Pa): yield stress; eps_p, rate (1/s):
    plastic strain and its rate; T (K); J: volume ratio; p (Pa): pressure; energy (of `pressure`), work (plastic), J per reference m3;
    stress (n,6) Pa: unrotated Cauchy stress, in the order xx xy xz yy yz zz of LAMMPS; eps_gradient (n,3) 1/m: gradient of eps_p."""

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
    the last step, zero before the first step of a chunk; in the enriched scheme only for sides ij with a greater number of j than
    of i; work (2,n) J: energy dissipated in the chunk, half of each pair at each of its points."""

    strength: Floats
    work: Floats


class Residuals(NamedTuple):
    """Residuals of the sides. plastic (sides,3) m: plastic part e_p of each; unseen (n,) J/m3: their elastic energy at each point."""

    plastic: Floats
    unseen: Floats
