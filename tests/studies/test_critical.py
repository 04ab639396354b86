"""The critical velocity by runs: the search itself, and the command on a scene of 200 points."""

import shlex
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise
from pathlib import Path
from statistics import NormalDist

import pytest
from runs import in_this_process
from scenes import TINY, scene
from study_table import read_rows

from coupler import Scene, run
from coupler.commands.main import main
from coupler.errors import StoreError
from coupler.measures import REBOUNDS, STICKS, UNDECIDED
from coupler.plan.planning import plan
from coupler.studies import critical
from coupler.studies import runs as study_runs
from coupler.studies.critical import Bracket, bracket, next_velocity

LIMITS = (50.0, 1500.0)
# strong bonds of little energy: fast particles rebound, slow ones are held
HELD = '[adhesion]\nkind = "cohesive"\nstrength = "462 MPa"\nenergy = "{} J/m2"\n'
EXPOSED = """[adhesion]
kind = "cohesive"
criterion = "exposure"
[materials.SS304]
oxide_thickness = "5 nm"
oxide_strength = "20 GPa"
oxide_threshold = 0.0
[materials.Ni]
oxide_thickness = "5 nm"
oxide_strength = "20 GPa"
oxide_threshold = 0.0
"""


def searched(judge: Callable[[float], str], start: float = 600.0, tolerance: float = 0.05) -> dict[float, str]:
    verdicts: dict[float, str] = {}
    while (velocity := next_velocity(verdicts, start, LIMITS, tolerance)) is not None:
        assert velocity not in verdicts
        verdicts[velocity] = judge(velocity)
        assert len(verdicts) < 25
    return verdicts


@pytest.mark.parametrize("critical", [61.0, 333.0, 598.0, 660.0, 1444.0])
def test_the_search_brackets_a_step(critical: float) -> None:
    found = bracket(searched(lambda v: STICKS if v >= critical else REBOUNDS))
    assert found.low is not None
    assert found.high is not None
    assert found.low < critical <= found.high
    assert found.half_width <= max(0.025 * critical * 1.05, 1.0)
    assert abs(found.velocity - critical) <= found.half_width


def test_a_range_of_sticking_below_the_start_is_found() -> None:
    """Bonds hold from 460 to 620 m/s, and the particle rebounds at the first velocity and above."""
    found = bracket(searched(lambda v: STICKS if 460.0 <= v < 620.0 else REBOUNDS, start=665.0))
    assert found.low is not None
    assert found.low < 460.0 <= found.velocity + found.half_width
    assert found.half_width <= 12.0


def test_runs_without_a_verdict_stay_inside_the_bracket() -> None:
    found = bracket(searched(lambda v: STICKS if v >= 700 else REBOUNDS if v < 640 else UNDECIDED))
    assert found.low == pytest.approx(640, abs=40)
    assert found.high == pytest.approx(700, abs=40)
    assert all(found.low < v < found.high for v in found.undecided)
    assert found.undecided


@pytest.mark.parametrize(
    ("word", "says"),
    [(REBOUNDS, "rebounds at all velocities up to 1500"), (STICKS, "sticks at all velocities down to 50")],
)
def test_a_search_without_a_change_ends_at_its_limit(word: str, says: str) -> None:
    assert says in bracket(searched(lambda v: word)).words


def test_sticking_at_low_velocity_is_no_critical_velocity() -> None:
    """A bond of constant energy holds slow particles: a critical velocity lies between a rebound and a faster one that sticks."""
    assert bracket({100.0: STICKS, 400.0: REBOUNDS, 800.0: REBOUNDS}) == Bracket(800.0, None)
    assert bracket({100.0: STICKS, 400.0: REBOUNDS, 800.0: STICKS}) == Bracket(400.0, 800.0)


def test_the_error_of_the_resolution_is_that_of_the_same_search_with_fewer_points() -> None:
    """Critical velocities v + a h with v = 500 m/s: the error is 1.25 times the distance a h of the finest (Eca & Hoekstra 2014)."""
    given = Scene.from_text(scene(("Ni", 25, 500), **TINY, more=EXPOSED))
    points = (given.derived.points, given.derived.points / 4, given.derived.points / 16)
    found, *others = (Bracket(v - 1.0, v + 1.0) for v in (500.0 + 300.0 * n ** (-1 / 3) for n in points))
    coarser = dict(zip(points[1:], others, strict=True))
    expected = 1.25 * 300.0 * points[0] ** (-1 / 3)
    assert critical.resolution_error(given, found, coarser) == pytest.approx(expected, rel=1e-6)
    assert f"error of the resolution: +- {expected:.2g} m/s" in critical.resolution_words(given, found, coarser)
    assert critical.resolution_error(given, found, {100: Bracket(400.0, None)}) is None
    assert found.velocity is not None
    wide = Bracket(found.velocity - 50.0, found.velocity + 50.0)  # of the same velocity
    assert critical.resolution_error(given, found, {100: wide}) == pytest.approx(50.0)
    assert "set resolution.error = true" in critical.resolution_words(given, found, {})
    asked = Scene.from_text(
        scene(("Ni", 25, 500), **TINY, more=EXPOSED).replace("[resolution]", "[resolution]\nerror = true")
    )
    assert asked.resolution.error
    assert "error" not in critical.at_velocity(asked, 500.0)  # the runs of the search need none of their own


def test_bonds_by_exposure_are_fine_unless_the_scene_says_how_fine() -> None:
    """At `standard` and below verdicts still move with the spacing (docs/evidence/bonding.md)."""
    text = scene(("Ni", 25, 500), more=EXPOSED)
    assert Scene.from_text(text).preset == "fine"
    assert Scene.from_text('preset = "draft"\n' + text).preset == "draft"
    assert Scene.from_text(scene(("Ni", 25, 500), more=HELD.format(20))).preset == "standard"


def test_the_command_brackets_keeps_its_runs_and_draws(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    """All rebound: the search ends at its upper limit; what it has computed it does not compute again."""
    monkeypatch.setattr(study_runs, "compute", in_this_process)
    file, out = tmp_path / "ni.toml", tmp_path / "out"
    file.write_text(scene(("Ni", 25, 500), **TINY, more=EXPOSED))
    call = [
        "critical",
        str(file),
        "--out",
        str(out),
        "--low",
        "450 m/s",
        "--high",
        "560 m/s",
        "--within",
        "90%",
        "--repeat",
        "1",
    ]
    assert main(call) == 0
    said = capsys.readouterr()
    assert "critical velocity" in said.out
    assert "Schmidt's formula: critical 665 m/s (Ni) and 716 m/s (SS304)" in said.out
    assert "the error (+-) does not include that of the resolution" in said.out
    rows = read_rows(out / "critical.csv")
    assert {row["verdict_by_bonds"] for row in rows} <= {STICKS, REBOUNDS, UNDECIDED}
    assert all((out / "runs" / f"{row['velocity_m_s']}ms" / "summary.json").is_file() for row in rows)
    assert (out / "critical.png").stat().st_size > 10_000
    assert said.err.count(" ...") == len(rows)
    (out / "critical.csv").unlink()  # a study killed before it wrote its table: its runs are used again
    before = {path: path.stat().st_mtime_ns for path in out.glob("runs/*/summary.json")}
    assert main(call) == 0
    assert {path: path.stat().st_mtime_ns for path in out.glob("runs/*/summary.json")} == before
    assert read_rows(out / "critical.csv") == rows
    head = (out / "critical.csv").read_text().splitlines()[0]
    remake = shlex.split(head.partition("remake: ")[2].partition(" (finished")[0])
    assert remake == ["coldspray", *call]
    capsys.readouterr()
    assert main(remake[1:]) == 0
    assert " ..." not in capsys.readouterr().err
    assert read_rows(out / "critical.csv") == rows


@pytest.mark.parametrize("scatter", [0.0, 20.0, 60.0])
def test_several_placements_show_their_scatter(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, scatter: float) -> None:
    """Placements whose own critical velocities are normally distributed about 600 m/s: its mean, and the band of one deviation."""
    placements = 9
    own = [600.0 + scatter * NormalDist().inv_cdf((k + 0.5) / placements) for k in range(placements)]

    def rows_at(scene: Scene, velocity: float, *_: object) -> list[dict[str, object]]:
        words = (STICKS if velocity >= v else REBOUNDS for v in own)
        return [{"velocity_m_s": velocity, "placement": k, "verdict_by_bonds": word} for k, word in enumerate(words)]

    monkeypatch.setattr(critical, "rows_at", rows_at)
    nickel = Scene.from_text(scene(("Ni", 25, 500), **TINY, more=EXPOSED), "ni")
    found, _ = critical.search(nickel, tmp_path, log=lambda _: None, repeat=placements)
    low, high = found.band
    assert abs(found.velocity - 600.0) < 0.025 * 600.0
    assert low == pytest.approx(600.0 - scatter, abs=30.0)  # straight lines between velocities up to 75 m/s apart
    assert high == pytest.approx(600.0 + scatter, abs=30.0)
    assert found.low >= low
    assert found.high <= high
    assert "half of the placements" in found.words


def test_an_undecided_placement_counts_as_half() -> None:
    rows = [{"velocity_m_s": 500.0, "verdict_by_bonds": word} for word in (STICKS, UNDECIDED, REBOUNDS, REBOUNDS)]
    assert critical.shares_of(rows, 4) == {500.0: 0.375}
    assert critical.shares_of(rows, 5) == {}


def test_the_verdict_of_a_scene_is_undecided_between_bonds_and_formulas() -> None:
    """Nickel on steel: the formula says 665 and 716 m/s, the runs are bracketed around those, below and above."""
    formula = plan(Scene.from_text(scene(("Ni", 25, 500), **TINY, more=EXPOSED), "ni")).impact.formula
    for low, high, says in (
        (680.0, 700.0, "rebounds up to 665 m/s, sticks from 716 m/s on, undecided between"),
        (500.0, 520.0, "rebounds up to 500 m/s, sticks from 716 m/s on"),
        (800.0, 820.0, "rebounds up to 665 m/s, sticks from 820 m/s on"),
    ):
        assert says in critical.verdict_words(bracket({low: REBOUNDS, high: STICKS}), formula)


def test_a_band_without_an_upper_end() -> None:
    """Three of four stick at most, and fewer at higher velocities."""
    shares = {400.0: 0.0, 500.0: 0.25, 600.0: 0.75, 700.0: 0.25}
    found = replace(bracket(critical.verdicts_of(shares)), shares=shares)
    assert (found.low, found.high) == (500.0, 600.0)
    assert found.band == (pytest.approx(464.0), None)
    assert "84% at no velocity" in found.words


def test_placements_differ_in_nothing_but_the_discretisation() -> None:
    first = Scene.from_text(scene(("Ni", 25, 500), **TINY, more=EXPOSED), "ni")
    scenes = [Scene.from_text(critical.at_velocity(first, 600.0, k), "ni") for k in range(8)]
    particles = [each.particle for each in scenes]
    size = first.derived.element_size
    assert all(max(map(abs, p.offset)) <= 0.5 * size for p in particles)
    assert len({p.offset for p in particles}) == len({p.tilt for p in particles}) == 8
    usual = {"offset": (0.0, 0.0), "tilt": 0.0}
    assert all(p.model_copy(update=usual) == particles[0] for p in particles)
    oblate = Scene.from_text(scene(("Ni", 25, 500), **TINY, of_particle='shape = "oblate"\n', more=EXPOSED), "ni")
    assert Scene.from_text(critical.at_velocity(oblate, 600.0, 1), "ni").particle.tilt == 0.0


def test_a_run_that_fails_is_the_upper_limit(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Too fast for the points: the answer is that of the runs there are, and the message says why there are no more."""

    def rows_at(scene: Scene, velocity: float, *_: object) -> list[dict[str, object]]:
        if velocity > failing:
            raise StoreError(f"the run at {velocity:g} m/s failed: the contact has lost 9 of 200 points")
        return [{"velocity_m_s": velocity, "placement": 0, "verdict_by_bonds": REBOUNDS}]

    monkeypatch.setattr(critical, "rows_at", rows_at)
    said: list[str] = []
    nickel = Scene.from_text(scene(("Ni", 25, 500), **TINY, more=EXPOSED), "ni")
    failing = 1000.0
    found, rows = critical.search(nickel, tmp_path, log=said.append)
    assert 700.0 < found.low <= failing
    assert found.high is None
    assert sum("has lost 9" in line for line in said) == 1
    assert min(float(row["velocity_m_s"]) for row in rows) < 400.0  # whether it sticks below is tried
    failing = 0.0
    with pytest.raises(StoreError, match="has lost 9"):
        critical.search(nickel, tmp_path)


@pytest.mark.slow
def test_the_verdict_changes_once_about_the_margin(tmp_path: Path) -> None:
    """Bonds of one energy hold slow particles: bracketed to 1 % of velocity, and 1 % beyond on each side, with one change."""

    def verdict(velocity: float) -> str:
        text = scene(("Ni", 25, velocity), **TINY, more=HELD.format(25))
        return run(Scene.from_text(text, "margin"), tmp_path / f"{velocity:g}", quiet=True).verdict_by_bonds

    low, high = 570.0, 590.0
    verdicts = {low: verdict(low), high: verdict(high)}
    while high - low > 0.01 * low:
        middle = 0.5 * (low + high)
        verdicts[middle] = verdict(middle)
        low, high = (middle, high) if verdicts[middle] == STICKS else (low, middle)
    verdicts |= {v: verdict(v) for v in (0.99 * low, 1.01 * high)}
    in_order = [verdicts[v] for v in sorted(verdicts)]
    assert in_order[0] == STICKS
    assert in_order[-1] == REBOUNDS
    assert sum(a != b for a, b in pairwise(in_order)) == 1


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (scene(("Ni", 25, 500), **TINY), "bonds are not computed"),
        (scene(("Ni", 25, 500), ("Ni", 25, 500), **TINY, tied=False, more=HELD.format(50)), "a single impact"),
    ],
)
def test_a_scene_without_computed_bonds_is_refused(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], text: str, says: str
) -> None:
    file = tmp_path / "scene.toml"
    file.write_text(text)
    assert main(["critical", str(file), "--out", str(tmp_path / "out")]) == 2
    assert says in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    file.write_text(scene(("Ni", 25, 500), **TINY, more=HELD.format(50)))
    assert main(["critical", str(file), "--low", "500 m/s", "--high", "400 m/s"]) == 2
    assert "--low" in capsys.readouterr().err


def test_a_scene_may_list_its_only_particle() -> None:
    text = scene(("Ni", 25, 500), **TINY, more=EXPOSED).replace("[particle]", "[[particle]]")
    assert Scene.from_text(critical.at_velocity(Scene.from_text(text, "ni"), 600.0), "ni").particle.velocity == 600.0
