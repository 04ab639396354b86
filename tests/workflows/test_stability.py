"""Runs in trouble: they go back, try again and say so; and the hard and random scenes that watch over it."""

import json
import subprocess
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from runs import SharedRuns, Stopped, assert_same_files, assert_same_numbers
from scenes import NI, SHORT, SHORT_DOUBLE, WHOLE

from coupler import Result, Scene, run
from coupler.deposition.run import resume
from coupler.errors import SceneError, SolverError
from coupler.geometry.tetrahedra import boundary_faces, oriented, volumes
from coupler.impact import retry
from coupler.impact.retry import REMEDIES, next_retry
from coupler.plan.cost import CFL
from coupler.progress import Progress
from workflows import fuzz, stability, verify


class Lines(Progress):
    """A progress that keeps what is logged."""

    def __init__(self) -> None:
        super().__init__(quiet=True)
        self.lines: list[str] = []

    def log(self, text: str) -> None:
        self.lines.append(text)


class Trouble:
    """A probe that breaks the n-th impact at `at` s, so many `times`: by an error, or by a point that is no longer anywhere."""

    def __init__(self, at: float, times: int = 1, how: str = "error", impact: int = 1):
        self.at, self.times, self.how, self.left = at, times, how, impact
        self.seen, self.done = -1.0, 0
        self.steps: list[float] = []
        self.times_seen: list[float] = []

    def __call__(self, impact: Any) -> None:
        if impact.time < self.seen and self.done == 0:
            self.left -= 1
        self.seen = impact.time
        self.steps.append(impact.particle.dt)
        self.times_seen.append(impact.time)
        if self.left == 1 and impact.time > self.at and self.done < self.times:
            self.done += 1
            if self.how == "error":
                raise SolverError("made to fail. Try nothing")
            impact.particle.x[7], impact.particle.v[7] = np.nan, np.nan


CONTROLLED = REMEDIES[0].numerics  # the scheme of the first retry


@pytest.fixture
def whole(shared_run: SharedRuns) -> Result:
    """An impact that nothing happened to, with hourglass control from its start."""
    return shared_run(WHOLE, numerics=CONTROLLED)


def same_numerics(monkeypatch: pytest.MonkeyPatch) -> None:
    """Retries that change nothing, so that nothing but going back is seen."""
    monkeypatch.setattr(retry, "REMEDIES", tuple(replace(m, dt_factor=1.0, numerics={}) for m in REMEDIES))


def assert_same(one: Result, other: Result) -> None:
    """The same to the last bit, but for what is said of retries."""
    assert_same_numbers(one.summary, other.summary, rel=0.0, ignore=("retries",))
    assert_same_files(one, other)


@pytest.mark.parametrize("how", ["error", pytest.param("nan", marks=pytest.mark.slow)])
def test_going_back_is_exact(shared_run: SharedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, how: str) -> None:
    same_numerics(monkeypatch)
    result = run(Scene.from_text(SHORT, "shared"), tmp_path / "out", probe=Trouble(7e-9, 2, how))
    assert [made["time_s"] > 7e-9 for made in result.retries] == [True, True]
    assert_same(result, shared_run(SHORT))


def test_a_retry_halves_the_step_and_says_so(whole: Result, tmp_path: Path) -> None:
    log, trouble = Lines(), Trouble(12e-9)
    result = run(Scene.from_text(WHOLE, "shared"), tmp_path / "out", probe=trouble, progress=log)
    (made,) = result.retries
    assert made["reason"] == "made to fail"
    assert made["remedy"] == REMEDIES[0].words
    assert made["dt_factor"] == 0.5
    said = [line for line in log.lines if "starts again" in line]
    assert said == [
        f"impact 1 failed at {made['time_s'] * 1e9:.2f} ns: made to fail; it starts again with {REMEDIES[0].words}"
    ]
    assert said[0] in result.warnings
    again = next(i for i in range(1, len(trouble.steps)) if trouble.times_seen[i] < trouble.times_seen[i - 1])
    # with hourglass control the stable step itself is shorter
    assert trouble.steps[again] == pytest.approx(0.5 * CFL["compiled"] / CFL["enriched"] * trouble.steps[0], rel=0.1)
    assert result.steps > whole.steps
    # the same splat, a little better integrated
    for name in ("flattening_ratio", "splat_diameter_m", "eps_p_mean", "T_mean_K"):
        assert result.values[name] == pytest.approx(whole.values[name], rel=0.01), name
    assert abs(result.energy_drift) < 0.01
    assert np.all(np.diff(result.history("time")) > 0)
    assert whole.retries == []


def test_the_last_measure_raises_the_viscosity_and_then_the_error_stands(tmp_path: Path) -> None:
    log, seen = Lines(), []

    def probe(impact: Any) -> None:
        seen.append(impact.particle.numerics)
        if impact.time > 5e-9:
            raise SolverError("made to fail")

    with pytest.raises(SolverError, match="made to fail"):
        run(Scene.from_text(WHOLE, "shared"), tmp_path / "out", probe=probe, progress=log)
    assert sum("starts again" in line for line in log.lines) == len(REMEDIES) == 2
    assert (seen[0].Q1, seen[0].hourglass) == (0.06, 1.0)
    assert (seen[-1].Q1, seen[-1].hourglass) == (0.2, 3.0)
    assert not (tmp_path / "out" / "summary.json").exists()
    assert len(Result(tmp_path / "out").times("target")) > 0


def test_with_hourglass_control_the_enriched_scheme_is_the_compiled_one(shared_run: SharedRuns, tmp_path: Path) -> None:
    scenes = {
        name: SHORT.replace("[resolution]", f'[resolution]\nengine = "{name}"') for name in ("compiled", "enriched")
    }
    compiled = shared_run(scenes["compiled"])
    enriched = run(Scene.from_text(scenes["enriched"], "shared"), tmp_path / "out", numerics={"control": 1.0})
    for name in ("flattening_ratio", "crater_depth_m", "eps_p_max", "T_max_K", "energy_drift", "steps"):
        assert enriched.values[name] == compiled.values[name], name


def test_a_time_step_too_long_is_retried(shared_run: SharedRuns, tmp_path: Path) -> None:
    """Nothing made up: with a step so much longer than the particle can take, the run fails."""
    whole = shared_run(NI, numerics=CONTROLLED)
    result = run(
        Scene.from_text(NI, "shared"), tmp_path / "out", numerics={"courant": 0.9, "stretch": 4.0, "frequency": 1.5}
    )
    made = result.retries
    assert 1 <= len(made) <= len(REMEDIES)
    assert result.numerics["stretch"] == 4.0
    assert abs(result.energy_drift) < 0.01
    for name in ("flattening_ratio", "splat_diameter_m", "T_mean_K"):
        assert result.values[name] == pytest.approx(whole.values[name], rel=0.03), name


def test_a_ledger_that_opens_on_the_way_is_reported(tmp_path: Path) -> None:
    def probe(impact: Any) -> None:
        if impact.time > 10e-9 and impact.dt_factor == 1.0:
            impact.target.balance.plastic += 0.002 * impact.ledger.kinetic_0  # plastic work out of nothing

    result = run(Scene.from_text(WHOLE, "shared"), tmp_path / "out", probe=probe)
    (made,) = result.retries
    assert "energy is not conserved" in made["reason"]
    assert abs(result.energy_drift) < 0.01


@pytest.mark.slow
def test_a_checkpoint_keeps_the_retries(tmp_path: Path) -> None:
    class Both(Trouble):
        def __call__(self, impact: Any) -> None:
            super().__call__(impact)
            if self.done == self.times and impact.time > 7e-9:
                raise Stopped

    scene = Scene.from_text(SHORT, "shared")
    through = run(scene, tmp_path / "through", probe=Trouble(4e-9, 2))
    with pytest.raises(Stopped):
        run(scene, tmp_path / "out", probe=Both(4e-9, 2), checkpoint_every=0.0)
    result = resume(tmp_path / "out")
    assert result.retries == through.retries
    assert result.numerics["Q1"] == 0.2
    assert_same(result, through)


@pytest.mark.slow
def test_the_second_impact_of_a_sequence_is_retried(
    shared_run: SharedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    same_numerics(monkeypatch)
    trouble = Trouble(12e-9, impact=2)
    result = run(Scene.from_text(SHORT_DOUBLE, "shared"), tmp_path / "out", probe=trouble)
    (made,) = result.retries
    assert made["impact"] == 2
    assert_same(result, shared_run(SHORT_DOUBLE))


def test_numerics_of_remedies_are_raised_and_never_lowered() -> None:
    error = SolverError("one: try two")
    first = next_retry([], {"Q1": 0.5}, error, 1, 5.0)
    assert (first.reason, first.numerics) == ("one", {"Q1": 0.5, "control": 1.0})
    second = next_retry([first], {"Q1": 0.5}, error, 1, 5.0)
    assert second.numerics == {"Q1": 0.5, "hourglass": 3.0, "control": 1.0}
    with pytest.raises(SolverError, match="one"):
        next_retry([first, second], {"Q1": 0.5}, error, 1, 5.0)


# ---- the battery and the random scenes --------------------------------------------------------------------------------


def test_the_battery_has_eighty_scenes_and_more() -> None:
    """All scenes can be read but two, which are there to be refused."""
    scenes, refused = stability.battery(), []
    assert len(scenes) >= 80
    for name, tables in scenes.items():
        try:
            assert Scene.from_dict(tables, "battery").derived.points <= 2100, name
        except SceneError:
            refused.append(name)
    assert refused == ["Ni at 80 degrees, gap of 25 um", "Ni on a thinner free substrate of Al, 800 m/s"]


def test_a_result_has_no_fault(whole: Result) -> None:
    """Of 200 points; the figures are those of an independent calculation, from float32 fields."""
    findings = verify.check(whole)
    assert findings.faults == []
    assert findings.figures["kinetic"] < 1e-5
    assert findings.figures["heat"] < 0.01


def test_volumes_and_depths_of_a_cube() -> None:
    """Six tetrahedra of the unit cube; its centre lies half deep, a point above it not at all."""
    points = np.array([[x, y, z] for x in (0.0, 1.0) for y in (0.0, 1.0) for z in (0.0, 1.0)])
    paths = [
        (0, 4, 6),
        (0, 4, 5),
        (0, 2, 6),
        (0, 2, 3),
        (0, 1, 5),
        (0, 1, 3),
    ]  # from one corner to the opposite along edges
    cells = np.array([[*path, 7] for path in paths])
    cells = oriented(points, cells)
    assert volumes(points, cells) == pytest.approx(np.full(6, 1 / 6))
    assert len(boundary_faces(cells)[0]) == 12
    depth = verify.depths(np.array([[0.5, 0.51, 0.49], [0.5, 0.4, 0.9], [0.5, 0.5, 1.1]]), points, cells)
    assert depth == pytest.approx([0.49, 0.1, 0.0])


@pytest.mark.parametrize(
    "name",
    [
        "Ni elements smaller than the spacing",
        *(
            pytest.param(name, marks=pytest.mark.slow)
            for name in ("Ni 1000 m/s", "Ni flake, tilt 90, on SS304, 500 m/s", "Ni on the rim of a Ni splat")
        ),
    ],
)
def test_hard_scenes_of_the_battery(name: str, tmp_path: Path) -> None:
    verdict, _, reasons = stability.play(stability.battery()[name], tmp_path)
    assert verdict == "passes", reasons


@pytest.mark.slow
def test_matter_that_slides_over_the_rim_is_not_pulled_back(tmp_path: Path) -> None:
    """Its points were taken to be behind the top, 0.75 of a spacing deep, and thrown back at 550 m/s."""
    one = {"material": "OFHC_Cu", "velocity": "1300 m/s", "angle": "75 deg"}
    said = stability.scene(one, points=210, substrate={"diameter": "75 um"}, end={"time": "44 ns"})
    outermost = []

    def probe(impact: Any) -> None:
        x, v, mass = impact.particle.x, impact.particle.v, impact.particle.mass
        outside = np.hypot(x[:, 0], x[:, 1]) > 38e-6
        if outside.any():
            outermost.append(float(mass[outside] @ v[outside, 0] / mass[outside].sum()))

    summary = run(Scene.from_dict(said, "rim"), tmp_path / "out", probe=probe, threads=1).values
    assert min(outermost) > 0.0
    assert summary["penetration_max_m"] < 0.5 * summary["spacing_m"]
    assert sum("over the rim" in text for text in summary["warnings"]) == 1


def test_random_scenes_are_made_from_their_seed() -> None:
    assert fuzz.scene(5) == fuzz.scene(5) != fuzz.scene(6)
    ways = {json.dumps(fuzz.scene(seed).get("adhesion", {}).get("kind")) for seed in range(60)}
    assert ways == {"null", '"none"', '"tied"', '"cohesive"'}
    drawn = [fuzz.scene(seed) for seed in range(300)]
    keys = {
        table: {key for each in drawn for key in each.get(table, ())} for table in ("spray", "substrate", "coating")
    }
    assert keys["spray"] >= {"passes", "step", "first", "length", "angle", "distribution"}
    assert keys["substrate"] >= {"layer", "groove", "step", "slope", "roughness", "height_map"}
    assert keys["coating"] >= {"powder", "porosity"}
    names = ["map.csv", "patch.stl", "'powder.stl'", "powder*.stl", *fuzz.CERAMICS, *fuzz.POLYMERS]
    assert [name for name in names if name not in str(drawn)] == []


def test_only_a_result_without_fault_or_one_message_is_a_good_end() -> None:
    for code, said in ((0, ""), (4, ""), (2, "coldspray: no"), (3, "coldspray: no")):
        assert fuzz.verdict(code, said, []) == "", (code, said)
    for code, said, faults in (
        (1, "x", []), (-11, "", []), (None, "", []), (2, "", []), (3, "coldspray: a\ncoldspray: b", []),
        (0, "Traceback (most recent call last)", []), (0, "", ["a NaN"]), (4, "", ["a NaN"]),
    ):  # fmt: skip
        assert fuzz.verdict(code, said, faults), (code, said)


def test_a_bad_end_is_kept_and_told(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Seed 2 of three ends badly: its files are kept, and the exit code is 1."""

    def play(seed: int, folder: Path) -> tuple[str, str]:
        (folder / "log").write_text(f"seed {seed}")
        return "a result", "a traceback" if seed == 2 else ""

    assert fuzz.tried("", play, 3, str(tmp_path), []) == 1
    assert [path.read_text() for path in tmp_path.rglob("log")] == ["seed 2"]
    assert capsys.readouterr().out.splitlines()[-1] == "1 BAD; 2 a result"
    assert fuzz.tried("", play, 1, str(tmp_path), []) == 0


@pytest.mark.slow
def test_random_scenes_are_refused_or_computed(tmp_path: Path) -> None:
    """Seed 1 is refused, 2 is computed. In a process of its own, which forks."""
    command = [sys.executable, fuzz.__file__, "--keep", str(tmp_path), "--n", "2"]
    said = subprocess.run(command, check=True, capture_output=True, text=True).stdout
    assert said.startswith("1 refused\n2 ")
