"""The package open3d, loaded when it is first needed."""

from types import ModuleType

from ..errors import DependencyError


def open3d() -> ModuleType:
    """open3d, silent but for errors. Raises DependencyError where it is missing or incomplete."""
    try:
        import open3d as package  # 1.4 s of processor time and 180 MB, which a single impact does not need

        package.utility.set_verbosity_level(package.utility.VerbosityLevel.Error)
    except (ImportError, AttributeError, OSError) as problem:
        raise DependencyError(
            f"open3d cannot be loaded ({problem}): install it again. The packages open3d-cpu and open3d (with CUDA) have the same"
            " files, so that removing one breaks the other: remove both, then install one"
        ) from problem
    return package
