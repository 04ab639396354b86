"""Every command and snippet of the guide, the gallery and README.md runs, in order, page by page, on scenes of 200 points and 10 ns.

A block that cannot run here stands under a comment `<!-- not run: REASON -->`: its options are still parsed, and its imports done.
"""

import ast
import json
import re
import shlex
import shutil
import tomllib
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest
import tomlkit

from coupler.commands.main import _parser, main
from coupler.plan.planning import plan
from coupler.plan.reading import Scene
from coupler.plan.record import plan_text
from coupler.studies.runs import write_scene
from coupler.studies.sweep import Sweep

ROOT = Path(__file__).parents[1]
PAGES = [
    ROOT / "README.md",
    ROOT / "CONTRIBUTING.md",
    *sorted(page for folder in ("guide", "gallery") for page in (ROOT / "docs" / folder).glob("*.md")),
]
BLOCK = re.compile(r"(?:<!-- ([^\n]*?) -->\n)?^```(console|python|toml)\n(.*?)^```$", re.DOTALL | re.MULTILINE)
BASE = {"particle": {"material": "Ni", "diameter": "25 um", "velocity": "500 m/s"}, "substrate": {"material": "SS304"}}
MAKEFILE = (ROOT / "Makefile").read_text()


@dataclass(frozen=True)
class Block:
    """A fenced block of a page. mark: the comment above it; line: where its text starts."""

    mark: str
    kind: str
    text: str
    line: int


def blocks(page: Path) -> list[Block]:
    text = page.read_text(encoding="utf-8")
    return [Block(m[1] or "", m[2], m[3], text[: m.start(3)].count("\n") + 1) for m in BLOCK.finditer(text)]


SHORT = {"time": "10 ns"}
ENDS: dict[str, dict[str, str] | None] = {
    "coating": {"at": "rest"},
    "single": None,
}  # of pages that print what only a whole impact has; None: as it is, with errors


def small(data: dict[str, Any], source: str, end: dict[str, str] = SHORT) -> Scene:
    """A scene of the same kind that takes a second, or some until an `end` where its measures are defined."""
    if "coating" in data:
        data["coating"] |= {"number": 2, "layers": 1}
    smallest = min(particle.diameter for particle in Scene.from_dict(data, source).particles)
    spacing = f"{0.13 * smallest * 1e6:.4g} um"  # 240 points in a sphere, two across a hollow one
    return Scene.from_dict(
        data | {"resolution": {"spacing": spacing}, "end": end, "output": {"every": "10 ns"}}, source
    )


@pytest.fixture(scope="session")
def workspace(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A folder as that of the source, with small scenes, a finished run of each of two, and a sweep made of copies of one."""
    folder = tmp_path_factory.mktemp("guide")
    shutil.copytree(ROOT / "workflows", folder / "workflows")
    for path in (folder / "workflows").glob("*.toml"):
        data = tomllib.loads(path.read_text())
        if "substrate" in data and not path.name.startswith("morphology"):
            path.write_text(small(data, str(path)).to_toml())
    for name in ("single_ni", "single_ti"):
        scene = folder / "workflows" / f"{name}.toml"
        assert main(["run", str(scene), "--out", str(folder / "runs" / name), "--threads", "1", "--quiet"]) == 0
    sweep = Sweep.load(folder / "workflows" / "map_ni.toml")
    for point in [name for name in sweep.points if re.search(r"_(10|33)um_(250|400|600)ms", name)]:
        scene = write_scene(folder / "runs" / "map_ni", point, sweep.points[point])
        shutil.copytree(folder / "runs" / "single_ni", scene.with_suffix(""))
        (scene.with_suffix("") / "scene.toml").write_text(Scene.load(scene).to_toml())
        (scene.with_suffix("") / "plan.json").write_text(plan_text(plan(Scene.load(scene))))
        scene.with_suffix(".json").write_text(json.dumps({"status": "done", "reason": "", "exit_code": 0}))
    return folder


def commands(block: Block) -> list[list[str]]:
    """Words of each line, without comments and without mpiexec."""
    lines = [shlex.split(line, comments=True) for line in block.text.replace("\\\n", " ").splitlines()]
    return [words[3:] if words[0] == "mpiexec" else words for words in lines if words]


def run_console(block: Block) -> None:
    for words in commands(block):
        if words[0] == "make":
            assert all(re.search(rf"^{target}:", MAKEFILE, re.MULTILINE) for target in words[1:]), words
        elif words[0] == "python":
            assert (ROOT / words[1]).is_file(), words
        elif words[0] == "coldspray":
            if {"--help", "--version"} & set(words):
                with pytest.raises(SystemExit) as ended:
                    _parser().parse_args(words[1:])
                assert ended.value.code == 0
            elif block.mark.startswith("not run"):
                _parser().parse_args(words[1:])
            else:
                wanted = 2 if block.mark == "exit code 2" else 0
                assert main(words[1:]) == wanted, words
        else:
            raise AssertionError(f"not a command that this test knows: {words}")


def run_toml(block: Block, end: dict[str, str] | None) -> None:
    """A scene with its file's name on the first line is written, small; any other block is part of a scene."""
    data = tomllib.loads(block.text)
    name = re.match(r"# (\S+\.toml)\n", block.text)
    if name and name[1] == "wrong.toml":
        Path(name[1]).write_text(block.text)
    elif name and "points" in data:
        Sweep.from_dict(data, name[1])
        points = {key: values[: 2 if key == "velocity" else 1] for key, values in data["points"].items()}
        scene = data["scene"] | {"resolution": {"spacing": "2 um"}, "end": {"time": "10 ns"}}
        Path(name[1]).write_text(tomlkit.dumps({"points": points, "scene": scene}))
    elif name:
        Scene.from_dict(data, name[1])
        Path(name[1]).write_text(block.text if end is None else small(data, name[1], end).to_toml())
    else:
        own = {"substrate": BASE["substrate"]} if "coating" in data else BASE
        Scene.from_dict({**own, **data}, "part of a scene")


def marked(page: Path) -> Any:
    """A page as a parameter; those of the gallery take some seconds each."""
    gallery = page.parent.name == "gallery"
    return pytest.param(page, marks=[pytest.mark.slow] if gallery else [], id="gallery-" * gallery + page.stem)


@pytest.mark.parametrize("page", [marked(page) for page in PAGES if blocks(page)])
def test_the_page_runs_as_written(
    page: Path, workspace: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    shutil.copytree(workspace, tmp_path / "work")
    monkeypatch.chdir(tmp_path / "work")
    mpl.use("agg")
    names: dict[str, Any] = {}
    for block in blocks(page):
        where = f"{page.name}, line {block.line}"
        try:
            if block.kind == "toml":
                run_toml(block, ENDS.get(page.stem, SHORT))
            elif block.kind == "console":
                run_console(block)
            elif block.mark.startswith("not run"):
                tree = ast.parse(block.text)
                tree.body = [node for node in tree.body if isinstance(node, ast.Import | ast.ImportFrom)]
                exec(compile(tree, where, "exec"), names)
            else:
                exec(compile(block.text, where, "exec"), names)
        except (Exception, SystemExit) as problem:
            raise AssertionError(
                f"{where}: {type(problem).__name__}: {problem}\n{capsys.readouterr().err}"
            ) from problem


def test_blocks_that_do_not_run_say_why() -> None:
    marks = [block.mark for page in PAGES for block in blocks(page) if block.mark]
    assert all(re.fullmatch(r"not run: .{8,}|exit code 2", mark) for mark in marks)
    assert all(page.read_text().count("```console") <= len(blocks(page)) for page in PAGES)
