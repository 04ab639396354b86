"""Springs at the cut stand for the rest of a half-space: the size of the substrate hardly shows."""

import numpy as np
import pytest
from scenes import scene_with

from coupler.fe import mesh as meshes
from coupler.fe.boundary import HALF_SPACE, foundation
from coupler.fe.explicit import Target
from coupler.geometry import mesher
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.target.bodies import Bodies
from coupler.target.cut import cut_out
from coupler.target.equilibrium import COOLED, settle

STEEL = material("SS304")


def cylinder(scale: float, kind: str) -> Bodies:
    """A cylinder 80 um wide and 40 um high, times `scale`; kind: of its sides and bottom, or a fixed bottom and free sides."""
    size = 80e-6 * scale, 40e-6 * scale
    points, tets = mesher.cylinder(*size, 4e-6, 18e-6, 0.35, (0.0, 0.0), 30e-6)
    mesh = meshes.prepare(points, tets)
    fixed = ("bottom",) if kind == "fixed" else ()
    if kind == HALF_SPACE:
        mesh.sets[HALF_SPACE] = np.concatenate([mesh.sets["sides"], mesh.sets["bottom"]])
    target = Target(mesh, law_record(STEEL, rate_filter=1e-9), 300.0, fixed=fixed, track_wave=False)
    return Bodies(target, np.zeros(len(mesh.conn), np.int32), fixed, (), 0.3)


def stresses_of_a_warm_spot(bodies: Bodies) -> np.ndarray:
    """Mean xx and zz stresses (MPa) in a hemisphere of 10 um below the middle that is 60 K warmer, and round it up to 30 um."""
    t = bodies.target
    away = np.linalg.norm(t.nodes.x[t.mesh.conn].mean(axis=1), axis=1)
    hot, ring = away < 10e-6, (away >= 10e-6) & (away < 30e-6)
    t.warm(np.flatnonzero(hot), STEEL.rho * STEEL.cp_at(300.0) * 60.0 * t.mesh.V0[hot])
    settle(bodies, 1e-9, aim=COOLED)
    stress = t.stress()
    return np.array(
        [np.average(stress[part, i], weights=t.elements.volume[part]) for part in (hot, ring) for i in (0, 2)]
    ) / 1e6  # fmt: skip


def test_the_size_of_the_substrate_hardly_shows() -> None:
    """Twice the size changes no stress by 3 % of the largest; with a fixed bottom and free sides the cut shows more."""
    small, large = (stresses_of_a_warm_spot(cylinder(scale, HALF_SPACE)) for scale in (1.0, 2.0))
    most = np.abs(large).max()
    assert np.abs(small - large).max() < 0.03 * most
    cut = stresses_of_a_warm_spot(cylinder(1.0, "fixed"))
    assert np.abs(cut - large).max() > 1.5 * np.abs(small - large).max()


def test_the_springs_balance_a_centre_of_dilatation() -> None:
    """u = A r / |r|^3 has the traction -4 G u / R on a hemisphere: the springs of its facets give that back."""
    bodies = cylinder(1.0, HALF_SPACE)
    mesh = bodies.target.mesh
    nodes, springs = foundation(mesh, np.full(len(mesh.conn), STEEL.G))
    bottom = np.isin(nodes, mesh.facets[mesh.sets["bottom"]])
    low = int(np.argmin(np.hypot(*mesh.points[nodes[bottom]][:, :2].T)))  # below the middle the face is across r
    area = np.zeros(len(mesh.points))
    corners = mesh.facets[mesh.sets["bottom"]]
    size = 0.5 * np.linalg.norm(
        np.cross(*(mesh.points[corners[:, i]] - mesh.points[corners[:, 0]] for i in (1, 2))), axis=1
    )
    np.add.at(area, corners, np.repeat(size[:, None] / 3.0, 3, axis=1))
    matrix, own = springs[bottom][low], area[nodes[bottom][low]]
    assert matrix[2, 2] / own == pytest.approx(4.0 * STEEL.G / 40e-6, rel=0.05)
    assert matrix[0, 0] / own == pytest.approx(2.0 * STEEL.G / 40e-6, rel=0.05)


def test_the_energy_of_the_springs_is_in_the_ledger() -> None:
    """A free push of the whole block on its springs: kinetic and elastic energy stay the same but for what the dashpots take."""
    t = cylinder(1.0, HALF_SPACE).target
    t.activate_all()
    t.nodes.v[:, 2] = -1.0
    start = 0.5 * float(t.mass.sum())
    for _ in range(60):
        t.advance(t.stable_dt())
        t.finish()
    assert t.balance.absorbed > 0.05 * start
    assert t.kinetic() + t.elastic() + t.balance.absorbed + t.balance.plastic + t.balance.numerical == pytest.approx(
        start, rel=2e-3
    )
    moved = t.momentum() - t.external_impulse()
    assert moved == pytest.approx([0.0, 0.0, -float(t.mass.sum())], abs=1e-9 * float(t.mass.sum()))


def test_a_coating_stands_on_a_half_space_unless_the_scene_says_otherwise() -> None:
    table = """
[coating]
material = "Ni"
number = 2
radius = "5 um"
diameter = "20 um"
velocity = "600 m/s"
[substrate]
material = "SS304"
"""
    target = plan(Scene.from_text(table, "c")).target
    assert (target.sides, target.bottom) == ("half_space", "half_space")
    target = plan(Scene.from_text(table + 'bottom = "fixed"\n', "c")).target
    assert (target.sides, target.bottom) == ("half_space", "fixed")
    assert plan(scene_with()).target.bottom == "fixed"


def test_what_the_wave_has_not_reached_is_in_balance_with_its_springs() -> None:
    """Displaced springs of the inactive part move nothing: momentum closes as the front goes out to them."""
    bodies = cylinder(2.0, HALF_SPACE)
    stresses_of_a_warm_spot(bodies)
    t = bodies.target
    assert np.abs(t.nodes.x[t.spring_nodes] - t.spring_rest).max() > 1e-11
    t.deactivate_beyond(20e-6)
    assert t.active_nodes < len(t.nodes.x)
    top = np.flatnonzero(np.linalg.norm(t.nodes.x, axis=1) < 8e-6)
    pushed = np.zeros(3)
    before = t.momentum() - t.external_impulse()
    for _ in range(40):
        t.advance(5e-11)
        t.finish()
        t.nodes.total[top, 2] -= 1e-3
        pushed[2] -= 5e-11 * 1e-3 * len(top)
    moved = t.momentum() - t.external_impulse() - before
    assert moved[2] == pytest.approx(pushed[2], rel=0.03)  # half of the last push is still to come
    assert np.abs(moved[:2]).max() < 1e-6 * abs(pushed[2])


def test_a_cut_at_the_side_has_the_springs_of_the_whole() -> None:
    bodies = cylinder(1.0, HALF_SPACE)
    part, cut = cut_out(bodies, (32e-6, 0.0, 0.0), 20e-6)
    t, own = bodies.target, part.target
    number = part.state().target.nodes.node_number[own.spring_nodes]
    free = np.linalg.norm(own.nodes.x[own.spring_nodes] - [32e-6, 0.0, 0.0], axis=1) < 20e-6
    assert 5 < free.sum() < len(t.spring_nodes) / 2
    assert np.isin(number[free], cut.nodes).all()
    place = np.searchsorted(t.spring_nodes, number[free])
    np.testing.assert_allclose(own.springs[free], t.springs[place], rtol=1e-12)


def test_bodies_that_are_numbered_anew_keep_the_contraction_of_the_half_space() -> None:
    bodies = cylinder(1.0, HALF_SPACE)
    t = bodies.target
    t.nodes.x[:] *= 0.995
    t.rest_scale *= 0.995
    same = bodies.renumbered((10e-6, 0.0, 0.0)).target
    assert np.abs(same.nodes.x[same.spring_nodes] - same.spring_rest).max() < 1e-12
    assert same.elastic() == pytest.approx(t.elastic(), abs=1e-15)


def test_heat_of_what_is_inactive_waits() -> None:
    """It becomes pressure once the wave has come, and not in each step until then."""
    bodies = cylinder(1.0, HALF_SPACE)
    t = bodies.target
    t.deactivate_beyond(15e-6)
    e = next(e for e in range(t.active_elements, len(t.mesh.conn)) if (t.mesh.conn[e] < t.active_nodes).any())
    t.elements.heat[e] = 1e-9
    before = t.nodes.energy.copy()
    for _ in range(5):
        t.advance(1e-12)
        t.finish()
    assert e >= t.active_elements
    assert t.elements.heat[e] == 1e-9
    assert float(t.mesh.node_volume @ np.abs(t.nodes.energy - before)) < 1e-12
