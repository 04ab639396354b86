"""The folder of the page: no path leads out of it, runs are known from their files alone."""

import fcntl
import os
from pathlib import Path

import pytest

from coupler.app.workspace import DAMAGED, LOG, PID, QUEUED, STOPPED, Workspace, alive
from coupler.errors import StoreError
from coupler.files.outputs import MARK
from coupler.files.store import lock_folder
from coupler.studies.pace import Pace


@pytest.fixture
def workspace(tmp_path: Path) -> Workspace:
    return Workspace(tmp_path / "work", {}, Pace(1.0, ""))


def ended(folder: Path) -> None:
    os.waitpid(int((folder / PID).read_text()), 0)


@pytest.mark.parametrize("name", ["../x.toml", "/etc/passwd", "link/x.toml", "a\0b"])
def test_no_name_leads_out(workspace: Workspace, tmp_path: Path, name: str) -> None:
    (workspace.root / "link").symlink_to(tmp_path)
    with pytest.raises(StoreError, match="outside the workspace"):
        workspace.inside(name)


@pytest.mark.parametrize(
    ("text", "key"),
    [
        ('library = "../metals.toml"', "library"), ('[particle]\nfile = "/powder.stl"', "particle.file"),
        ('[powder]\nsizes = "../sizer.csv"', "powder.sizes"), ('[coating]\nfiles = "../*.stl"', "coating.files"),
    ],
)  # fmt: skip
def test_a_scene_names_no_file_outside(workspace: Workspace, text: str, key: str) -> None:
    assert [problem.split(" = ")[0] for problem in workspace.outside(text)] == [key]
    assert workspace.outside(text.replace("../", "").replace('"/', '"')) == []


def test_a_command_waits_for_its_turn_and_is_known_to_another_server(workspace: Workspace) -> None:
    """The lock of the queue belongs to the process that computes; the state of one that waits is in its folder alone."""
    folder = workspace.folder("waits")
    with (workspace.runs / ".queue").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        workspace.start(folder, "shapes")
        other = Workspace(workspace.root, {}, workspace.here)
        assert [(row.name, row.state) for row in other.rows()] == [("waits", QUEUED)]
        with pytest.raises(StoreError, match="in the queue or running"):
            other.start(folder, "shapes")
        with pytest.raises(StoreError, match="cannot be deleted"):
            other.delete(folder)
    ended(folder)
    assert not alive(folder)
    assert "sphere" in (folder / LOG).read_text()  # of `coldspray shapes`


def test_two_starts_at_once_make_one_process(workspace: Workspace, monkeypatch: pytest.MonkeyPatch) -> None:
    """The second one has found no process yet: the lock of the log alone decides."""
    folder = workspace.folder("twice")
    monkeypatch.setattr("coupler.app.workspace.alive", lambda folder: False)
    with (workspace.runs / ".queue").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        workspace.start(folder, "shapes")
        with pytest.raises(StoreError, match="in the queue or running"):
            workspace.start(folder, "shapes")
    ended(folder)
    assert (folder / LOG).read_text().count("coldspray shapes") == 1


def test_files_of_the_workspace_are_no_modules(workspace: Workspace) -> None:
    """Python looks for modules in its working folder first, if it is not told otherwise."""
    (workspace.root / "types.py").write_text("raise SystemExit('of the workspace')\n")
    assert "sphere" in workspace.call("shapes")


def test_a_folder_goes_on_with_its_own_scene_or_not_at_all(
    workspace: Workspace, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A part of a job or sweep can have the name of a scene of the workspace; other folders stay as they are."""
    started: list[tuple[str, ...]] = []
    monkeypatch.setattr(workspace, "start", lambda folder, *words: started.append(words))
    workspace.save("single-1", "")
    for name in ("single-1", "sweep/single-1"):
        folder = workspace.folder(name)
        folder.mkdir(parents=True)
        with pytest.raises(StoreError, match="not the folder of a run"):
            workspace.resume(folder)
        (folder / LOG).touch()
        workspace.resume(folder)
    assert [words[0] for words in started] == ["run", "resume"]


def test_no_scene_that_names_a_file_outside_is_started(workspace: Workspace) -> None:
    with pytest.raises(StoreError, match=r"particle.file = .* lies outside the workspace"):
        workspace.begin("run", "x", '[particle]\nfile = "/powder.stl"')
    assert not (workspace.root / "x.toml").exists()


def test_a_command_that_waits_can_be_stopped(workspace: Workspace) -> None:
    folder = workspace.folder("waits")
    with (workspace.runs / ".queue").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        workspace.start(folder, "shapes")
        workspace.stop(folder)
        ended(folder)
    assert "sphere" not in (folder / LOG).read_text()
    assert workspace.row(folder).state == STOPPED


def test_a_damaged_folder_says_so(workspace: Workspace) -> None:
    folder = workspace.folder("bad")
    folder.mkdir()
    (folder / ".coldspray").write_text(f"{MARK}: run\n")
    (folder / "plan.json").write_text("{}")
    (folder / "summary.json").write_text('{"format": 2, "impacts": 3}')
    row = workspace.row(folder)
    assert row.state == DAMAGED
    assert "summary.json is damaged" in row.words


def test_only_results_are_deleted(workspace: Workspace, tmp_path: Path) -> None:
    folder, foreign, link = (workspace.folder(name) for name in ("mine", "notes", "link"))
    for place in (folder, foreign):
        place.mkdir()
    (folder / ".coldspray").write_text(f"{MARK}: run\n")
    link.symlink_to(folder)
    assert [row.name for row in workspace.rows()] == ["mine"]
    for place in (foreign, link):
        with pytest.raises(StoreError, match="cannot be deleted"):
            workspace.delete(place)
    lock = lock_folder(folder)  # as a run in a terminal
    assert lock is not None
    for act in (workspace.delete, workspace.stop):
        with pytest.raises(StoreError, match="mine is computed by a process that was not started here"):
            act(folder)
    os.close(lock)
    workspace.delete(folder)
    assert sorted(path.name for path in workspace.runs.iterdir()) == ["link", "notes"]


def test_names_are_taken_once(workspace: Workspace) -> None:
    assert workspace.free("scene") == "scene-1"
    workspace.save("scene-1", "")
    assert workspace.free("scene") == "scene-2"
    for name in ("scene-1", "../x", ".hidden", "a b", ""):
        with pytest.raises(StoreError, match="name = "):
            workspace.save(name, "")
