"""Import of the package open3d at its first use."""

import sys
from types import ModuleType

from ..errors import DependencyError

# Modules for machine learning and notebooks: their import takes up to two seconds and needs dash, pandas, scikit-learn.
UNUSED = ("open3d.ml", "open3d.visualization.draw_plotly")


class _Unused(ModuleType):
    """A module that has every attribute, so that `from ... import` succeeds for any name."""

    def __getattr__(self, name: str) -> None:
        if name.startswith("__"):
            raise AttributeError(name)


def open3d() -> ModuleType:
    """The module open3d without the parts UNUSED, which are not imported. open3d prints only errors. Raises DependencyError if
    open3d is missing or incomplete, KeyboardInterrupt if the import is interrupted."""
    if "open3d" not in sys.modules:
        for name in UNUSED:
            sys.modules.setdefault(name, _Unused(name))
    try:
        import open3d as package  # 0.6 s of processor time and 180 MB: a single impact does not need it

        package.utility.set_verbosity_level(package.utility.VerbosityLevel.Error)
    except (ImportError, AttributeError, OSError) as problem:
        if isinstance(problem.__cause__, KeyboardInterrupt):  # Ctrl-C during the import of its compiled part
            raise problem.__cause__ from None
        raise DependencyError(
            f"open3d cannot be loaded ({problem}): pip uninstall open3d open3d-cpu, then pip install open3d-cpu (with CUDA: open3d)."
            " The two packages share files: install only one"
        ) from problem
    return package
