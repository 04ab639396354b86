"""The fields of a run in other formats, for tools that do not read time steps of VTKHDF."""

from collections.abc import Callable, Iterable
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import meshio
import numpy as np
from numpy.typing import NDArray

from .fields import Fields
from .outputs import MARK, replacing, write_text
from .result import COLD, DOMAINS, Result

CELLS = {1: "vertex", 3: "triangle", 4: "tetra"}  # columns of the cells -> type in meshio
WRITTEN = (*DOMAINS, COLD)
ENDINGS = (".pvd", "_[0-9][0-9][0-9][0-9].vtu", ".xdmf", ".h5")
NAMES = tuple(f"{domain}{ending}" for domain in WRITTEN for ending in ENDINGS)
_TOPOLOGY = {1: "Polyvertex", 3: "Triangle", 4: "Tetrahedron"}  # columns of the cells -> type in XDMF
_ATTRIBUTE = {(): "Scalar", (3,): "Vector", (6,): "Tensor6"}  # shape of a value -> type in XDMF
_TENSOR6 = [0, 3, 5, 1, 4, 2]  # from xx yy zz xy yz xz to the order of XDMF, xx xy xz yy yz zz


def write_fields(
    result: Result, folder: Path, form: str, stage: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Write the stored steps of each domain, SI units. Returns the files to open. form: "pvd": a .vtu file for each step, and a
    .pvd file that lists them with their times; "xdmf": an .h5 file with the arrays of all steps, each with its mesh, and an .xdmf
    file (XDMF 3) that describes them. stage(text): called with the name of each step. Raises StoreError."""
    write = {"pvd": _write_pvd, "xdmf": _write_xdmf}[form]
    opened = []

    def step_of(domain: str, step: int, count: int) -> Fields:
        stage(f"{domain}, step {step + 1} of {count}")
        return result.fields(step, domain)

    for domain in WRITTEN:
        if count := len(result.times(domain)):
            text = write(folder, domain, (step_of(domain, step, count) for step in range(count)))
            write_text(folder / f"{domain}.{form}", text)
            opened.append(folder / f"{domain}.{form}")
    return opened


def _write_pvd(folder: Path, domain: str, steps: Iterable[Fields]) -> str:
    """Write the .vtu file of each step. Returns the text of the .pvd file."""
    entries = []
    for step, fields in enumerate(steps):
        name = f"{domain}_{step:04d}.vtu"
        (at_points, in_cells), kind = fields.split(), CELLS[fields.cells.shape[1]]
        of_cells = {key: [values] for key, values in in_cells.items()}
        mesh = meshio.Mesh(fields.points, [(kind, fields.cells)], at_points, of_cells)
        with replacing(folder / name) as part:
            meshio.write(part, mesh, file_format="vtu")
            with part.open("a", encoding="utf-8") as file:
                file.write(f"<!-- {MARK} -->\n")
        entries.append(f'<DataSet timestep="{fields.time:.9g}" part="0" file={quoteattr(name)}/>\n')
    head = f'<?xml version="1.0"?>\n<!-- {MARK} -->\n<VTKFile type="Collection" version="1.0">\n<Collection>\n'
    return f"{head}{''.join(entries)}</Collection>\n</VTKFile>\n"


def _write_xdmf(folder: Path, domain: str, steps: Iterable[Fields]) -> str:
    """Write the .h5 file of all steps. Returns the text of the .xdmf file."""
    with replacing(folder / f"{domain}.h5") as part, h5py.File(part, "w") as file:
        file.attrs["comment"] = MARK
        grids = [_grid(file, f"{domain}.h5", step, fields) for step, fields in enumerate(steps)]
    return (
        f'<?xml version="1.0"?>\n<!-- {MARK} -->\n<Xdmf Version="3.0">\n<Domain>\n'
        f'<Grid Name="{domain}" GridType="Collection" CollectionType="Temporal">\n{"".join(grids)}</Grid>\n'
        "</Domain>\n</Xdmf>\n"
    )


def _grid(file: h5py.File, name: str, step: int, fields: Fields) -> str:
    """Write the arrays of one step into `file`, whose name is `name`. Returns the XML text that describes them."""

    def item(key: str, values: NDArray) -> str:
        path = f"{step:04d}/{key}"
        data = file.create_dataset(path, data=values, compression="gzip", compression_opts=1)
        kind = "Float" if np.issubdtype(data.dtype, np.floating) else "Int"
        shape = " ".join(map(str, data.shape))
        attributes = f'Dimensions="{shape}" NumberType="{kind}" Precision="{data.dtype.itemsize}" Format="HDF"'
        return f"<DataItem {attributes}>{name}:/{path}</DataItem>"

    count, columns = fields.cells.shape
    lines = [
        f'<Grid Name="step {step}">',
        f'<Time Value="{fields.time:.9g}"/>',
        f'<Topology TopologyType="{_TOPOLOGY[columns]}" NumberOfElements="{count}" NodesPerElement="{columns}">'
        f"{item('cells', fields.cells)}</Topology>",
        f'<Geometry GeometryType="XYZ">{item("points", fields.points)}</Geometry>',
    ]
    for centre, arrays in zip(("Node", "Cell"), fields.split(), strict=True):
        for key, values in arrays.items():
            kind = _ATTRIBUTE[values.shape[1:]]
            array = item(f"{centre}/{key}", values[:, _TENSOR6] if kind == "Tensor6" else values)
            named = f'Name={quoteattr(key)} AttributeType="{kind}" Center="{centre}"'
            lines.append(f"<Attribute {named}>{array}</Attribute>")
    return "\n".join([*lines, "</Grid>\n"])
