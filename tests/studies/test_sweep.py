"""Sweeps and ensembles: points and their scenes, failed and stopped ones, executors."""

import csv
import json
import os
import signal
import subprocess
import sys
import tomllib
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest
from study_table import read_rows
from sweeps import SHARED, made, points, pretend

from coupler.commands import main as cli
from coupler.commands import sweep as sweep_command
from coupler.core.executors import WITH_PARENT
from coupler.errors import ColdsprayError, InterruptedRunError, SceneError
from coupler.plan.reading import Scene
from coupler.scene.toml import toml_text
from coupler.studies import runs as study_runs
from coupler.studies.runs_table import table
from coupler.studies.sweep import Sweep


def test_points_of_a_sweep() -> None:
    few = Sweep.from_dict(points(material=["Ni", "Ti"], temperature=["300 K", "200 degC"]))
    assert len(few.points) == 16
    assert not few.refused
    scene = Scene.from_text(few.points["Ti_25um_700ms_200degC"])
    assert (scene.particle.material, scene.preset) == ("Ti", "draft")
    assert (scene.particle.diameter, scene.particle.velocity, scene.particle.temperature) == (25e-6, 700.0, 473.15)
    assert (scene.substrate.diameter, scene.substrate.height) == (200e-6, 100e-6)
    assert Scene.from_text(few.points["Ni_10um_400ms_300K"]).substrate.diameter == pytest.approx(80e-6, rel=1e-12)
    held = Sweep.from_dict(points() | {"scene": {"substrate": {"material": "Al", "height": "70 um"}}})
    assert Scene.from_text(held.points["Ni_25um_400ms_300K"]).substrate.height == 70e-6


def test_what_is_wrong_with_a_sweep_is_said_at_once() -> None:
    wrong = points(diameter=["10", "25 m/s"], velocity="fast", temperture=["300 K"], contact={"frction": [0.1]})
    with pytest.raises(SceneError) as caught:
        Sweep.from_dict(wrong, "mine.toml")
    text = str(caught.value)
    assert text.startswith("mine.toml: 5 problems")
    for words in (
        'particle.diameter = "10" has no unit', 'particle.diameter = "25 m/s" is a velocity', 'particle.velocity = "fast"',
        "temperture: unknown key", 'contact.frction: unknown key (did you mean "friction"?)',
    ):  # fmt: skip
        assert words in text
    with pytest.raises(SceneError, match=r"preset = .darft..*did you mean .draft."):
        Sweep.from_dict(points() | {"scene": SHARED | {"preset": "darft"}})
    with pytest.raises(SceneError, match=r"absent\.toml"):
        Sweep.load("absent.toml")
    for data, words in (
        ({"scene": SHARED}, "give .points"),
        ({"points": {"velocity": []}, "scene": SHARED}, "points.particle.velocity: expected a list"),
        ({"points": {"velocity": [f"{v} m/s" for v in range(100, 200)], "diameter": [f"{d} um" for d in range(10, 120)]},
          "scene": SHARED}, "at most 10000"),
        ({"points": {"particle[3].velocity": ["500 m/s"]}, "scene": SHARED | {"particle": [{}, {}]}}, "has 2 tables"),
        (points() | {"target": {"width": 3}}, "target.width"),
        (points() | {"ensemble": {"runs": 3}}, "give .points"),
        ({"scene": SHARED, "ensemble": {"runs": 0, "velocity": {"mean": "500 m/s", "deviation": "3 K"}}},
         "whole number from 1 to 10000\n.*the same dimension"),
        ({"scene": SHARED, "ensemble": {"runs": 3, "velocity": {"mean": 5}}}, "expected a distribution"),
        ({"scene": SHARED, "ensemble": {"runs": 3, "temperature": {"mean": "100 C", "deviation": "20 C"}}}, "value in K"),
        ({"scene": SHARED, "ensemble": {"runs": 3, "velocity": {"mean": "600 m/s", "deviation": "3 m/s", "smallest": "900 m/s"}}},
         "leave nothing of the distribution"),
        (points() | {"scene": "absent.toml"}, "absent.toml"),
    ):  # fmt: skip
        with pytest.raises(SceneError, match=words):
            Sweep.from_dict(data)


def test_a_point_without_changes_is_the_base() -> None:
    scene = SHARED | {"particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"}}
    assert list(Sweep.from_dict({"scene": scene, "points": [{}, {"velocity": "450 m/s"}]}).points) == ["base", "450ms"]


def test_a_sweep_marks_what_is_refused_and_keeps_what_is_done_without_a_process(tmp_path, monkeypatch, capsys) -> None:
    """One point finished before, one that the program refuses: hotter than its metal stands."""
    monkeypatch.setattr(study_runs, "compute", lambda scene: pytest.fail(f"{scene.name} was run"))
    two = Sweep.from_dict(points(diameter=["25 um"], velocity=["400 m/s"], temperature=["300 K", "1700 K"]))
    good, bad = two.points
    assert list(two.refused) == [bad]
    study_runs.write_scene(tmp_path, good, two.points[good])
    pretend(tmp_path, good, flattening_ratio=0.5)
    assert two.run(tmp_path, jobs=2) == tmp_path
    rows = {row["point"]: row for row in table(tmp_path)}
    assert (rows[good]["status"], rows[good]["flattening_ratio"]) == ("done", 0.5)
    assert rows[bad]["status"] == "failed"
    assert "must be below 0.95 times the melting point of Ni" in rows[bad]["reason"]
    assert (rows[bad]["velocity_m_s"], rows[bad]["temperature_K"]) == (400.0, 1700.0)
    times = {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.json")}
    said = capsys.readouterr().out.splitlines()
    assert said[0].startswith(f"1/2 {bad}: failed: particle.temperature")
    assert said[1:] == ["1 of 2 points are already computed"]
    two.run(tmp_path)
    assert {path: path.stat().st_mtime_ns for path in tmp_path.glob("*.json")} == times


def test_a_point_that_was_refused_before_is_run_when_it_no_longer_is(tmp_path, monkeypatch) -> None:
    def end(scene: Path, threads: int) -> dict[str, object]:
        scene.with_suffix(".json").write_text(json.dumps(ended := {"status": "done", "reason": "", "exit_code": 0}))
        return ended

    monkeypatch.setattr(study_runs, "compute", end)
    few = Sweep.from_dict(points(diameter=["25 um"], velocity=["400 m/s"]))
    (name,) = few.points
    scene = study_runs.write_scene(tmp_path, name, few.points[name])
    scene.with_suffix(".json").write_text(json.dumps({"status": "failed", "reason": "", "exit_code": 2}))
    few.run(tmp_path)
    assert json.loads(scene.with_suffix(".json").read_text())["status"] == "done"


def test_time_to_go_of_a_sweep_is_that_of_the_points_that_are_left(tmp_path, monkeypatch) -> None:
    """Three points of 40 s each."""
    done = {"status": "done", "reason": "", "exit_code": 0}
    monkeypatch.setattr(study_runs, "run_point", lambda *_: done)
    monkeypatch.setattr(study_runs, "time", SimpleNamespace(monotonic=iter([0.0, 40.0, 80.0, 120.0]).__next__))
    said: list[str] = []
    study_runs.run_points(tmp_path, dict.fromkeys("abc", ""), log=said.append, pool=ThreadPoolExecutor(1))
    assert [line.partition("; ")[2] for line in said] == ["about 80 s remaining", "about 40 s remaining", ""]


@pytest.mark.parametrize(("number", "verdict"), [("TERM", None), ("INT", None), ("KILL", "killed by SIGKILL")])
def test_a_point_that_is_stopped_is_no_failure(tmp_path, monkeypatch, number, verdict) -> None:
    program = tmp_path / "program"
    # a shell would pass on that a signal is ignored, as it is for what runs in the background
    default = "" if number == "KILL" else f"signal.signal(signal.SIG{number}, signal.SIG_DFL); "
    program.write_text(f"#!{sys.executable}\nimport os, signal\n{default}os.kill(os.getpid(), signal.SIG{number})\n")
    program.chmod(0o755)
    monkeypatch.setattr(study_runs.sys, "executable", str(program))
    name = "Ni_10um_400ms_300K"
    scene = study_runs.write_scene(tmp_path, name, Sweep.from_dict(points()).points[name])
    status = scene.with_suffix(".json")
    if verdict is None:
        with pytest.raises(InterruptedRunError):
            study_runs.compute(scene)
        assert not status.exists()
    else:
        assert study_runs.compute(scene)["reason"] == verdict
        assert json.loads(status.read_text())["status"] == "failed"


def test_a_run_of_another_scene_is_not_gone_on_with(tmp_path) -> None:
    few = Sweep.from_dict(points())
    name = next(iter(few.points))
    scene = study_runs.write_scene(tmp_path, name, few.points[name])
    pretend(tmp_path, name)
    assert "resume" in study_runs._command(scene, tmp_path / name, 1)
    scene.write_text(few.points[name].replace("draft", "fine"))
    assert "resume" not in study_runs._command(scene, tmp_path / name, 1)


def test_points_are_a_list_and_settings_reach_any_table(tmp_path) -> None:
    (tmp_path / "base.toml").write_text(
        'preset = "draft"\n[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "500 m/s"\n'
        '[[particle]]\nmaterial = "Ni"\ndiameter = "25 um"\nvelocity = "500 m/s"\n'
        '[substrate]\nmaterial = "SS304"\ndiameter = "200 um"\nheight = "100 um"\n'
    )
    listed = {
        "scene": "base.toml",
        "points": [{"contact": {"friction": 0.1}}, {"contact.friction": 0.3, "particle[2].velocity": "600 m/s"}],
    }
    two = Sweep.from_dict(listed, str(tmp_path / "two.toml"))
    assert list(two.points) == ["friction0.1", "friction0.3_velocity600ms"]
    scene = Scene.from_text(two.points["friction0.3_velocity600ms"])
    assert [particle.velocity for particle in scene.particles] == [500.0, 600.0]
    assert scene.contact.friction == 0.3
    assert two.varied == ("contact.friction", "particle[2].velocity")


ENSEMBLE = {
    "name": "scatter",
    "scene": {
        "preset": "draft",
        "particle": {"material": "Ni", "velocity": "500 m/s"},
        "substrate": {"material": "SS304"},
    },
    "ensemble": {
        "runs": 64,
        "seed": 5,
        "velocity": {"mean": "600 m/s", "deviation": "40 m/s"},
        "diameter": {"median": "25 um", "spread": 1.4, "smallest": "15 um", "largest": "40 um"},
        "particle": {
            "offset": [{"from": "-5 um", "to": "5 um"}, {"from": "0 um", "to": "1 um"}],
            "angle": {"values": ["0 deg", "30 deg"]},
        },
    },
}


def test_an_ensemble_has_the_distributions_that_it_names() -> None:
    """Quasi-random: quantiles are right to 1/n, where random draws would be to 1/sqrt(n); Kolmogorov-Smirnov distance below 0.05."""
    from scipy import stats

    drawn = Sweep.from_dict(ENSEMBLE)
    scenes = [Scene.from_text(text) for text in drawn.points.values()]
    v, D = (np.array([getattr(s.particle, key) for s in scenes]) for key in ("velocity", "diameter"))
    assert stats.kstest(v, stats.norm(600.0, 40.0).cdf).statistic < 0.05
    law = stats.lognorm(np.log(1.4), scale=25e-6)
    low, high = law.cdf((15e-6, 40e-6))
    assert D.min() > 15e-6
    assert D.max() < 40e-6
    assert stats.kstest((law.cdf(D) - low) / (high - low), "uniform").statistic < 0.05
    x, y = np.array([s.particle.offset for s in scenes]).T
    assert stats.kstest(x * 1e5 + 0.5, "uniform").statistic < 0.05
    assert stats.kstest(y * 1e6, "uniform").statistic < 0.05
    assert sum(s.particle.angle > 0.0 for s in scenes) == pytest.approx(32, abs=2)
    assert abs(stats.spearmanr(v, D).statistic) < 0.1
    longer = Sweep.from_dict(ENSEMBLE | {"ensemble": ENSEMBLE["ensemble"] | {"runs": 80}})  # type: ignore[operator]
    assert list(longer.points.items())[:64] == list(drawn.points.items())
    assert drawn.varied == ("particle.velocity", "particle.diameter", "particle.offset", "particle.angle")


def test_the_distribution_of_the_measures_is_the_result(tmp_path, capsys) -> None:
    """Flattening is made a straight function of velocity: its quantiles are those of the velocity, its rank correlation is one."""
    few = {**ENSEMBLE, "ensemble": {"runs": 24, "velocity": {"mean": "600 m/s", "deviation": "40 m/s"}}}
    few["scene"]["particle"]["diameter"] = "25 um"  # type: ignore[index]
    scene = tomllib.loads(next(iter(Sweep.from_dict(few).points.values())))
    file = tmp_path / "scatter.toml"
    file.write_text(toml_text({"name": "scatter", "scene": scene, "ensemble": few["ensemble"]}))
    drawn = Sweep.load(file)
    v = []
    for name in drawn.points:
        study_runs.write_scene(tmp_path / "out", name, drawn.points[name])
        v.append(Scene.load(tmp_path / "out" / f"{name}.toml").particle.velocity)
        pretend(tmp_path / "out", name, flattening_ratio=v[-1] / 1000.0, T_mean_K=v[-1])
    assert cli.main(["sweep", str(file), "--out", str(tmp_path / "out")]) == 0
    said = capsys.readouterr().out
    assert "24 points: 24 done" in said
    assert "mean temperature" in said  # values, where bands are those of its rise
    line = next(line.split() for line in said.splitlines() if line.startswith("flattening"))
    assert line[-1] == "+1.00"
    with (tmp_path / "out" / "distribution.csv").open() as stream:
        rows = {row["measure"]: row for row in csv.DictReader(line for line in stream if not line.startswith("#"))}
    row = rows["flattening_ratio"]
    assert float(row["quantile_0.95"]) == pytest.approx(float(np.quantile(v, 0.95)) / 1000.0, rel=1e-5)
    assert float(row["mean"]) == pytest.approx(float(np.mean(v)) / 1000.0, rel=1e-5)
    assert float(row["rank_correlation particle.velocity"]) == 1.0
    assert (tmp_path / "out" / "distribution.png").stat().st_size > 10_000


def test_a_lost_worker_and_a_stopped_run_leave_points_without_an_end(tmp_path) -> None:
    """Each executor ends so: the exception of a worker's death, or of a run that was stopped; other points go on."""
    from concurrent.futures import Executor, Future

    class Losing(Executor):
        def submit(self, function, folder, point, text, **options):  # type: ignore[no-untyped-def, override]
            future: Future[dict[str, object]] = Future()
            if point == "b":
                future.set_exception(InterruptedRunError("stopped"))
            elif point == "c":
                future.set_exception(RuntimeError("node down"))
            else:
                future.set_result({"status": "done", "reason": ""})
            return future

    said: list[str] = []
    statuses = study_runs.run_points(tmp_path, dict.fromkeys("abc", ""), log=said.append, pool=Losing())
    assert statuses == {"a": "done", "b": "stopped", "c": "stopped"}
    assert sum("its process ended early (node down)" in line for line in said) == 1


def test_the_server_of_the_slurm_jobs_ends_with_the_sweep() -> None:
    """The pipe ends when its last writer has: the child of a killed parent."""
    child = f"{WITH_PARENT}; print('ready', flush=True); signal.pause()"
    start = "import subprocess, sys; subprocess.run([sys.executable, '-c', sys.argv[1]])"
    with subprocess.Popen([sys.executable, "-c", start, child], stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        assert parent.stdout.readline() == "ready\n"
        parent.kill()
        assert parent.stdout.read() == ""


def test_executors(tmp_path, monkeypatch) -> None:
    from coupler.core.executors import executor, own_environment

    for known, expected in (None, "glibc.malloc.hugetlb=1"), ("glibc.malloc.perturb=1", "glibc.malloc.perturb=1"):
        monkeypatch.delenv("GLIBC_TUNABLES", raising=False)
        if known is not None:  # what the user says stays
            monkeypatch.setenv("GLIBC_TUNABLES", known)
        with executor("processes", 2, tmp_path) as pool:
            assert list(pool.map(abs, [-1, 2])) == [1, 2]
            assert pool.submit(os.getenv, "GLIBC_TUNABLES").result() == expected
            # Ctrl-C, which a terminal sends to all, ends none of them, and from their first moment: they inherit this
            assert signal.SIGINT in pool.submit(signal.pthread_sigmask, signal.SIG_BLOCK, ()).result()
        assert signal.SIGINT not in signal.pthread_sigmask(signal.SIG_BLOCK, ())
    with pytest.raises(ColdsprayError, match=r'did you mean "slurm"'):
        executor("slum", 1, tmp_path)
    with pytest.raises(ColdsprayError, match="two ranks or more"):
        executor("mpi", 1, tmp_path)
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(ColdsprayError, match="sbatch, which is not installed"):
        executor("slurm", 1, tmp_path)
    monkeypatch.setenv("PMI_RANK", "3")
    assert "PMI_RANK" not in own_environment()


def test_errors_that_runs_have_measured_are_columns_of_the_table(tmp_path: Path) -> None:
    sweep = Sweep.from_dict(points())
    made(tmp_path, sweep)
    name = next(iter(sweep.points))
    path = tmp_path / name / "summary.json"
    summary = json.loads(path.read_text())
    summary["impacts"][-1]["errors"] = {"flattening_ratio": {"half_width": 0.0125}}
    path.write_text(json.dumps(summary))
    sweep_command.summarise(sweep, tmp_path)
    rows = {row["point"]: row for row in read_rows(tmp_path / "sweep.csv")}
    assert rows[name]["flattening_ratio_error"] == "0.0125"
    assert {row["flattening_ratio_error"] for row in rows.values()} == {"0.0125", ""}
    assert "crater_depth_m_error" not in rows[name]
