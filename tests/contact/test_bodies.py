"""Contact between bodies of one target: Coulomb's law, collisions, what is conserved, heat, bonds, checkpoints."""

from dataclasses import fields

import numpy as np
import pytest
from blocks import Blocks, cubes, touching
from scipy.spatial.transform import Rotation

from coupler.contact import broad
from coupler.contact.bodies import BodyContact
from coupler.contact.bond import Bond, penalty
from coupler.contact.overlap import overlaps
from coupler.contact.surfaces import Surfaces, interface
from coupler.core.records import copied
from coupler.errors import SolverError
from coupler.fe import explicit
from coupler.fe.explicit import Target
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material

SLAB = ((2.0, 1.0, 0.4), 0.25, (0.0, 0.0, 0.0))
SLIDER = ((0.5, 0.5, 0.3), 0.2, (0.3, 0.25, 0.4))


@pytest.fixture(autouse=True)
def undamped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explicit, "LINEAR_VISCOSITY", 0.0)
    monkeypatch.setattr(explicit, "QUADRATIC_VISCOSITY", 0.0)


def weight(b: Blocks, body: int, g: float) -> np.ndarray:
    """Dead load (N,3) of a body, N."""
    mine, load = b.nodes(body), np.zeros_like(b.target.nodes.x)
    load[mine, 2] = -b.target.mass[mine] * g
    return load


def test_a_pressed_block_sinks_until_the_penalty_carries_its_weight() -> None:
    """Mean contact force over a long time is the weight; the depth is what the stiffness says."""
    b = Blocks(SLAB, SLIDER, fixed=("a.bottom",))
    contact, t, g = b.touch(), b.target, 1e4
    load, carried = weight(b, 1, g), [0.0]
    mass = float(t.mass[b.nodes(1)].sum())
    pen: list[float] = []

    def watch() -> None:
        carried[0] += t.dt_last * float(t.f_ext[b.nodes(0), 2].sum())
        pen.append(float(contact.pairs.depth.max()))

    b.run(1.5e-3, push=load, watch=watch)
    assert -carried[0] == pytest.approx(mass * (g * t.time + b.velocity(1)[2]), rel=0.01)
    assert contact.pairs.penalty_energy > 0
    nodes = len(interface(b.surfaces, t.mesh.points, 1, 1e-3).nodes)
    assert 0.5 < np.mean(pen) / (mass * g / (nodes * contact.pairs.stiffness[0])) < 3.0


def test_a_sliding_block_slows_down_by_coulombs_law() -> None:
    """Dv = mu (g t + v_z): the integral of the normal force is known from the motion normal to the plane."""
    b = Blocks(SLAB, SLIDER, fixed=("a.bottom",))
    mu, g, start = 0.3, 3e4, 15.0
    contact, t, up = b.touch(friction=mu), b.target, b.nodes(1)
    t.nodes.v[up, 0] = start
    b.run(1e-3, push=weight(b, 1, g))
    v = b.velocity(1)
    assert start - v[0] == pytest.approx(mu * (g * t.time + v[2]), rel=0.01)
    assert abs(v[1]) < 0.01 * start
    # what the block has lost is heat, but for the waves that the jerk of sliding has sent through both
    loss = 0.5 * float(t.mass[up].sum()) * (start**2 - v[0] ** 2)
    assert 0.9 * loss < contact.pairs.sums.friction_heat < loss


def test_friction_that_is_not_overcome_holds() -> None:
    """A push of half of what Coulomb allows moves the block as far as its springs and its own shear give, and no further."""
    b = Blocks(SLAB, SLIDER, fixed=("a.bottom",))
    _, t, up, g = b.touch(friction=0.5), b.target, b.nodes(1), 3e4
    down, push, steps = weight(b, 1, g), weight(b, 1, g), 40
    moved = []
    for i in range(1, 2 * steps + 1):  # slowly, so that little swings: pressed, then pushed, then left so
        push[:] = down * min(1.0, 2 * i / steps)
        push[up, 0] = -0.25 * down[up, 2] * min(max(0.0, 2 * i / steps - 1), 1.0)
        b.run(t.time + 1e-4, push=push)
        moved.append(float(np.mean(t.nodes.x[up, 0] - t.mesh.points[up, 0])))
    free = 0.5 * 0.25 * g * (steps * 1e-4) ** 2  # how far the push would have led it meanwhile without friction
    assert 0 < moved[steps - 1] < 0.01 * free
    assert moved[-1] == pytest.approx(moved[steps - 1], rel=0.3)


@pytest.mark.parametrize("turned", [False, True], ids=["along the axes", "turned"])
def test_equal_bars_exchange_their_velocities(turned: bool) -> None:
    """End on: the striking bar all but stops, the other flies off; energy, momentum and its moment stay."""
    turn = Rotation.from_rotvec([0.5, 0.3, 0.2]).as_matrix() if turned else np.eye(3)
    bars = ((0.3, 0.3, 1.0), 0.15, (0.0, 0.0, 0.0)), ((0.3, 0.3, 1.0), 0.13, (0.0, 0.0, 1.01))
    b = Blocks(*bars, turn=turn)
    contact, t = b.touch(), b.target
    t.nodes.v[b.nodes(1)] = turn @ [0, 0, -10.0]
    start, momentum, moment = b.energy(), t.momentum(), b.moment()
    b.run(1.6e-3, limit=1e-6)
    assert touching(contact) == 0
    assert (b.velocity(0) @ turn)[2] == pytest.approx(-10.0, abs=0.5)
    assert (b.velocity(1) @ turn)[2] == pytest.approx(0.0, abs=0.5)
    assert b.energy() == pytest.approx(start, rel=1e-4)
    scale = float(t.mass.sum()) * 10.0
    assert np.abs(t.momentum() - momentum).max() < 1e-12 * scale
    assert np.abs(b.moment() - moment).max() < 1e-12 * scale


def test_an_oblique_collision_with_friction_closes_its_ledger() -> None:
    b = Blocks(((0.3, 0.3, 1.0), 0.15, (0.0, 0.0, 0.0)), ((0.3, 0.3, 1.0), 0.13, (0.05, 0.02, 1.01)))
    contact, t = b.touch(friction=0.3), b.target
    t.nodes.v[b.nodes(1)] = [3.0, 1.0, -10.0]
    start, momentum, moment = b.energy(), t.momentum(), b.moment()
    b.run(1.6e-3, limit=2.5e-7)
    assert contact.pairs.sums.friction_heat > 5e-4 * start
    assert b.energy() == pytest.approx(start, rel=1e-4)
    scale = float(t.mass.sum()) * 10.0
    assert np.abs(t.momentum() - momentum).max() < 1e-12 * scale
    assert np.abs(b.moment() - moment).max() < 1e-12 * scale


def test_heat_of_friction_warms_the_elements_of_both_sides() -> None:
    b = Blocks(SLAB, SLIDER, fixed=("a.bottom",))
    contact = b.touch(friction=0.3)
    t = Target(b.target.mesh, law_record(material("OFHC_Cu")), 300.0, fixed=("a.bottom",), track_wave=False)
    b.target = t
    t.nodes.v[b.nodes(1)] = [20.0, 0, -5.0]
    b.run(1.5e-4)
    made = contact.pairs.sums.friction_heat
    elements, heat = contact.heat()
    assert heat.sum() == pytest.approx(made, rel=1e-12)
    assert heat[b.body[elements] == 1].sum() == pytest.approx(0.5 * made, rel=1e-12)
    behind = t.mesh.points[t.mesh.conn[elements]]
    assert np.abs(behind[:, :, 2] - 0.4).min(axis=1).max() < 1e-9  # all of them lie on the interface
    before = t.elements.T.copy()
    t.warm(elements, heat)
    assert np.all(t.elements.T[np.unique(elements)] > before[np.unique(elements)])
    assert contact.heat()[1].size == 0
    assert contact.pairs.sums.friction_heat == made


def test_three_bodies_each_against_those_before_it() -> None:
    """A tower: the third lies on the second, which lies on the first; all stand still, pressed together."""
    tower = [((1.0, 1.0, 0.5), 0.3, (0, 0, 0.5 * i)) for i in range(3)]
    x = Blocks(*tower).target.nodes.x
    b = Blocks(*tower)
    contact = b.touch()
    squeezed = x.copy()
    for body in (1, 2):
        squeezed[b.nodes(body), 2] -= 1e-4 * body
    f = np.zeros_like(x)
    contact.search(squeezed, 0.0)
    contact.forces(1e-9, squeezed, np.zeros_like(x), f)
    up = [f[b.nodes(body), 2].sum() for body in range(3)]
    assert up[0] < 0 < up[2]
    assert sum(up) == pytest.approx(0, abs=1e-9 * up[2])
    assert up[2] == pytest.approx(-up[0], rel=0.3)


def test_bodies_fitted_together_begin_without_force() -> None:
    b = Blocks(((1.0,) * 3, 0.3, (0, 0, 0)), ((1.0,) * 3, 0.25, (0, 0, 1.0)))
    t, up = b.target, b.nodes(1)
    rng = np.random.default_rng(3)
    rough = t.nodes.x.copy()
    rough[up] += 0.01 * rng.standard_normal((len(up), 3))
    fitted = interface(b.surfaces, rough, 1, 0.1).fitted(rough, b.surfaces)
    energies = []
    for x in (rough, fitted):
        contact = BodyContact(b.surfaces, x, [b.K] * 2, 0.3)
        contact.search(x, 0.0)
        contact.forces(1e-9, x, np.zeros_like(x), np.zeros_like(x))
        energies.append(contact.pairs.penalty_energy)
    assert energies[0] > 1.0
    assert energies[1] < 1e-20 * energies[0]


def test_far_bodies_are_not_looked_at_and_held_nodes_are_left_alone() -> None:
    b = Blocks(((1.0,) * 3, 0.35, (0, 0, 0)), ((1.0,) * 3, 0.3, (0, 0, 1.0)))
    contact, t, s = b.touch(), b.target, b.surfaces
    x = t.nodes.x.copy()
    x[b.nodes(1), 2] -= 1e-4
    contact.search(x, 0.0)
    contact.forces(1e-9, x, np.zeros_like(x), np.zeros_like(x))
    assert touching(contact) > 10
    step = contact.stable_dt(t.mass, 1e-6)
    assert 0.5e-6 < step < 1e-6
    bond = Bond.between(interface(s, x, 1, 0.01), s, x, penalty(b.K, 0.3))
    contact.search(x, 0.0, bond)
    f = np.zeros_like(x)
    contact.forces(1e-9, x, np.zeros_like(x), f)
    between, bonded = (np.count_nonzero(contact.pairs.depth[contact.pairs.points.owner == body]) for body in (0, 1))
    assert bonded == 0
    assert between > 0  # nodes of the other side lie between those that the bond holds
    x[b.nodes(1), 2] += 5.0
    f[:] = 0.0
    contact.search(x, 0.0)
    contact.forces(1e-9, x, np.zeros_like(x), f)
    assert not f.any()
    assert contact.stable_dt(t.mass, 1e-6) == step  # that of all that may ever touch
    assert contact.pairs.penalty_energy == 0.0


def test_a_body_on_a_wide_plate_keeps_the_facets_near_it_and_has_the_forces_of_all(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    b = Blocks(((8.0, 8.0, 1.0), 0.5, (0, 0, 0)), ((1.0,) * 3, 0.3, (3.0, 3.0, 0.99)))
    t, forces = b.target, []
    for near in (True, False):
        with monkeypatch.context() as patched:
            if not near:
                patched.setattr(broad, "boxes_within", lambda low, high, ids, *_: ids)
            contact = b.touch(friction=0.3)
        kept = len(contact.pairs.facing[1])
        assert (kept < 0.2 * len(b.surfaces.facets_of(0))) == near
        contact.search(t.nodes.x, 1e-3)
        v = np.where(b.body_of_node[:, None] == 1, np.array([20.0, 5.0, -10.0]), 0.0)
        forces.append(np.zeros_like(t.nodes.x))
        contact.forces(1e-7, t.nodes.x, v, forces[-1])
    assert np.abs(forces[0]).max() > 0.0
    assert np.array_equal(*forces)


@pytest.mark.parametrize("fine", [0, 1])
def test_neither_body_lies_in_the_other(fine: int) -> None:
    """A block with few nodes and one with many, pressed on each other by a hundredth of K: a tenth of the finer spacing at most."""
    sizes = [0.1 if body == fine else 0.5 for body in (0, 1)]
    b = Blocks(
        ((1.0, 1.0, 0.5), sizes[0], (0, 0, 0)), ((0.7, 0.7, 0.5), sizes[1], (0.15, 0.15, 0.5)), fixed=("a.bottom",)
    )
    t = b.touch() and b.target
    top = np.isclose(t.mesh.points[:, 2], 1.0)
    load = np.zeros_like(t.nodes.x)
    load[top, 2] = -0.01 * b.K / np.count_nonzero(top)
    deepest: list[float] = []

    def watch() -> None:
        if round(t.time / t.dt_last) % 20 == 0:
            deepest.append(float(overlaps(b.surfaces, t.nodes.x, (0, 1)).max()))

    b.run(1e-3, push=load, watch=watch)
    assert 0.0 < max(deepest) < 0.1 * b.surfaces.spacing(t.nodes.x, fine)


def test_between_bodies_that_sleep_all_stays_as_it_was() -> None:
    """Neither their forces nor what their springs hold: the inactive part is in equilibrium with them."""
    b = Blocks(((1.0,) * 3, 0.35, (0, 0, 0)), ((1.0,) * 3, 0.3, (0, 0, 1.0)))
    contact, x = b.touch(), b.target.nodes.x.copy()
    x[b.nodes(1), 2] -= 1e-4
    f, still = np.zeros_like(x), np.zeros_like(x)
    contact.search(x, 0.0)
    contact.forces(1e-9, x, still, f)
    held, count = contact.pairs.penalty_energy, touching(contact)
    f[:] = 0.0
    contact.search(x, 0.0, active=0)
    contact.forces(1e-9, x, still, f, 0)
    assert not f.any()
    assert (contact.pairs.penalty_energy, touching(contact)) == (held, count)
    contact.search(x, 0.0, active=len(x))
    contact.forces(1e-9, x, still, f)
    assert f.any()
    assert contact.pairs.penalty_energy == pytest.approx(held, rel=1e-12)


def test_what_does_not_move_keeps_its_forces_and_costs_no_search(rng: np.random.Generator) -> None:
    """Two blocks that touch, of which the first nodes move: their forces, energy and history are those of a contact that looks at
    all; what begins to move is looked at, too."""
    b = Blocks(((3.0, 1.0, 0.5), 0.25, (-1.5, -0.5, 0)), ((3.0, 1.0, 0.5), 0.22, (-1.5, -0.5, 0.5)))
    outwards = np.argsort(np.abs(b.target.nodes.x[:, 0]), kind="stable")
    rank = np.empty(len(outwards), int)
    rank[outwards] = np.arange(len(outwards))
    body = b.body_of_node[outwards]
    surfaces = Surfaces(rank[b.surfaces.facets], *(getattr(b.surfaces, f.name) for f in fields(Surfaces)[1:]))
    x, v = b.target.nodes.x[outwards], np.zeros((len(outwards), 3))
    contacts = [BodyContact(surfaces, x, [b.K] * 2, 0.3) for _ in range(2)]
    x[body == 1, 2] -= 2e-3
    for c in contacts:
        c.search(x, 0.01)
        c.forces(0.0, x, v, np.zeros_like(x))
    assert contacts[0].pairs.penalty_energy > 0.0
    contacts[1].pairs.expire(np.ones(len(contacts[1].pairs.history), bool))  # as of bodies that have come to rest
    looked: list[int] = []
    for active in (60, 60, 90, 91, 150, len(x)):
        for c, number in zip(contacts, (None, active), strict=True):
            c.search(x, 0.01, active=number)
        x[:active] += 1e-4 * rng.normal(size=(active, 3))
        v[:active] = rng.normal(size=(active, 3))
        forces = np.zeros((2, *x.shape))
        for c, f, number in zip(contacts, forces, (None, active), strict=True):
            c.forces(1e-6, x, v, f, number)
        scale = np.abs(forces[0]).max()
        np.testing.assert_allclose(forces[1][:active], forces[0][:active], atol=1e-12 * scale)
        assert contacts[1].pairs.penalty_energy == pytest.approx(contacts[0].pairs.penalty_energy, rel=1e-12)
        for name in ("spring", "depth", "ignored"):
            of_some, of_all = (c.past().nodes[name] for c in (contacts[1], contacts[0]))
            np.testing.assert_allclose(of_some, of_all, rtol=1e-9, atol=1e-9 * scale)
        looked.append(len(contacts[1].pairs.rows))
    every = len(contacts[0].pairs.rows)
    assert 0 < looked[0] < 0.6 * every
    assert sorted(looked) == looked
    assert looked[-1] == every


def test_a_search_that_is_still_valid_gives_the_forces_of_a_fresh_one() -> None:
    """Pressed and slid in small steps: the search is kept through some of them, done again after others, and misses nothing."""
    b = Blocks(((1.0,) * 3, 0.35, (0, 0, 0)), ((0.7, 0.7, 0.5), 0.3, (0.15, 0.15, 1.0)))
    kept, fresh, x = b.touch(friction=0.0), b.touch(friction=0.0), b.target.nodes.x.copy()
    up, still, done = b.nodes(1), np.zeros_like(x), []
    for step in range(24):
        x[up] += [0.018, 0.004, -0.0005]
        before = kept.pairs._searches.x[kept.pairs.bounds[1] :].copy()
        kept.search(x, 0.01)
        done.append(not np.array_equal(kept.pairs._searches.x[kept.pairs.bounds[1] :], before))
        fresh.pairs.expire(np.ones(len(fresh.pairs.history), bool))
        fresh.search(x, 0.01)
        f, g = np.zeros_like(x), np.zeros_like(x)
        kept.forces(1e-9, x, still, f)
        fresh.forces(1e-9, x, still, g)
        assert np.abs(g).max() > 0.0, step
        np.testing.assert_allclose(f, g, atol=1e-9 * np.abs(g).max())
    assert 0 < sum(done) < len(done)


def test_a_search_that_reaches_much_too_far_is_renewed() -> None:
    """After fast motion, points keep only the faces that slow motion can bring near; the forces do not change."""
    b = Blocks(((1.0,) * 3, 0.2, (0, 0, 0)), ((1.0,) * 3, 0.18, (0, 0, 1.0)))
    contact, x, forces, counts = b.touch(friction=0.0), b.target.nodes.x.copy(), [], []
    x[b.nodes(1), 2] -= 1e-3
    still = np.zeros_like(x)
    for travel in (0.3, 0.1, 0.001):
        contact.search(x, travel)
        forces.append(np.zeros_like(x))
        contact.forces(1e-9, x, still, forces[-1])
        counts.append(len(contact.pairs._candidates.face))
    assert counts[0] > counts[1] > counts[2] > 0
    assert np.abs(forces[0]).max() > 0.0
    np.testing.assert_array_equal(forces[1], forces[0])
    np.testing.assert_array_equal(forces[2], forces[0])


def test_a_friction_spring_of_a_point_outside_becomes_heat_once_the_point_moves() -> None:
    """Bodies that were moved apart at rest keep the energy of their springs until a wave reaches them."""
    b = Blocks(((1.0,) * 3, 0.35, (0, 0, 0)), ((1.0,) * 3, 0.3, (0, 0, 1.0)))
    contact, x = b.touch(friction=0.5), b.target.nodes.x.copy()
    x[b.nodes(1), 2] -= 1e-3
    f, v = np.zeros_like(x), np.zeros_like(x)
    v[b.nodes(1), 0] = 1.0
    contact.search(x, 0.01)
    contact.forces(1e-5, x, v, f)
    stored = contact.pairs.penalty_energy
    contact.pairs.history["depth"] = 0.0
    spring = contact.pairs.penalty_energy
    assert 0.0 < spring < stored
    x[b.nodes(1), 2] += 2e-3
    before = contact.pairs.sums.friction_heat
    contact.search(x, 0.01)
    for active, left in ((0, spring), (0, spring), (len(x), 0.0)):
        contact.forces(1e-5, x, v, f, active)
        assert contact.pairs.penalty_energy == left
    assert contact.pairs.sums.friction_heat - before == pytest.approx(spring, rel=1e-12)


def test_a_body_at_rest_is_searched_again_when_another_body_comes_near() -> None:
    """Neither it nor the faces near it move: only the faces that were not near at its last search end this search."""
    block = (1.0,) * 3
    b = Blocks(((3.0, 1.0, 1.0), 0.5, (0, 0, 0)), (block, 0.2, (0, 0, 1.0)), (block, 0.2, (1.45, 0, 1.4)))
    kept, fresh, x = b.touch(friction=0.0), b.touch(friction=0.0), b.target.nodes.x.copy()
    still = np.zeros_like(x)
    kept.search(x, 0.055)
    first = len(kept.pairs._searches.faces_near(1))
    for move in [0.055] * 8 + [0.01] * 3:
        fresh.pairs.expire()
        for contact in (kept, fresh):
            contact.search(x, 0.055)
        x[b.nodes(2), 0] -= move
        forces = np.zeros((2, *x.shape))
        for contact, f in zip((kept, fresh), forces, strict=True):
            contact.forces(1e-9, x, still, f)
    assert len(kept.pairs._searches.faces_near(1)) > first
    assert kept.pairs.depth[kept.pairs.points.owner == 1].any()
    np.testing.assert_allclose(*forces, atol=1e-9 * np.abs(forces).max())


def test_a_run_goes_on_from_its_state_to_the_last_bit() -> None:
    def start() -> tuple[Blocks, BodyContact]:
        b = Blocks(SLAB, SLIDER, fixed=("a.bottom",))
        contact = b.touch(friction=0.3)
        b.target.nodes.v[b.nodes(1)] = [15.0, 3.0, -5.0]
        return b, contact

    one, contact = start()
    one.run(1e-4)
    kept = copied(contact)
    fresh = BodyContact(one.surfaces, one.target.mesh.points, [one.K] * 2, 0.3)
    fresh.restore(kept)
    assert fresh.pairs.sums.friction_heat == contact.pairs.sums.friction_heat > 0
    assert fresh.pairs.penalty_energy == contact.pairs.penalty_energy
    t = one.target
    forces = []
    for c in (contact, fresh):
        f = np.zeros_like(t.nodes.x)
        c.search(t.nodes.x, 1e-3)
        for _ in range(3):
            c.forces(1e-6, t.nodes.x, t.nodes.v, f)
        forces.append(f)
    assert np.array_equal(*forces)
    assert fresh.pairs.sums.friction_heat == contact.pairs.sums.friction_heat


def test_a_contact_of_more_bodies_takes_over_what_fewer_remember() -> None:
    b = Blocks(SLAB, SLIDER, fixed=("a.bottom",))
    contact, t = b.touch(friction=0.3), b.target
    t.nodes.v[b.nodes(1)] = [15.0, 3.0, -5.0]
    b.run(1e-4)
    contact.heat()
    more = Blocks(SLAB, SLIDER, ((0.2, 0.2, 0.2), 0.1, (1.2, 0.4, 0.4)))
    node = np.empty(len(t.nodes.x), int)  # each old node's new number, by the place it had to begin with
    for body in (0, 1):
        for new in more.nodes(body):
            gap = np.abs(t.mesh.points - more.target.nodes.x[new]).max(axis=1)
            gap[b.body_of_node != body] = 1.0
            node[int(gap.argmin())] = new
    later = more.touch(friction=0.3)
    later.continue_from(contact.past().renumbered(node, len(more.target.nodes.x)))
    x, v = more.target.nodes.x.copy(), np.zeros_like(more.target.nodes.x)
    x[node], v[node] = t.nodes.x, t.nodes.v
    f, g = np.zeros_like(t.nodes.x), np.zeros_like(x)
    contact.search(t.nodes.x, 1e-3)
    later.search(x, 1e-3)
    contact.forces(1e-9, t.nodes.x, t.nodes.v, f)
    later.forces(1e-9, x, v, g)
    assert np.abs(f).max() > 0
    assert g[node] == pytest.approx(f, rel=1e-12, abs=1e-12 * np.abs(f).max())
    assert later.pairs.sums.friction_heat == pytest.approx(contact.pairs.sums.friction_heat, rel=1e-12)


def test_positions_that_are_no_numbers_are_refused() -> None:
    b = Blocks(SLAB, SLIDER)
    contact, x = b.touch(), b.target.nodes.x.copy()
    x[b.surfaces.nodes_of(1)[0]] = np.nan
    with pytest.raises(SolverError, match="not finite numbers"):
        contact.search(x, 0.1)
    with pytest.raises(SolverError, match="not finite numbers"):
        interface(b.surfaces, x, 1, 0.1)


def test_an_overlap_that_did_not_come_from_a_motion_sets_no_energy_free() -> None:
    """Nodes that are found deep in another body, as at the folds of splats, meet nothing until they have been outside."""
    b = cubes(1.0)
    contact, t, above = b.touch(), b.target, b.nodes(1)
    spacing = b.surfaces.spacing(t.nodes.x, 1)
    placed = t.nodes.x.copy()

    def energy_at(depth: float) -> float:
        t.nodes.x[:] = placed
        t.nodes.x[above, 2] -= depth * spacing
        contact.search(t.nodes.x, 0.05 * spacing)
        contact.forces(0.0, t.nodes.x, t.nodes.v, np.zeros_like(t.nodes.x))
        return contact.pairs.penalty_energy

    assert energy_at(0.3) == 0.0
    energy_at(-0.05)
    seen = [energy_at(depth) for depth in (0.05, 0.14, 0.2)]
    assert 0.0 < seen[0] < seen[1] < seen[2]
    assert energy_at(0.4) == 0.0


def test_bodies_that_lie_in_each_other_are_pushed_apart() -> None:
    """Deeper than a step can bring them: they begin without a force, which grows as less of the depth is ignored."""
    b = cubes(1.0)
    contact, t, above = b.touch(), b.target, b.nodes(1)
    depth = 0.3 * b.surfaces.spacing(t.nodes.x, 1)
    t.nodes.x[above, 2] -= depth

    def lift() -> float:
        f = np.zeros_like(t.nodes.x)
        contact.search(t.nodes.x, 0.01)
        contact.forces(0.0, t.nodes.x, t.nodes.v, f)
        return float(f[above, 2].sum())

    assert lift() == 0.0
    contact.ignore_depth(overlaps(b.surfaces, t.nodes.x, [1]))
    begins = lift()
    lifts = []
    for step in range(10):
        contact.reduce_overlap(1.0 - 1.0 / (10 - step))
        lifts.append(lift())
    stiffness = float(contact.pairs.points.stiffness[contact.pairs.depth > 0.0].sum())
    np.testing.assert_allclose(lifts, 0.1 * depth * stiffness * np.arange(1, 11), rtol=1e-6)
    assert abs(begins) < 1e-12 * lifts[-1]
    contact.ignore_depth(overlaps(b.surfaces, t.nodes.x, [1]))
    assert lift() == pytest.approx(lifts[-1], rel=1e-6), "those that press go on"


def test_a_node_between_two_bodies_is_stopped_by_a_third() -> None:
    """Two blocks side by side on a slab: what is closest to their edges is the other block, and they lie in the slab all the same."""
    gap, depth = 0.002, 0.008  # m; a block's spacing is 0.1
    left = ((0.3, 0.3, 0.2), 0.1, (0.2, 0.25, 0.4))
    right = ((0.3, 0.3, 0.2), 0.1, (0.5 + gap, 0.25, 0.4))
    b = Blocks(SLAB, left, right, fixed=("a.bottom",))
    contact, t = b.touch(), b.target
    assert gap < depth < 0.1 * b.surfaces.spacing(t.nodes.x, 1)
    above = np.union1d(b.nodes(1), b.nodes(2))
    for _ in range(4):
        t.nodes.x[above, 2] -= 0.25 * depth
        contact.search(t.nodes.x, 0.01)
        f = np.zeros_like(t.nodes.x)
        contact.forces(0.0, t.nodes.x, t.nodes.v, f)
    bottom = above[t.mesh.points[above, 2] < 0.4 + 1e-9]
    np.testing.assert_allclose(contact.past().nodes["depth"][bottom, 0], depth, rtol=1e-6)
    inner = bottom[np.abs(t.nodes.x[bottom, 0] - 0.5) < 2.0 * gap]
    assert len(inner) >= 8
    assert (f[inner, 2] > 0.0).all()
    np.testing.assert_allclose(f.sum(axis=0), 0.0, atol=1e-9 * np.abs(f).max())


def test_a_node_that_a_bond_holds_to_one_body_meets_the_others() -> None:
    """A block on a slab, bonded to it or not, and another that is pushed into its side: the lowest row of nodes is stopped as well."""
    depth = 0.008  # m
    b = Blocks(SLAB, ((0.3, 0.3, 0.2), 0.1, (0.2, 0.25, 0.4)), ((0.3, 0.3, 0.3), 0.13, (0.501, 0.25, 0.35)))
    t = b.target
    b.tie()
    assert b.bond is not None
    held = np.zeros(len(t.nodes.x), bool)
    held[b.bond.nodes[~b.bond.loose]] = True
    start, depths = t.nodes.x.copy(), []
    for bond in (None, b.bond):
        contact = b.touch()
        t.nodes.x[:] = start
        for _ in range(5):
            contact.search(t.nodes.x, 0.01, bond)
            contact.forces(0.0, t.nodes.x, t.nodes.v, np.zeros_like(t.nodes.x))
            t.nodes.x[b.nodes(2), 0] -= 0.25 * (depth + 0.001)
        t.nodes.x[b.nodes(2), 0] += 0.25 * (depth + 0.001)
        depths.append(contact.past().nodes["depth"][:, 0])
    again = b.touch()  # as after another body has joined: what bonded nodes remember of the others stays
    again.continue_from(contact.past())
    again.search(t.nodes.x, 0.01, b.bond)
    np.testing.assert_array_equal(again.past().nodes["depth"][:, 0], depths[1])
    side = b.nodes(1)[np.abs(start[b.nodes(1), 0] - 0.5) < 1e-9]
    inside = side[(np.abs(start[side, 1] - 0.4) < 0.1)]
    assert 2 <= np.count_nonzero(held[inside]) < len(inside)
    np.testing.assert_allclose(depths[1][inside], depth, rtol=1e-6)
    np.testing.assert_allclose(depths[1][inside], depths[0][inside], rtol=1e-6)
    assert not depths[1][held & (start[:, 0] < 0.45)].any()


def test_a_collision_of_three_bodies_at_one_place_closes_its_ledger() -> None:
    """Two blocks are pressed on each other, and nodes of a third into the seam between them: these lie in both."""
    lower, upper = ((0.4, 0.3, 0.3), 0.13, (0.0, 0.0, -0.301)), ((0.4, 0.3, 0.3), 0.12, (0.0, 0.0, 0.001))
    b = Blocks(lower, upper, ((0.3, 0.3, 0.3), 0.15, (0.401, 0.0, -0.15)))
    contact, t, second = b.touch(friction=0.3), b.target, [0.0]
    t.nodes.v[b.nodes(0)] = [0.0, 0.0, 8.0]
    t.nodes.v[b.nodes(1)] = [0.0, 0.0, -8.0]
    t.nodes.v[b.nodes(2)] = [-8.0, 0.5, 0.0]
    start, momentum, moment = b.energy(), t.momentum(), b.moment()

    def watch() -> None:
        second[0] = max(second[0], float(contact.pairs.history["depth"][:, 1].max()))

    b.run(1e-3, limit=2.5e-7, watch=watch)
    assert second[0] > 1e-4 * b.surfaces.spacing(t.nodes.x, 1)
    assert b.velocity(2)[0] > 0.0
    assert b.energy() + contact.pairs.sums.dropped_energy == pytest.approx(start, rel=1e-3)
    scale = float(t.mass.sum()) * 10.0
    assert np.abs(t.momentum() - momentum).max() < 1e-12 * scale
    assert np.abs(b.moment() - moment).max() < 1e-12 * scale
