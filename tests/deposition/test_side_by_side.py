"""Impacts of a batch in several processes, over a stop and over failures."""

from concurrent.futures import Executor, Future
from concurrent.futures.process import BrokenProcessPool
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest
import scenes
from runs import SharedRuns, assert_same_files, assert_same_numbers, break_off
from threadpoolctl import threadpool_info, threadpool_limits

from coupler import Result, Scene
from coupler.core.threads import RANGES, share
from coupler.deposition import batches as deposition_batches
from coupler.deposition import task as deposition_task
from coupler.deposition.replay import BatchReplay
from coupler.deposition.run import resume, run
from coupler.errors import ColdsprayError
from coupler.files import checkpoint
from coupler.impact.run import RunOptions
from coupler.impact.summary import peak_memory
from coupler.particle.inertia import ENOUGH
from coupler.progress import Progress


@pytest.mark.parametrize(("after", "jobs"), [(0, 2), pytest.param(2, 1, marks=pytest.mark.slow)])
def test_one_process_and_two_make_the_same_coating_over_a_stop(
    shared_run: SharedRuns, tmp_path: Path, after: int, jobs: int
) -> None:
    """Broken off in the first impact, then two processes, one of which goes on with it; or on a splat that a cut has put back: equal
    to the last bit."""
    whole = shared_run(scenes.SIDE)
    assert [join["bodies"] for join in whole.summary["joins"]] == [1, 1]
    assert [impact["numerics"]["inertia"] for impact in whole.summary["impacts"]] == [0.0, ENOUGH, ENOUGH]
    break_off(Scene.from_text(scenes.SIDE, "shared"), tmp_path / "out", 4e-9, after=after)
    assert max(path.name for path in (tmp_path / "out" / "impacts").iterdir()) == f"{after + 1:05d}"
    own = peak_memory()
    result = resume(tmp_path / "out", jobs=jobs)
    assert result.summary["run"]["memory_peak_bytes"] >= own  # of this process, too, where others compute the impacts
    assert_same_numbers(whole.summary, result.summary, rel=0.0)
    assert_same_files(whole, result)


def test_a_run_that_ends_after_a_batch_goes_on_from_the_results_of_its_tasks(
    shared_run: SharedRuns, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the pause, before files and checkpoint of the batch are written, and again while its files are: equal to the last bit."""

    def ended(*_: object) -> None:
        raise KeyboardInterrupt

    def impacts() -> set[float]:
        return set(Result(tmp_path / "out").history()["impact"].tolist())

    with monkeypatch.context() as patched:
        patched.setattr("coupler.deposition.fold.rest", ended)
        with pytest.raises(KeyboardInterrupt):
            run(Scene.from_text(scenes.SIDE, "shared"), tmp_path / "out", quiet=True)
    assert impacts() == {1.0, 2.0}  # what was computed can be read
    with monkeypatch.context() as patched:
        patched.setattr(BatchReplay, "_go_on", ended)
        with pytest.raises(KeyboardInterrupt):
            resume(tmp_path / "out", quiet=True)
    assert impacts() == {1.0}
    result = resume(tmp_path / "out", quiet=True)
    whole = shared_run(scenes.SIDE)
    assert_same_numbers(whole.summary, result.summary, rel=0.0)
    assert_same_files(whole, result)


def test_a_process_of_a_batch_lets_blas_have_one_thread(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As the run has in one process: sums over many nodes are the same to the last bit."""

    def threads(*_: object) -> set[int]:
        return {library["num_threads"] for library in threadpool_info() if library["user_api"] == "blas"}

    monkeypatch.setattr(deposition_task, "attempt", threads)
    with threadpool_limits(2, "blas"):
        assert deposition_task.run_alone(SimpleNamespace(folder=tmp_path / "00001"), {}, 60.0, None, 1) == {1}


@pytest.mark.parametrize(
    ("jobs", "threads", "each"), [(2, 2, "2"), (4, 4, "4 2"), (8, 8, "8 4 2 2"), (2, 1, ""), (2, 8, "8")]
)
def test_the_last_impacts_of_a_batch_share_the_threads(
    jobs: int, threads: int, each: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """each: how many threads an impact has when one, two ... of five tasks are left, as far as they are more than at the beginning."""

    class Waiting(Executor):
        def submit(self, *arguments: object, **options: object) -> Future[Any]:  # type: ignore[override]
            return Future()

    spare, seen = tmp_path / deposition_task.SPARE, {}

    def wait(left: list[Future[Any]], *_: object) -> None:
        seen[len(left)] = spare.read_text() if spare.exists() else None
        left[-1].set_result(None)

    monkeypatch.setattr(deposition_batches, "wait", wait)
    spare.touch()  # of a batch before
    options = RunOptions(Progress(True), Path("log"), threads=threads, jobs=jobs)
    monkeypatch.setattr(deposition_batches, "forecast", lambda _: SimpleNamespace(shares=[(0.0, 0.0)]))
    task = SimpleNamespace(i=0, plan=None)
    found = iter([(task, None)] * 5)
    assert len(deposition_batches.side_by_side(Waiting(), found, tmp_path, options, lambda: None)) == 5
    said = dict(enumerate(each.split(), 1))
    assert seen == {left: said.get(left) for left in range(1, 6)}


@pytest.mark.usefixtures("eight_cores")
def test_a_task_is_given_threads_on_its_way_and_leaves_none(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def pieces(task: SimpleNamespace, options: RunOptions) -> list[int]:
        """How many ranges work is divided into: before the first window, and after it."""
        counts = []
        for _ in range(2):
            ranges: list[tuple[int, int]] = []
            share(lambda lo, hi, ranges=ranges: ranges.append((lo, hi)), 100, 10)
            counts.append(len(ranges))
            (tmp_path / deposition_task.SPARE).write_text("2")
            options.probe(None)
        return counts

    monkeypatch.setattr(deposition_task, "attempt", pieces)
    assert deposition_task.run_alone(SimpleNamespace(folder=tmp_path / "00001"), {}, 60.0, None, 1) == [1, 2 * RANGES]
    ranges: list[tuple[int, int]] = []
    share(lambda lo, hi: ranges.append((lo, hi)), 100, 10)
    assert len(ranges) == 1  # it is gone with the task


def test_a_process_of_a_batch_that_is_ended_is_one_message(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Ended(Executor):
        def submit(self, *arguments: object, **options: object) -> Future[Any]:  # type: ignore[override]
            future: Future[Any] = Future()
            future.set_exception(BrokenProcessPool("ended"))
            return future

    monkeypatch.setattr(deposition_batches, "executor", lambda *arguments: Ended())
    with pytest.raises(ColdsprayError, match=f"impacts 1 to 2 was killed.*coldspray resume {tmp_path / 'out'}"):
        run(Scene.from_text(scenes.SIDE, "x"), tmp_path / "out", quiet=True, jobs=2)
    assert checkpoint.stored(tmp_path / "out")


def test_an_impact_on_a_cut_that_is_undecided_at_its_limit_goes_on(tmp_path: Path) -> None:
    """For as long again as it has had."""
    limited = scenes.SIDE.replace('time = "10 ns"', 'at = "rest"\ntime = "3 ns"')
    result = run(Scene.from_text(limited, "x"), tmp_path / "out", quiet=True)
    assert result.undecided is not None
    before = float(result.end["time_s"])
    again = resume(tmp_path / "out", quiet=True)
    assert len(result.impacts) == len(again.impacts) == 1
    assert 1.5 * before < again.end["time_s"] < 2.3 * before
