"""The pages: the scene's keys are those of the models, formulas can be drawn, links lead somewhere."""

import importlib.util
import re
import tomllib
from pathlib import Path
from typing import Any

import pytest
from matplotlib.mathtext import MathTextParser
from sphinx.cmd.build import build_main

from coupler import __version__

ROOT = Path(__file__).parents[1]
DOCS = ROOT / "docs"


def loaded(path: Path) -> Any:
    """A file outside the package, as a module."""
    spec = importlib.util.spec_from_file_location(f"_{path.stem}_of_docs", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    return module


def test_the_page_of_the_scene_is_that_of_the_models() -> None:
    scene_page = loaded(ROOT / "workflows" / "scene_page.py")
    assert not scene_page.missing_words(), "workflows/scene_page.py has no words for these keys"
    assert (DOCS / "guide" / "scene.md").read_text() == scene_page.page(), (
        "docs/guide/scene.md is old: python workflows/scene_page.py"
    )


def test_the_version_stands_once_in_each_file() -> None:
    with open(ROOT / "pyproject.toml", "rb") as file:
        assert tomllib.load(file)["project"]["version"] == __version__
    assert f"\nversion: {__version__}\n" in (ROOT / "CITATION.cff").read_text()


def test_the_page_knows_units_limits_and_defaults() -> None:
    page = (DOCS / "guide" / "scene.md").read_text()
    for row in (
        "| `diameter` | 1 um to 200 um | needed |",
        "| `preset` | `draft` `standard` `fine` | `standard` |",
        "| `friction` | number 0 to 2 | `0.5` |",
        "| `standoff` | 1 mm to 500 mm | `30 mm` |",
        "| `offset` | two of -5000 um to 5000 um | `0 um`, `0 um` |",
    ):
        assert row in page


def test_formulas_can_be_drawn() -> None:
    drawn = loaded(DOCS / "conf.py").drawn
    text = "\n".join(page.read_text() for page in sorted((DOCS / "theory").glob("*.md")))
    blocks = re.findall(r"\$\$(.+?)\$\$", text, re.DOTALL)
    lines = set(re.findall(r"\$([^$\n]+)\$", re.sub(r"\$\$.+?\$\$", "", text, flags=re.DOTALL)))
    assert len(blocks) > 10
    assert len(lines) > 20
    for formula in (*blocks, *lines):
        MathTextParser("path").parse(f"${' '.join(formula.split())}$")  # what `drawn` begins with
    assert drawn(blocks[0], 12).startswith('<img class="formula" src=')
    with pytest.raises(ValueError, match="Unknown symbol"):
        drawn(r"\nosuchthing", 12)


def slugs(page: Path) -> set[str]:
    """Anchors of the headings of a page."""
    headings = re.findall(r"^#+ (.+)$", re.sub(r"^```.*?^```$", "", page.read_text(), flags=re.M | re.S), re.M)
    return {re.sub(r"[^\w\- ]", "", heading.lower()).strip().replace(" ", "-") for heading in headings}


PAGES = [ROOT / "README.md", ROOT / "CONTRIBUTING.md", *sorted(DOCS.rglob("*.md"))]


@pytest.mark.parametrize("page", PAGES, ids=lambda page: str(page.relative_to(ROOT)))
def test_every_link_leads_somewhere(page: Path) -> None:
    text = re.sub(r"^```.*?^```$|`[^`\n]+`", "", page.read_text(), flags=re.M | re.S)
    for link in re.findall(r"\]\(([^)\s]+)\)", text):
        if not link.startswith(("http:", "https:", "mailto:")):
            name, _, anchor = link.partition("#")
            there = page.parent / name if name else page
            assert there.exists(), link
            assert not anchor or anchor in slugs(there), link


def test_every_file_that_a_page_names_is_there() -> None:
    """Files of the repository in text, such as `coupler/units.py`: pages change where a module moves."""
    named = {
        name
        for page in PAGES
        for name in re.findall(r"\b(?:coupler|tests|workflows)/[\w/]+\.(?:py|toml)\b", page.read_text())
    }
    assert len(named) > 50
    assert not [name for name in sorted(named) if not (ROOT / name).is_file()]


def test_every_page_is_in_a_list_of_pages() -> None:
    listed = {DOCS / "index.md"}
    pages = {*DOCS.rglob("*.md"), *DOCS.rglob("*.ipynb")}
    for page in DOCS.rglob("*.md"):
        for names in re.findall(r"^```{toctree}\n(?::[^\n]*\n)*(.*?)^```$", page.read_text(), re.M | re.S):
            listed |= {page.parent / name for name in names.split()}
    assert {page.with_suffix("") for page in pages} == {page.with_suffix("") for page in listed}


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore:.*is deprecated:PendingDeprecationWarning")  # between sphinx and myst_parser
def test_every_page_is_in_the_site_and_every_link_leads_somewhere(tmp_path, capsys) -> None:
    """The whole site but for the writing of HTML; with warnings as errors, as `make docs`."""
    code = build_main(["-q", "-E", "-W", "--keep-going", "-b", "dummy", str(DOCS), str(tmp_path / "site")])
    assert code == 0, capsys.readouterr().err
