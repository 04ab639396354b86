"""Output for people: pictures of the cross-section, tables, an HTML report, animations, comparisons. It imports no solver.

Matplotlib is imported only for the first picture, because its import takes as long as the computation of a coarse impact.
"""

from importlib import import_module
from typing import TYPE_CHECKING

from .screen import screen

if TYPE_CHECKING:
    from .picture import section_picture

__all__ = ["screen", "section_picture"]


def __getattr__(name: str) -> object:
    if name == "section_picture":
        return import_module(".picture", __name__).section_picture
    raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
