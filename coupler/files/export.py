"""The fields of a run as files of other formats, for tools that cannot read VTKHDF in time."""

from collections.abc import Callable, Sequence
from pathlib import Path
from xml.sax.saxutils import quoteattr

import h5py
import meshio
import numpy as np
from numpy.typing import NDArray

from .fields import Fields
from .outputs import MARK, replacing
from .result import COLD, DOMAINS, Result

CELLS = {1: "vertex", 3: "triangle", 4: "tetra"}  # columns of the cells -> name of meshio
WRITTEN = (*DOMAINS, COLD)
NAMES = tuple(
    f"{domain}{ending}" for domain in WRITTEN for ending in (".pvd", "_[0-9][0-9][0-9][0-9].vtu", ".xdmf", ".h5")
)
FORMATS = ("pvd", "xdmf")
_TOPOLOGY = {1: "Polyvertex", 3: "Triangle", 4: "Tetrahedron"}  # columns of the cells -> name of XDMF
_ATTRIBUTE = {(): "Scalar", (3,): "Vector", (6,): "Tensor6"}  # shape of a value -> name of XDMF
_TENSOR6 = [0, 3, 5, 1, 4, 2]  # xx yy zz xy yz xz as XDMF has them: xx xy xz yy yz zz


def write_fields(
    result: Result, folder: Path, form: str, stage: Callable[[str], None] = lambda text: None
) -> list[Path]:
    """Write the stored steps of each domain in a format of FORMATS, SI units. Returns the files to open. stage(text): called with the
    name of each step. Raises StoreError."""
    return (write_pvd if form == "pvd" else write_xdmf)(result, folder, stage)


def write_pvd(result: Result, folder: Path, stage: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Write each stored step of each domain as a .vtu file, and a .pvd file for each domain that names its steps with their times.

    stage(text): called with the name of each step. Returns the .pvd files. SI units.
    """
    collections = []
    for domain in WRITTEN:
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


def write_xdmf(result: Result, folder: Path, stage: Callable[[str], None] = lambda text: None) -> list[Path]:
    """Write each domain as an .xdmf file (XDMF 3) of all its steps, each with its own mesh, and an .h5 file of the arrays.

    stage(text): called with the name of each step. Returns the .xdmf files. SI units.
    """
    written = []
    for domain in WRITTEN:
        times = result.times(domain)
        if not len(times):
            continue
        grids = []
        with replacing(folder / f"{domain}.h5") as part, h5py.File(part, "w") as file:
            file.attrs["comment"] = MARK
            for step in range(len(times)):
                stage(f"{domain}, step {step + 1} of {len(times)}")
                grids.append(_grid(file, f"{domain}.h5", step, result.fields(step, domain)))
        with replacing(folder / f"{domain}.xdmf") as part:
            part.write_text(
                f'<?xml version="1.0"?>\n<!-- {MARK} -->\n<Xdmf Version="3.0">\n<Domain>\n'
                f'<Grid Name="{domain}" GridType="Collection" CollectionType="Temporal">\n{"".join(grids)}</Grid>\n'
                "</Domain>\n</Xdmf>\n",
                encoding="utf-8",
            )
        written.append(folder / f"{domain}.xdmf")
    return written


def _grid(file: h5py.File, name: str, step: int, fields: Fields) -> str:
    """One step: its arrays into `file`, called `name`, and the lines that describe them."""

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
            lines.append(
                f'<Attribute Name={quoteattr(key)} AttributeType="{kind}" Center="{centre}">{array}</Attribute>'
            )
    return "\n".join([*lines, "</Grid>\n"])


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
