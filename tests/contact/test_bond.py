"""Bonds between bodies: the traction law in each mode, what is conserved, waves across, breaking in a run, checkpoints."""

import numpy as np
import pytest
from blocks import Blocks, cubes, touching
from scipy.spatial.transform import Rotation

from coupler.contact.bodies import ContactPast
from coupler.contact.bond import Bond
from coupler.contact.bond_kernels import yielding
from coupler.contact.overlap import overlaps
from coupler.contact.surfaces import interface
from coupler.core import safety
from coupler.core.records import copied
from coupler.errors import SolverError
from coupler.fe import explicit
from coupler.fe.stability import resist
from coupler.target.bodies import FOLDED, Bodies

N, S, GI, GII = 300e6, 200e6, 900.0, 1600.0  # strengths, Pa, and energies, J/m2, of the bonds below
SIDE = 1e-3


@pytest.fixture
def pair() -> Blocks:
    return cubes(SIDE)


@pytest.fixture
def undamped(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(explicit, "LINEAR_VISCOSITY", 0.0)
    monkeypatch.setattr(explicit, "QUADRATIC_VISCOSITY", 0.0)


def cohesive(b: Blocks) -> Bond:
    return b.tie(strength=N, energy=GI, shear_strength=S, shear_energy=GII)


def shifted(b: Blocks, shift: np.ndarray) -> np.ndarray:
    """Positions with the upper block displaced as a whole."""
    x = b.target.nodes.x.copy()
    x[b.nodes(1)] += shift
    return x


def pull(b: Blocks, bond: Bond, path: np.ndarray) -> np.ndarray:
    """Force (steps,3) on the upper block while it is led along a path of displacements (steps,3)."""
    out = []
    for shift in path:
        f = np.zeros_like(b.target.nodes.x)
        bond.forces(shifted(b, shift), f)
        out.append(f[b.nodes(1)].sum(axis=0))
    return np.array(out)


@pytest.mark.parametrize(
    ("toward", "strength", "energy"),
    [((0, 0, 1), N, GI), ((1, 0, 0), S, GII), ((-0.6, 0.8, 0), S, GII)],
    ids=["tension", "shear", "shear across"],
)
def test_pure_modes_reach_the_strength_and_spend_the_energy(
    pair: Blocks, toward: tuple[float, float, float], strength: float, energy: float
) -> None:
    bond, e = cohesive(pair), np.array(toward, float)
    path = np.linspace(0, 1.05 * 2 * energy / strength, 4001)
    force = -pull(pair, bond, path[:, None] * e) @ e
    assert bond.area.sum() == pytest.approx(SIDE**2, rel=1e-12)
    assert force.max() == pytest.approx(strength * SIDE**2, rel=1e-3)
    assert bond.broken.all()
    assert force[-1] == 0.0
    assert bond.dissipated == pytest.approx(energy * SIDE**2, rel=1e-3)
    work = float(np.sum(0.5 * (force[1:] + force[:-1]) * np.diff(path)))
    assert work == pytest.approx(bond.dissipated, rel=1e-9)  # nothing is left in the springs


@pytest.mark.parametrize("angle", [20.0, 45.0, 75.0])
def test_mixed_mode_meets_both_criteria(pair: Blocks, angle: float) -> None:
    """Onset: quadratic in the tractions. End: the sum of G_I/G_Ic and G_II/G_IIc is one."""
    bond, a = cohesive(pair), np.deg2rad(angle)
    e = np.array([np.sin(a), 0, np.cos(a)])
    path = np.linspace(0, 3e-5, 6001)[:, None] * e
    force = -pull(pair, bond, path) / SIDE**2
    springs = bond.stiffness[0] * path  # tractions until the onset
    first = int(np.argmax(np.linalg.norm(force - springs, axis=1) > 1e-9 * N))
    before, at = (springs[first - 1 : first + 1, [2, 0]] ** 2 / [N**2, S**2]).sum(axis=1)
    assert before <= 1.0 < at
    mean, step = 0.5 * (force[1:] + force[:-1]), np.diff(path, axis=0)
    spent = (mean * step).sum(axis=0)
    assert spent[2] / GI + spent[0] / GII == pytest.approx(1.0, rel=2e-3)
    assert bond.dissipated == pytest.approx(spent.sum() * SIDE**2, rel=1e-6)


@pytest.mark.parametrize("angle", [0.0, 20.0, 45.0, 75.0, 90.0])
def test_the_flow_is_normal_to_the_locus(pair: Blocks, angle: float) -> None:
    """Without softening the traction goes to the point of the locus whose normal is the opening, of the largest power (Drucker)."""
    bond, a = pair.tie(strength=N, energy=np.inf, shear_strength=S, shear_energy=np.inf), np.deg2rad(angle)
    e = np.array([np.sin(a), 0, np.cos(a)])
    path = np.linspace(0, 400 * N / bond.stiffness[0], 4000)[:, None] * e
    force = -pull(pair, bond, path) / SIDE**2
    power = np.hypot(N * e[2], S * e[0])
    assert force[-1] == pytest.approx([S**2 * e[0] / power, 0.0, N**2 * e[2] / power], rel=1e-3, abs=1e-6 * N)
    assert force[-1] @ e == pytest.approx(power, rel=1e-6)
    assert (force @ e).max() <= power * (1 + 1e-9)


@pytest.mark.parametrize("damage", [0.0, 0.5, 1.0 - 1e-12, 1.0 - 2.0**-53])
def test_any_opening_of_any_bond_has_an_end(damage: float) -> None:
    k = 1e18
    for wide, slip in ((1e-3, 0.0), (1e-9, 1e-3), (1e-3, 1e-3), (1e-30, 1e-9)):
        for inv_G in ((1 / GI, 1 / GII), (0.0, 0.0), (np.inf, np.inf)):
            *shares, after = yielding(wide, slip, k, 1 / np.array([N, S]), np.array(inv_G), damage, 1.0)
            assert damage <= after <= 1.0
            assert all(0.0 <= share <= 1.0 for share in shares)
            left = np.hypot((1 - shares[0]) * wide * k / N, (1 - shares[1]) * slip * k / S)
            assert left == pytest.approx(1.0 - after, rel=1e-6, abs=1e-6)  # shares are near one here


@pytest.mark.parametrize(("toward", "far"), [((0, 0, 1.0), GI / N), ((1.0, 0, 0), GII / S), ((0.6, 0, 0.8), GI / N)])
def test_unloading_is_elastic_to_a_residual_opening_and_damage_does_not_heal(
    pair: Blocks, toward: tuple[float, float, float], far: float
) -> None:
    """Led out, back until the traction is zero, and out again: stiffness of the whole bond, and the energy is that of one way."""
    bond, e = cohesive(pair), np.array(toward)
    k = bond.stiffness[0] * SIDE**2
    first = -pull(pair, bond, np.linspace(0, far, 500)[:, None] * e) @ e
    spent, damage = bond.dissipated, bond.damage.copy()
    assert 0.1 < damage.min() < 0.9
    residual = far - first[-1] / k
    assert residual > 0.2 * far
    back = np.linspace(far, residual, 40)
    for path in (back, back[::-1]):
        force = -pull(pair, bond, path[:, None] * e) @ e
        assert force == pytest.approx(k * (path - residual), rel=1e-9, abs=1e-6 * first.max())
    assert bond.dissipated == pytest.approx(spent, rel=1e-12)
    assert bond.damage == pytest.approx(damage, rel=1e-12)
    pull(pair, bond, np.linspace(far, 2.1 * GII / S, 4000)[:, None] * e)
    assert bond.broken.all()
    if toward[2] == 0.0:
        assert bond.dissipated == pytest.approx(GII * SIDE**2, rel=1e-3)


def test_a_moved_bond_is_lifted_out_although_another_breaks() -> None:
    b = Blocks(((1.0,) * 3, 0.3, (0, 0, 0)), ((1.0,) * 3, 0.25, (0, 0, 1.0)))
    bond, rows = b.tie(), np.array([3])
    b.target.nodes.x[bond.nodes[3], 2] -= 0.02
    bond.move(b.target.nodes.x, rows, bond.triangles[rows])
    assert bond.gap[3] == pytest.approx(-0.02)
    bond.drop(np.arange(len(bond)) == 1)
    bond.reduce_overlap(0.0)
    assert bond.gap[2] == 0.0


def test_a_bond_that_is_moved_begins_without_a_force_and_leads_its_node_out() -> None:
    b = Blocks(((1.0,) * 3, 0.3, (0, 0, 0)), ((1.0,) * 3, 0.25, (0, 0, 1.0)))
    bond, t, rows = b.tie(), b.target, np.array([3])
    node = bond.nodes[3]

    def lift() -> float:
        f = np.zeros_like(t.nodes.x)
        bond.forces(t.nodes.x, f)
        return float(f[node, 2])

    t.nodes.x[node, 2] -= 0.02
    pressed, stored = lift(), bond.stored
    assert pressed > 0.0
    assert bond.compression(t.nodes.x, rows) == pytest.approx(0.02)
    bond.move(t.nodes.x, rows, bond.triangles[rows])
    assert bond.dissipated == pytest.approx(stored)
    assert abs(lift()) < 1e-9 * pressed
    bond.reduce_overlap(0.5)
    assert lift() == pytest.approx(0.5 * pressed)
    bond.reduce_overlap(0.0)
    assert lift() == pytest.approx(pressed)
    bond.reduce_overlap(0.0)
    assert bond.gap[3] == pytest.approx(0.0, abs=1e-12)


def test_a_bonded_node_behind_a_folded_surface_is_led_out() -> None:
    """A node that its bond holds beside its triangle, where the surface has risen above the node."""
    b = Blocks(((1.0, 1.0, 0.5), 0.2, (0, 0, 0)), ((0.4, 0.4, 0.3), 0.2, (0.3, 0.3, 0.5)))
    bond, t = b.tie(), b.target
    b.touch()
    node = bond.nodes[np.argmin(np.hypot(*(t.nodes.x[bond.nodes, :2] - 0.3).T))]
    row = int(np.flatnonzero(bond.nodes == node)[0])
    t.nodes.x[node, :2] -= 0.15
    top = np.flatnonzero((b.body_of_node == 0) & (t.nodes.x[:, 2] > 0.5 - 1e-9))
    beside = np.setdiff1d(top[np.hypot(*(t.nodes.x[top, :2] - t.nodes.x[node, :2]).T) < 0.2], bond.triangles[row])
    t.nodes.x[beside, 2] += 0.1
    deep = overlaps(b.surfaces, t.nodes.x, [1])[node]
    assert deep > 0.02
    assert bond.compression(t.nodes.x, np.array([row]))[0] < 0.5 * deep
    before = bond.triangles[row].copy()
    Bodies.separate(b, [1])
    assert set(bond.triangles[row]) != set(before)
    assert bond.compression(t.nodes.x, np.array([row]))[0] == pytest.approx(0.0, abs=1e-12)
    Bodies.reduce_overlap(b, 0.0)
    assert bond.compression(t.nodes.x, np.array([row]))[0] > 0.5 * deep


def test_bonds_that_hold_a_body_on_a_node_begin_anew() -> None:
    """A node of the lower body that has risen into the upper one, whose own nodes are tied round it; other bonds keep their forces."""
    b = Blocks(((1.0, 1.0, 0.5), 0.2, (0, 0, 0)), ((0.4, 0.4, 0.3), 0.2, (0.3, 0.3, 0.5)))
    bond, t = b.tie(), b.target
    b.touch()
    top = np.flatnonzero((b.body_of_node == 0) & (t.nodes.x[:, 2] > 0.5 - 1e-9))
    node = top[np.argmin(np.hypot(*(t.nodes.x[top, :2] - 0.5).T))]
    t.nodes.x[b.nodes(1), 0] += 1e-3
    t.nodes.x[node, 2] += 0.04
    pinned = (bond.triangles == node).any(axis=1)
    assert 0 < pinned.sum() < len(bond)
    assert overlaps(b.surfaces, t.nodes.x, [1])[node] > 0.02
    f = np.zeros_like(t.nodes.x)
    bond.forces(t.nodes.x, f)
    before, held = bond.traction.copy(), bond.stored_by_each[pinned].sum()
    assert before.any(axis=1).all()
    Bodies.separate(b, [1])
    bond.forces(t.nodes.x, f)
    assert np.abs(bond.traction[pinned]).max() < 1e-9 * np.abs(before).max()
    assert bond.traction[~pinned] == pytest.approx(before[~pinned])
    assert bond.dissipated == pytest.approx(held)


def test_a_bond_too_soft_for_its_node_holds_it_out() -> None:
    """A node of the upper body is pressed into the triangle that it is bonded to: without a force first, and stiffer where it is led
    out; what presses it then presses it FOLDED spacings deep."""
    b = Blocks(((1.0, 1.0, 0.5), 0.2, (0, 0, 0)), ((0.4, 0.4, 0.3), 0.2, (0.3, 0.3, 0.5)))
    bond, t = b.tie(), b.target
    b.touch()
    row = int(np.argmin(np.hypot(*(t.nodes.x[bond.nodes, :2] - 0.5).T)))
    bond.area[row] *= 0.02
    t.nodes.x[bond.nodes[row], 2] -= 0.04
    spacing = b.surfaces.spacing(t.nodes.x, 1)
    assert overlaps(b.surfaces, t.nodes.x, [1])[bond.nodes[row]] == pytest.approx(0.04, rel=0.2)
    f = np.zeros_like(t.nodes.x)
    bond.forces(t.nodes.x, f)
    pressing, held, soft = -bond.traction[row, 0] * bond.area[row], bond.stored_by_each[row], bond.stiffness.copy()
    Bodies.separate(b, [1])
    bond.forces(t.nodes.x, f)
    assert abs(bond.traction[row, 0] * bond.area[row]) < 1e-9 * pressing
    assert bond.dissipated == pytest.approx(held)
    others = np.arange(len(bond)) != row
    np.testing.assert_array_equal(bond.stiffness[others], soft[others])
    assert bond.stiffness[row] * bond.area[row] < np.median(bond.stiffness * bond.area)
    Bodies.reduce_overlap(b, 0.0)
    t.nodes.x[bond.nodes[row], 2] += bond.compression(t.nodes.x, np.array([row]))[0] - FOLDED * spacing
    bond.forces(t.nodes.x, f)
    assert -bond.traction[row, 0] * bond.area[row] == pytest.approx(pressing, rel=1e-6)


def test_a_bond_becomes_no_stiffer_than_others_are() -> None:
    b = Blocks(((1.0, 1.0, 0.5), 0.2, (0, 0, 0)), ((0.4, 0.4, 0.3), 0.2, (0.3, 0.3, 0.5)))
    bond, x = b.tie(), b.target.nodes.x
    springs = bond.stiffness * bond.area
    order = np.argsort(springs)
    least, most = order[[0]], order[[-1]]
    for _ in range(3):
        bond.stiffen(x, np.concatenate([least, most]), np.full(2, 50.0))
    now = bond.stiffness * bond.area
    assert np.median(springs) <= now[least] <= np.median(now) * (1.0 + 1e-12)
    np.testing.assert_array_equal((bond.stiffness * bond.area)[most], springs[most])


def test_compression_is_resisted_in_full_by_a_damaged_bond(pair: Blocks) -> None:
    bond, up = cohesive(pair), np.array([0, 0, 1.0])
    pull(pair, bond, np.linspace(0, GI / N, 500)[:, None] * up)
    gap, damage = bond.gap[0], bond.damage[0]
    assert 0.0 < damage < 1.0
    assert gap > 0.5 * GI / N  # the residual opening
    pressed = pull(pair, bond, (gap - 1e-8) * up[None])[0, 2]
    assert pressed == pytest.approx(bond.stiffness[0] * SIDE**2 * 1e-8, rel=1e-6)
    assert bond.damage[0] == damage


def test_surfaces_that_only_touch_meet_where_they_did(pair: Blocks) -> None:
    """A bond that is broken from the start bears nothing while it is open, also when it closes again."""
    bond, up = cohesive(pair), np.array([0, 0, 1.0])
    bond.damage[:] = 1.0
    force = pull(pair, bond, np.array([1e-8, 5e-9, -1e-8])[:, None] * up)[:, 2]
    assert force[:2] == pytest.approx(0.0, abs=1e-12 * force[2])
    assert force[2] == pytest.approx(bond.stiffness[0] * SIDE**2 * 1e-8, rel=1e-6)


def test_a_mass_that_swings_on_a_bond_comes_to_rest(pair: Blocks) -> None:
    """With half the fracture energy it stops in the first swing, but for the elastic energy (1 - D)^2 N^2 / 2 k per area."""
    bond = cohesive(pair)
    mass = 1.0
    speed, z, dt = np.sqrt(GI * SIDE**2 / mass), 0.0, 2e-8  # 6000 steps in an elastic period
    turned, energy = 0, []
    while turned < 2:
        force = pull(pair, bond, np.array([[0.0, 0.0, z]]))[0, 2]
        before = speed
        speed += dt * force / mass
        z += dt * speed
        if before * speed < 0.0:
            turned += 1
            energy.append(bond.stored)
    left = (1.0 - bond.damage[0]) ** 2 * N**2 / (2 * bond.stiffness[0]) * SIDE**2
    assert (1.0 - bond.damage[0]) ** 2 == pytest.approx(0.5, abs=0.02)
    assert max(energy) <= 1.01 * left
    assert left < 0.1 * GI * SIDE**2


def test_a_path_that_changes_its_mode_never_gives_energy_back(pair: Blocks, rng: np.random.Generator) -> None:
    bond = cohesive(pair)
    way = np.cumsum(rng.standard_normal((600, 3)) * 2e-7, axis=0)
    way[:, 2] = np.abs(way[:, 2])
    last = 0.0
    for shift in way:
        pull(pair, bond, shift[None])
        assert bond.dissipated >= last
        last = bond.dissipated
    assert 0.1 < bond.damage.max() <= 1.0


def test_infinite_strength_holds_zero_energy_snaps_infinite_energy_flows(pair: Blocks) -> None:
    for_ever = pair.tie()
    first = N / for_ever.stiffness[0]  # opening at the strength
    path = np.linspace(0, 3 * first, 1000)[:, None] * np.array([0, 0, 1.0])
    force = -pull(pair, for_ever, path)[:, 2]
    assert force[-1] == pytest.approx(3 * N * SIDE**2)
    assert for_ever.dissipated == 0.0
    brittle = pair.tie(strength=N, energy=0.0)
    force = -pull(pair, brittle, path)[:, 2]
    assert 0.99 * N * SIDE**2 < force.max() <= N * SIDE**2
    assert np.count_nonzero((force[1:] < force[:-1]) & (force[1:] > 0)) <= 1  # peak, then nothing, but for rounding
    assert brittle.broken.all()
    flowing = pair.tie(strength=N, energy=np.inf)
    force = -pull(pair, flowing, path)[:, 2]
    assert force[-1] == pytest.approx(N * SIDE**2, rel=1e-9)


def test_force_and_moment_cancel_in_any_shape_with_gaps_and_damage(pair: Blocks, rng: np.random.Generator) -> None:
    t = pair.target
    t.nodes.x[pair.nodes(1)] += [0, 0, 0.02 * SIDE]  # bonds across a gap
    bond = cohesive(pair)
    assert bond.gap == pytest.approx(0.02 * SIDE)
    for size in (1e-6, 1e-5, 3e-5):
        x, f = t.nodes.x + size * rng.standard_normal(t.nodes.x.shape), np.zeros_like(t.nodes.x)
        bond.forces(x, f)
        assert np.abs(f.sum(axis=0)).max() < 1e-12 * np.abs(f).sum()
        assert np.abs(np.cross(x, f).sum(axis=0)).max() < 1e-12 * np.abs(f).sum() * SIDE
    assert 0.1 < bond.damage.mean() <= 1.0


def test_bonds_between_nodes_that_do_not_move_keep_their_state(pair: Blocks, rng: np.random.Generator) -> None:
    """Of the first nodes that move, the forces are those of all bonds, and so are the energies."""
    every, some, x = (
        cohesive(pair),
        cohesive(pair),
        pair.target.nodes.x + 3e-6 * rng.standard_normal(pair.target.nodes.x.shape),
    )
    for bond in (every, some):
        bond.forces(x, np.zeros_like(x))
    active = int(np.median(np.minimum(every.nodes, every.triangles.min(axis=1))))
    x[:active] += 3e-6 * rng.standard_normal((active, 3))
    f, g = np.zeros_like(x), np.zeros_like(x)
    every.forces(x, f)
    some.forces(x, g, active=active)
    np.testing.assert_allclose(g[:active], f[:active], rtol=0.0, atol=1e-12 * np.abs(f).max())
    np.testing.assert_allclose(some.damage, every.damage, rtol=1e-12)
    assert np.abs(g[active:]).sum() < 0.9 * np.abs(f[active:]).sum()  # some are left out
    assert some.stored == pytest.approx(every.stored, rel=1e-12)
    assert some.dissipated == pytest.approx(every.dissipated, rel=1e-12)


def test_the_forces_are_the_gradient_of_the_stored_energy(pair: Blocks, rng: np.random.Generator) -> None:
    t = pair.target
    t.nodes.x[pair.nodes(1)] += [0, 0, 0.05 * SIDE]
    bond = pair.tie()
    x, d = t.nodes.x + 2e-5 * rng.standard_normal(t.nodes.x.shape), rng.standard_normal(t.nodes.x.shape)
    f = np.zeros_like(x)
    bond.forces(x, f)

    def energy(s: float) -> float:
        bond.forces(x + s * d, np.zeros_like(x))
        return bond.stored

    slope = (energy(1e-9) - energy(-1e-9)) / 2e-9
    assert slope == pytest.approx(-float(np.sum(f * d)), rel=1e-6)


def test_a_rigid_motion_of_a_tied_pair_makes_no_force(pair: Blocks) -> None:
    t = pair.target
    t.nodes.x[pair.nodes(1)] += [0, 0, 0.05 * SIDE]
    bond = cohesive(pair)
    for angle in np.linspace(0.3, 6.0, 7):
        turned = Rotation.from_rotvec(angle * np.array([0.6, -0.5, 0.62])).apply(t.nodes.x)
        f = np.zeros_like(t.nodes.x)
        bond.forces(np.ascontiguousarray(turned) + np.array([1.0, -2.0, 3.0]), f)
        assert np.abs(f).max() < 1e-9 * N * SIDE**2
    assert bond.dissipated == 0.0


@pytest.mark.usefixtures("undamped")
def test_a_wave_crosses_a_tied_interface_as_through_one_body() -> None:
    """A pulse four elements wide at half height: tied bars differ from one bar as another mesh of it does."""
    W, L, h = 0.25, 1.0, 0.06
    ends: dict[str, tuple[np.ndarray, np.ndarray]] = {}
    for name, bars in {
        "one": [((W, W, 2 * L), h, (0, 0, 0))],
        "another mesh": [((W, W, 2 * L), 0.93 * h, (0, 0, 0))],
        "tied": [((W, W, L), h, (0, 0, 0)), ((W, W, L), 0.93 * h, (0, 0, L))],
        "apart": [((W, W, L), h, (0, 0, 0)), ((W, W, L), 0.93 * h, (0, 0, L))],
    }.items():
        b = Blocks(*bars)
        t = b.target
        if name == "tied":
            assert b.tie().area.sum() == pytest.approx(W**2)
        t.nodes.v[:, 2] = np.exp(-(((t.nodes.x[:, 2] - 0.5) / 0.25) ** 2))
        far = np.flatnonzero(t.nodes.x[:, 2] > 2 * L - 1e-9)
        seen: list[tuple[float, float]] = []
        b.run(4e-4, watch=lambda t=t, far=far, seen=seen: seen.append((t.time, float(t.nodes.v[far, 2].mean()))))
        ends[name] = (np.array(seen)[:, 0], np.array(seen)[:, 1])
    grid = np.linspace(0, 4e-4, 400)
    one = np.interp(grid, *ends["one"])
    off = {name: np.linalg.norm(np.interp(grid, *end) - one) / np.linalg.norm(one) for name, end in ends.items()}
    assert off["tied"] < 1.5 * off["another mesh"] < 0.05
    assert off["apart"] > 0.9


@pytest.mark.usefixtures("undamped")
@pytest.mark.parametrize("toward", [(0, 0, 1), (1, 0, 0), (1, 0, 1)], ids=["tension", "shear", "mixed"])
def test_blocks_torn_apart_spend_the_fracture_energy_and_the_ledger_closes(toward: tuple[int, int, int]) -> None:
    """Elastic cubes that fly apart. The step is short, so that the last opening, 50 um, takes more than twenty of them."""
    b = Blocks(((1.0,) * 3, 0.3, (0, 0, 0)), ((1.0,) * 3, 0.25, (0, 0, 1.0)))
    bond, t = b.tie(strength=20e6, energy=500.0), b.target
    b.touch(friction=0.3)
    for body, sign in ((0, -1), (1, 1)):
        t.nodes.v[b.nodes(body)] = sign * np.array(toward) / np.linalg.norm(toward)
    start, momentum, moment, worst = b.energy(), t.momentum(), b.moment(), [0.0]

    def check_ledger() -> None:
        worst[0] = max(worst[0], abs(b.energy() / start - 1.0))

    b.run(6e-4, watch=check_ledger, limit=1e-6)
    assert len(bond) == 0  # all have broken and gone over to the contact
    assert bond.dissipated == pytest.approx(500.0, rel=0.01)
    assert worst[0] < 1e-4
    scale = float(t.mass.sum())
    assert np.abs(t.momentum() - momentum).max() < 1e-12 * scale
    assert np.abs(b.moment() - moment).max() < 1e-12 * scale


@pytest.mark.usefixtures("undamped")
@pytest.mark.parametrize(("energy", "parts"), [(500.0, True), (1e6, False)])
def test_cubes_that_fly_apart_part_when_they_can_pay_the_fracture_energy(energy: float, parts: bool) -> None:
    b = Blocks(((1.0,) * 3, 0.35, (0, 0, 0)), ((1.0,) * 3, 0.3, (0, 0, 1.0)))
    bond, t, kinetic = b.tie(strength=30e6, energy=energy), b.target, 7800.0
    b.touch()
    for body, sign in ((0, -1), (1, 1)):
        t.nodes.v[b.nodes(body), 2] = sign * 1.0
    bonds = len(bond)
    b.run(2e-3)
    assert t.mass.sum() == pytest.approx(2 * kinetic)
    if parts:
        assert len(bond) == 0
        assert b.velocity(1)[2] == pytest.approx(np.sqrt(1 - energy / kinetic), rel=0.03)
    else:
        assert len(bond) == bonds
        # where the bonds' plateau has absorbed all the kinetic energy
        assert np.abs(bond.opening).max() < 1.2 * kinetic / 30e6


def test_a_broken_bond_under_pressure_hands_over_to_the_contact(pair: Blocks) -> None:
    bond, contact = cohesive(pair), pair.touch(friction=0.4)
    up, still = pair.nodes(1), np.zeros_like(pair.target.nodes.x)
    contact.search(pair.target.nodes.x, 0.0, bond)
    before = (
        contact.pairs.penalty_energy
    )  # held nodes are the bond's; those of the other side touch by rounding at most
    x = shifted(pair, np.array([1.02 * 2 * GII / S, 0, -0.001 * SIDE]))
    f, g = np.zeros_like(x), np.zeros_like(x)
    bond.forces(x, f)
    pressed, energy = f[up, 2].sum(), bond.stored
    assert bond.broken.all()
    assert pressed == pytest.approx(bond.stiffness[0] * SIDE**2 * 0.001 * SIDE)  # still resisted
    contact.search(x, 1e-9, bond)
    contact.forces(1e-12, x, still, g)
    assert len(bond) == 0
    assert bond.stored == pytest.approx(0.0, abs=1e-12 * energy)
    assert touching(contact) >= 16
    assert g[up, 2].sum() > 0
    assert before <= 1e-12 * energy
    assert contact.pairs.penalty_energy + contact.pairs.sums.lost == pytest.approx(energy, rel=1e-9)


def test_friction_springs_that_open_while_bonds_take_nodes_over_are_counted_once(pair: Blocks) -> None:
    """Springs of nodes that bonds hold are lost, those of the other side become heat or are dropped: together what they stored."""
    bond, contact = cohesive(pair), pair.touch(friction=0.4)
    # a contact takes over what bonds hold at its first search: here they come after it
    contact.search(pair.target.nodes.x, 0.0)
    springs = contact.past().nodes
    springs["spring"] = [0.3, 0.4, 0.0]  # N
    contact.continue_from(ContactPast(springs))
    stored = contact.pairs.penalty_energy
    assert stored > 0.0
    contact.search(shifted(pair, np.array([0.0, 0.0, 0.01 * SIDE])), 0.0, bond)
    assert contact.pairs.sums.friction_heat > 0.1 * stored
    spent = contact.pairs.sums.friction_heat + contact.pairs.sums.dropped_energy + contact.pairs.sums.lost
    assert contact.pairs.penalty_energy + spent == pytest.approx(stored, rel=1e-9)


def test_a_bond_that_slides_far_keeps_its_shear_and_leaves_the_pressure_to_the_contact(pair: Blocks) -> None:
    bond, contact = pair.tie(strength=S, energy=1e6), pair.touch()  # so tough that it lasts for ten spacings
    up, still = pair.nodes(1), np.zeros_like(pair.target.nodes.x)
    contact.search(pair.target.nodes.x, 0.0, bond)
    spacing = float(np.sqrt(bond.area.max()))
    x = shifted(pair, np.array([0.7 * spacing, 0, -0.001 * SIDE]))
    f = np.zeros_like(x)
    bond.forces(x, f)
    shear, energy = f[up, 0].sum(), bond.stored
    contact.search(x, 1e-9, bond)
    assert bond.loose.all()
    assert len(bond) > 0
    f[:] = 0.0
    bond.forces(x, f)
    assert f[up, 0].sum() == pytest.approx(shear, rel=1e-3)
    contact.forces(1e-12, x, still, f)
    assert f[up, 2].sum() > 0
    assert touching(contact) > 10
    assert bond.stored + contact.pairs.penalty_energy + contact.pairs.sums.lost == pytest.approx(energy, rel=1e-9)


def test_a_run_goes_on_from_its_state_as_if_it_had_not_stopped(pair: Blocks) -> None:
    bond = cohesive(pair)
    path = np.linspace(0, 3e-5, 60)[:, None] * np.array([0.6, 0, 0.8])
    pull(pair, bond, path[:30])
    kept = copied(bond)
    later = pull(pair, bond, path[30:])
    again = copied(kept)
    assert np.array_equal(pull(pair, again, path[30:]), later)
    assert again.dissipated == bond.dissipated
    assert np.array_equal(pull(pair, kept, path[30:]), later)


def test_numbers_of_nodes_may_change_and_sets_be_joined(pair: Blocks, rng: np.random.Generator) -> None:
    t = pair.target
    order = rng.permutation(len(t.nodes.x))
    new = np.argsort(order)  # new number of each old node
    one, two, whole = cohesive(pair), cohesive(pair), cohesive(pair)
    x = shifted(pair, np.array([1e-6, 0, 2e-6]))
    f = np.zeros_like(x)
    whole.forces(x, f)
    one.renumber(new)
    g = np.zeros_like(x)
    one.forces(x[order], g)
    assert np.array_equal(g[new], f)
    both = Bond.joined([two, copied(two)])
    h = np.zeros_like(x)
    both.forces(x, h)
    assert h == pytest.approx(2 * f, rel=1e-12, abs=1e-12 * np.abs(f).max())


@pytest.mark.parametrize(
    ("law", "says"),
    [
        ({"strength": N, "energy": 0.1}, "its spring stores"),
        ({"strength": -1.0}, "positive strength"),
        ({"strength": N, "energy": -1.0}, "energy of zero or more"),
    ],
)
def test_a_law_that_cannot_be_followed_is_refused(pair: Blocks, law: dict[str, float], says: str) -> None:
    with pytest.raises(SolverError, match=says):
        pair.tie(**law)


def test_no_bonds_cost_nothing(pair: Blocks) -> None:
    s = pair.surfaces
    lifted = pair.target.nodes.x + np.where(pair.body_of_node[:, None] == 1, SIDE, 0.0)
    none = Bond.between(interface(s, lifted, 1, 0.1 * SIDE), s, lifted, 1e15)
    f = np.zeros_like(lifted)
    none.forces(lifted, f)
    assert len(none) == 0
    assert not f.any()
    assert pair.target.stable_dt(springs=none.springs()) == pair.target.stable_dt()
    assert none.stored == none.dissipated == 0.0


def test_the_stable_step_is_below_the_exact_one_of_the_springs(pair: Blocks) -> None:
    """Springs alone, with the lumped masses: largest eigenvalue by a dense solver."""
    bond, t = pair.tie(), pair.target
    used = np.unique(np.concatenate([bond.nodes, bond.triangles.ravel()]))
    stiffness = np.zeros((len(used), len(used)))
    place = {int(node): i for i, node in enumerate(used)}
    for node, corners, w, k in zip(bond.nodes, bond.triangles, bond.weights, bond.stiffness * bond.area, strict=True):
        g = np.zeros(len(used))
        g[place[int(node)]] += 1
        for corner, weight in zip(corners, w, strict=True):
            g[place[int(corner)]] -= weight
        stiffness += k * np.outer(g, g)
    root = 1 / np.sqrt(t.mass[used])
    exact = 2 / np.sqrt(np.linalg.eigvalsh(stiffness * np.outer(root, root)).max())
    assert 0.5 * exact < 2 / np.sqrt(np.max(bond.springs().load(len(t.nodes.x)) / t.mass)) < exact
    w = np.zeros((len(t.nodes.x), 3))
    w[used] = np.random.default_rng(1).normal(size=(len(used), 3))
    f = np.zeros_like(w)
    resist(bond.springs(), w, len(w), f)
    assert f[used] == pytest.approx(stiffness @ w[used])


def test_the_step_of_tied_blocks_is_that_of_springs_and_elements_together(pair: Blocks) -> None:
    """Springs far stiffer than the elements, on a block far heavier than the other, set the step alone; row sums make it shorter."""
    t, bond = pair.target, pair.tie()
    heavier = np.ones(len(t.nodes.x))
    heavier[t.mesh.conn[pair.body == 0]] = 100.0
    t.mass *= heavier
    t.inv_mass /= heavier
    free = t.stable_dt(enough=1.0)
    assert t.stable_dt(1.0, springs=bond.springs()) <= free
    bond.stiffness *= 1e4
    springs = bond.springs()
    f, w, factor = np.zeros_like(t.nodes.x), np.random.default_rng(1).normal(size=t.nodes.x.shape), 0.0
    for _ in range(2000):
        f[:] = 0.0
        resist(springs, w, len(w), f)
        w = f * t.inv_mass[:, None]
        factor = np.linalg.norm(w)
        w /= factor
    exact = 2 / np.sqrt(factor)
    for _ in range(20):  # later calls start from the last vector
        step = t.stable_dt(1.0, springs=springs)
    assert step * (1 + explicit.LINEAR_VISCOSITY) / safety.MESH == pytest.approx(exact, rel=0.02)
    assert step > 1.05 * t.stable_dt(springs=springs)
