"""The command `coldspray materials`: it lists the metals of the library, shows one metal, or imports metals from a table."""

import argparse
import textwrap
from typing import TYPE_CHECKING

from ..files.inputs import check_regular
from ..units import rounded
from .arguments import Commands, add_command, add_force, path
from .collection import COLUMNS, write_library

if TYPE_CHECKING:
    from ..physics.materials import Entry, Material

_STATES = ((0.2, 1e3, 300.0), (0.2, 1e7, 300.0), (0.2, 1e7, 600.0))  # plastic strain, rate 1/s, temperature K


def add(commands: Commands) -> None:
    option = add_command(commands, "materials", run, "show metals of the library, their strength sets and sources")
    option("name", nargs="?", metavar="NAME", help="name of the metal to show (default: list all metals)")
    option("--import", type=path, dest="table", metavar="FILE",
           help=f"convert a CSV table to a library of metals for scenes; the table needs the columns {', '.join(COLUMNS)}")  # fmt: skip
    option("--out", type=path, metavar="FILE", help="file of the library (default: name of the table with .toml)")
    add_force(option)


def run(arguments: argparse.Namespace) -> int:
    """List the metals, show one, or import a table. Returns the exit code. Raises ColdsprayError for an unknown name or a bad table."""
    from ..physics import materials

    if arguments.table:
        check_regular(arguments.table)
        out = arguments.out or arguments.table.with_suffix(".toml")
        print("\n".join(write_library(arguments.table, out, arguments.force)))
    elif arguments.name:
        print("\n".join(_explained(materials.entry(arguments.name))))
    else:
        print("\n".join(_listed([materials.entry(name) for name in materials.names()])))
    return 0


def _listed(entries: "list[Entry]") -> list[str]:
    lines = [f"{'metal':9} {'strength set':19} {'law':22} fitted"]
    for known in entries:
        for i, metal in enumerate(known.materials):
            law = metal.strength
            lines.append(f"{'' if i else metal.name:9} {law.set:19} {law.law:22} {law.fitted.words}")
    named = [known for known in entries if known.aliases]
    others = "; ".join(f"{known.material.name} is also {', '.join(known.aliases)}" for known in named)
    return [
        *lines,
        "",
        *textwrap.wrap(f"Other names: {others}.", 118),
        "The symbol and the name of an element mean one metal of the list: Al is the alloy 6061-T6, Al1100 nearly pure aluminium.",
        'The first set is the default; [materials.NAME] in a scene selects another: strength = "Preston_2003", or a law.',
        "coldspray materials NAME: shows constants, sources and flow stresses of a metal",
    ]


def _explained(known: "Entry") -> list[str]:
    metal, show = known.material, _value
    moduli = {"G": metal.G, "K": metal.K, "E": metal.E}
    lines = [metal.name + (f"  (also: {', '.join(known.aliases)})" if known.aliases else ""), ""]
    for name, text in (
        ("density", f"{metal.rho:g} kg/m^3"),
        ("elasticity", f"{', '.join(f'{k} {v / 1e9:.4g} GPa' for k, v in moduli.items())}, nu {metal.nu:.3f}"),
        ("shock", f"U = {metal.c0:g} m/s + {metal.s:g} u, Gamma0 {metal.Gamma0:g}"),
        ("melting", f"{metal.T_m:g} K"),
        ("cp", show(metal.cp, "J/(kg K)")),
        ("k", show(metal.k, "W/(m K)")),
        ("expansion", show(metal.thermal_expansion, "1/K") if metal.thermal_expansion_at(300.0) else "not known"),
        ("heat", f"{metal.taylor_quinney:g} of the plastic work"),
        ("tensile", f"{metal.sigma_TS / 1e6:g} MPa" if metal.sigma_TS else "not known: no critical velocity"),
        ("brittle", f"ceramic: broken above {metal.tensile_limit / 1e6:g} MPa" if metal.tensile_limit else "no"),
    ):
        lines.append(f"  {name:10} {text}")
    lines += _wrapped("source", metal.source) + _wrapped("note", metal.note)
    for other in known.materials:
        lines += ["", *_set(other)]
    return lines


def _set(metal: "Material") -> list[str]:
    from ..physics.strength import LAWS

    law = metal.strength
    parameters = LAWS[law.law].parameters
    shown = [f"{key} {rounded(law[key], p.unit, 6) if p.unit else f'{law[key]:g}'}" for key, p in parameters.items()]
    states = ((metal.flow_stress(*state) / 1e6, *state) for state in _STATES)
    stresses = [f"{stress:.0f} MPa at {eps_p:g}, {rate:.0e} 1/s, {T:.0f} K" for stress, eps_p, rate, T in states]
    return [
        f"{law.set}: {LAWS[law.law].about}",
        *_wrapped("law", f"{law.law}: {', '.join(shown)}; melting {metal.T_m:g} K"),
        *_wrapped("fitted", law.fitted.words),
        *_wrapped("flow", "; ".join(stresses)),
        *_wrapped("source", law.source),
    ]


def _value(pairs: tuple[tuple[float, float], ...], unit: str) -> str:
    if len(pairs) == 1:
        return f"{pairs[0][1]:g} {unit}"
    return ", ".join(f"{value:g} {unit} at {T:g} K" for T, value in pairs) + ", linear between these temperatures"


def _wrapped(name: str, text: str) -> list[str]:
    indent = " " * 13
    return textwrap.wrap(text, 118, initial_indent=f"  {name:10} ", subsequent_indent=indent) if text else []
