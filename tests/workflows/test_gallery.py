"""The notebooks of the gallery: executed, small, of no machine; and their code runs with few points, without Jupyter."""

import ast
import base64
import json
import os
from pathlib import Path
from typing import Any

import matplotlib as mpl
import pytest

NOTEBOOKS = sorted((Path(__file__).parents[2] / "docs" / "gallery").glob("*.ipynb"))


def cells(path: Path) -> list[dict[str, Any]]:
    return [cell for cell in json.loads(path.read_text())["cells"] if cell["cell_type"] == "code"]


@pytest.mark.parametrize("path", NOTEBOOKS, ids=lambda path: path.stem)
def test_a_notebook_is_stored_as_it_was_executed(path: Path) -> None:
    text = path.read_text()
    assert json.loads(text)["metadata"]["kernelspec"]["name"] == "python3"
    assert [cell["execution_count"] for cell in cells(path)] == [*range(1, len(cells(path)) + 1)]
    outputs = [output for cell in cells(path) for output in cell["outputs"]]
    assert not [out for out in outputs if out["output_type"] == "error" or out.get("name") == "stderr"]
    images = [data["image/png"] for out in outputs if "image/png" in (data := out.get("data", {}))]
    assert images
    assert all(len(base64.b64decode(image)) < 150_000 for image in images)
    assert len(text) < 400_000
    assert not [folder for folder in ("/tmp/", "/home/", "/root/", os.getcwd()) if folder in text]


@pytest.mark.parametrize(
    "path",
    [pytest.param(p, marks=[pytest.mark.slow] * (p.stem != "notebook_reading"), id=p.stem) for p in NOTEBOOKS],
)
def test_the_code_of_a_notebook_runs(path: Path, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """With 240 points; an expression that ends a cell shows itself."""
    monkeypatch.chdir(tmp_path)
    mpl.use("agg")
    names: dict[str, Any] = {}
    for cell in cells(path):
        text = "".join(cell["source"])
        text = text.replace('"preset": "draft"', '"resolution": {"spacing": "3.3 um", "error": False}')
        *body, last = ast.parse(text).body
        exec(compile(ast.Module(body, []), path.name, "exec"), names)
        if not isinstance(last, ast.Expr):
            exec(compile(ast.Module([last], []), path.name, "exec"), names)
        else:
            value = eval(compile(ast.Expression(last.value), path.name, "eval"), names)
            assert not hasattr(value, "_repr_html_") or value._repr_html_().startswith("<pre")
