"""The wheel by itself: built from the source, installed into a clean environment, away from the repository."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest

from coupler import __version__

ROOT = Path(__file__).parents[1]


def run(folder: Path, *command: str | Path) -> str:
    """Run a command in a folder, without this environment's Python; returns its output."""
    environment = {name: value for name, value in os.environ.items() if name not in ("PYTHONPATH", "VIRTUAL_ENV")}
    done = subprocess.run(
        list(map(str, command)),
        cwd=folder,
        env=environment | {"UV_SYSTEM_CERTS": "true"},
        capture_output=True,
        text=True,
    )
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout


@pytest.mark.slow
@pytest.mark.timeout(1200)
def test_the_wheel_runs_the_main_job_without_the_repository(tmp_path: Path) -> None:
    """Its lowest versions are not tested: the versions are those of uv.lock."""
    uv, python = (sys.executable, "-m", "uv"), tmp_path / "env" / "bin" / "python"
    locked = run(ROOT, *uv, "export", "--quiet", "--locked", "--no-dev", "--no-emit-project", "--no-hashes")
    (tmp_path / "locked.txt").write_text(locked)
    run(ROOT, *uv, "build", "--quiet", "--wheel", "--out-dir", tmp_path)
    (wheel,) = tmp_path.glob("coldspray-*.whl")
    run(tmp_path, *uv, "venv", "--quiet", "--python", sys.executable, tmp_path / "env")
    # open3d's other packages are not needed: see pyproject.toml
    run(tmp_path, *uv, "pip", "install", "--quiet", "--python", python, "--no-deps", "-r", tmp_path / "locked.txt")
    run(tmp_path, *uv, "pip", "install", "--quiet", "--python", python, "--no-deps", wheel)
    place, coldspray = tmp_path / "empty", python.with_name("coldspray")
    place.mkdir()
    assert run(place, python, "-c", "import coupler; print(coupler.__file__)").startswith(str(tmp_path))
    assert run(place, coldspray, "--version").strip() == f"coldspray {__version__}"
    run(place, coldspray, "new", "single", "first")
    run(place, coldspray, "new", "coating_ni", "example")
    run(place, coldspray, "run", "first.toml", "--preset", "draft", "--set", "end.at=", "--set", "end.time=10 ns")
    summary = json.loads((place / "runs" / "first" / "summary.json").read_text())
    assert summary["version"] == __version__
    run(place, coldspray, "report", "runs/first")
    assert (place / "runs" / "first" / "report.html").stat().st_size > 1_000_000
