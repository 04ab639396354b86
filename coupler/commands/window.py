"""The command `coldspray window`: impact velocities of a powder compared with the critical and the erosion velocity, and the
deposition efficiency."""

import argparse
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from .. import __version__
from ..errors import SceneError
from ..files.outputs import MARK
from ..measures import REBOUNDS, STICKS
from ..studies.table import write_rows
from . import gas
from .arguments import Commands, add_command, add_force, path, remake, share

if TYPE_CHECKING:
    from ..physics.materials import Material
    from ..spray.window import Spray

COLUMNS = "share", "diameter_um", "velocity_m_s", "temperature_K", "critical_velocity_m_s", "velocity_ratio", "version"


def add(commands: Commands) -> None:
    text = "compare impact velocities of a powder with its deposition window; estimate the deposition efficiency"
    option = add_command(commands, "window", run, text)
    gas.add_conditions(option)
    option("--powder", nargs=3, metavar=("D10", "D50", "D90"), required=True, dest="diameter",
           help='diameters below which 10, 50 and 90 %% of the mass lie, such as "15 um" "25 um" "40 um"')  # fmt: skip
    option("--substrate", metavar="NAME", help="metal of the substrate, for the verdict about the first layer")
    option("--within", default="20%", metavar="PERCENT", help='uncertainty of the critical velocity (default: "20%%")')
    option("--csv", type=path, metavar="FILE", help="write a table with a row for each class of the powder")
    option(
        "--png", type=path, metavar="FILE", help="draw velocity against temperature at impact and the deposition window"
    )
    add_force(option)


def run(arguments: argparse.Namespace) -> int:
    from ..spray import window
    from ..spray.sizes import Sizes

    within = share(arguments.within, "--within")
    flow, metals, (small, median, large), fly = gas.setup(arguments, "window", "--powder")
    if not small <= median <= large:
        order = "give three diameters in ascending order, D10 D50 D90"
        raise SceneError([f"--powder {' '.join(arguments.diameter)}: {order}"], "window")
    metal = metals[arguments.material]
    base = metals[arguments.substrate] if arguments.substrate is not None else None
    sizes, keys = Sizes.of_diameters(small, median, large), ("--material", "--substrate")
    spray = window.spray(metal, base, sizes, partial(fly, metal), keys)
    print("\n".join(text_of(metal, spray, within)))
    if arguments.csv:
        _write_csv(arguments, spray)
    if arguments.png:
        draw(arguments.png, metal, median, spray, within, gas.conditions_of(flow))
    return 0


def text_of(metal: "Material", spray: "Spray", within: float) -> list[str]:
    """Text lines: impact conditions at D10, D50 and D90, the deposition efficiency with its range, and the verdict on the substrate.
    within: relative uncertainty of the critical velocity, 0 to 1."""
    from ..spray.flight import melting

    ratio = spray.ratio
    columns = f"{'velocity':>9}  {'temperature':>11}  {'critical':>9}  velocity / critical"
    lines = [f"  {metal.name + ' diameter':>16}  {columns}"]
    for i in (len(ratio) // 10, len(ratio) // 2, len(ratio) - 1 - len(ratio) // 10):
        arrives = f"{spray.velocity[i]:>5.0f} m/s  {spray.temperature[i]:>9.0f} K"
        lines.append(f"  {spray.diameter[i] * 1e6:>13.3g} um  {arrives}  {spray.critical[i]:>5.0f} m/s  {ratio[i]:.2f}")
    notes = melting(metal, spray.diameter.tolist(), spray.hottest.tolist(), spray.temperature.tolist())
    lines += ["", *(f"note: {note}" for note in notes), f"deposition efficiency {_efficiency(spray)}"]
    for word, factor in zip(("least", "greatest"), spray.extremes(within), strict=True):
        if factor != 1.0:
            side = f"{abs(factor - 1.0):.0%} {'higher' if factor > 1.0 else 'lower'}"
            lines.append(f"  {word} within {within:.0%} (critical velocity {side}): {_efficiency(spray, factor)}")
    median = spray.formula[len(ratio) // 2]
    head = f"verdict on {median.base}" if median.base else "verdict on its own metal (other: --substrate NAME)"
    shares = ", ".join(f"{share:.0%} {fate}" for fate, share in spray.fates(on_substrate=True).items() if share)
    return [*lines, f"{head}: of the mass {shares}; median: {median.words(spray.velocity[len(ratio) // 2])}"]


def _efficiency(spray: "Spray", factor: float = 1.0) -> str:
    """Text: deposition efficiency if the critical velocity is multiplied by `factor`, and the mass fractions below and above the
    window."""
    from ..spray.window import ERODES, EROSION

    fates = spray.fates(factor)
    below = f"{fates[REBOUNDS]:.0%} of the mass is below the critical velocity"
    above = f"{fates[ERODES]:.0%} above the erosion velocity ({EROSION:g} times the critical one)"
    return f"{fates[STICKS]:.0%}; {below}, {above}"


def _write_csv(arguments: argparse.Namespace, spray: "Spray") -> None:
    values = spray.share, spray.diameter * 1e6, spray.velocity, spray.temperature, spray.critical, spray.ratio
    rows = ([*map(float, row), __version__] for row in zip(*values, strict=True))
    table = [dict(zip(COLUMNS, row, strict=True)) for row in rows]
    write_rows(arguments.csv, COLUMNS, table, f"{MARK} window; {remake(arguments)}")


def draw(picture: Path, metal: "Material", median: float, spray: "Spray", within: float, conditions: str) -> None:
    """Draw velocity against temperature at impact as PNG: the size classes of the powder, and the limits of the deposition window
    for the median diameter (m). Filled markers: classes above their own critical velocity, which depends on the diameter. within:
    relative uncertainty of the critical velocity; conditions: gas and nozzle, for the title."""
    import numpy as np
    from matplotlib import colormaps
    from matplotlib.colors import Normalize

    from ..physics.adhesion import critical_velocity
    from ..report.figure import blank, save
    from ..spray import window

    figure = blank(7.0, 5.2, dpi=150, layout="constrained")
    axis = figure.subplots()
    coldest, hottest = float(spray.temperature.min()), float(spray.temperature.max())
    T = np.linspace(min(273.0, coldest), min(hottest + 300.0, 0.9 * metal.T_m), 60)
    critical = np.array([critical_velocity(metal, t, median) for t in T])
    axis.fill_between(T, (1.0 - within) * critical, (1.0 + within) * critical, color="0.9", linewidth=0.0)
    size = f"of {median * 1e6:.3g} µm (median)"
    for factor, style, label in (
        (1.0, "-", f"critical velocity {size}, ± {within:.0%}"),
        (window.OPTIMAL, "--", f"optimal velocity {size}"),
        (window.EROSION, ":", f"erosion velocity {size}"),
    ):
        axis.plot(T, factor * critical, "k", linestyle=style, linewidth=1.2, label=label)
    diameter, colours = spray.diameter * 1e6, colormaps["viridis"]
    scale = Normalize(float(diameter.min()), float(diameter.max()))
    above, n = spray.ratio >= 1.0, len(diameter)
    T, v, D = spray.temperature, spray.velocity, diameter
    points = axis.scatter(T[above], v[above], c=D[above], cmap=colours, norm=scale, s=26, zorder=3)
    edges = colours(scale(D[~above]))
    axis.scatter(T[~above], v[~above], s=26, zorder=3, facecolors="none", linewidths=1.3, edgecolors=edges)
    for face, count, side in (("0.3", int(above.sum()), "above"), ("none", int((~above).sum()), "below")):
        axis.scatter([], [], s=26, facecolors=face, edgecolors="0.3",
                     label=f"{count} of {n} classes of equal mass, {side} their own critical velocity")  # fmt: skip
    figure.colorbar(points, ax=axis, label="diameter (µm)")
    axis.set(xlabel="temperature at impact (K)", ylabel="velocity (m/s)", ylim=(0.0, None))
    efficiency, low, high = (f"{spray.fates(factor)[STICKS]:.0%}" for factor in (1.0, *spray.extremes(within)))
    axis.set_title(f"{metal.name}: deposition efficiency {efficiency} ({low} to {high})\n{conditions}", fontsize=10)
    axis.legend(fontsize=8)
    save(figure, picture)
