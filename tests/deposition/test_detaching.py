"""A splat whose bonds to what holds it break later leaves the coating, and its mass counts as lost."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from blocks import block, substrate
from runs import SharedRuns, assert_goes_on

from coupler import Result, Scene
from coupler.deposition import detaching
from coupler.errors import StoreError
from coupler.physics.adhesion import Adhesion
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import Plan, plan
from coupler.studies import coating
from coupler.target.bodies import Bodies

SIZE = 5e-6
ORIGIN = (0.0, 0.0, 0.0)
# the second impact knocks off what the first has left, and rebounds
KNOCKED_OFF = """
preset = "draft"
[[particle]]
material = "Ni"
diameter = "20 um"
velocity = "400 m/s"
dwell = "0 us"
[[particle]]
material = "Ni"
diameter = "20 um"
velocity = "600 m/s"
offset = ["10 um", "0 um"]
[substrate]
material = "SS304"
diameter = "80 um"
height = "40 um"
[resolution]
spacing = "2.75 um"
element_size = "5 um"
[adhesion]
kind = "cohesive"
criterion = "all"
strength = "200 MPa"
energy = "12 J/m2"
[end]
at = "cold"
[output]
every = "10 ns"
"""


@pytest.fixture(scope="module")
def planned() -> Plan:
    known = plan(Scene.from_text(KNOCKED_OFF, "six"))
    return replace(known, impacts=known.impacts * 3)


@pytest.fixture
def column() -> Bodies:
    """Three blocks of 20 um bonded one on the other, from impacts 1, 2 and 4."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    bodies = substrate()
    for k, impact in enumerate((1, 2, 4)):
        body = block((-10e-6, -10e-6, k * 20e-6), 0.0, 1.0, law)
        bodies = bodies.joined([body], Adhesion("tied"), SIZE, ORIGIN, 1.0, impact)
    return bodies


def part(bodies: Bodies, upper: int) -> None:
    """Break the bonds between a body and the one below it, which it is bonded to alone."""
    owner = np.zeros(len(bodies.target.nodes.x), int)
    owner[bodies.target.mesh.conn] = bodies.body[:, None]
    assert bodies.bond is not None
    bodies.bond.damage[owner[bodies.bond.nodes] == upper] = 1.0


def test_what_no_path_of_bonds_leads_to_is_not_held(column: Bodies) -> None:
    assert column.attached().all()
    part(column, 2)
    np.testing.assert_array_equal(column.attached(), [True, True, False, False])
    part(column, 1)
    np.testing.assert_array_equal(column.attached(), [True, False, False, False])


def test_an_embedded_body_is_held_by_what_it_touches(column: Bodies) -> None:
    """The second block has no bond, and lies on the first."""
    part(column, 2)
    np.testing.assert_array_equal(column.attached([2], 0.6 * SIZE), [True, True, True, True])
    own = np.unique(column.target.mesh.conn[column.body == 2])
    column.target.nodes.x[own, 2] += SIZE
    np.testing.assert_array_equal(column.attached([2], 0.1 * SIZE), [True, True, False, False])


def test_it_leaves_with_its_mass_and_its_contact(column: Bodies, planned: Plan) -> None:
    """Two of three blocks of 20 um: the rest keeps its state to the last bit, and what they covered can be hit again."""
    part(column, 2)
    x, count = column.target.nodes.x.copy(), column.count
    stays = np.unique(column.target.mesh.conn[column.body < 2])
    hidden = len(column.buried)
    left, records = detaching.without_detached(planned, column, 5, "impact")
    assert [(r["splat"], r["by_impact"], r["bodies"]) for r in records] == [(2, 5, 1), (4, 5, 1)]
    rho = float(column.target.laws["rho"][1])
    assert sum(r["mass_kg"] for r in records) == pytest.approx(2 * rho * 8e-15, rel=1e-9)
    assert (left.count, count) == (2, 4)
    np.testing.assert_array_equal(left.impact, [0, 1])
    np.testing.assert_array_equal(left.target.nodes.x, x[stays])
    assert left.target.mesh.sets.keys() >= {"top", "bottom", "sides", "splat1"}
    assert left.contact is not None
    left.search(0.0)
    left.forces(0.0)
    assert left.contact.pairs.penalty_energy == 0.0
    assert left.bond is not None
    assert len(left.bond) > 0
    assert 0 < len(left.buried) < hidden
    top = left.target.mesh.facets[np.setdiff1d(left.target.mesh.sets["splat1"], left.buried)]
    assert (left.target.nodes.x[top][:, :, 2].min(axis=1) > 19.9e-6).any(), "the top of the first block can be hit"
    again = Bodies.from_state(left.state(), ("bottom",), (), 0.3, False)
    np.testing.assert_array_equal(again.impact, left.impact)


def test_what_lies_apart_from_it_is_not_looked_at(column: Bodies) -> None:
    """A block beside the column stays buried where it lies, although it now stands off: what has left did not cover it."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    two = column.joined([block((16e-6, -10e-6, 0.0), 0.0, 1.0, law)], Adhesion("tied"), SIZE, ORIGIN, 1.0, 5)
    own = np.unique(two.target.mesh.conn[two.body == 4])
    two.target.nodes.x[own, 2] += SIZE
    left = two.without(np.array([False, False, True, True, False]), SIZE)

    def buried_beyond(bodies: Bodies, x: float) -> int:
        facets = bodies.target.mesh.facets[bodies.buried]
        return int(np.sum(bodies.target.nodes.x[facets, 0].min(axis=1) > x))

    assert buried_beyond(left, 15e-6) == buried_beyond(two, 15e-6) > 0
    assert len(left.buried) < len(two.buried) - 1


def test_without_adhesion_splats_lie_where_they_are(column: Bodies, planned: Plan) -> None:
    part(column, 1)
    other = replace(planned, adhesion=Adhesion("none"))
    same, records = detaching.without_detached(other, column, 5, "rest")
    assert same is column
    assert records == []


def test_a_tied_particle_that_has_glanced_off_leaves(column: Bodies, planned: Plan) -> None:
    """It lies 20 um beside the column and has no bond; what is tied stays."""
    law = law_record(material("Ni"), rate_filter=1e-9)
    tied = replace(planned, adhesion=Adhesion("tied"))
    assert detaching.without_detached(tied, column, 4, "rest")[0] is column
    beside = column.joined([block((30e-6, 0.0, 5e-6), 0.0, 1.0, law)], Adhesion("tied"), SIZE, ORIGIN, 1.0, 5)
    left, records = detaching.without_detached(tied, beside, 5, "rest")
    assert [r["splat"] for r in records] == [5]
    np.testing.assert_array_equal(left.impact, [0, 1, 2, 4])


@pytest.fixture
def knocked_off(shared_run: SharedRuns) -> Result:
    return shared_run(KNOCKED_OFF)


def test_the_next_impact_knocks_a_splat_off(knocked_off: Result) -> None:
    s = knocked_off.summary
    first, second = s["impacts"]
    assert first["verdict_by_bonds"] == "sticks"
    assert first["at_end"] is None
    assert first["detached_mass_kg"] == first["particle_mass_kg"]
    assert second["rebounded"]
    assert s["run"]["deposition_efficiency"] == 0.0
    stages = [(r["splat"], r["stage"]) for join in s["joins"] for r in join["detached"]]
    assert stages == [(1, "impact")]
    assert any("splat 1 has come off" in text for text in s["run"]["warnings"])
    for impact in s["impacts"]:
        assert abs(impact["energy_drift"]) < 9e-3  # 0.84 %: 200 points on the stiff contact of bonded impacts
        assert impact["momentum_error"] < 1e-10
    assert int(knocked_off.fields(-1, "cold").data["body"].max()) == 0
    built = coating.read(knocked_off)
    np.testing.assert_array_equal(built.stayed, [0.0, 0.0])
    with pytest.raises(StoreError, match="no particle has stayed"):
        coating.measure(built)


@pytest.mark.slow
def test_a_last_impact_that_leaves_points_has_no_shape_at_the_end(shared_run: SharedRuns) -> None:
    """Its particle is no splat, although its impact has knocked the first splat off."""
    s = shared_run(KNOCKED_OFF.replace('at = "cold"', 'at = "rest"')).summary
    first, second = s["impacts"]
    assert first["at_end"] is None
    assert "at_end" not in second
    assert [r["splat"] for r in s["joins"][-1]["detached"]] == [1]


@pytest.mark.slow
def test_it_is_off_after_a_resumption_too(knocked_off: Result, tmp_path: Path) -> None:
    """Of its bodies as they are after the first impact."""
    assert_goes_on(KNOCKED_OFF, knocked_off, tmp_path / "out", None, every=1e9)
