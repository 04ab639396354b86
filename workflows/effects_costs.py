"""What effects cost, on and off: python workflows/effects_costs.py [--kernels | --impacts]

docs/tables/effects_costs.csv: processor time of a step with everything on, and what leaving out an effect saves of it. The
impacts go on in turn, ten steps of each at a time, so that what slows down one slows down the others; of each ten steps the least of
several rounds counts.

docs/tables/effects_kernels.csv: the kernels that evaluate the law, on elements and points that all flow: with an effect on; with it
off in the law's record, as `effects` has it; and compiled from the same source with its numbers written in, so that it cannot be on.
"""

import argparse
import csv
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from bench import block
from effects_study import COSTS, CROSSINGS, KERNELS, SCENES, least_of

from coupler import constitutive
from coupler.coupling import CHUNK
from coupler.effects import NAMES
from coupler.fe import kernels
from coupler.fe.explicit import LINEAR_VISCOSITY, QUADRATIC_VISCOSITY
from coupler.materials import material
from coupler.sph import law as points_law

SCENE = "Ni on steel, 500 m/s"
OF_THE_LAW = {
    "thermal_softening": {"softening": 0.0},
    "rate_hardening": {"C": 0.0},
    "plastic_heating": {"taylor_quinney": 0.0},
    "temperature_dependent_cp": {"cp_slope": 0.0},
    "mie_gruneisen": {"s": 0.0, "Gamma0": 0.0},
    "thermal_expansion": {"expansion": 0.0},
}  # effect -> fields of the law's record, as they are without it
POINTS, CALLS, H = 5000, 30, 1e9

clock = time.process_time


def impacts(rounds: int) -> list[dict[str, Any]]:
    """A row for each choice of effects: ms per step, and the share of it that everything on would save."""
    asked: dict[str, Any] = {"everything on": "all", "auto": "auto", "none": "none"}
    asked |= {f"without {name}": ["all", f"-{name}"] for name in NAMES if name not in ("adhesion", "cooling")}
    least = least_of(rounds, SCENES[SCENE], asked, CROSSINGS)
    step = {name: sum(costs) / (CHUNK * len(costs)) for name, costs in least.items()}
    whole = step["everything on"]
    return [
        {"effects": name, "ms_per_step": f"{1e3 * seconds:.4g}", "saves": f"{1.0 - seconds / whole:.4f}"}
        for name, seconds in step.items()
    ]


def compiled(fields: dict[str, float]) -> dict[str, Any]:
    """The law and the kernels that call it, compiled with these fields of the law's record as numbers in their source."""
    space: dict[str, Any] = {}
    for module in (constitutive, kernels, points_law):
        text = Path(str(module.__file__)).read_text(encoding="utf-8")
        text = re.sub(r"^from \.\.constitutive import .*\n", "", text, flags=re.MULTILINE).replace("cache=True, ", "")
        for name, value in fields.items():
            text = re.sub(rf"\blaw\.{name}\b", repr(value), text)
        exec(compile(text, str(module.__file__), "exec"), space)
    return space


def elements_of(space: dict[str, Any], on: dict[str, bool]) -> Callable[[], float]:
    """A call that updates stresses, pressures and forces of 20 000 tetrahedra that flow; seconds per element."""
    t = block(4.2e-6, 1, plastic=True)
    laws = constitutive.law_record(material("SS304"), on, rate_filter=1e-9)
    dt, n, m, mesh, sums = 0.3 * t.stable_dt()[0], len(t.x), len(t.mesh.conn), t.mesh, np.zeros(3)
    kept = {
        name: getattr(t, name).copy() for name in ("J", "p", "energy", "s", "sigma_y", "eps_p", "rate", "T", "heat")
    }

    def work() -> float:
        for name, values in kept.items():
            getattr(t, name)[...] = values
        start = clock()
        space["nodal_pressure"](
            0, n, t.start, t.table, t.volume, t.heat, mesh.node_volume, laws, t.law_of_node, t.J, t.p, t.energy
        )
        space["element_forces"](
            0, m, dt, LINEAR_VISCOSITY, QUADRATIC_VISCOSITY, t.x, t.v, mesh.conn, mesh.B, mesh.V0, t.volume, t.p, t.J,
            laws, t.law_of, t.s, t.sigma_y, t.eps_p, t.rate, t.T, t.heat, t.fe, sums,
        )  # fmt: skip
        return (clock() - start) / m

    return work


def points_of(space: dict[str, Any], on: dict[str, bool]) -> Callable[[], float]:
    """A call that applies the law to points that flow, some compressed and some warm; seconds per point."""
    laws = constitutive.law_record(material("Ni"), on, rate_filter=1e-9)
    law, rng, n = laws[0], np.random.default_rng(1), POINTS
    J, sigma_y = rng.uniform(0.96, 1.0, n), rng.uniform(2e8, 4e8, n)
    stress = np.zeros((n, 6))
    stress[:, [0, 3, 5]] = -(law["K"] * (1.0 - J) / (1.0 - law["s"] * (1.0 - J)) ** 2)[:, None]  # on the Hugoniot
    kept = {
        "eps": (sigma_y + 3e5) / H, "sigma_y": sigma_y, "eps_p": rng.uniform(0.1, 1.0, n), "rate": np.full(n, 1e7),
        "T": rng.uniform(350.0, 800.0, n), "J": J, "p": -stress[:, 0], "energy": np.zeros(n), "set_e": np.zeros(n),
    }  # fmt: skip
    a = {name: values.copy() for name, values in kept.items()}
    one, de, e, work, sums = np.ones(n), np.zeros(n), np.zeros(n), np.zeros(n), np.zeros(2)

    def call() -> float:
        for name, values in kept.items():
            a[name][...] = values
        start = clock()
        space["apply_law"](
            laws, 1e-10, H, one, one, stress, a["eps"], e, de, a["sigma_y"], a["eps_p"], a["rate"], a["T"], a["J"], a["p"],
            a["energy"], a["set_e"], work, sums,
        )  # fmt: skip
        return (clock() - start) / n

    return call


def in_kernels() -> None:
    """Record a row for each effect of the law: ns per element and per point, on, off, and where it cannot be on."""
    rows: list[dict[str, Any]] = []
    general = compiled({})
    together = {name: value for fields in OF_THE_LAW.values() for name, value in fields.items()}
    for effect, fields in {"all six": together, **OF_THE_LAW}.items():
        special, off = compiled(fields), {name: effect not in ("all six", name) for name in OF_THE_LAW}
        row: dict[str, Any] = {"effect": effect}
        for what, of in (("element", elements_of), ("point", points_of)):
            calls = {"on": of(general, {}), "off": of(general, off), "cannot": of(special, off)}
            for call in calls.values():
                call()
            found: dict[str, list[float]] = {name: [] for name in calls}
            for _ in range(CALLS):
                for name, call in calls.items():
                    found[name].append(call())
            row |= {f"{what}_{name}_ns": f"{1e9 * min(seconds):.4g}" for name, seconds in found.items()}
        rows.append(row)
        record(KERNELS, rows, "python workflows/effects_costs.py --kernels")


def record(path: Path, rows: list[dict[str, Any]], remake: str) -> None:
    """Write a table and print its last row."""
    path.parent.mkdir(parents=True, exist_ok=True)
    with path.open("w", newline="") as file:
        file.write(f"# remake: {remake}\n")
        writer = csv.DictWriter(file, list(rows[0]))
        writer.writeheader()
        writer.writerows(rows)
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
        record(COSTS, impacts(a.rounds), "python workflows/effects_costs.py --impacts")
    if not a.impacts:
        in_kernels()


if __name__ == "__main__":
    main()
