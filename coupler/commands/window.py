"""The command `coldspray window`: a spray's particles between critical and erosion velocity, and its deposition efficiency."""

import argparse
import shlex
from pathlib import Path
from typing import TYPE_CHECKING

from .. import __version__
from . import gas
from .arguments import Commands, add_command, add_force, path

if TYPE_CHECKING:
    from ..physics.materials import Material
    from ..spray.window import Spray

COLUMNS = ("share", "diameter_um", "velocity_m_s", "temperature_K", "critical_velocity_m_s", "velocity_ratio")


def add(commands: Commands) -> None:
    """Add the command to a parser's subcommands."""
    text = "where a spray's particles lie in the window of deposition, and the deposition efficiency"
    option = add_command(commands, "window", run, text)
    gas.add_conditions(option)
    option("--powder", nargs=3, metavar=("D10", "D50", "D90"), required=True, dest="diameter",
           help='diameters below which 10, 50 and 90 %% of the mass are, such as "15 um" "25 um" "40 um"')  # fmt: skip
    option("--within", default="20%", metavar="PERCENT", help='uncertainty of the critical velocity (default: "20%%")')
    option("--csv", type=path, metavar="FILE", help="write a row for each class of the powder")
    option("--png", type=path, metavar="FILE", help="draw velocity over temperature at impact, with the limits")
    add_force(option)


def run(arguments: argparse.Namespace) -> int:
    """Run the command. Returns the exit code. Raises ColdsprayError for what a user can mend."""
    from ..errors import SceneError
    from ..files.outputs import claim_file
    from ..physics import materials
    from ..plan import gas as scene_gas
    from ..spray import flight, window
    from .accuracy import share

    for out, suffixes in ((arguments.csv, (".csv",)), (arguments.png, (".png",))):
        if out is not None:
            claim_file(out, suffixes, [arguments.nozzles] if arguments.nozzles else [], arguments.force)
    within, nozzles = share(arguments.within, "--within"), gas.known_nozzles(arguments.nozzles)
    conditions, sizes = gas.read_conditions(arguments, nozzles)
    if not sizes[0] <= sizes[1] <= sizes[2]:
        raise SceneError([f"--powder {' '.join(arguments.diameter)}: D10, D50 and D90 must not fall"], "window")
    metal = materials.material(arguments.material)
    flow, law = scene_gas.flow(conditions, nozzles[conditions.nozzle]), flight.DRAG_LAWS[conditions.drag]
    spray = window.spray(
        metal,
        (sizes[0], sizes[1], sizes[2]),
        lambda D: flight.fly_together(flow, metal, D, conditions.powder_temperature, law),
    )
    print("\n".join(text_of(metal, spray, within)))
    if arguments.csv:
        _write_csv(arguments, spray)
    if arguments.png:
        draw(arguments.png, metal, sizes[1], spray, within)
    return 0


def text_of(metal: "Material", spray: "Spray", within: float) -> list[str]:
    """Particles and deposition efficiency in some lines. within: uncertainty of the critical velocity."""
    from ..spray.flight import melting

    ratio = spray.ratio
    lines = [
        f"  {metal.name + ' diameter':>16}  {'velocity':>9}  {'temperature':>11}  {'critical':>9}  velocity / critical"
    ]
    for i in (len(ratio) // 10, len(ratio) // 2, len(ratio) - 1 - len(ratio) // 10):
        lines.append(
            f"  {spray.diameter[i] * 1e6:>13.3g} um  {spray.velocity[i]:>5.0f} m/s  {spray.temperature[i]:>9.0f} K"
            f"  {spray.critical[i]:>5.0f} m/s  {ratio[i]:.2f}"
        )
    low, high = spray.band(within)
    band = f"{low:.0%} to {high:.0%} with a critical velocity {within:.0%} higher or lower"
    notes = melting(metal, spray.diameter.tolist(), spray.hottest.tolist(), spray.temperature.tolist())
    return [*lines, "", *(f"note: {note}" for note in notes), f"deposition efficiency {spray.efficiency():.0%}; {band}"]


def _write_csv(arguments: argparse.Namespace, spray: "Spray") -> None:
    from ..files.outputs import MARK
    from ..studies.table import write_rows

    options = shlex.join([*gas.given(arguments), "--powder", *arguments.diameter])
    values = (
        spray.share, spray.diameter * 1e6, spray.velocity, spray.temperature, spray.critical, spray.ratio
    )  # fmt: skip
    rows = [dict(zip(COLUMNS, map(float, row), strict=True)) for row in zip(*values, strict=True)]
    write_rows(
        arguments.csv,
        (*COLUMNS, "version"),
        [{**row, "version": __version__} for row in rows],
        f"{MARK} window; remake: coldspray window {options}",
    )


def draw(picture: Path, metal: "Material", median: float, spray: "Spray", within: float) -> None:
    """Velocity over temperature at impact as a PNG: the powder's classes, and the limits for its median diameter (m)."""
    import numpy as np

    from ..report.picture import blank, save
    from ..spray import window

    figure = blank(7.0, 5.0, dpi=150, layout="constrained")
    axis = figure.subplots()
    T = np.linspace(
        min(273.0, float(spray.temperature.min())), min(float(spray.temperature.max()) + 300.0, 0.9 * metal.T_m), 60
    )
    critical = np.array([window.critical_at(metal, t, median) for t in T])
    axis.fill_between(T, (1.0 - within) * critical, (1.0 + within) * critical, color="0.9", linewidth=0.0)
    for factor, style, label in (
        (1.0, "-", "critical"),
        (window.OPTIMAL, "--", "optimal"),
        (window.EROSION, ":", "erosion"),
    ):
        axis.plot(T, factor * critical, "k", linestyle=style, linewidth=1.2, label=f"{label}, {median * 1e6:.3g} µm")
    points = axis.scatter(spray.temperature, spray.velocity, c=spray.diameter * 1e6, cmap="viridis", s=22, zorder=3)
    figure.colorbar(points, ax=axis, label="diameter (µm)")
    axis.set(xlabel="temperature at impact (K)", ylabel="velocity (m/s)", ylim=(0.0, None))
    axis.set_title(f"{metal.name}: deposition efficiency {spray.efficiency():.0%}", fontsize=11)
    axis.legend(fontsize=8)
    save(figure, picture)
