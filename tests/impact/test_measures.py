"""Measures of an impact on fields that are known."""

import math
from types import SimpleNamespace

import numpy as np
import pytest
from validate import contact_pressure  # workflows/validate.py

from coupler.fe import mesh as meshes
from coupler.geometry import mesher
from coupler.impact.measure import YIELDED, crater_depth, plastic_zone
from coupler.measures import GROUPS, MEASURES, TABLE, axis_label, measure, within_range
from coupler.studies.splats import flat


def test_a_round_contact_has_its_area_and_the_mean_pressure(rng: np.random.Generator) -> None:
    r, angle = 9e-6 * np.sqrt(rng.random(4000)), 2 * np.pi * rng.random(4000)
    bowl = np.stack([r * np.cos(angle), r * np.sin(angle), 0.02 * r], axis=1)
    pressure, area = contact_pressure(0.3, bowl)
    assert area == pytest.approx(np.pi * 9e-6**2, rel=0.02)
    assert pressure == pytest.approx(0.3 / area)
    # seen along z: how deep the bowl is does not matter
    assert contact_pressure(0.3, bowl * [1, 1, 40])[1] == pytest.approx(area)


@pytest.mark.parametrize(
    "touching", [np.zeros((0, 3)), np.ones((2, 3)), np.outer(np.linspace(0, 1e-5, 9), [1.0, 2.0, 0.5])]
)
def test_what_fills_no_area_presses_nothing(touching: np.ndarray) -> None:
    assert contact_pressure(0.3, touching) == (0.0, 0.0)


def test_the_yielded_zone_is_found_in_a_block() -> None:
    points, tets = mesher.box((40e-6, 40e-6, 20e-6), 2e-6)
    mesh = meshes.prepare(points - np.array([20e-6, 20e-6, 20e-6]), tets)
    middle = mesh.points[mesh.conn].mean(axis=1)
    radius, depth = 12e-6, 9e-6
    inside = (middle[:, 0] / radius) ** 2 + (middle[:, 1] / radius) ** 2 + (middle[:, 2] / depth) ** 2 < 1
    nodes, elements = (
        SimpleNamespace(x=mesh.points),
        SimpleNamespace(eps_p=np.where(inside, 2 * YIELDED, 0.5 * YIELDED)),
    )
    target = SimpleNamespace(mesh=mesh, nodes=nodes, elements=elements)
    found = plastic_zone(target, flat)
    assert found[0] == pytest.approx(radius, rel=0.05)
    assert found[1] == pytest.approx(depth, abs=1e-6)
    in_groove = plastic_zone(target, lambda at: np.full(len(at), -4e-6))
    assert found[1] - in_groove[1] == pytest.approx(4e-6, rel=1e-12)
    elements.eps_p[:] = 0.0
    assert plastic_zone(target, flat) == (0.0, 0.0)


def test_what_flattening_may_be() -> None:
    """No thickness is below zero; a splat that covers the wall of its crater is higher than the sphere was, which is a remark."""
    assert measure("flattening_ratio_total").refusal(0.37) is None
    assert "above 1" in (measure("flattening_ratio_total").refusal(1.76) or "")
    assert measure("flattening_ratio_total").refusal(-0.29) is None
    assert "covers the wall of its crater" in (measure("flattening_ratio_total").remark(-0.29) or "")
    assert measure("flattening_ratio").refusal(1.2) is None
    assert "embedded" in (measure("flattening_ratio").remark(1.2) or "")
    assert "stands upright" in (measure("flattening_ratio").remark(-0.06) or "")
    assert measure("flattening_ratio").remark(0.5) is None


def test_a_surface_that_does_not_follow_its_points_gives_no_shape() -> None:
    values = {"surface_volume_error": -0.29, "flattening_ratio": 0.5, "height_m": 1e-6, "crater_depth_m": 2e-6}
    kept, reasons = within_range(values)
    assert kept == {**dict.fromkeys(values), "crater_depth_m": 2e-6}
    assert reasons["height_m"] == "-29 is below -20 %: the surface does not follow the points: use more points"
    assert within_range(values | {"surface_volume_error": -0.1})[1] == {}


def test_a_strain_beyond_the_scheme_is_refused() -> None:
    assert measure("eps_p_max").refusal(5.2) is None
    assert "too large for the numerical scheme" in (measure("eps_p_max").refusal(85.0) or "")
    assert measure("T_max_K").refusal(float("nan")) == "not a number"


def test_values_outside_their_range_have_a_reason() -> None:
    values = {
        "eps_p_max": 85.0,
        "flattening_ratio_total": 1.76,
        "T_max_K": 900.0,
        "velocity_z_m_s": math.inf,
        "material": "Ni",
    }
    kept, reasons = within_range(values)
    assert kept == {**values, "eps_p_max": None, "flattening_ratio_total": None, "velocity_z_m_s": None}
    assert reasons.keys() == {"eps_p_max", "flattening_ratio_total", "velocity_z_m_s"}
    assert within_range({"rebounded": None, "restitution": 0.0}) == (
        {"rebounded": None, "restitution": 0.0},
        {},
    )


def test_records_agree_with_their_keys() -> None:
    assert all(m.group in GROUPS and m.label and m.short and m.factor > 0.0 for m in TABLE)
    assert len(MEASURES) == len(TABLE)
    assert (measure("dt_mean_s").unit, measure("rebound_velocity_m_s").unit, measure("new_length_m").unit) == (
        "ps",
        "m/s",
        "µm",
    )
    assert measure("T_p99_K").initial(300.0) == 300.0
    assert measure("crater_depth_m").initial(300.0) == 0.0
    assert axis_label("velocity_m_s") == "velocity (m/s)"


def test_a_cut_without_the_surface_of_the_substrate_has_no_crater() -> None:
    """The window of an impact on a heap higher than its radius holds splats alone."""
    assert crater_depth(np.zeros((0, 3))) == 0.0
