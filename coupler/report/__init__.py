"""What a person looks at: pictures of the cut, tables, a page, an animation, a comparison. Reads results, imports no solver."""

from .picture import section_picture
from .words import summary_table

__all__ = ["section_picture", "summary_table"]
