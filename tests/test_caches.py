"""Where compiled kernels are kept: never those of other sources."""

import os
import re
import shutil
import subprocess
import sys
from pathlib import Path

import numba
import pytest

import coupler
from coupler.caches import kernel_folder

PACKAGE = Path(coupler.__file__).parent
STRESS = """
import numba  # before the package, as in a notebook
from coupler.physics import constitutive, materials
print(constitutive.yield_stress(constitutive.law_record(materials.material("Ni"))[0], 0.3, 1e5, 400.0))
"""


@pytest.fixture
def copied(tmp_path: Path) -> Path:
    """A copy of the package that keeps nothing beside its sources."""
    package = tmp_path / "site" / "coupler"
    shutil.copytree(PACKAGE, package, ignore=shutil.ignore_patterns("__pycache__"))
    for folder in (package, *(path for path in package.iterdir() if path.is_dir())):
        (folder / "__pycache__").touch()  # a file there: root may write everywhere else
    return package


def test_kernel_follows_a_function_of_another_file(copied: Path, tmp_path: Path) -> None:
    """Johnson-Cook doubled doubles the stress of the kernel that calls it, in a package that cannot be written: numba's own check
    reads the file of the kernel alone."""
    cache = tmp_path / "cache"
    environment = {name: value for name, value in os.environ.items() if name != "NUMBA_CACHE_DIR"}
    environment |= {"PYTHONPATH": str(copied.parent), "COLDSPRAY_CACHE": str(cache)}

    def stress() -> float:
        command = [sys.executable, "-c", STRESS]
        done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True, check=True)
        return float(done.stdout)

    before, of_user = stress(), kernel_folder(copied, str(tmp_path))
    law = copied / "physics" / "strength.py"
    text = law.read_text()
    last = "        sigma *= max(1.0 - law.softening * theta**law.m, 0.0)\n"
    assert text.count(last) == 1
    law.write_text(text.replace(last, f"{last}    sigma *= 2.0\n"))
    assert stress() == 2.0 * before
    assert len(list(cache.glob("kernels-*"))) == 2
    assert of_user.parent == kernel_folder(copied, str(tmp_path)).parent == tmp_path
    assert of_user != kernel_folder(copied, str(tmp_path))


def test_a_process_shares_the_kernels_of_the_one_that_started_it(tmp_path: Path) -> None:
    folder = kernel_folder(PACKAGE, str(tmp_path))
    assert folder.parent == tmp_path
    assert kernel_folder(PACKAGE, str(folder)) == folder
    assert os.environ["NUMBA_CACHE_DIR"] == numba.config.CACHE_DIR


def test_kernels_without_a_folder_of_their_own(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nowhere to write: each process compiles for itself."""
    (tmp_path / "file").touch()
    monkeypatch.setenv("COLDSPRAY_CACHE", str(tmp_path / "file"))
    monkeypatch.setattr("tempfile.tempdir", str(tmp_path))
    assert kernel_folder(tmp_path / "file", str(tmp_path / "file")).parent == tmp_path


def test_one_process_at_a_time_writes_kernels(tmp_path: Path) -> None:
    """While a process loads, compiles and saves a kernel, another waits for the lock of the folder: numba itself lets both give their
    kernels the same number, and loads the wrong one later."""
    program = """
import fcntl, os, subprocess, sys
from coupler.compiling import LOCK
from numba.core.compiler_lock import global_compiler_lock
attempt = "import fcntl, sys; fcntl.lockf(open(sys.argv[1], 'a'), fcntl.LOCK_EX | fcntl.LOCK_NB)"
def other():
    path = os.path.join(os.environ["NUMBA_CACHE_DIR"], LOCK)
    return subprocess.run([sys.executable, "-c", attempt, path], stderr=subprocess.DEVNULL).returncode
with global_compiler_lock:
    inside = other()
print(inside, other())
"""
    environment = os.environ | {"NUMBA_CACHE_DIR": str(tmp_path)}
    done = subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
    assert done.stdout.split() == ["1", "0"]


def test_every_kernel_is_compiled_under_the_lock() -> None:
    for path in PACKAGE.rglob("*.py"):
        if path.name != "compiling.py":
            imported = re.findall(r"^from numba import (.*)$", path.read_text(), re.MULTILINE)
            assert not any("njit" in names for names in imported), path
