"""Output for people: pictures of the cut, tables, a page, an animation, a comparison. Reads results, imports no solver.

Matplotlib, which takes as long to load as a coarse impact to compute, is loaded for the first picture.
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
