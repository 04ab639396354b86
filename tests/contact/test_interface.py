"""Whose facet is whose, where one body lies on another, and which of its nodes the scene bonds."""

import numpy as np
import pytest
from blocks import Blocks, cubes

from coupler.contact.bond import Bond, penalty
from coupler.contact.surfaces import Surfaces, interface
from coupler.geometry.triangles import area_vectors
from coupler.physics.adhesion import Adhesion

SIDE = 1e-3


@pytest.fixture
def pair() -> Blocks:
    return cubes(SIDE)


def test_surfaces_know_whose_facet_is_whose(pair: Blocks) -> None:
    s: Surfaces = pair.surfaces
    assert s.bodies == 2
    assert len(s.facets_of(0)) + len(s.facets_of(1)) == len(s.facets)
    assert set(s.nodes_of(0)).isdisjoint(s.nodes_of(1))
    assert np.linalg.norm(area_vectors(pair.target.nodes.x, s.facets[s.facets_of(1)]), axis=1).sum() == pytest.approx(
        6 * SIDE**2
    )
    assert 0.1 * SIDE < s.spacing(pair.target.nodes.x, 1) < 0.3 * SIDE


def test_an_interface_is_what_faces_and_has_area(pair: Blocks) -> None:
    t, s = pair.target, pair.surfaces
    found = interface(s, t.nodes.x, 1, 0.05 * SIDE)
    assert t.nodes.x[found.nodes, 2] == pytest.approx(SIDE)
    assert found.weights.sum(axis=1) == pytest.approx(1.0)
    assert found.weights.min() >= 0
    normals = area_vectors(t.nodes.x, s.facets[found.facet])
    assert np.all(normals[:, 2] > 0)  # the lower block's top, not its sides
    mine, theirs = found.behind(s, pair.body.astype(float))
    assert np.all(mine == 1)
    assert np.all(theirs == 0)
    half = found.only(t.nodes.x[found.nodes, 0] < 0.5 * SIDE)
    assert half.area.sum() < found.area.sum()
    assert half.own[:, 0].max() < len(half.nodes)
    lifted = t.nodes.x.copy()
    lifted[pair.nodes(1), 2] += 0.2 * SIDE
    assert len(interface(s, lifted, 1, 0.05 * SIDE).nodes) == 0


def test_a_thin_plates_far_side_is_not_in_the_interface() -> None:
    b = Blocks(((1.0, 1.0, 0.5), 0.3, (0, 0, 0)), ((1.0, 1.0, 0.1), 0.1, (0, 0, 0.5)))
    found = interface(b.surfaces, b.target.nodes.x, 1, 0.15)
    assert b.target.nodes.x[found.nodes, 2] == pytest.approx(0.5)


def test_fitted_nodes_lie_on_their_facets(pair: Blocks, rng: np.random.Generator) -> None:
    t, s = pair.target, pair.surfaces
    rough = t.nodes.x.copy()
    rough[pair.nodes(1)] += 2e-5 * rng.standard_normal((len(pair.nodes(1)), 3))
    found = interface(s, rough, 1, 0.1 * SIDE)
    assert np.abs(found.gap).max() > 1e-5
    fitted = found.fitted(rough, s)
    assert np.abs(interface(s, fitted, 1, 0.1 * SIDE).gap).max() < 1e-12 * SIDE
    assert np.array_equal(fitted[pair.nodes(0)], rough[pair.nodes(0)])


def test_the_criterion_of_the_scene_decides_which_nodes_are_bonded(pair: Blocks) -> None:
    t, s = pair.target, pair.surfaces
    found = interface(s, t.nodes.x, 1, 0.05 * SIDE)
    strain = t.mesh.points[t.mesh.conn, 0].mean(axis=1) / SIDE  # as if one side had flowed more
    here, there = found.behind(s, strain)
    asked = Adhesion(kind="cohesive", strength=300e6, energy=900.0, criterion="plastic_strain", threshold=0.5)
    chosen = asked.bonded(len(found.nodes), plastic_strain=np.maximum(here, there))
    bond = Bond.between(found.only(chosen), s, t.nodes.x, penalty(pair.K, 0.25 * SIDE), **asked.law())
    assert 0 < len(bond) < len(found.nodes)
    assert t.nodes.x[bond.nodes, 0].min() > 0.25 * SIDE
    assert bond.area.sum() == pytest.approx(0.5 * SIDE**2, rel=0.35)
    f, x = np.zeros_like(t.nodes.x), t.nodes.x.copy()
    x[pair.nodes(1), 2] += 0.5 * 300e6 / bond.stiffness[0]  # half way to the strength
    bond.forces(x, f)
    assert -f[pair.nodes(1), 2].sum() == pytest.approx(150e6 * bond.area.sum())
