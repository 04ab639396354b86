"""The arrays of a particle, as its kernels take them. n: points of this rank; N: these and the neighbours' copies of other ranks.

The letters are those of the equations, see `particle.compiled_kernels`. A side is a neighbour as seen from a point; a pair has two. SI
units.
"""

from typing import NamedTuple

from ..core.arrays import Floats, Ints


class Scheme(NamedTuple):
    """V m3 and rho kg/m3 of each point; h m: reach of the kernel; c m/s: longitudinal wave speed; E Pa: Young's modulus; H Pa: of the
    linear hardening through which LAMMPS keeps the yield stress; Q1, Q2, hourglass: MACHDYN's coefficients."""

    V: float
    rho: float
    h: float
    c: float
    E: float
    H: float
    Q1: float
    Q2: float
    hourglass: float


class Sides(NamedTuple):
    """Neighbours of the points: of point i the rows first[i] to first[i + 1], first (n+1,), of arrays (sides,). neighbour: its number;
    pair: the row of the pair, ~row where i is the second point; w 1/m5: W'/r; gradient (sides,3) 1/m: g."""

    first: Ints
    neighbour: Ints
    pair: Ints
    w: Floats
    gradient: Floats


class Pairs(NamedTuple):
    """points (m,2): the first and the second point of each; sides (m,2): the row of each one's side, those of other ranks' points after
    the own; r0 m, w 1/m5, W 1/m3 (m,): distance, W'/r and W of the reference; gradient (m,6) 1/m: g_ij and g_ji."""

    points: Ints
    sides: Ints
    r0: Floats
    w: Floats
    W: Floats
    gradient: Floats


class Motion(NamedTuple):
    """(N,3): reference positions X m, positions x m and velocities v m/s at n+1, velocities v_half m/s at n+1/2."""

    X: Floats
    x: Floats
    v: Floats
    v_half: Floats


class Deformation(NamedTuple):
    """F (N,9) and its rotation R (n,9), row by row; Q (N,9) J: minus the derivative of a point's energy by F, to which its forces go
    with g; effective (N,): sigma_y / H and the plastic strain of the step, by which MACHDYN chooses its hourglass control."""

    F: Floats
    R: Floats
    Q: Floats
    effective: Floats


class State(NamedTuple):
    """The state of the law, (n,): sigma_y Pa; eps_p; rate 1/s; T K; J; p Pa; energy and plastic work J per reference m3. stress (n,6)
    Pa: unrotated Cauchy stress, xx xy xz yy yz zz, as LAMMPS keeps it; eps_gradient (n,3) 1/m."""

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
    """Losses by viscosity and by hourglass control, (m,2): strength N/m of their forces over x_j - x_i, of the last step of the chunk,
    zero before the first; work J that they have dissipated in the chunk."""

    strength: Floats
    work: Floats


class Residuals(NamedTuple):
    """Residuals of sides: plastic (sides,3) m: e_p; force (own and other ranks' sides,3) N. unseen (n,) J/m3: elastic energy."""

    plastic: Floats
    force: Floats
    unseen: Floats
