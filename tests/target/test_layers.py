"""Layers of a substrate: waves and heat across their interfaces, against closed forms."""

from pathlib import Path

import numpy as np
import pytest

from coupler import Scene, run
from coupler.deposition.pause import _links
from coupler.errors import SceneError
from coupler.fe.cooling import cool
from coupler.geometry.triangles import areas
from coupler.impact.domains import build_target
from coupler.plan.model import Plan
from coupler.plan.planning import plan
from coupler.target.bodies import Bodies
from workflows import verify

LAYERED = """
[particle]
material = "Ni"
diameter = "20 um"
velocity = "300 m/s"

[substrate]
material = "OFHC_Cu"
diameter = "110 um"
height = "45 um"
sides = "free"

[[substrate.layer]]
material = "Al"
thickness = "15 um"

[resolution]
spacing = "2 um"
element_size = "2.2 um"
growth = 0.2
"""


def layered() -> tuple[Plan, Bodies]:
    made = plan(Scene.from_text(LAYERED))
    return made, build_target(made)


@pytest.mark.slow
def test_a_wave_is_reflected_by_the_ratio_of_impedances() -> None:
    """A pressure p on aluminium becomes p (1 + R) on the upper side of its interface with copper, R = (Z2 - Z1) / (Z2 + Z1) = 0.42,
    Z = rho c (Meyers (1994), Dynamic Behavior of Materials, ch. 2). Near the axis, after a rise of 1.5 ns, before waves from the sides
    and the bottom arrive; mean over 2 ns: 2 % (a front on few elements overshoots)."""
    made, bodies = layered()
    t, p = bodies.target, 1e6
    upper, lower = (metal.rho * metal.wave_speed for metal in reversed(made.target.materials))
    load, top = np.zeros(len(t.nodes.x)), t.mesh.facets[t.mesh.sets["top"]]
    np.add.at(load, top, (p * areas(t.nodes.x, top) / 3.0)[:, None])
    middle = t.nodes.x[t.mesh.conn].mean(axis=1)
    above = (bodies.body == 1) & (np.hypot(middle[:, 0], middle[:, 1]) < 8e-6) & (middle[:, 2] < -11e-6)
    t.activate_all()
    pressures = []
    while t.time < 6.5e-9:
        dt = 0.5 * bodies.stable_dt(0.0)
        bodies.search(1e-9)
        t.advance(dt)
        bodies.forces(dt)
        t.f_ext[:, 2] -= min(t.time / 1.5e-9, 1.0) * load
        t.finish()
        if t.time > 4.5e-9:
            pressures.append(-np.average(t.stress()[above, 2], weights=t.mesh.V0[above]))
    assert np.mean(pressures) / p == pytest.approx(1.0 + (lower - upper) / (lower + upper), rel=0.02)


@pytest.mark.slow
def test_heat_flows_between_layers_as_between_half_spaces() -> None:
    """Q = 2 e1 e2 / (e1 + e2) dT sqrt(t / pi) per area, e = sqrt(k rho c_p) (Carslaw & Jaeger (1959), 2.15), between two times: the
    step at the start is narrower than an element. 3 %."""
    made, bodies = layered()
    t, times = bodies.target, np.array([0.4e-7, 0.8e-7, 1.6e-7, 2.4e-7, 3.2e-7])
    layer, (lower, upper) = bodies.body == 1, made.target.materials
    t.elements.T[layer] = 310.0
    content = []
    for time in np.diff(times, prepend=0.0):
        cool(t, time, np.zeros(0, np.int64), 300.0, _links(bodies, made.splat_element_size))
        content.append(upper.rho * upper.cp_at(305.0) * float(t.mesh.V0[layer] @ t.elements.T[layer]))
    e1, e2 = (metal.effusivity(305.0) for metal in (lower, upper))
    flow = 10.0 * e1 * e2 / (e1 + e2) * 2.0 * (np.sqrt(times[4] / np.pi) - np.sqrt(times[2] / np.pi))
    assert (content[2] - content[4]) / (np.pi / 4.0 * made.target.diameter**2) == pytest.approx(flow, rel=0.03)


@pytest.mark.parametrize(
    ("before", "after", "says"),
    [
        ('"15 um"', '"2 um"', 'substrate.layer[1].thickness = "2 um": thinner than an element'),
        ('"15 um"', '"44 um"', 'substrate.height = "45 um": its layers are 44 um thick'),
        ('"Al"', '"Alu"', 'substrate.layer[1].material = "Alu": unknown material'),
        ('sides = "free"', 'sides = "free"\nroughness = "1 um"', "substrate.roughness: layers need a flat surface"),
    ],
)
def test_layers_that_cannot_be_meshed_are_refused_by_their_key(before: str, after: str, says: str) -> None:
    with pytest.raises(SceneError) as error:
        Scene.from_text(LAYERED.replace(before, after, 1))
    assert says in str(error.value)


@pytest.mark.slow
def test_a_ceramic_layer_that_cracks_is_told(tmp_path: Path) -> None:
    """Hertz's tension at the rim of a contact is above the 260 MPa that alumina bears long before a metal particle stops."""
    scene = Scene.from_text(LAYERED, "coated").with_(
        substrate={"layer": [{"material": "Al2O3", "thickness": "15 um"}]}, resolution={"spacing": "2.5 um"}, end={"time": "12 ns"}
    )  # fmt: skip
    result = run(scene, tmp_path / "run", quiet=True, error=False)
    assert any("times the limit of Al2O3: it cracks" in text for text in result.warnings)
    assert verify.check(result).faults == []  # with each layer as its own material


@pytest.mark.slow
def test_layers_of_one_metal_are_one_body(tmp_path: Path) -> None:
    """The crater in layers of the substrate's own metal is that in one body. Six meshes of one body have a standard deviation of 1.2 %,
    four pairs of meshes a difference of at most 1.5 %: 3 %."""
    whole = Scene.from_text(LAYERED.replace('"Al"', '"OFHC_Cu"'), "whole").with_(
        resolution={"element_size": "3 um", "growth": 0.35}
    )
    craters = [
        run(scene, tmp_path / name, quiet=True, error=False).crater_depth_m
        for name, scene in (("layers", whole), ("one", whole.with_(substrate={"layer": []})))
    ]
    assert craters[0] == pytest.approx(craters[1], rel=0.03)
