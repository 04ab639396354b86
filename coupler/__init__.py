"""coldspray simulates cold spray: metal particles (SPH in LAMMPS) hit a target of explicit finite elements.

from coupler import Scene, run
result = run(Scene.load("workflows/single_ni.toml"))
result.flattening_ratio, result.history("kinetic"), result.fields(-1)
"""

import os
import sys
from importlib import import_module
from pathlib import Path
from typing import TYPE_CHECKING

from .caches import kernel_folder

if TYPE_CHECKING:
    from .deposition.run import run
    from .files.result import Result
    from .plan.reading import Scene

__version__ = "0.3.0"
__all__ = ["Result", "Scene", "run"]


# numba reads this variable at its import; if it is imported already, it must read the variable again
os.environ["NUMBA_CACHE_DIR"] = str(kernel_folder(Path(__file__).parent, os.environ.get("NUMBA_CACHE_DIR")))
if "numba" in sys.modules:
    sys.modules["numba"].config.reload_config()

_MODULES = {"Scene": "plan.reading", "run": "deposition.run", "Result": "files.result"}


def __getattr__(name: str) -> object:
    if name in _MODULES:  # imported at first use, so that --help stays fast
        return getattr(import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
