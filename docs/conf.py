"""How the pages of this folder become a site: `make docs` writes it into docs/_build, which git ignores.

Formulas are drawn by matplotlib into the page itself, so that the site reads without a network.
"""

import base64
import io
from importlib.metadata import version as installed

project = "coldspray"
version = release = installed("coldspray")
extensions = ["myst_parser"]
exclude_patterns = ["_build"]
suppress_warnings = ["myst.header"]  # a table under a heading two levels down is no fault

myst_enable_extensions = ["dollarmath", "colon_fence"]
myst_heading_anchors = 3
myst_dmath_double_inline = True

html_theme = "alabaster"
html_theme_options = {"description": "Cold spray impacts: smoothed particles on finite elements", "page_width": "1100px",
                      "sidebar_width": "230px"}  # fmt: skip
html_show_sourcelink = False
html_show_copyright = False
html_math_renderer = "mathtext"


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
    return f'<img src="data:image/svg+xml;base64,{data}" alt="{alt}" style="vertical-align:{-depth:.1f}pt">'


def inline(self, node) -> None:
    """Put a formula into the line."""
    from docutils.nodes import SkipNode

    self.body.append(drawn(node.astext(), 13))
    raise SkipNode


def block(self, node) -> None:
    """Put a formula onto lines of its own."""
    from docutils.nodes import SkipNode

    lines = "<br>".join(drawn(line, 15) for line in node.astext().split("\\\\") if line.strip())
    self.body.append(f'<div style="margin:0.8em 2em;line-height:2.4">{lines}</div>\n')
    raise SkipNode


def setup(app) -> None:
    """Tell Sphinx of the way to draw formulas."""
    app.add_html_math_renderer("mathtext", (inline, None), (block, None))
