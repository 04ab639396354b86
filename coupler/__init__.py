"""coldspray: metal particles (LAMMPS SPH) that meet a target (explicit finite elements), as in cold spray.

from coupler import Scene, run
result = run(Scene.load("workflows/single_ni.toml"))
result.flattening_ratio, result.history("kinetic"), result.fields(-1)
"""

from importlib import import_module
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from .deposition.run import run
    from .files.result import Result
    from .plan.reading import Scene

__version__ = "0.1.0"
__all__ = ["Result", "Scene", "run"]

_MODULES = {"Scene": "plan.reading", "run": "deposition.run", "Result": "files.result"}


def __getattr__(name: str) -> object:
    if name in _MODULES:  # imported at first use, so that --help stays fast
        return getattr(import_module(f".{_MODULES[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
