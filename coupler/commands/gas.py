"""The command `coldspray gas`: impact velocity and temperature against particle diameter, as table, file and picture."""

import argparse
import re
import textwrap
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

from ..errors import SceneError
from ..files.inputs import read_toml
from ..files.outputs import MARK, claim_file
from ..spray import nozzles
from ..studies.table import write_rows
from ..units import show
from .arguments import Commands, Option, add_command, add_force, path, remake

if TYPE_CHECKING:
    from ..physics.materials import Material
    from ..spray.flight import Flight
    from ..spray.gas import Flow

DIAMETERS = ("5 um", "10 um", "15 um", "20 um", "25 um", "30 um", "40 um", "50 um", "60 um")
_FIELDS = ("kind", "pressure", "temperature", "nozzle", "standoff", "ambient", "powder_temperature", "drag")
_OPTIONS = {"kind": "gas", "powder_temperature": "powder-temperature"}  # field -> option of another name
_NAMES = re.compile(rf"^({'|'.join(_OPTIONS)})\b")


def add(commands: Commands) -> None:
    option = add_command(commands, "gas", run, "impact velocity and temperature from gas, nozzle and particle diameter")
    add_conditions(option)
    option("--diameter", nargs="+", metavar="D", default=DIAMETERS, help='particle diameters, such as "25 um" "22 um"')
    option("--csv", type=path, metavar="FILE", help="also write the table to a file")
    option("--png", type=path, metavar="FILE", help="draw velocity and temperature along the axis")
    add_force(option)


def add_conditions(option: Option) -> None:
    """Add the options for gas, nozzle and material; `setup` evaluates them."""
    option("--gas", dest="kind", default="N2", help="name of the gas: N2 (default), He or air")
    option("--pressure", metavar="P", required=True, help='total pressure before the nozzle, such as "40 bar"')
    option("--temperature", metavar="T", required=True, help='total temperature before the nozzle, such as "800 degC"')
    text = "a nozzle of the library (coldspray nozzles), or of --library FILE"
    option("--nozzle", metavar="NAME", required=True, help=text)
    add_library(option)
    option("--material", metavar="NAME", default="Ni", help="metal of the particle (default: Ni)")
    option("--standoff", metavar="L", default="30 mm", help="distance between nozzle and target (default: 30 mm)")
    option("--ambient", metavar="P", default="1.01325 bar", help="pressure around the jet (default: 1.01325 bar)")
    option("--powder-temperature", metavar="T", default="20 degC", help="temperature in the feeder (default: 20 degC)")
    option("--drag", default="henderson", metavar="LAW", help="drag law: henderson (default) or carlson-hoglund")
    option("--bow-shock", action="store_true", help="include a normal shock before the target")


def add_library(option: Option) -> None:
    """Add the option --library; `known` evaluates it."""
    option("--library", type=path, metavar="FILE", help="file (or scene) with your own metals and nozzles")


def run(arguments: argparse.Namespace) -> int:
    flow, metals, diameters, fly = setup(arguments)
    material = metals[arguments.material]
    flights = fly(material, diameters)
    print("\n".join(_table(flow, material, diameters, flights)))
    if arguments.csv:
        _write_csv(arguments, flow, diameters, flights)
    if arguments.png:
        _draw(arguments.png, flow, material.name, diameters, flights)
    return 0


def setup(
    arguments: argparse.Namespace, command: str = "gas", sizes: str = "--diameter"
) -> "tuple[Flow, dict[str, Material], list[float], Callable[[Material, Sequence[float]], list[Flight]]]":
    """Read the conditions from the options, and check that the files of --csv and --png can be written. command, sizes: names of the
    command and of its option for diameters, for messages. Returns the flow, the metals by name, the diameters (m), and a function
    (metal, diameters in m) -> flights. Raises SceneError with all problems."""
    from ..physics import materials
    from ..plan import gas as scene_gas
    from ..scene.values import DIAMETER

    metals, of_name = known(arguments)
    for out, suffix in ((arguments.csv, ".csv"), (arguments.png, ".png")):
        if out is not None:
            claim_file(out, (suffix,), [arguments.library] if arguments.library else [], arguments.force)
    conditions, found = scene_gas.read({field: vars(arguments)[field] for field in (*_FIELDS, "bow_shock")})
    problems = [f"--{_NAMES.sub(lambda name: _OPTIONS[name[0]], text).replace(' = ', ' ', 1)}" for text in found]
    if arguments.nozzle not in of_name:
        problems.append(f'--nozzle "{arguments.nozzle[:40]}": {nozzles.unknown(arguments.nozzle, of_name)}')
    for option in ("material", "substrate"):
        name = vars(arguments).get(option)
        if name is not None and name not in metals:
            problems.append(f'--{option} "{name[:40]}": {materials.unknown(name[:40], metals)}')
    diameters = []
    for text in arguments.diameter:
        try:
            diameters.append(DIAMETER.read(text))
        except ValueError as error:
            problems.append(f'{sizes} "{text[:40]}" {error}')
    if problems or conditions is None:
        raise SceneError(problems, command)
    flow = scene_gas.flow(conditions, of_name[conditions.nozzle])
    return flow, metals, diameters, partial(scene_gas.flights, conditions, flow)


def known(arguments: argparse.Namespace) -> "tuple[dict[str, Material], dict[str, nozzles.Nozzle]]":
    """The metals and the nozzles of the library and of the file --library. Raises SceneError with all problems of the file."""
    from ..physics import materials
    from ..plan.own import with_library

    raw: dict[str, Any] = read_toml(arguments.library) if arguments.library else {}
    problems = with_library(raw, str(arguments.library))
    metals, of_metals = materials.from_scene(raw["materials"])
    known, of_nozzles = nozzles.from_tables(raw["nozzles"])
    if problems := [*problems, *of_metals, *of_nozzles]:
        raise SceneError(problems, str(arguments.library))
    return metals, known


def shown(nozzle: nozzles.Nozzle) -> str:
    lengths = ("inlet", "throat", "exit", "converging", "diverging", "barrel", "chamber")
    dimensions = ", ".join(f"{name} {show(vars(nozzle)[name], 'mm')}" for name in lengths if vars(nozzle)[name])
    texts = [f"  {name}: {text}" for name in ("source", "assumed") if (text := vars(nozzle)[name])]
    return "\n".join([f"{nozzle.name}: {dimensions}", *texts])


def _table(flow: "Flow", material: "Material", diameters: list[float], flights: "list[Flight]") -> list[str]:
    from ..spray.flight import melting

    exit_, jet = flow.inside(flow.nozzle.end), flow.jet
    celsius = flow.T0 - 273.15
    lines = [
        f"{flow.gas.name}, {flow.p0 / 1e5:.4g} bar, {celsius:.4g} degC through {flow.nozzle.name},"
        f" {flow.standoff * 1e3:.3g} mm to the target",
        f"  flow   {flow.mass_flow * 1e3:.3g} g/s",
        f"  exit   Mach {flow.exit_mach:.3g}, {exit_.u:.0f} m/s, {exit_.T:.0f} K, {flow.exit_pressure / 1e5:.3g} bar",
        f"  jet    {jet.u:.0f} m/s, {jet.T:.0f} K, at {flow.ambient / 1e5:.3g} bar; core {flow.core * 1e3:.3g} mm",
        *([f"  shock  {flow.layer * 1e3:.2g} mm before the target"] if flow.layer else []),
        "",
        f"  {material.name + ' diameter':>14}  {'at exit':>10}  {'at impact':>10}  {'temperature':>12}  {'in flight':>10}",
    ]
    for D, flight in zip(diameters, flights, strict=True):
        lines.append(
            f"  {D * 1e6:>11.4g} um  {_at_exit(flow, flight):>6.0f} m/s  {flight.velocity:>6.0f} m/s"
            f"  {flight.temperature:>10.0f} K  {flight.t[-1] * 1e3:>7.2f} ms"
        )
    notes = melting(material, diameters, [float(f.T.max()) for f in flights], [f.temperature for f in flights])
    notes += flow.notes
    wrapped = [textwrap.fill(note, 110, initial_indent="  note: ", subsequent_indent=" " * 8) for note in notes]
    return [*lines, "", *wrapped] if notes else lines


def conditions_of(flow: "Flow") -> str:
    """Gas, pressure, temperature and nozzle as text, for the title of a picture."""
    return f"{flow.gas.name}, {flow.p0 / 1e5:.4g} bar, {flow.T0 - 273.15:.4g} °C, nozzle {flow.nozzle.name}"


def _at_exit(flow: "Flow", flight: "Flight") -> float:
    return float(flight.v[int((flight.x < flow.nozzle.end).sum())])


def _write_csv(arguments: argparse.Namespace, flow: "Flow", diameters: list[float], flights: "list[Flight]") -> None:
    head = f"{MARK} gas; {remake(arguments)}"
    columns = ("diameter_um", "exit_velocity_m_s", "velocity_m_s", "temperature_K", "flight_time_ms")
    rows = [
        (D * 1e6, _at_exit(flow, flight), flight.velocity, flight.temperature, flight.t[-1] * 1e3)
        for D, flight in zip(diameters, flights, strict=True)
    ]
    write_rows(arguments.csv, columns, [dict(zip(columns, map(float, row), strict=True)) for row in rows], head)


def _draw(path: Path, flow: "Flow", material: str, diameters: list[float], flights: "list[Flight]") -> None:
    from matplotlib import colormaps

    from ..report.figure import blank, save

    figure = blank(8.0, 7.0, dpi=150, layout="constrained")
    above, below = figure.subplots(2, 1, sharex=True)
    gas = flights[0]
    above.plot(gas.x * 1e3, gas.u, "k--", linewidth=1.2, label=flow.gas.name)
    below.plot(gas.x * 1e3, gas.T_gas, "k--", linewidth=1.2, label=flow.gas.name)
    for i, (D, flight) in enumerate(zip(diameters, flights, strict=True)):
        colour = colormaps["viridis"](0.9 * i / max(len(flights) - 1, 1))
        above.plot(flight.x * 1e3, flight.v, color=colour, linewidth=1.4, label=f"{D * 1e6:.4g} µm")
        below.plot(flight.x * 1e3, flight.T, color=colour, linewidth=1.4)
    for name, x in {"throat": 0.0, "exit": flow.nozzle.end, "target": flow.target}.items():
        for axis in (above, below):
            axis.axvline(x * 1e3, color="0.75", linewidth=0.8, zorder=0)
        above.annotate(name, (x * 1e3, 1.0), (2, 3), xycoords=("data", "axes fraction"), textcoords="offset points")
    above.set_ylabel("velocity (m/s)")
    below.set(ylabel="temperature (K)", xlabel="distance from the throat (mm)")
    above.set_ylim(bottom=0)
    above.legend(title=material, fontsize=8, loc="upper left")
    figure.suptitle(conditions_of(flow), fontsize=11)
    save(figure, path)
