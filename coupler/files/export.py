"""The fields of a run as .vtu and .pvd files, for tools that do not read time steps of VTKHDF."""

from collections.abc import Callable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import meshio

from .outputs import MARK, replacing, write_text
from .result import STORED, Result

CELLS = {1: "vertex", 3: "triangle", 4: "tetra"}  # columns of the cells -> type in meshio
NAMES = tuple(f"{domain}{ending}" for domain in STORED for ending in (".pvd", "_[0-9][0-9][0-9][0-9].vtu"))


def write_fields(result: Result, folder: Path, stage: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Write the stored steps of each domain: a .vtu file for each step, and a .pvd file that lists them with their times; SI units.
    Returns the .pvd files. stage(text): called with the name of each step. Raises StoreError."""
    domains = {domain: count for domain in STORED if (count := len(result.times(domain)))}
    for domain, count in domains.items():
        entries = []
        for step in range(count):
            stage(f"{domain}, step {step + 1} of {count}")
            fields, name = result.fields(step, domain), f"{domain}_{step:04d}.vtu"
            (at_points, in_cells), kind = fields.split(), CELLS[fields.cells.shape[1]]
            of_cells = {key: [values] for key, values in in_cells.items()}
            with replacing(folder / name) as part:
                meshio.Mesh(fields.points, [(kind, fields.cells)], at_points, of_cells).write(part, file_format="vtu")
                with part.open("a", encoding="utf-8") as file:
                    file.write(f"<!-- {MARK} -->\n")
            entries.append(f'<DataSet timestep="{fields.time!r}" part="0" file={quoteattr(name)}/>\n')
        head = f'<?xml version="1.0"?>\n<!-- {MARK} -->\n<VTKFile type="Collection" version="1.0">\n<Collection>\n'
        write_text(folder / f"{domain}.pvd", f"{head}{''.join(entries)}</Collection>\n</VTKFile>\n")
    return [folder / f"{domain}.pvd" for domain in domains]
