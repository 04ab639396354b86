"""coldspray: metal particles (LAMMPS SPH) that meet a target (explicit finite elements), as in cold spray.

from coupler import Scene, run
result = run(Scene.load("workflows/single_ni.toml"))
result.flattening_ratio, result.history("kinetic"), result.fields(-1)
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .deposition.run import run
    from .files.result import Result
    from .plan.reading import Scene

__version__ = "0.1.0"
__all__ = ["Result", "Scene", "run"]

_HOME = {"Scene": "plan.reading", "run": "deposition.run", "Result": "files.result"}


def __getattr__(name: str) -> Any:
    if name in _HOME:  # loaded when first asked for: the command line must answer --help at once
        return getattr(import_module(f".{_HOME[name]}", __name__), name)
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
