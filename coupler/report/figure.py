"""Figures without a screen: their size, axes, labels, and how they are written."""

import base64
import io
import textwrap
import zlib
from pathlib import Path
from typing import Literal

from matplotlib.axes import Axes
from matplotlib.axis import Axis
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, MaxNLocator, NullFormatter

from ..files.outputs import MARK, replacing

READABLE = 8.0  # points: least size of a font
LETTER = 0.6  # greatest mean width of a letter over the size of its font


def fitted(words: str, length: float) -> tuple[str, float]:
    """Break a text into the fewest lines that fit into a length (inches) at a readable font size. Returns text and size (points)."""
    label, size = words, 0.0
    for width in sorted({len(words), *(i for i, letter in enumerate(words) if letter == " ")}, reverse=True):
        lines = textwrap.wrap(words, width, break_long_words=False)
        label, size = "\n".join(lines), min(11.0, 72.0 * length / (LETTER * max(map(len, lines))))
        if size >= READABLE:
            break
    return label, size


def blank(width: float, height: float, dpi: float, layout: Literal["constrained"] | None = None) -> Figure:
    """An empty white figure with a size in inches that does not depend on a screen."""
    figure = Figure(figsize=(width, height), dpi=dpi, facecolor="white", layout=layout)
    FigureCanvasAgg(figure)
    return figure


def axes_at(figure: Figure, left: float, bottom: float, width: float, height: float) -> Axes:
    """Axes at a position in a figure; all lengths in inches."""
    across, down = figure.get_size_inches()
    return figure.add_axes((left / across, bottom / down, width / across, height / down))


def label_log(axis: Axis, factor: float = 1.0) -> None:
    """Label a logarithmic axis, whose limits are already set, at 1, 2, 5 times powers of ten. If its limits differ at most by a factor
    of 6, labels are evenly spaced. factor: from the values to the unit of the labels."""
    low, high = sorted(axis.get_view_interval())
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)) if high > 6.0 * low else MaxNLocator(5))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f"{value * factor:.4g}"))
    axis.set_minor_formatter(NullFormatter())


def save(figure: Figure, path: Path) -> None:
    """Write a figure as PNG. Raises StoreError if the file cannot be written. Only sequences of equal bytes are compressed: it takes a
    third of the time of the default compression, and files are 12 % longer."""
    with replacing(path) as part:
        figure.savefig(part, format="png", metadata={"Software": MARK}, pil_kwargs={"compress_type": zlib.Z_RLE})


def embedded(figure: Figure, dpi: float | None = None) -> str:
    """A figure as the data URL of a PNG image. dpi: resolution, by default that of the figure."""
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=dpi or figure.dpi)
    return image_of(stream.getvalue())


def image_of(png: bytes) -> str:
    """The data URL of a PNG image."""
    return "data:image/png;base64," + base64.b64encode(png).decode()
