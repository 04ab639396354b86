"""A substrate that splats cover gets coarser elements: what is carried over, when it is due, and a whole run."""

from dataclasses import replace
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from runs import SharedRuns, assert_same_files, assert_same_numbers, break_off
from test_cut import SIDE
from test_detaching import SIZE
from test_sequence import block, substrate

from coupler import Scene, run
from coupler.deposition import coarsening
from coupler.deposition.run import resume
from coupler.errors import SplatError
from coupler.fe.assemble import Domain, domain_now
from coupler.fe.remeshed import base_surface, with_base
from coupler.geometry import mesher
from coupler.geometry.locate import containing
from coupler.impact.bodies import Bodies
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan import batches


def test_a_place_is_found_in_the_tetrahedron_that_holds_it(rng: np.random.Generator) -> None:
    """Random places in random tetrahedra of a box; one outside is given to one that it lies at."""
    points, tets = mesher.box((1.0, 2.0, 1.0), 0.3)
    own = rng.integers(len(tets), size=500)
    weights = rng.dirichlet(np.ones(4), 500)
    places = np.einsum("kc,kcd->kd", weights, points[tets[own]])
    element, found = containing(points, tets, places)
    np.testing.assert_array_equal(element, own)
    np.testing.assert_allclose(found, weights, atol=1e-9)
    (at,), (of_it,) = containing(points, tets, np.array([[0.5, 1.0, 1.001]]))
    np.testing.assert_allclose(of_it @ points[tets[at]], [0.5, 1.0, 1.0], atol=2e-3)
    assert of_it.min() >= 0.0


@pytest.fixture
def bodies() -> Bodies:
    """A cube bonded on a block that is compressed by .3 %, under shear and warm on one side."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    two = substrate().joined(
        [block((-10e-6, -10e-6, 0.0), 0.0, 1.0, law)], Adhesion("tied"), SIZE, (0.0, 0.0, 0.0), None, 1
    )
    t, own = two.target, two.body == 0
    of_base = np.unique(t.mesh.conn[own])
    t.x *= 0.999
    t.J[of_base] = 0.999**3
    t.volume[own] *= 0.999**3
    t.s[own] = [0.0, 0.0, 0.0, 5e7, 0.0, 0.0]
    t.T[own] = 350.0 + 1e6 * t.x[t.mesh.conn[own], 0].mean(axis=1)
    return two


def coarser_inside(domain: Domain, size: float) -> tuple[np.ndarray, np.ndarray]:
    nodes, triangles = base_surface(domain)
    return mesher.fill([(domain.nodes.x[nodes], triangles)], size)


def test_state_is_carried_over(bodies: Bodies) -> None:
    """Mass and heat exactly, what is uniform as it is, what is linear to a part of an element; the cube and the surface stay."""
    domain = domain_now(bodies.target, bodies.body)
    new, number = with_base(domain, *coarser_inside(domain, 9e-6))
    old, own = bodies.body == 0, new.body == 0
    assert 0.2 < own.sum() / old.sum() < 0.8
    assert new.mesh.V0[own].sum() == pytest.approx(domain.mesh.V0[old].sum(), rel=1e-12)
    of_base = np.unique(new.mesh.conn[own])
    np.testing.assert_allclose(new.nodes.J[of_base], 0.999**3, rtol=1e-9)
    np.testing.assert_allclose(
        new.elements.s[own], np.tile([0.0, 0.0, 0.0, 5e7, 0.0, 0.0], (int(own.sum()), 1)), atol=1.0
    )
    heat = [float(d.mesh.V0[d.body == 0] @ d.elements.T[d.body == 0]) for d in (domain, new)]
    assert heat[1] == pytest.approx(heat[0], rel=1e-12)
    x = new.nodes.x[new.mesh.conn[own], 0].mean(axis=1)
    assert np.abs(new.elements.T[own] - 350.0 - 1e6 * x).max() < 4.0  # K, of 60

    kept = number >= 0
    np.testing.assert_array_equal(new.nodes.x[number[kept]], domain.nodes.x[kept])
    assert kept[np.unique(domain.mesh.facets)].all()
    np.testing.assert_array_equal(new.elements.s[~own], domain.elements.s[~old])
    np.testing.assert_array_equal(new.mesh.facets, number[domain.mesh.facets])
    behind = new.mesh.conn[new.mesh.facet_element]
    assert all(np.isin(facet, corners).all() for facet, corners in zip(new.mesh.facets, behind, strict=True))
    np.testing.assert_array_equal(new.body[new.mesh.facet_element], domain.body[domain.mesh.facet_element])
    F = np.einsum(
        "ekd,eki->edi", new.nodes.x[new.mesh.conn[own][:, 1:]] - new.nodes.x[new.mesh.conn[own][:, :1]], new.mesh.B[own]
    )
    np.testing.assert_allclose(np.linalg.det(F), 0.999**3, rtol=1e-9)


def test_the_surface_must_be_the_same(bodies: Bodies) -> None:
    domain = domain_now(bodies.target, bodies.body)
    points, tets = coarser_inside(domain, 9e-6)
    with pytest.raises(SplatError, match="another surface"):
        with_base(domain, points * 1.01, tets)


def planned() -> SimpleNamespace:
    """What of a plan is needed."""
    return SimpleNamespace(
        target=SimpleNamespace(
            growth=0.35, centre=(0.0, 0.0), largest_element=20e-6, spread=10e-6, element_size=6e-6, refined_radius=20e-6
        )
    )


def test_bonds_contact_and_energy_stay(bodies: Bodies) -> None:
    """At rest elastic energy changes by little, and what the bonds hold is held as before."""
    assert bodies.bond is not None
    held, bonds = bodies.target.elastic(), len(bodies.bond)
    where = np.sort(bodies.target.x[bodies.bond.nodes], axis=0)
    hidden = bodies.target.x[bodies.target.mesh.facets[bodies.buried]]
    new, report = coarsening.coarsened(planned(), bodies)
    assert report["elements_after"] < 0.8 * report["elements_before"]
    assert report["T_mean_K_after"] == pytest.approx(report["T_mean_K_before"], rel=1e-12)
    assert new.target.elastic() - held == pytest.approx(report["given_J"], rel=1e-9)
    assert abs(report["given_J"]) < 0.01 * held
    assert new.bond is not None
    assert len(new.bond) == bonds
    np.testing.assert_array_equal(np.sort(new.target.x[new.bond.nodes], axis=0), where)
    np.testing.assert_array_equal(new.target.x[new.target.mesh.facets[new.buried]], hidden)
    assert new.held().all()
    assert "elements from here on" in coarsening.words(report)


def test_where_gmsh_fails_the_fine_elements_stay(bodies: Bodies, monkeypatch: pytest.MonkeyPatch) -> None:
    def fails(*_: object) -> None:
        raise SplatError("gmsh: no tetrahedra")

    monkeypatch.setattr(coarsening, "apart", fails)
    same, report = coarsening.coarsened(planned(), bodies)
    assert same is bodies
    assert "keeps its fine elements" in coarsening.words(report)
    assert "no tetrahedra" in coarsening.words(report)


def test_it_is_due_where_splats_cover_the_substrate() -> None:
    """Forty places 40 um apart, each hit over and over: as soon as three quarters of them are hit."""
    places = [batches.Landing((40e-6 * (i % 40), 0.0), 30e-6, 20e-6) for i in range(400)]
    after = batches.covering(places)
    assert after is not None
    assert abs(after - (1.0 - batches.BARE) * 40) <= 1
    assert batches.covering(places[: batches.LATER]) is None
    assert batches.covering([replace(place, window=np.inf) for place in places]) is None
    apart = [replace(place, offset=(40e-6 * i, 0.0)) for i, place in enumerate(places)]
    assert batches.covering(apart) is None


def test_a_run_goes_on_with_coarser_elements(
    shared_run: SharedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """After the batch of two, before the third impact; the same to the last bit where it is broken off in that and resumed."""
    fine = shared_run(SIDE)
    monkeypatch.setattr(coarsening, "covering", lambda impacts: 2)
    result = run(Scene.from_text(SIDE, "shared"), tmp_path / "one", quiet=True)
    first, report = fine.summary["joins"][-1], result.summary["joins"][-1]["coarsening"]
    assert report["elements_after"] < 0.9 * report["elements_before"]
    assert "coarsening" not in first
    assert "splats cover the substrate" in (tmp_path / "one" / "run.log").read_text()
    last, before = (r.summary["impacts"][-1] for r in (result, fine))
    assert abs(last["energy_drift"]) < 0.01
    assert last["end"]["eps_p_mean"] == pytest.approx(before["end"]["eps_p_mean"], rel=0.01)
    break_off(Scene.from_text(SIDE, "shared"), tmp_path / "two", 4e-9, after=2)
    again = resume(tmp_path / "two", quiet=True)
    assert_same_numbers(result.summary, again.summary, rel=0.0)
    assert_same_files(result, again)
