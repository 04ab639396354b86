"""Runs the pages and notebooks of docs/gallery, and stores what they print and draw:
python workflows/gallery.py [PAGE ...]

The blocks of a page run in order in a temporary folder. A TOML block is a file, whose name is in its first line; the output of a Python
block or a console block is written to a text block below it. Pictures of the page are stored beside it, in 256 colours, and its last
line gives the processor time. A notebook also runs in a temporary folder, and contains its outputs. Each takes from 10 s to some
minutes of processor time.
"""

import contextlib
import io
import os
import re
import shlex
import subprocess
import sys
import tempfile
from pathlib import Path
from typing import Any

import nbformat
from nbclient import NotebookClient
from pages import spent
from PIL import Image
from study_table import DOCS

from coupler import __version__

GALLERY = DOCS / "gallery"
BLOCK = re.compile(r"^```(console|python|toml)\n(.*?)^```\n(?:\n```text\n.*?^```\n)?", re.DOTALL | re.MULTILINE)


def printed(kind: str, text: str, names: dict[str, Any]) -> str:
    """Run a block in the working directory. Returns what it prints. names: names that earlier Python blocks have defined."""
    if kind == "toml":
        Path(text.split()[1]).write_text(text)
        return ""
    if kind == "python":
        with contextlib.redirect_stdout(io.StringIO()) as stream:
            exec(compile(text, "page", "exec"), names)
        return stream.getvalue()
    commands = [[sys.executable, "-m", "coupler", *shlex.split(line)[1:]] for line in text.splitlines()]
    done = [subprocess.run(command, stdout=subprocess.PIPE, text=True, check=True) for command in commands]
    return "".join(each.stdout for each in done)


def run_page(page: Path) -> None:
    """Run a page and write it with its output, pictures and time."""
    start, names, home = spent(), dict[str, Any](), Path.cwd()

    def with_output(match: re.Match[str]) -> str:
        output = printed(match[1], match[2], names).rstrip()
        return f"```{match[1]}\n{match[2]}```\n" + (f"\n```text\n{output}\n```\n" if output else "")

    with tempfile.TemporaryDirectory() as place:
        os.chdir(place)
        try:
            text = BLOCK.sub(with_output, page.read_text(encoding="utf-8"))
            for name in re.findall(r"!\[.*\]\((.*?\.png)\)", text):
                (page.parent / name).parent.mkdir(exist_ok=True)
                Image.open(name).convert("RGB").quantize(256).save(page.parent / name, optimize=True)
        finally:
            os.chdir(home)
    text = re.sub(r"\n\*Computed in .*\n", "", text)
    took = f"Computed in {spent() - start:.0f} s of processor time by version {__version__}."
    page.write_text(f"{text}\n*{took}*\n", encoding="utf-8")


def run_notebook(path: Path) -> None:
    """Run a notebook and write it with its outputs. Outputs in HTML or as a picture lose their text form, which names folders."""
    book = nbformat.read(path, as_version=4)
    with tempfile.TemporaryDirectory() as place:
        NotebookClient(
            book, timeout=600, record_timing=False, coalesce_streams=True, resources={"metadata": {"path": place}}
        ).execute()
    for output in (output for cell in book.cells for output in cell.get("outputs", ())):
        if {"text/html", "image/png"} & (data := output.get("data", {})).keys():
            data.pop("text/plain", None)
    book.metadata.language_info = {"name": "python"}
    nbformat.write(book, path)


if __name__ == "__main__":
    files = {path.stem: path for kind in ("md", "ipynb") for path in GALLERY.glob(f"*.{kind}") if path.stem != "index"}
    for stem in sys.argv[1:] or sorted(files):
        print(stem, flush=True)
        (run_page if files[stem].suffix == ".md" else run_notebook)(files[stem])
