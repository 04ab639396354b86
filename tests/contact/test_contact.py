"""Contact alone: conservation to rounding, energy, Coulomb's law, the search against brute force."""

from typing import Any

import numpy as np
import pytest

from coupler.contact import bond_kernels, broad, closest, kernels
from coupler.contact.contact import Contact
from coupler.contact.law import TANGENTIAL, stiffness, stored
from coupler.contact.model import ANY, Candidates, Nodes, Points, Projections, faces_of
from coupler.core.records import copied
from coupler.errors import SolverError
from coupler.fe.mesh import prepare
from coupler.geometry import mesher


def sheet(rng: np.random.Generator, n: int = 12, bumps: float = 0.0) -> tuple[np.ndarray, np.ndarray]:
    """A bumpy triangulated square, normals upwards: nodes (N,3), triangles (k,3)."""
    g = np.linspace(-1, 1, n)
    x = np.stack([*(a.ravel() for a in np.meshgrid(g, g, indexing="ij")), np.zeros(n * n)], axis=1)
    x[:, 2] = bumps * rng.standard_normal(n * n)
    i = np.arange(n * n).reshape(n, n)
    a, b, c, d = (q.ravel() for q in (i[:-1, :-1], i[1:, :-1], i[1:, 1:], i[:-1, 1:]))
    return x, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)])


def make(points: int, facets: np.ndarray, friction: float = 0.5, jump: float = np.inf) -> Contact:
    k = stiffness(bulk_modulus=1e9, area=0.01, spacing=0.1)
    return Contact(np.zeros(points, int), facets, np.ones(len(facets), int), [k], [0.1], friction, jump=jump)


def forces(
    c: Contact, dt: float, xp: np.ndarray, x: np.ndarray, vp: np.ndarray | None = None, v: np.ndarray | None = None
) -> tuple[np.ndarray, np.ndarray]:
    """Those on points and nodes at these places, with these velocities (default: at rest)."""
    p, nodes = c.points, Nodes(x, np.zeros_like(x) if v is None else v, np.zeros_like(x), len(x))
    p.x[:], p.v[:], p.f[:] = xp, 0.0 if vp is None else vp, 0.0
    c.forces(dt, nodes)
    return p.f.copy(), nodes.f


def test_forces_and_moments_of_both_sides_cancel(rng: np.random.Generator) -> None:
    x, facets = sheet(rng, bumps=0.03)
    xp = rng.uniform(-0.9, 0.9, (200, 3)) * [1, 1, 0.06] - [0, 0, 0.03]
    vp, v = rng.standard_normal(xp.shape), rng.standard_normal(x.shape)
    c = make(len(xp), facets)
    c.search(xp, x, 0.0)
    for _ in range(3):  # the friction springs have something to remember
        fp, fn = forces(c, 1e-3, xp, x, vp, v)
    assert np.count_nonzero(c.depth) > 20
    scale = np.abs(fp).sum()
    assert np.abs(fp.sum(0) + fn.sum(0)).max() < 1e-13 * scale
    moment = np.cross(xp, fp).sum(0) + np.cross(x, fn).sum(0)
    assert np.abs(moment).max() < 1e-13 * scale
    tangential = c.history["spring"]
    assert np.all(np.linalg.norm(tangential, axis=1) <= 0.5 * c.stiffness * c.depth * (1 + 1e-12))


def test_rigid_motion_of_both_sides_is_no_slip(rng: np.random.Generator) -> None:
    x, facets = sheet(rng, bumps=0.02)
    xp = rng.uniform(-0.8, 0.8, (100, 3)) * [1, 1, 0.03] - [0, 0, 0.05]
    spin = rng.standard_normal(3)
    c = make(len(xp), facets)
    c.search(xp, x, 0.0)
    forces(c, 1e-3, xp, x, np.cross(spin, xp) + 3.0, np.cross(spin, x) + 3.0)
    assert np.count_nonzero(c.depth) > 20
    assert np.abs(c.history["spring"]).max() < 1e-9 * c.stiffness * c.depth.max()


def test_frictionless_bounce_gives_back_all_its_energy(rng: np.random.Generator) -> None:
    """A heavy point on a bumpy rigid sheet: kinetic plus penalty energy constant to the order of the integrator."""
    x, facets = sheet(rng, bumps=0.02)
    errors: list[float] = []
    finals: list[float] = []
    for dt in (2e-5, 1e-5):
        c = make(1, facets, friction=0.0)
        mass, xp, vp = 1.0, np.array([[0.03, -0.011, 0.1]]), np.array([[3.0, 1.0, -20.0]])
        force, start, worst = np.zeros((1, 3)), 0.5 * 1.0 * 410.0, 0.0
        for step in range(int(0.02 / dt)):
            if step % 10 == 0:
                c.search(xp, x, 0.02)
            vp = vp + 0.5 * dt * force / mass
            xp = xp + dt * vp
            force, _ = forces(c, dt, xp, x, vp)
            vp = vp + 0.5 * dt * force / mass
            worst = max(worst, abs(0.5 * mass * float(vp[0] @ vp[0]) + c.penalty_energy - start) / start)
        assert vp[0, 2] > 10.0  # it has bounced
        finals.append(abs(0.5 * mass * float(vp[0] @ vp[0]) - start) / start)
        errors.append(worst)
    assert errors[1] < 3e-3
    assert finals[1] < 3e-3  # a few crossings from facet to facet, each good to the order of dt
    assert errors[1] < 0.5 * errors[0]


def test_sliding_block_slows_down_by_coulombs_law_and_its_loss_is_the_heat(rng: np.random.Generator) -> None:
    x, facets = sheet(rng)
    mu, dt, mass = 0.3, 1e-5, 1.0
    c = make(1, facets, friction=mu)
    depth = 1e-5
    xp, vp = np.array([[-0.5, 0.02, -depth]]), np.array([[4.0, 0.0, 0.0]])
    normal = float(c.stiffness[0]) * depth
    force, heat, steps = np.zeros((1, 3)), 0.0, 600
    for step in range(steps):
        if step % 10 == 0:
            c.search(xp, x, 1e-2)
        warmth = c.sums.friction_heat
        force, _ = forces(c, dt, xp, x, vp)
        force[0, 2] = 0.0  # held at its depth
        vp = vp + dt * force / mass
        xp = xp + dt * vp
        heat += c.sums.friction_heat - warmth
    assert vp[0, 0] == pytest.approx(4.0 - mu * normal * steps * dt / mass, rel=2e-2)
    assert heat + c.penalty_energy - 0.5 * normal * depth == pytest.approx(
        0.5 * mass * (16.0 - vp[0, 0] ** 2), rel=2e-2
    )
    assert c.sums.friction_heat == pytest.approx(heat)
    assert c.heat_point.sum() + c.heat_face.sum() == pytest.approx(heat)


def test_a_small_pull_sticks(rng: np.random.Generator) -> None:
    x, facets = sheet(rng)
    c = make(1, facets)
    xp = np.array([[0.0, 0.01, -1e-3]])
    c.search(xp, x, 1e-2)
    f, _ = forces(c, 1e-6, xp, x, np.array([[1.0, 0, 0]]))
    assert f[0, 0] == pytest.approx(-TANGENTIAL * c.stiffness[0] * 1e-6)
    assert c.sums.friction_heat == 0.0


def test_what_a_point_ignores_of_a_body_stays_with_the_body() -> None:
    """A point in a floor and in a wall: as the order of the two changes its force goes on smoothly."""
    x = np.array(
        [[-5, -5, 0], [5, -5, 0], [5, 5, 0], [-5, 5, 0], [0, -5, -5], [0, 5, -5], [0, 5, 5], [0, -5, 5]], float
    )
    facets = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    contact = Contact(np.zeros(1, int), facets, np.array([1, 1, 2, 2]), [1.0], [1.0], 0.0, jump=np.inf)

    def force(of_wall: float, of_floor: float) -> np.ndarray:
        f, _ = forces(contact, 1.0, np.array([[-of_wall, 0.3, -of_floor]]), x)
        return f[0] / contact.stiffness

    contact.search(np.array([[-0.05, 0.3, -0.06]]), x, 0.5)
    force(0.05, 0.06)
    h = contact.history[0]
    assert h["body"].tolist() == [1, 2]
    h["depth"][1], h["ignored"][1] = 0.01, 0.04
    for of_wall in (0.05, 0.059, 0.061, 0.07, 0.061, 0.059, 0.05):
        assert force(of_wall, 0.06) == pytest.approx([of_wall - 0.04, 0.0, 0.06], abs=1e-12)
        assert h["body"][0] == (1 if of_wall < 0.06 else 2)
    assert contact.sums.dropped_energy == 0.0


def test_search_finds_every_pair_that_brute_force_finds(rng: np.random.Generator) -> None:
    xp = rng.uniform(-1, 1, (400, 3))
    low = rng.uniform(-1.5, 1, (300, 3))
    high = low + rng.uniform(0, 0.4, (300, 3))
    reach, own, of = rng.uniform(0.0, 0.1, len(xp)), rng.integers(0, 3, len(xp)), rng.integers(0, 3, len(low))
    start, boxes = broad.pairs_within(xp, reach, own, low, high, of, 0.13)
    far = reach[:, None, None]
    brute = np.all((xp[:, None] >= low[None] - far) & (xp[:, None] <= high[None] + far), axis=2)
    brute &= own[:, None] != of
    for i in range(len(xp)):
        assert boxes[start[i] : start[i + 1]].tolist() == np.flatnonzero(brute[i]).tolist()
    assert (
        len(broad.pairs_within(xp, reach + 9.0, own, low, high, of + 3, 0.13)[1]) == 400 * 300
    )  # more than there is room for


def test_what_lies_in_a_box(rng: np.random.Generator) -> None:
    x, facets = sheet(rng, bumps=0.05)
    least, most = np.array([-0.4, -0.2, -0.03]), np.array([0.3, 0.5, 0.02])
    ids = np.flatnonzero(rng.random(len(facets)) < 0.7)
    low, high = x[facets[ids]].min(axis=1), x[facets[ids]].max(axis=1)
    overlapping = ids[((low <= most) & (high >= least)).all(axis=1)]
    assert 0 < len(overlapping) < len(ids)
    np.testing.assert_array_equal(broad.facets_within(x, facets, ids, least, most), overlapping)
    nodes = np.unique(facets[ids])
    inside = nodes[((x[nodes] > least) & (x[nodes] < most)).all(axis=1)]
    assert 0 < len(inside) < len(nodes)
    np.testing.assert_array_equal(broad.boxes_within(x, x, nodes, least, most), inside)


class Projector:
    """Points against triangles of bodies, owner (k,), each point with all of them as candidates, and their projections on these."""

    def __init__(self, xp: np.ndarray, x: np.ndarray, facets: np.ndarray, owner: np.ndarray, partner: np.ndarray):
        n, k = len(xp), len(facets)
        none, far = np.zeros(n, int), np.full(n, np.inf)
        self.faces = faces_of(facets, owner)
        closest.box_faces(x, self.faces)
        self.points = Points(xp, 0 * xp, 0 * xp, none, none - 1, partner, none + 1.0, none + 1.0, far)
        self.candidates = Candidates(np.arange(n + 1) * k, np.tile(np.arange(k), n))
        self.projections = Projections(
            np.full((n, 2), ANY), np.zeros((n, 2, 3)), np.zeros((n, 2)), np.zeros((n, 3)), -far
        )

    def find(self, x: np.ndarray, shift: float, limit: float) -> Projections:
        """The projections of the points when the nodes are at x."""
        for i in range(len(self.points.x)):
            closest.closest_faces(i, self.points, self.candidates, self.faces, x, shift, limit, self.projections)
        return self.projections


def distances(xp: np.ndarray, x: np.ndarray, facets: np.ndarray) -> np.ndarray:
    """Distance (n,k) of each point from each triangle."""
    away = np.empty((len(xp), len(facets)))
    for i, p in enumerate(xp):
        for j, corners in enumerate(x[facets]):
            away[i, j] = np.linalg.norm(p - np.array(closest.closest_on_triangle(p, *corners)) @ corners)
    return away


@pytest.mark.parametrize("shift", [0.0, 0.2])
def test_the_closest_facet_is_the_closest_whatever_was_guessed(rng: np.random.Generator, shift: float) -> None:
    """Also with boxes of a search from which the sheet has moved since."""
    before, facets = sheet(rng, bumps=0.05)
    x = before + shift * np.array([0.6, 0.0, 0.8]) * rng.uniform(0.0, 1.0, (len(before), 1))
    xp = rng.uniform(-0.9, 0.9, (300, 3)) * [1, 1, 0.15]
    projector = Projector(xp, before, facets, np.zeros(len(facets), int), np.full(300, ANY))
    assert np.array_equal(projector.faces["low"], before[facets].min(axis=1))
    assert np.array_equal(projector.faces["high"], before[facets].max(axis=1))
    m, away = projector.find(x, shift, np.inf), distances(xp, x, facets).min(axis=1)
    gap = m.gap[:, 0].copy()
    assert np.abs(gap) == pytest.approx(away, rel=1e-9)
    place = np.einsum("ij,ijd->id", m.foot[:, 0], x[facets[m.face[:, 0]]])
    assert np.linalg.norm(xp - place, axis=1) == pytest.approx(np.abs(gap), rel=1e-9)
    for _ in range(3):  # from any other guess the same
        m.face[:, 0] = rng.integers(0, len(facets), 300)
        assert projector.find(x, shift, np.inf).gap[:, 0] == pytest.approx(gap, rel=1e-9)


def test_of_several_bodies_a_point_meets_the_two_in_which_it_lies_deepest(rng: np.random.Generator) -> None:
    """Three boxes that overlap; bodies deeper than the limit, and the one that a bond holds a point to, are not met."""
    boxes = [mesher.box((1.0, 1.0, 1.0), 0.5) for _ in range(3)]
    meshes = [
        prepare(points + place, tets) for (points, tets), place in zip(boxes, np.diag([0.0, 0.9, 0.8]), strict=True)
    ]
    first = np.cumsum([0, *(len(mesh.points) for mesh in meshes)])
    x = np.concatenate([mesh.points for mesh in meshes])
    facets = np.concatenate([mesh.facets + at for mesh, at in zip(meshes, first, strict=False)])
    owner = np.repeat([0, 1, 2], [len(mesh.facets) for mesh in meshes])
    order = rng.permutation(len(facets))
    facets, owner = facets[order], owner[order]
    xp, limit, rows = rng.uniform(-0.1, 2.0, (400, 3)), 0.15, np.arange(400)

    def gaps(chosen: np.ndarray, of: np.ndarray, partner: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        m = Projector(xp, x, facets[chosen], of[chosen], partner).find(x, 0.0, limit)
        for body in (0, 1):
            met = m.face[:, body] >= 0
            there = np.einsum("ij,ijd->id", m.foot[met, body], x[facets[chosen[m.face[met, body]]]])
            assert np.linalg.norm(xp[met] - there, axis=1) == pytest.approx(np.abs(m.gap[met, body]), rel=1e-9)
            assert body == 0 or not m.gap[~met, 1].any()
        return m.gap[:, 0], m.gap[:, 1]

    nobody, ids = np.full(400, ANY), np.arange(len(facets))
    of_each = np.array([gaps(np.flatnonzero(owner == body), owner, nobody)[0] for body in range(3)])
    for partner in (nobody, rng.integers(-1, 3, 400)):
        left = of_each.copy()
        left[partner[partner >= 0], rows[partner >= 0]] = np.inf
        nearest = left[np.abs(left).argmin(axis=0), rows]
        met = np.sort(np.where(left < -limit, np.inf, left), axis=0)
        several = np.abs(nearest) <= limit
        first, second = gaps(ids, owner, partner)
        assert first == pytest.approx(np.where(several, met[0], nearest), rel=1e-9)
        assert second == pytest.approx(np.where(several, np.minimum(met[1], 0.0), 0.0), rel=1e-9)
        assert np.count_nonzero(first != nearest) > 4
        assert np.count_nonzero(second) > 4
    nearest = of_each[np.abs(of_each).argmin(axis=0), rows]
    alone = gaps(ids, 0 * owner, nobody)
    assert alone[0] == pytest.approx(nearest, rel=1e-9)
    assert not alone[1].any()


def test_only_the_rows_of_a_search_are_read_and_none_is_missed(rng: np.random.Generator) -> None:
    """Points and a sheet that jump about within `travel` of where they were searched: at each place the forces of a search there."""
    x, facets = sheet(rng, bumps=0.03)
    xp = rng.uniform(-0.8, 0.8, (400, 3)) * [1, 1, 0.3]
    xp[xp[:, 2] < -0.03, 2] *= -1.0
    travel, touched = 0.08, set()
    c = make(len(xp), facets, friction=0.0)
    c.search(xp, x, travel)
    assert 0 < len(c.rows) < 300
    for _ in range(12):
        ways = [rng.standard_normal(a.shape) for a in (xp, x)]
        steps = [w / np.linalg.norm(w, axis=1)[:, None] * rng.uniform(0, 1, (len(w), 1)) for w in ways]
        now, sheet_now = xp + 0.7 * travel * steps[0], x + 0.3 * travel * steps[1]
        fresh = make(len(xp), facets, friction=0.0)
        fresh.search(now, sheet_now, travel)
        right, _ = forces(fresh, 1e-3, now, sheet_now)
        blind = np.full_like(now, np.nan)
        blind[c.rows] = now[c.rows]
        fp, _ = forces(c, 1e-3, blind, sheet_now)
        touched |= set(np.flatnonzero(fresh.depth).tolist())
        assert fp == pytest.approx(right, rel=1e-9, abs=1e-9 * np.abs(right).max())
        assert np.array_equal(c.depth > 0.0, fresh.depth > 0.0)
    assert 40 < len(touched) < len(c.rows)


def test_what_is_far_from_a_surface_is_not_looked_at_until_it_may_be_near() -> None:
    """Point and sheet come closer by no more than both move."""
    x, facets = sheet(np.random.default_rng(1))
    xp = np.array([[0.0, 0.01, 0.02], [0.3, 0.01, 0.06], [-0.3, 0.01, -0.01]])
    for up, down, looked in ((0.0, 0.0, [2]), (0.03, 0.0, [0, 2]), (0.0, 0.05, [0, 2]), (0.02, 0.05, [0, 1, 2])):
        c = make(3, facets)
        c.search(xp, x, 0.1)
        before = c.gap.copy()
        forces(c, 0.0, xp - [0, 0, down + 1e-9], x + np.array([0.0, 0.0, up]))
        assert np.flatnonzero(c.gap != before).tolist() == looked


def test_closest_point_of_a_triangle_is_the_closest(rng: np.random.Generator) -> None:
    w = rng.dirichlet([1, 1, 1], 4000)
    for _ in range(50):
        a, b, c, p = rng.standard_normal((4, 3))
        u = np.array(closest.closest_on_triangle(p, a, b, c))
        assert u.min() >= 0
        assert u.sum() == pytest.approx(1.0)
        mine = np.linalg.norm(p - u @ np.stack([a, b, c]))
        assert mine <= np.linalg.norm(p - w @ np.stack([a, b, c]), axis=1).min() + 1e-12


def test_positions_that_are_no_numbers_are_refused(rng: np.random.Generator) -> None:
    x, facets = sheet(rng)
    with pytest.raises(SolverError, match="not finite numbers"):
        make(1, facets).search(np.array([[np.nan, 0, 0]]), x, 0.1)


def test_a_dropped_point_is_counted_and_its_energy_kept(rng: np.random.Generator) -> None:
    """A point pushed far in within a step loses its contact: once, with the energy of both of its springs."""
    x, facets = sheet(rng)
    xp, still = np.array([[0.05, 0.02, -0.004], [0.4, 0.3, -0.004]]), np.zeros((2, 3))
    moving = still + np.array([1.0, 0.0, 0.0])
    c = make(2, facets, jump=0.2)

    def step() -> None:
        forces(c, 1e-4, xp, x, moving)

    c.search(xp, x, 0.0)
    step()
    spring = c.history["spring"][0]
    own = stored(c.stiffness[0], c.depth[0], float(spring @ spring))
    assert spring.any()
    xp[0, 2] = -0.045
    for _ in range(3):
        step()
    assert (c.sums.dropped, np.count_nonzero(c.depth)) == (1, 1)
    assert c.sums.dropped_energy == pytest.approx(own, rel=1e-12)
    kept = make(2, facets, jump=0.2)
    kept.restore(copied(c))
    assert (kept.sums.dropped, kept.sums.dropped_energy) == (c.sums.dropped, c.sums.dropped_energy)


def test_what_jumps_into_contact_gives_no_energy() -> None:
    """Two sheets end on one another, 0.2 apart in height: halfway between a point finds itself below the upper one past the edge."""
    corners = np.array(
        [[-1, -1, 0], [0, -1, 0], [0, 1, 0], [-1, 1, 0], [0, -1, 0.2], [1, -1, 0.2], [1, 1, 0.2], [0, 1, 0.2]]
    )
    facets = np.array([[0, 1, 2], [0, 2, 3], [4, 5, 6], [4, 6, 7]])
    c, last, work = make(1, facets, friction=0.0), np.array([-0.3, 0.1, 0.1]), 0.0

    def move(*to: float) -> float:
        """To a place in 40 steps; the force there."""
        nonlocal last, work
        f = np.zeros((1, 3))
        for step, xp in enumerate(np.linspace(last, to, 40)):
            if step % 10 == 0:
                c.search(xp[None], corners, 0.1)
            f, _ = forces(c, 1e-3, xp[None], corners)
            work -= float(f[0] @ (xp - last))
            last = xp
        return float(f[0, 2])

    assert move(0.3, 0.1, 0.1) < 1e-8 * c.stiffness
    assert c.penalty_energy < 1e-16 * c.stiffness
    assert move(0.3, 0.1, 0.06) == pytest.approx(0.04 * c.stiffness)  # of a depth of 0.14
    assert c.penalty_energy == pytest.approx(work, rel=0.05)
    assert move(0.3, 0.1, 0.25) == 0.0
    assert move(0.3, 0.1, 0.14) == pytest.approx(0.06 * c.stiffness)  # it has been outside: all of it
    move(-0.3, 0.1, 0.14)
    assert c.penalty_energy == 0.0
    assert c.sums.dropped_energy == pytest.approx(work, rel=0.15)  # out of contact by a jump, which gives nothing back
    assert c.sums.dropped == 0


def test_a_point_that_nothing_is_near_lies_outside(rng: np.random.Generator) -> None:
    """Also where it is looked at all the same, as a bonded point is."""
    x, facets = sheet(rng)
    xp = np.array([[0.05, 0.02, -0.004], [0.4, 0.3, 5.0]])
    c = make(2, facets)
    c.search(xp, x, 0.0, always=np.array([1]))
    forces(c, 0.0, xp, x)
    assert c.gap[0] < 0.0 < c.gap[1]
    assert c.depth[1] == 0.0
    assert c.sums.dropped == 0


@pytest.mark.parametrize(
    "kernel",
    [
        kernels._push, kernels._friction, kernels._update_history, kernels.project, kernels.contact_forces,
        closest.closest_faces, closest._closest_of, closest._next_body, closest.several_bodies,
        broad._points_of_box, broad._points_of_boxes, bond_kernels.bond_forces,
    ],
)  # fmt: skip
def test_loops_over_rows_count_no_references(kernel: Any) -> None:
    """Counting takes more than half of the contact forces of a small particle, and no other test shows it."""
    assert kernel.targetoptions["_nrt"] is False
