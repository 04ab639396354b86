"""Configuration of the site: `make docs` writes it into docs/_build.

Formulas are drawn by matplotlib into the page, so that the site needs no network.
"""

import base64
import io
import re
from importlib.metadata import version as installed

project = "coldspray"
version = release = installed("coldspray")
extensions = ["myst_nb", "sphinx.ext.autodoc", "sphinx.ext.autosummary"]
exclude_patterns = ["_build"]
nb_execution_mode = "off"  # workflows/gallery.py runs the notebooks
nb_mime_priority_overrides = [("dummy", "text/html", 0), ("dummy", "image/png", 1)]  # the builder of tests/test_docs.py
suppress_warnings = ["myst.header"]  # tables written by workflows/ may stand two heading levels down

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

html_theme = "furo"
html_title = f"coldspray {version}"
html_static_path = ["_static"]
html_css_files = ["tables.css"]
html_show_sourcelink = False
html_show_copyright = False
html_math_renderer = "mathtext"

autodoc_member_order = "bysource"
autodoc_typehints = "signature"
autodoc_preserve_defaults = True
python_maximum_signature_line_length = 100


def drawn(formula: str, size: float) -> str:
    """A formula of TeX as an <img>; size: of its letters, points. Raises ValueError for what matplotlib cannot read."""
    import matplotlib
    from matplotlib.font_manager import FontProperties
    from matplotlib.mathtext import math_to_image

    picture = io.BytesIO()
    text = " ".join(formula.split())
    with matplotlib.rc_context({"mathtext.fontset": "cm", "svg.hashsalt": "coldspray"}):
        depth = math_to_image(f"${text}$", picture, prop=FontProperties(size=size), format="svg")
    data = base64.b64encode(picture.getvalue()).decode()
    alt = text.replace("&", "&amp;").replace('"', "&quot;").replace("<", "&lt;").replace(">", "&gt;")
    return f'<img class="formula" src="data:image/svg+xml;base64,{data}" alt="{alt}" style="vertical-align:{-depth:.1f}pt">'


def inline(self, node) -> None:
    """Put a formula into the line."""
    from docutils.nodes import SkipNode

    self.body.append(drawn(node.astext(), 13))
    raise SkipNode


def block(self, node) -> None:
    """Put a formula onto lines of its own."""
    from docutils.nodes import SkipNode

    lines = "<br>".join(drawn(line, 15) for line in node.astext().split("\\\\") if line.strip())
    self.body.append(f'<div class="formula">{lines}</div>\n')
    raise SkipNode


def plain(app, kind, name, obj, options, lines) -> None:
    """Docstrings are plain text: keep the characters that reStructuredText would take for markup."""
    lines[:] = [re.sub(r"([*|])", r"\\\1", re.sub(r"`([^`]+)`", r"``\1``", line)) for line in lines]


def setup(app) -> None:
    """Register the renderer of formulas and the filter of docstrings."""
    app.add_html_math_renderer("mathtext", (inline, None), (block, None))
    app.connect("autodoc-process-docstring", plain)
