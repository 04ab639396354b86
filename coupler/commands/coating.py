"""The command `coldspray coating`: measures of a coating as tables, pictures and meshes."""

import argparse
import contextlib
import io
from typing import TYPE_CHECKING

from ..errors import StoreError
from ..files.inputs import reading
from ..files.outputs import claim_folder
from ..units import rounded
from . import arguments as options
from .arguments import Commands

if TYPE_CHECKING:
    from ..studies.coating import CoatingMeasures
    from ..studies.splats import Splats

# statistics of a layer in the table: field, width of the first column, number of digits, factor from SI
_FORMS = (("eps_p", 14, ".2f", 1.0), ("T", 13, ".0f", 1.0), ("von_mises", 23, ".0f", 1e-6))


def add(commands: Commands) -> None:
    text = "measure a coating: thickness, roughness, porosity, stress along the depth"
    option = options.add_command(commands, "coating", run, text)
    option("run", type=options.path, metavar="DIR", help="folder of a run of several impacts, finished or not")
    option("--out", type=options.path, metavar="DIR", help="folder for the output files (default: DIR/coating)")
    option("--disc", type=options.quantity("--disc", "length"), metavar="L",
           help='radius of the measured disc, such as "20 um" (default: 0.6 times the radius of the coated area)')  # fmt: skip
    option("--section", type=options.quantity("--section", "length", positive=False), metavar="L",
           help="y of the cross-section (default: the plane that cuts the most particles)")  # fmt: skip
    option("--seeds", type=options.at_least_one, default=0, metavar="N",
           help="first compute the coating with N other seeds, for the error of each measure (default: none)")  # fmt: skip
    options.add_jobs(option, "number of simultaneous runs")
    options.add_force(option)


def run(arguments: argparse.Namespace) -> int:
    from ..files.result import Result
    from ..plan.reading import Scene
    from ..report.picture import stage
    from ..studies import coating, coating_files, coating_seeds, spread

    result = Result(arguments.run)
    folder = arguments.out or arguments.run / "coating"
    claim_folder(folder, "coating", coating_files.NAMES, [arguments.run], arguments.force)
    with reading(arguments.run):
        splats = coating.read(result)
    _check(arguments, splats)
    if arguments.seeds:
        others = coating_seeds.other_seeds(Scene.from_text(result.scene_text, str(arguments.run)), arguments.seeds)
        spread.compute(others, arguments.run / coating_seeds.FOLDER, options.jobs_of(arguments), options.teller(False))
    with reading(arguments.run), options.working("measuring the coating") as progress:
        measures = coating_seeds.measured(result, splats, arguments.disc)
        coating_files.write_measures(folder, measures)
        progress.stage("measuring the growth of the coating")
        coating_files.write_growth(folder, coating.growth(result, arguments.disc))
        progress.stage("drawing pictures and writing meshes")
        heading = f"{measures.impacts} of {measures.of} impacts" if measures.warnings else f"{measures.of} impacts"
        radius = 1.3 * measures.disc_radius_m / coating.DISC
        plane = stage(result).plane if arguments.section is None else arguments.section
        coating_files.section(result, splats, folder / "section.png", radius, heading, plane)
        coating_files.micrograph(splats, folder / "micrograph.png", radius, plane)
        coating_files.stress_profile(measures, folder / "stress.png")
        with contextlib.redirect_stdout(io.StringIO()):  # meshio prints remarks about fields
            meshes = coating_files.write_meshes(splats, folder)
    print("\n".join(describe(measures)))
    print(f"{', '.join(coating_files.NAMES[:-1])} and {len(meshes) - 1} surfaces of splats are in {folder}")
    return 0


def _check(arguments: argparse.Namespace, splats: "Splats") -> None:
    """Raise StoreError for a disc or a plane in which there is no coating."""
    y = splats.mesh.points[:, 1]
    low, high = float(y.min()), float(y.max())
    if arguments.disc is not None and not splats.element_size <= arguments.disc <= 0.5 * (high - low):
        least, most = rounded(splats.element_size, "um"), rounded(0.5 * (high - low), "um")
        raise StoreError(
            f"--disc: give a radius from {least} (element size of the splats) to {most} (radius of the target)"
        )
    if arguments.section is not None and not low < arguments.section < high:
        within = f"y = {rounded(low, 'um')} and {rounded(high, 'um')}"
        raise StoreError(f"--section: give a plane within the target, between {within}")


def describe(measures: "CoatingMeasures") -> list[str]:
    """The measures of a coating as text lines for a terminal."""
    from ..studies.coating import lines

    table = [
        *measures.warnings,
        *(f"{label:33}{value}" for label, value in lines(measures)),
        "",
        "layer      splats   strain: mean   99 %    max   T (K): mean   99 %    max   von Mises (MPa): mean   99 %    max",
    ]
    for row in measures.layers:
        table.append(f"{row['layer'] or 'substrate':<9} {row['splats']:7d}")
        for name, width, form, factor in _FORMS:
            mean, tail, most = (factor * row[f"{name}_{kind}"] for kind in ("mean", "p99", "max"))
            table[-1] += f" {mean:{width}{form}} {tail:6{form}} {most:6{form}}"
    return table
