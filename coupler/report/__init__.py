"""What a person looks at: pictures of the cut, tables, a page, an animation, a comparison. Reads results, imports no solver."""

from .picture import section_picture
from .words import alerts, summary_table, verdict

__all__ = ["alerts", "section_picture", "summary_table", "verdict"]
