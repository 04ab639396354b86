"""What effects cost, on and off: python workflows/effects_costs.py [--kernels | --impacts]

docs/tables/effects_costs.csv: processor time of a step with everything on, and what leaving out an effect saves of it. The
impacts go on in turn, ten steps of each at a time, so that what slows down one slows down the others; of each ten steps the least of
several rounds counts.

docs/tables/effects_kernels.csv: the kernels that evaluate the law, on elements and points that all flow, with each effect left out:
off, in the kernels that are made without it, as runs have it; as a zero in the general kernels; and compiled from the same source
with its numbers written in, so that it cannot be on. All on the same arrays, in turn; of many calls the least counts. compile_s:
processor time that numba takes for the kernels without it when those with all effects (`none` left out) are there.
"""

import argparse
import re
import time
from collections.abc import Callable
from functools import partial
from pathlib import Path
from random import shuffle
from typing import Any

import numpy as np
from bench import block
from effects_study import CROSSINGS, SCENES, Effects, least_of
from pages import TABLES, write_table

from coupler.fe import blocks, kernels
from coupler.fe.explicit import LINEAR_VISCOSITY, QUADRATIC_VISCOSITY, Target
from coupler.impact.exchange import WINDOW
from coupler.physics import constitutive
from coupler.physics.materials import material
from coupler.scene.effects import NAMES
from coupler.sph import law as points_law

SCENE = "Ni on steel, 500 m/s"
OF_THE_LAW = {
    "thermal_softening": {"softening": 0},
    "rate_hardening": {"C": 0},
    "plastic_heating": {"taylor_quinney": 0},
    "temperature_dependent_cp": {"cp_slope": 0},
    "mie_gruneisen": {"s": 0, "Gamma0": 0},
    "thermal_expansion": {"expansion": 0},
}  # effect -> fields of the law's record, as they are without it: integers, known to be off where they are compiled
POINTS, CALLS, H = 5000, 300, 1e9
STATE = ("J", "p", "energy", "s", "sigma_y", "eps_p", "rate", "T", "heat")  # of elements, as it is before each call

clock = time.process_time


def impacts(rounds: int) -> list[dict[str, Any]]:
    """A row for each choice of effects: ms per step, and the share of it that everything on would save."""
    choices: dict[str, Effects] = {"everything on": "all", "auto": "auto", "none": "none"}
    choices |= {f"without {name}": ["all", f"-{name}"] for name in NAMES if name not in ("adhesion", "cooling")}
    least = least_of(rounds, SCENES[SCENE], choices, CROSSINGS)
    step = {name: sum(costs) / (WINDOW * len(costs)) for name, costs in least.items()}
    whole = step["everything on"]
    return [
        {"effects": name, "ms_per_step": f"{1e3 * seconds:.4g}", "saves": f"{1.0 - seconds / whole:.4f}"}
        for name, seconds in step.items()
    ]


def compiled(fields: dict[str, int]) -> dict[str, Any]:
    """The law and the kernels that call it, compiled with these fields of the law's record as numbers in their source."""
    space: dict[str, Any] = {}
    for module in (constitutive, blocks, kernels, points_law):
        text = Path(str(module.__file__)).read_text(encoding="utf-8")
        text = re.sub(r"^from \.(\.constitutive|blocks) import .*\n", "", text, flags=re.MULTILINE).replace(
            "cache=True, ", ""
        )
        for name, value in fields.items():
            text = re.sub(rf"\blaw\.{name}\b", repr(value), text)
        exec(compile(text, str(module.__file__), "exec"), space)
    return space


def elements_of(
    t: Target, kept: dict[str, np.ndarray], space: dict[str, Any], on: dict[str, bool], special: bool
) -> Callable[[], float]:
    """A call that updates stresses, pressures and forces of tetrahedra in the state `kept`; seconds per element."""
    laws = constitutive.law_record(material("SS304"), on, rate_filter=1e-9)
    pressing, flowing = (
        constitutive.specialised(laws, read) if special else laws for read in (constitutive.PRESSURE, constitutive.FLOW)
    )
    dt, n, m, mesh, sums = 0.3 * t.stable_dt()[0], len(t.x), len(t.mesh.conn), t.mesh, np.zeros(3)

    def work() -> float:
        for name, values in kept.items():
            getattr(t, name)[...] = values
        start = clock()
        space["nodal_pressure"](
            0, n, t.start, t.table, t.volume, t.heat, mesh.node_volume, pressing, t.law_of_node, t.J, t.p, t.energy
        )
        space["element_forces"](
            0, m, dt, LINEAR_VISCOSITY, QUADRATIC_VISCOSITY, t.x, t.v, mesh.conn, mesh.B, mesh.V0, t.volume, t.p, t.J,
            flowing, t.law_of, t.s, t.sigma_y, t.eps_p, t.rate, t.T, t.heat, t.fe, sums,
        )  # fmt: skip
        return (clock() - start) / m

    return work


def points() -> dict[str, np.ndarray]:
    """The state of points that flow, some compressed and some warm."""
    law, rng, n = constitutive.law_record(material("Ni"))[0], np.random.default_rng(1), POINTS
    J, sigma_y = rng.uniform(0.96, 1.0, n), rng.uniform(2e8, 4e8, n)
    stress = np.zeros((n, 6))
    stress[:, [0, 3, 5]] = -(law["K"] * (1.0 - J) / (1.0 - law["s"] * (1.0 - J)) ** 2)[:, None]  # on the Hugoniot
    return {
        "stress": stress, "eps": (sigma_y + 3e5) / H, "sigma_y": sigma_y, "eps_p": rng.uniform(0.1, 1.0, n), "rate": np.full(n, 1e7),
        "T": rng.uniform(350.0, 800.0, n), "J": J, "p": -stress[:, 0], "energy": np.zeros(n), "set_e": np.zeros(n),
    }  # fmt: skip


def points_of(
    a: dict[str, np.ndarray], kept: dict[str, np.ndarray], space: dict[str, Any], on: dict[str, bool], special: bool
) -> Callable[[], float]:
    """A call that applies the law to points in the state `kept`; a receives the new one; seconds per point."""
    plain = constitutive.law_record(material("Ni"), on, rate_filter=1e-9)
    laws, n = constitutive.specialised(plain) if special else plain, len(a["J"])
    one, de, e, work, sums = np.ones(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(2)

    def call() -> float:
        for name, values in kept.items():
            a[name][...] = values
        start = clock()
        space["apply_law"](
            laws, 1e-10, H, one, one, a["stress"], a["eps"], e, de, a["sigma_y"], a["eps_p"], a["rate"], a["T"], a["J"], a["p"],
            a["energy"], a["set_e"], work, sums,
        )  # fmt: skip
        return (clock() - start) / n

    return call


def in_kernels() -> None:
    """Record a row for each effect of the law: ns per element and per point without it, in three ways, all of them in turn."""
    target, cloud, product = block(4.2e-6, 1, plastic=True), points(), compiled({})
    state = {name: getattr(target, name).copy() for name in STATE}
    elements, of_cloud = (
        partial(elements_of, target, state),
        partial(points_of, {name: values.copy() for name, values in cloud.items()}, cloud),
    )
    calls: dict[tuple[str, str], Callable[[], float]] = {}
    compiling: dict[str, float] = {}
    together = {name: value for fields in OF_THE_LAW.values() for name, value in fields.items()}
    for effect, fields in {"none": {}, **OF_THE_LAW, "all six": together}.items():
        cannot, on = compiled(fields), {name: effect not in ("all six", name) for name in OF_THE_LAW}
        compiling[effect] = 0.0
        for what, of in (("element", elements), ("point", of_cloud)):
            mine = {"off": of(product, on, True), "zero": of(product, on, False), "cannot": of(cannot, on, False)}
            start = clock()
            mine["off"]()
            compiling[effect] += clock() - start
            mine["cannot"]()
            calls |= {(effect, f"{what}_{way}_ns"): call for way, call in mine.items()}
    least, order = dict.fromkeys(calls, np.inf), list(calls)
    for _ in range(CALLS):
        shuffle(order)  # what went before has its share in what the caches hold
        for name in order:
            least[name] = min(least[name], calls[name]())
    rows: list[dict[str, Any]] = []
    for effect, seconds in compiling.items():
        row = {column: f"{1e9 * found:.4g}" for (of_effect, column), found in least.items() if of_effect == effect}
        rows.append({"effect": effect, **row, "compile_s": f"{seconds:.2f}"})
        write_table(TABLES / "effects_kernels.csv", rows, "remake: python workflows/effects_costs.py --kernels")
        print(rows[-1], flush=True)


def main() -> None:
    """Measure and record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--rounds", type=int, default=1, help="of the impacts")
    only = parser.add_mutually_exclusive_group()
    only.add_argument("--impacts", action="store_true", help="only the first table")
    only.add_argument("--kernels", action="store_true", help="only the second table")
    a = parser.parse_args()
    if not a.kernels:
        write_table(
            TABLES / "effects_costs.csv", impacts(a.rounds), "remake: python workflows/effects_costs.py --impacts"
        )
    if not a.impacts:
        in_kernels()


if __name__ == "__main__":
    main()
