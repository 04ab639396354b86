"""The error budget: what is left out stays within what is allowed, for the measures asked for."""

import csv
import math

import pytest
from test_scene import scene_with

from coupler.errors import SceneError
from coupler.measures import BANDED, MEASURES
from coupler.plan import budget
from coupler.plan.planning import plan
from coupler.plan.text import describe
from coupler.scene.effects import NAMES

SHAPES = {"want": {"measures": list(budget.SHAPES)}}


def test_changes_follow_the_number_of_an_effect(monkeypatch: pytest.MonkeyPatch) -> None:
    """In proportion below a measured case, with the square above, the larger of two cases; nothing where an effect cannot act."""
    cases = "effect,number,cost_share," + ",".join(BANDED) + "\n"
    cases += "friction_heat,0.1,0.02," + ",".join(["1.0"] * len(BANDED)) + "\n"
    cases += "friction_heat,0.4,0.04," + ",".join(["-8.0"] * len(BANDED)) + "\n"
    cases += "absorbing_boundaries,2.0,0.04," + ",".join(["2.0"] * len(BANDED)) + "\n"
    rows = [{"scene": "a", **row} for row in csv.DictReader(cases.splitlines())]
    monkeypatch.setattr(budget, "_measured", lambda: rows)
    monkeypatch.setattr(budget, "_scenes", lambda: {"a": {"friction_heat": 0.1}})

    def changed(name: str, value: float) -> float:
        return budget.expected(name, {"friction_heat": 0.1, name: value})[0]["T_mean_K"]

    for value, percent in ((0.05, 1.0), (0.2, 4.0), (0.8, 64.0), (0.0, 0.0)):
        assert changed("friction_heat", value) == pytest.approx(0.01 * percent)
    assert changed("absorbing_boundaries", 0.9) == 0.0
    assert changed("absorbing_boundaries", 1.5) == pytest.approx(0.015)
    assert changed("conduction", 0.1) == math.inf  # never measured: it is not left out
    assert budget.expected("friction_heat", {"friction_heat": 0.11})[1] == 0.02


@pytest.mark.parametrize("preset", ["draft", "standard", "fine"])
@pytest.mark.parametrize("more", [{}, SHAPES, {"particle__velocity": "900 m/s"}, {"particle__material": "Al"}])
def test_the_sum_of_what_is_left_out_stays_within_what_is_allowed(preset: str, more: dict[str, object]) -> None:
    made = plan(scene_with(preset=preset, **more)).budget
    assert made.accuracy == budget.ACCURACY[preset]
    for share in made.shares:
        # gradients of plastic strain are a choice of the model, as the strength set is
        chosen = [row for row in made.rows if row.name != budget.GRADIENTS]
        left_out = sum(row.changes[share.measure] for row in chosen if not row.on)
        assert share.omitted == pytest.approx(left_out)
        assert share.discretisation + share.omitted <= share.allowed * (1.0 + 1e-12)
        assert share.allowed == pytest.approx(max(made.accuracy, 1.25 * share.discretisation))


def test_who_asks_for_shapes_does_not_pay_for_heat() -> None:
    whole, shapes = plan(scene_with(preset="draft")), plan(scene_with(preset="draft", **SHAPES))
    assert [share.measure for share in shapes.budget.shares] == list(budget.SHAPES)
    assert not shapes.effects.particle_conduction
    assert whole.effects.particle_conduction
    assert shapes.budget.saved > whole.budget.saved
    rough = plan(scene_with(want=SHAPES["want"] | {"accuracy": 0.5}))
    assert (whole.impact.end_at, rough.impact.end_at) == ("rest", "greatest")
    assert rough.impact.expected < plan(scene_with()).impact.expected


def test_a_scene_decides_before_the_budget() -> None:
    on = ["auto", *(f"+{name}" for name in NAMES)]
    made = plan(scene_with(preset="draft", effects=on, end__at="rest", **SHAPES))
    assert made.effects.active == list(NAMES)
    assert made.impact.end_at == "rest"
    assert all(share.omitted == 0.0 for share in made.budget.shares)
    assert plan(scene_with(want={"measures": ["crater_depth_m", "verdict"]})).impact.end_at == "rest"


def test_more_accuracy_leaves_out_less_and_bands_hold_what_is_left_out() -> None:
    rough, exact = (plan(scene_with(want={"accuracy": a, **SHAPES["want"]})) for a in (0.5, 0.001))
    assert set(rough.effects.active) < set(exact.effects.active)
    for share in rough.budget.shares:
        (band,) = (band for band in rough.impact.bands if band.measure == share.measure)
        assert band.share == pytest.approx(share.discretisation + share.omitted)


def test_check_prints_the_budget() -> None:
    made = plan(scene_with(preset="draft"))
    text = describe(made)
    for row in made.budget.rows:
        assert f"  {row.name} " in text
    for share in made.budget.shares:
        assert f"  {MEASURES[share.measure].short} " in text
    assert "budget, 5 % asked for" in text


def test_a_measure_that_does_not_exist_is_refused_by_name() -> None:
    with pytest.raises(SceneError, match=r'want\.measures.*"crater_depth_m"'):
        scene_with(want={"measures": ["crater_depth"]})
    with pytest.raises(SceneError, match=r"want\.accuracy"):
        scene_with(want={"accuracy": 0})
