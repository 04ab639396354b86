"""The fields of a run as files of other formats, for tools that cannot read VTKHDF in time."""

from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio

from .outputs import MARK, replacing
from .result import DOMAINS, Fields, Result

CELLS = {1: "vertex", 3: "triangle", 4: "tetra"}  # columns of the cells -> name of meshio
NAMES = tuple(f"{domain}{ending}" for domain in DOMAINS for ending in (".pvd", "_[0-9][0-9][0-9][0-9].vtu"))


def write_pvd(result: Result, folder: Path, stage: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Write each stored step of each domain as a .vtu file, and a .pvd file for each domain that names its steps with their times.

    stage(text): told what comes next. Returns the .pvd files. SI units.
    """
    collections = []
    for domain in DOMAINS:
        times = result.times(domain)
        for step in range(len(times)):
            stage(f"{domain}, step {step + 1} of {len(times)}")
            with replacing(folder / _step(domain, step)) as part:
                meshio.write(part, as_mesh(result.fields(step, domain)), file_format="vtu")
                with part.open("a", encoding="utf-8") as file:
                    file.write(f"<!-- {MARK} -->\n")
        if len(times):
            with replacing(folder / f"{domain}.pvd") as part:
                part.write_text(_collection(domain, times.tolist()), encoding="utf-8")
            collections.append(folder / f"{domain}.pvd")
    return collections


def as_mesh(fields: Fields) -> meshio.Mesh:
    """One domain at one time as meshio has it."""
    at_points, in_cells = fields.split()
    cells = [(CELLS[fields.cells.shape[1]], fields.cells)]
    return meshio.Mesh(fields.points, cells, at_points, {name: [values] for name, values in in_cells.items()})


def _step(domain: str, step: int) -> str:
    return f"{domain}_{step:04d}.vtu"


def _collection(domain: str, times: Sequence[float]) -> str:
    steps = "".join(
        f'<DataSet timestep="{time:.9g}" part="0" file={quoteattr(_step(domain, k))}/>\n'
        for k, time in enumerate(times)
    )
    head = f'<?xml version="1.0"?>\n<!-- {MARK} -->\n<VTKFile type="Collection" version="1.0">\n<Collection>\n'
    return f"{head}{steps}</Collection>\n</VTKFile>\n"
