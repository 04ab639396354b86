"""Output for people: pictures of the cut, tables, a page, an animation, a comparison. Reads results, imports no solver."""

from .picture import section_picture
from .screen import screen

__all__ = ["screen", "section_picture"]
