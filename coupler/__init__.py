"""coldspray: metal particles (LAMMPS SPH) that meet a target (explicit finite elements), as in cold spray.

from coupler import Scene, run
result = run(Scene.load("workflows/single_ni.toml"))
result.flattening_ratio, result.history("kinetic"), result.fields(-1)
"""

import hashlib
import os
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .deposition.run import run
    from .files.result import Result
    from .plan.reading import Scene

__version__ = "0.2.0"
__all__ = ["Result", "Scene", "run"]


def _kernel_cache(package: Path) -> str:
    """Folder of a package's compiled kernels, another for each state of their sources.

    numba looks at the file of a kernel alone, not at those of the functions that it calls: in one folder for all, a change of the
    strength law would leave kernels that still hold the law before it.
    """
    sources = [path.read_bytes() for path in sorted(package.glob("*/*.py"))]
    state = hashlib.sha256(b"".join(source for source in sources if b"njit" in source)).hexdigest()
    return str(package / "__pycache__" / f"kernels-{state[:12]}")


os.environ.setdefault("NUMBA_CACHE_DIR", _kernel_cache(Path(__file__).parent))  # numba reads it as it is imported

_MODULES = {"Scene": "plan.reading", "run": "deposition.run", "Result": "files.result"}


def __getattr__(name: str) -> object:
    if name in _MODULES:  # imported at first use, so that --help stays fast
        return getattr(import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
