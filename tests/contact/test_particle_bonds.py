"""Springs between a particle's surface and the target: opening from zero gap, slip under pressure, energy of fracture."""

from types import SimpleNamespace

import numpy as np
import pytest
from blocks import cubes
from scipy.sparse import csr_matrix, identity
from sheet import ENERGY, FACETS, SHEAR, SIDE, SQUARE, STIFFNESS, STRENGTH, Sheet

from coupler.contact.bond import Bond
from coupler.contact.particle_bonds import CONTACT_RANGE, ParticleBonds
from coupler.core.records import copied
from coupler.impact.heat import release
from coupler.physics.constitutive import heat_capacities


def alone(bond: Bond) -> ParticleBonds:
    """Bonds of points that have no neighbours."""
    points = int(bond.nodes.max(initial=0)) + 1
    return ParticleBonds(bond, csr_matrix((points, points)))


def patch(pull: float, energy: float = np.inf) -> tuple[ParticleBonds, np.ndarray, np.ndarray]:
    """Four points on a square of two facets, 1 um across, the points pulled off by `pull` m after they were bonded."""
    x = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0], [5, 5, 5.0]]) * 1e-6
    facets = np.array([[0, 1, 2], [0, 1, 2], [0, 2, 3], [0, 2, 3]])
    xp = np.array([[9, 9, 9], [0.6, 0.2, 0], [0.9, 0.6, 0], [0.2, 0.6, 0], [0.5, 0.9, 0]]) * 1e-6
    law = {} if energy == np.inf else {"strength": 4e8, "energy": energy}
    bonds = alone(Bond.tie(np.arange(1, 5), facets, xp, x, np.full(4, 0.25e-12), 1e17, **law))
    return bonds, xp + np.array([0.0, 0.0, pull]), x


def test_a_hold_pulls_back_and_gives_as_much_to_the_facets() -> None:
    bonds, xp, x = patch(1e-9)
    f, g = np.zeros_like(xp), np.zeros_like(x)
    bonds.forces(xp, x, f, g)
    np.testing.assert_allclose(f[1:, 2], -1e17 * 1e-9 * 0.25e-12, rtol=1e-9)
    assert not f[0].any()
    assert not g[4].any()
    np.testing.assert_allclose(f.sum(axis=0) + g.sum(axis=0), 0.0, atol=1e-18)
    np.testing.assert_allclose(np.cross(xp, f).sum(axis=0) + np.cross(x, g).sum(axis=0), 0.0, atol=1e-22)
    assert bonds.bond.work == pytest.approx(0.5 * 1e17 * 1e-18 * 1e-12)
    assert not bonds.bond.broken.any()


def test_a_hold_gives_way_when_its_energy_is_spent() -> None:
    bonds, xp, x = patch(0.0, energy=10.0)
    f, g = np.zeros_like(xp), np.zeros_like(x)
    for _ in range(300):
        xp[:, 2] += 2e-10  # to 60 nm: the last opening is 2 G / strength = 50 nm
        bonds.forces(xp, x, f, g)
    assert bonds.bond.broken.all()
    assert bonds.bond.work == pytest.approx(10.0 * 1e-12, rel=5e-3)
    assert bonds.bond.area.sum() == pytest.approx(1e-12)
    assert bonds.bond.soundness.max() == 0.0
    again = alone(copied(bonds.bond))
    np.testing.assert_array_equal(again.bond.nodes, bonds.bond.nodes)
    assert again.bond.work == bonds.bond.work


def test_a_hold_without_springs_keeps_what_they_have_dissipated() -> None:
    bonds, xp, x = patch(1e-9)
    bonds.forces(xp, x, np.zeros_like(xp), np.zeros_like(x))
    held = bonds.bond.work
    bonds.bond.drop(np.ones(4, bool))
    empty = alone(bonds.bond)
    f, g = np.zeros_like(xp), np.zeros_like(x)
    empty.forces(xp, x, f, g)
    assert not f.any()
    assert not g.any()
    assert empty.bond.work == pytest.approx(held, rel=1e-12)
    assert empty.stable_dt(1.0, np.ones(5)) == np.inf
    assert len(empty.bond) == 0
    both = alone(Bond.joined([empty.bond, patch(0.0)[0].bond]))
    assert len(both.bond) == 4
    assert both.bond.work == pytest.approx(held, rel=1e-12)


def test_its_step_is_that_of_a_mass_on_a_spring() -> None:
    bonds, _, _ = patch(0.0)
    mass = 1e-15
    dt = bonds.stable_dt(1.0 / mass, np.full(5, 1e3))
    # each point on one spring of k a; Gershgorin counts the foot's side too
    assert dt == pytest.approx(0.9 * 2.0 / np.sqrt(2.0 * 1e17 * 0.25e-12 / mass))


@pytest.mark.parametrize("n", [2, 4, 8])
@pytest.mark.parametrize("mode", ["tear", "shear", "peel"])
def test_parting_a_known_area_costs_the_fracture_energy_at_any_spacing(mode: str, n: int) -> None:
    sheet = Sheet(n)
    reach = 3.0 * ENERGY / STRENGTH
    for s in np.linspace(0.0, 1.0, 125 * n)[1:]:  # in a peel the rows open one after another
        to = sheet.xp.copy()
        if mode == "tear":
            to[:, 2] += s * reach
        elif mode == "shear":
            to[:, 0] += s * reach
        else:  # about the edge x = 0; the points nearest to it open last
            to[:, 2] += s * reach * 2 * n * sheet.xp[:, 0] / SIDE
        sheet.move(to)
    assert sheet.bonds.bond.broken.all()
    energy = SHEAR if mode == "shear" else ENERGY
    assert sheet.bonds.bond.work == pytest.approx(energy * SIDE**2, rel=0.01)
    assert sheet.work == pytest.approx(energy * SIDE**2, rel=0.01)
    assert sheet.bonds.bond.spent.sum() == pytest.approx(sheet.bonds.bond.dissipated, rel=1e-12)


def test_unloading_from_pressure_is_no_opening() -> None:
    """Bonded 80 nm deep, under 8 GPa: no damage until the contact lets go, then the whole fracture energy."""
    sheet = Sheet(4)
    deep = sheet.xp - np.array([0.0, 0.0, 80e-9])
    for lift in np.linspace(0.0, 79.9e-9, 50):
        assert sheet.move(deep + np.array([0.0, 0.0, lift]))[2] > 0.0
        assert sheet.bonds.bond.damage.max() == 0.0
        assert sheet.bonds.bond.work == pytest.approx(0.0, abs=1e-30)
    assert sheet.move(sheet.xp + np.array([0.0, 0.0, 2e-9]))[2] == pytest.approx(-STIFFNESS * 2e-9 * SIDE**2, rel=1e-6)
    for lift in np.linspace(2e-9, 1e-6, 250):
        sheet.move(sheet.xp + np.array([0.0, 0.0, lift]))
    assert sheet.bonds.bond.work == pytest.approx(ENERGY * SIDE**2, rel=0.01)


def test_sliding_under_pressure_shears_bonds_without_opening_them() -> None:
    sheet = Sheet(4)
    deep = sheet.xp - np.array([0.0, 0.0, 30e-9])
    last = 0.0
    for slip in np.linspace(0.0, 0.05e-6, 100):
        sheet.move(deep + np.array([slip, 0.0, 0.0]))
        bond = sheet.bonds.bond
        assert np.abs(bond.opening[:, 2]).max() == 0.0
        assert bond.traction[:, 0].max() == 0.0
        assert bond.damage.min() >= last
        last = float(bond.damage.min())
    assert 0.1 < last < 1.0
    # the slip is remembered when the contact opens: bonds pull back along it and off the surface
    force = sheet.move(sheet.xp + np.array([0.05e-6, 0.0, 5e-9]))
    assert force[0] < 0.0
    assert force[2] < 0.0


@pytest.mark.parametrize("share", [0.7, 1.0])
def test_what_slides_under_pressure_welds_again(share: float) -> None:
    """Slid by four ligament widths 2 G_II / S: flow at the strength that is left, whose work is heat; then torn from there. Without
    pressure all is lost on the first width."""
    law = {"strength": STRENGTH, "energy": ENERGY, "shear_energy": SHEAR, "rewelds": share}
    pressed, free = Sheet(4, **law), Sheet(4, **law)
    deep = np.array([0.0, 0.0, -30e-9])
    way = 4.0 * 2.0 * SHEAR / STRENGTH
    pressed.move(pressed.xp + deep)
    pressed.work = 0.0  # not that of pressing
    for slip in np.linspace(0.0, way, 300):
        force = pressed.move(pressed.xp + deep + np.array([slip, 0.0, 0.0]))
        free.move(free.xp + np.array([slip, 0.0, 0.0]))
    assert force[0] == pytest.approx(-share * STRENGTH * SIDE**2, rel=1e-6)
    assert pressed.bonds.bond.damage == pytest.approx(1.0 - share, abs=1e-12)
    assert pressed.bonds.bond.work == pytest.approx(pressed.work, rel=2e-3)
    assert pressed.bonds.bond.spent.sum() == pytest.approx(pressed.bonds.bond.dissipated, rel=1e-12)
    assert free.bonds.bond.broken.all()
    slid = pressed.bonds.bond.dissipated + pressed.bonds.bond.stored
    still = pressed.xp + np.array([way - STRENGTH / STIFFNESS * share, 0.0, 0.0])  # no shear is left
    for lift in np.linspace(-30e-9, 3.0 * ENERGY / STRENGTH, 300):
        pressed.move(still + np.array([0.0, 0.0, lift]))
    assert pressed.bonds.bond.broken.all()
    unloaded = 0.5 * (share * STRENGTH) ** 2 / STIFFNESS * SIDE**2
    assert pressed.bonds.bond.work - slid + unloaded == pytest.approx(share**2 * ENERGY * SIDE**2, rel=0.01)


def test_a_point_beside_one_that_presses_is_not_opened() -> None:
    """Two unlike triangulations touch at some points only: the others follow the surface within the range of contact."""
    sheet = Sheet(4)
    hover = np.zeros(16)
    hover[5] = 0.5 * CONTACT_RANGE * SIDE / 4
    for depth in (100e-9, 50e-9, 1e-9):
        to = sheet.xp.copy()
        to[:, 2] += hover - depth
        sheet.move(to)
        assert sheet.bonds.bond.traction[5, 0] == 0.0
    to[:, 2] = hover + 1e-9  # all free: the opening of the one counts from where it was
    sheet.move(to)
    assert sheet.bonds.bond.traction[5, 0] == pytest.approx(2e-9 * STIFFNESS, rel=1e-6)
    assert sheet.bonds.bond.damage[5] == 0.0


def test_a_mass_on_bonds_leaves_above_one_velocity() -> None:
    """v = sqrt(2 G A / m), from energy. The verdict flips once when the velocity rises in steps of 1 %."""
    mass = 1e-13
    v_margin = np.sqrt(2.0 * ENERGY * SIDE**2 / mass)
    left = []
    for ratio in 1.0 + 0.01 * np.arange(-3, 4):
        sheet = Sheet(2)
        z, v, dt = 0.0, ratio * v_margin, 5e-11
        f = 0.0
        while v > 0.0 and not sheet.bonds.bond.broken.all():
            v += f / mass * dt
            z += v * dt
            f = float(sheet.move(sheet.xp + np.array([0.0, 0.0, z]))[2])
        left.append(v > 0.0 and sheet.bonds.bond.broken.all())
    assert np.count_nonzero(np.diff(left)) == 1
    assert not left[1]
    assert left[5]


def test_holds_that_form_one_after_another_act_as_one() -> None:
    both, first = Sheet(4), Sheet(4)
    n = 16
    part = np.arange(n) < 7
    below = np.where(first.xp[:, 0] > first.xp[:, 1], 0, 1)
    law = {"strength": STRENGTH, "energy": np.where(part, ENERGY, 2 * ENERGY)}
    parts = [
        Bond.tie(np.flatnonzero(rows), FACETS[below[rows]], both.xp, SQUARE, np.full(rows.sum(), 1e-12), STIFFNESS,
                 strength=STRENGTH, energy=law["energy"][rows])
        for rows in (part, ~part)
    ]  # fmt: skip
    joined = alone(Bond.joined(parts))
    whole = alone(Bond.tie(np.arange(n), FACETS[below], both.xp, SQUARE, np.full(n, 1e-12), STIFFNESS, **law))
    f, g, F, G = np.zeros((n, 3)), np.zeros((4, 3)), np.zeros((n, 3)), np.zeros((4, 3))
    to = both.xp + np.array([1e-8, 0.0, 1.5e-7])
    joined.forces(to, SQUARE, f, g)
    whole.forces(to, SQUARE, F, G)
    np.testing.assert_allclose(f, F, rtol=1e-12)
    np.testing.assert_allclose(g, G, rtol=1e-9)
    assert joined.bond.damage[0] > joined.bond.damage[-1] > 0.0
    assert joined.resistance == pytest.approx(whole.resistance)
    nodes, heat = joined.bond.triangles, joined.bond.heat()
    assert nodes.max() < 4
    assert heat.sum() == pytest.approx(joined.bond.dissipated)
    assert not joined.bond.heat().any()


def test_the_energy_of_fracture_becomes_heat_of_both_sides() -> None:
    """rho cp V dT of the target's elements and what the particle gets add up to G A."""
    b = cubes(SIDE)
    t, share = b.target, 0.3
    top = t.mesh.facets[t.mesh.sets["a.top"]][:6]
    xp, area = t.nodes.x[top].mean(axis=1), np.full(6, 1e-13)
    bonds = alone(Bond.tie(np.arange(6), top, xp, t.nodes.x, area, STIFFNESS, strength=STRENGTH, energy=ENERGY))
    f, g = np.zeros((6, 3)), np.zeros_like(t.nodes.x)
    for lift in np.linspace(0.0, 1e-6, 250):
        bonds.forces(xp + np.array([0.0, 0.0, lift]), t.nodes.x, f, g)

    class Points:
        heat = np.zeros(6)
        touching = average = identity(6, format="csr")

        def warm(self, heat: np.ndarray) -> None:
            self.heat = heat

        def spread_heat(self, heat: np.ndarray) -> np.ndarray:
            return heat

    points, T = Points(), t.elements.T.copy()
    no_friction = SimpleNamespace(constants=SimpleNamespace(share=share), heat_point=np.zeros(0), heat_face=np.zeros(0))
    plan = SimpleNamespace(effects=SimpleNamespace(friction_heat=True))
    release(
        SimpleNamespace(plan=plan, particle=points, target=t, surface=points, contact=no_friction, folding=None), bonds
    )
    law = t.laws[t.law_of]
    gained = float(np.sum(law["rho"] * heat_capacities(law, T) * t.mesh.V0 * (t.elements.T - T)))
    assert points.heat.sum() == pytest.approx(share * ENERGY * area.sum(), rel=0.01)
    assert points.heat.sum() + gained == pytest.approx(bonds.bond.work, rel=1e-6)
    assert not bonds.bond.heat().any()
