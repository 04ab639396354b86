"""Impacts on the window of a target."""

from pathlib import Path
from typing import Any

import numpy as np
import pytest
import scenes
from runs import SharedRuns

from coupler import Scene, run
from coupler.errors import SceneError
from coupler.impact.domains import build_domains, build_target
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.plan.planning import plan
from coupler.target.bodies import Bodies

PARTICLE = '[[particle]]\nmaterial = "Ni"\ndiameter = "20 um"\nvelocity = "500 m/s"\n'
TARGET = '[substrate]\nmaterial = "SS304"\ndiameter = "160 um"\nheight = "80 um"\n'


def scene(particles: int, more: str = "", name: str = "windows") -> Scene:
    return Scene.from_text('preset = "draft"\n' + particles * PARTICLE + TARGET + more, name)


def test_many_particles_have_a_window_and_few_have_none() -> None:
    assert np.isinf(plan(scene(9)).impact.window)
    assert plan(scene(10)).impact.window == pytest.approx(1.75 * 20e-6)
    assert plan(scene(1, 'window = "33 um"\n')).impact.window == pytest.approx(33e-6)
    assert "window" in scene(10).to_toml()


def assert_same_impact(whole: dict[str, Any], part: dict[str, Any]) -> None:
    for name, most in (
        ("flattening_ratio", 0.01),
        ("splat_diameter_m", 0.01),
        ("crater_depth_m", 0.02),
        ("T_mean_K", 0.01),
    ):
        assert part[name] == pytest.approx(whole[name], rel=most), name
    assert part["momentum_error"] < 1e-10
    assert abs(part["energy_drift"]) < 5e-3


def test_a_window_changes_little_of_an_impact(shared_run: SharedRuns) -> None:
    """The window is 1.75 diameters wide, as `plan` chooses: what it leaves out is elastic, and less than 2 % of a measure."""
    size = {"spacing": 2.7, "element_size": 4.0, "diameter": 160, "height": 80}
    whole, part = (
        shared_run(scenes.scene(("Ni", 20, 500), **size, of_substrate=window)).values
        for window in ("", 'window = "35 um"\n')
    )
    assert part["energies"] != whole["energies"]
    assert_same_impact(whole, part)


@pytest.mark.slow
def test_a_window_changes_little_of_a_finer_impact(tmp_path: Path) -> None:
    whole = run(scene(1), tmp_path / "whole").values
    assert_same_impact(whole, run(scene(1, 'window = "35 um"\n'), tmp_path / "part").values)


def test_a_window_that_does_not_hold_the_splat_is_refused() -> None:
    with pytest.raises(
        SceneError, match=r"substrate.window = .*5 um.*: smaller than the area .* at least 12 um is needed"
    ):
        scene(1, 'window = "5 um"\n')


def test_a_particle_that_reaches_the_edge_is_told_of(tmp_path: Path) -> None:
    particle = scenes.scene(("Ni", 20, 500), spacing=2.7, element_size=5, end=25, of_substrate='window = "14 um"\n')
    narrow = run(Scene.from_text(particle, "narrow"), tmp_path / "narrow").values
    assert any("increase substrate.window" in warning for warning in narrow["warnings"])


def test_bodies_are_searched_as_far_as_their_surfaces_move_in_a_window_of_steps(
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """Two surfaces move against each other by twice the way of the fastest node at most, from the first touch on."""
    planned, searched, shares = plan(Scene.from_text(scenes.SIDE, "x")), list[float](), list[float]()
    search = Bodies.search

    def note(self: Bodies, travel: float, by_speed: bool = False, time: float = 0.0) -> None:
        searched.append(travel)
        search(self, travel, by_speed, time)

    monkeypatch.setattr(Bodies, "search", note)
    domains = build_domains(planned, 0, build_target(planned).renumbered((0.0, 0.0, 0.0)))
    impact = Impact(domains)
    try:
        while impact.time < 15e-9:
            before = impact.target.nodes.x.copy()
            advance_chunk(impact)
            shares.append(2.0 * float(np.linalg.norm(impact.target.nodes.x - before, axis=1).max()) / searched[-1])
    finally:
        domains.particle.close()
    assert 0.5 < max(shares) <= 1.0  # not much farther than it must
