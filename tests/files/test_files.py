"""Files of the user are never replaced; damaged or hostile files end in one message; what a run has written comes back."""

import io
import json
import os
import resource
import shutil
import subprocess
import sys
import time
import zipfile
from pathlib import Path

import h5py
import numpy as np
import pytest

from coupler.commands.main import main
from coupler.deposition.run import resume
from coupler.errors import SceneError, StoreError
from coupler.files import checkpoint, inputs
from coupler.files.inputs import InputError, parse_json, parse_toml
from coupler.files.outputs import MARK, claim_file, claim_folder, is_ours
from coupler.files.result import Result
from coupler.files.store import Store, StoreState
from coupler.plan.reading import Scene
from coupler.report import picture
from tests import made_up_run
from workflows import fuzz_files

MINE = "a file of the user\n"


@pytest.fixture(scope="module")
def finished(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return made_up_run.write(tmp_path_factory.mktemp("run") / "run", 2, 300, 20.0, summary=made_up_run.summary())


def message(capsys: pytest.CaptureFixture[str]) -> str:
    """The one message of a command."""
    said = capsys.readouterr().err
    assert len([line for line in said.splitlines() if line.startswith("coldspray: ")]) == 1
    assert "Traceback" not in said
    return said


# --- files of the user


def test_a_scene_is_not_replaced_by_its_own_run(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.chdir(tmp_path)
    Path("scene.toml").write_text(made_up_run.SCENE)
    os.link("scene.toml", "linked.toml")
    for arguments in (["scene.toml"], ["linked.toml"], ["scene.toml", "--force"]):
        assert main(["run", *arguments, "--out", "."]) == 2
        assert "the same file as" in message(capsys)
    Path("other.toml").write_text(made_up_run.SCENE)
    assert main(["run", "other.toml", "--out", "."]) == 2
    assert "was not written by coldspray" in message(capsys)
    assert Path("scene.toml").read_text() == made_up_run.SCENE
    assert sorted(os.listdir()) == ["linked.toml", "other.toml", "scene.toml"]


@pytest.mark.parametrize("option", [["run", "s.toml", "--out", ""], ["resume", ""], ["report", "x", "--out", " "]])
def test_an_empty_name_is_no_folder(option: list[str], capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit) as end:
        main(option)
    assert end.value.code == 2
    assert "the path is empty" in capsys.readouterr().err


@pytest.mark.parametrize(
    "name", ["scene.toml", "summary.json", "section.png", "particle.vtkhdf", "notes.html", "x.doc"]
)
@pytest.mark.parametrize("verb", ["report", "animate", "compare"])
def test_pages_and_pictures_replace_nothing_else(
    verb: str, name: str, finished: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = finished / name
    before = path.read_bytes() if path.exists() else None
    if before is None:
        path.write_text(MINE)
    runs = [str(finished)] * (2 if verb == "compare" else 1)
    assert main([verb, *runs, "--out", str(path)]) == 2
    assert "cannot write" in (said := message(capsys)) or "was not written by coldspray" in said
    assert path.read_bytes() == (MINE.encode() if before is None else before)
    if before is None:
        path.unlink()


def test_a_page_of_ours_is_replaced_and_one_of_the_user_with_force(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Of a run without fields: its page is made at once."""
    light = shutil.copytree(finished, tmp_path / "run", ignore=shutil.ignore_patterns("*.vtkhdf"))
    page = tmp_path / "a.html"
    assert main(["report", str(light), "--out", str(page)]) == 0
    assert main(["report", str(light), "--out", str(page)]) == 0
    page.write_text(MINE)
    assert main(["report", str(light), "--out", str(page)]) == 2
    assert "add --force" in capsys.readouterr().err
    assert main(["report", str(light), "--out", str(page), "--force"]) == 0
    assert is_ours(page)


def test_an_output_is_claimed_before_the_work(tmp_path: Path) -> None:
    source, out = tmp_path / "points.vtu", tmp_path / "out.vtu"
    source.write_text(MINE)
    os.link(source, out)
    with pytest.raises(StoreError, match="the same file as"):
        claim_file(out, (".vtu",), [source], force=True)
    (tmp_path / "folder.vtu").mkdir()
    os.mkfifo(tmp_path / "pipe.vtu")
    (tmp_path / "link.vtu").symlink_to("nowhere")
    for name, says in (
        ("folder", "is a folder"),
        ("pipe", "a pipe or a device"),
        ("link", "--force"),
        ("no/a", "no folder"),
    ):
        with pytest.raises(StoreError, match=says):
            claim_file(tmp_path / f"{name}.vtu", (".vtu",))
    claim_folder(tmp_path / "new", "coating", ["coating.json"])
    (tmp_path / "new" / "coating.json").write_text("{}")
    claim_folder(tmp_path / "new", "coating", ["coating.json"])
    with pytest.raises(StoreError, match="choose another folder"):
        claim_folder(tmp_path / "new", "run", ["coating.json"])
    with pytest.raises(StoreError, match="Not a directory"):
        claim_folder(source / "below", "run", ["a"])
    for name, kind in (("full", ""), ("empty", ""), ("ours", "run")):
        (tmp_path / name).mkdir()
        (tmp_path / f"to_{name}").symlink_to(tmp_path / name)
        if kind:
            claim_folder(tmp_path / name, kind, [])
    (tmp_path / "full" / "thesis.tex").write_text("a")
    with pytest.raises(StoreError, match=r"is a link to .*full, a folder with files that coldspray did not write"):
        claim_folder(tmp_path / "to_full", "run", ["scene.toml"])
    assert [path.name for path in (tmp_path / "full").iterdir()] == ["thesis.tex"]
    claim_folder(tmp_path / "to_empty", "run", ["scene.toml"])
    claim_folder(tmp_path / "to_ours", "run", ["scene.toml"])


def test_force_replaces_only_files_of_a_run(tmp_path: Path) -> None:
    for name in ("scene.toml", "notes.txt", "checkpoint-000001.ckpt.old"):
        (tmp_path / name).write_text(MINE)
    with pytest.raises(StoreError, match=r"add --force \(Python: force=True\)"):
        Store.create(tmp_path, "a = 1\n")
    with pytest.raises(StoreError) as nobody:
        claim_folder(tmp_path, "sweep", ["notes.txt"], force=None)
    assert "--force" not in str(nobody.value)
    Store.create(tmp_path, "a = 1\n", force=True).close()
    assert (tmp_path / "scene.toml").read_text() == "a = 1\n"
    assert (tmp_path / "notes.txt").read_text() == (tmp_path / "checkpoint-000001.ckpt.old").read_text() == MINE


# --- what a run has written


@pytest.mark.parametrize("damage", ["cut", "hole", "garbage", "gone"])
def test_the_history_comes_back_from_the_checkpoint(tmp_path: Path, damage: str) -> None:
    with Store.create(tmp_path, "") as store:
        for k in range(5):
            store.record({"time": k / 3.0, "step": float(k)})
        state = store.state()
        store.record({"time": 9.0, "step": 9.0})
    path = tmp_path / "history.csv"
    sound = path.read_text()
    new = {"cut": sound[:30], "hole": sound[:20] + sound[45:], "garbage": "\x00\xff" + sound, "gone": ""}[damage]
    path.write_text(new, encoding="latin-1")
    checkpoint.write(tmp_path, state, {})
    kept = checkpoint.latest(tmp_path, StoreState, {})
    assert kept is not None
    with Store.reopen(tmp_path) as store:
        store.go_on(kept, lambda _: None)
        store.record({"time": 9.0, "step": 9.0})
    assert path.read_text() == sound


def test_resume_completes_a_run_that_ended_before_its_picture(finished: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("coupler.report.section_picture", picture.section_picture)
    (finished / "section.png").unlink(missing_ok=True)
    left = checkpoint.write(finished, {"i": 1}, {})
    (finished / "checkpoint-000009.ckpt").mkdir()  # no file of ours
    resume(finished)
    assert is_ours(finished / "section.png")
    assert not left.exists()
    (finished / "checkpoint-000009.ckpt").rmdir()


# --- hostile or broken input


def test_a_plan_that_was_changed_is_not_gone_on_with(
    finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    text = (finished / "plan.json").read_text()
    spacing = next(line for line in text.splitlines() if '"spacing"' in line)
    (tmp_path / "plan.json").write_text(text.replace(spacing, spacing.replace(": ", ": 9")))
    (tmp_path / "scene.toml").write_text((finished / "scene.toml").read_text())
    assert main(["resume", str(tmp_path)]) == 2
    assert "plan.json is damaged: its checksum does not fit" in message(capsys)


@pytest.mark.parametrize(
    ("text", "says"),
    [
        ("a." * 100_000 + "a = 1", "nested"),
        ("x = " + "[" * 600 + "]" * 600, "nested"),
        ("x = " + "{a=" * 600 + "1" + "}" * 600, "nested"),
        ("[" + ".".join(f'"{k}"' for k in range(600)) + "]", "nested"),
        ("x = " + "9" * 400, "64 bits"),
        ("x = " + "9" * 5000, "digits"),
        ("x" * 900_000, "Expected '='"),
    ],
    ids=lambda text: text[:12],
)
def test_toml_has_limits(text: str, says: str) -> None:
    started = time.process_time()
    with pytest.raises(ValueError, match=says):
        parse_toml(text)
    with pytest.raises(SceneError):
        Scene.from_text(text)
    assert time.process_time() - started < 5.0  # it takes milliseconds


@pytest.mark.parametrize(
    "text", ['{"a": 1e999}', '{"a": NaN}', '{"a": ' + "9" * 400 + "}", '{"a":' * 600 + "1" + "}" * 600]
)
def test_json_has_numbers_that_a_float_holds(text: str) -> None:
    with pytest.raises(ValueError, match=r"too large|not a number|64 bits|nested"):
        parse_json(text)


def test_only_regular_files_are_read(tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "circle").symlink_to(tmp_path / "circle")
    for path, says in (
        (tmp_path / "pipe", "a pipe or a device"), (tmp_path / "circle", "symbolic links"), (tmp_path, "it is a folder"),
        (Path("/dev/zero"), "a pipe or a device"), (tmp_path / "absent", "is missing"), (Path("a\0b"), "null"),
    ):  # fmt: skip
        with pytest.raises(InputError, match=says):
            inputs.read_text(path)
        with pytest.raises(SceneError, match=says):
            Scene.load(path)
    (tmp_path / "mark.toml").write_bytes(b"\xef\xbb\xbf" + made_up_run.SCENE.encode())
    assert Scene.load(tmp_path / "mark.toml").particle.material == "Ni"


def bomb(path: Path) -> None:
    head = io.BytesIO()
    np.lib.format.write_array_header_1_0(head, {"descr": "<f8", "fortran_order": False, "shape": (10**11, 3)})
    with zipfile.ZipFile(path, "w", zipfile.ZIP_DEFLATED) as archive:
        archive.writestr("points.npy", head.getvalue() + bytes(10**6))


def test_an_archive_is_held_against_the_free_memory(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bomb(tmp_path / "a.npz")
    assert main(["mesh", str(tmp_path / "a.npz")]) == 2
    assert "out of memory: Unable to allocate 2.18 TiB" in message(capsys)
    with pytest.raises(StoreError, match="to try"):
        inputs.require_memory(1e15, "to try")


def test_a_data_set_is_held_against_what_is_stored(finished: Path, tmp_path: Path) -> None:
    for name in ("scene.toml", "particle.vtkhdf"):
        (tmp_path / name).write_bytes((finished / name).read_bytes())
    with h5py.File(tmp_path / "particle.vtkhdf", "r+", locking=False) as file:
        del file["VTKHDF/Steps/Values"]
        file["VTKHDF/Steps"].create_dataset("Values", (9 * 10**9,), dtype="f8")
    with pytest.raises(StoreError, match="states more data"):
        Result(tmp_path).times()
    with h5py.File(tmp_path / "particle.vtkhdf", "r+", locking=False) as file:
        del file["VTKHDF/Steps/Values"]
        file["VTKHDF/Steps/Values"] = np.array([0.0, np.nan])
    with pytest.raises(StoreError, match="a time that is not a finite number"):
        Result(tmp_path).times()


def test_no_memory_is_one_message(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    def full(*_: object) -> int:
        raise MemoryError("Unable to allocate 67 GiB")

    monkeypatch.setattr("coupler.commands.main._check", full)
    assert main(["check", "x.toml"]) == 2
    assert "out of memory: Unable to allocate 67 GiB" in message(capsys)


def test_more_memory_than_is_free_cannot_be_had(monkeypatch: pytest.MonkeyPatch) -> None:
    before = resource.getrlimit(resource.RLIMIT_DATA)
    monkeypatch.setattr(inputs, "free_memory", lambda: 2**28)
    with inputs.bounded_memory(), pytest.raises(MemoryError):
        np.zeros(2**32, np.uint8)
    assert resource.getrlimit(resource.RLIMIT_DATA) == before


def test_a_comparison_names_a_bad_run(finished: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    bad = tmp_path / "bad"
    bad.mkdir()
    for path in finished.iterdir():
        if path.is_file():
            (bad / path.name).write_bytes(path.read_bytes())
    (bad / "summary.json").write_text('{"points": 1e999}')
    out = str(tmp_path / "a.png")
    assert main(["compare", str(finished), str(bad), "--out", out]) == 2
    assert f"{bad}/summary.json is damaged" in message(capsys)


@pytest.mark.parametrize("value", ["nan", "inf", "-inf", "-1", "0", "soon", "1e999"])
def test_the_time_between_checkpoints_is_a_time(value: str, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(SystemExit):
        main(["run", "x.toml", f"--checkpoint={value}"])
    assert "is not a positive number of seconds" in capsys.readouterr().err


def test_one_rank_says_what_is_wrong(monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]) -> None:
    monkeypatch.setenv("PMI_RANK", "1")
    with pytest.raises(SystemExit):
        main(["run", "x.toml", "--checkpoint=nan"])
    assert capsys.readouterr().err == ""


def test_a_file_that_reaches_its_limit_is_named(tmp_path: Path) -> None:
    program = f"""
import resource, numpy as np
from coupler.files.store import Store
resource.setrlimit(resource.RLIMIT_FSIZE, (2_000_000, 2_000_000))
with Store.create({str(tmp_path / "run")!r}, "") as store:
    for k in range(50):
        points = np.random.default_rng(k).random((2000, 3))
        store.write("particle", float(k), points, np.arange(2000)[:, None])
"""
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, timeout=60)
    assert done.returncode == 1
    assert "particle.vtkhdf: File too large; steps that were written before are kept" in done.stderr.splitlines()[-1]
    assert len(Result(tmp_path / "run").times()) > 0


@pytest.mark.parametrize(
    ("limit", "amount", "says"),
    [("v", 500_000, "address space"), ("n", 20, "open files"), ("f", 9000, "files are limited")],
)
def test_tight_limits_of_the_process_are_one_message(limit: str, amount: int, says: str) -> None:
    command = f"ulimit -{limit} {amount}; exec '{sys.executable}' -m coupler check x.toml"
    done = subprocess.run(["bash", "-c", command], capture_output=True, text=True, timeout=60)
    assert done.returncode == 2
    assert says in done.stderr
    assert done.stderr.count("\n") == 1


def test_damaged_files_of_every_kind(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A short run of workflows/fuzz_files.py: no traceback, no warning, no signal."""
    arguments = ["--n", "12", "--seed", "100000", "--keep", str(tmp_path / "kept")]
    assert fuzz_files.main(arguments) == 0, capsys.readouterr().out


def test_files_of_ours_say_so(finished: Path, tmp_path: Path) -> None:
    assert MARK in (finished / ".coldspray").read_text()
    assert json.loads((finished / "summary.json").read_text())["version"]
    for name in ("film.gif", "film.mp4"):
        assert main(["animate", str(finished), "--out", str(tmp_path / name)]) == 0
        assert is_ours(tmp_path / name)
