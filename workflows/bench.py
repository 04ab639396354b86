"""What a step costs, part by part: python workflows/bench.py   # docs/tables/bench.csv

Elements elastic and plastic; scikit-fem's own forms for the same forces; points in plain LAMMPS and with our
law and contact in its step. Elements: the fastest of several repeats; points: medians. Machines differ, ratios within a table compare.
"""

import argparse
import os
import platform
import statistics
import time
from collections.abc import Callable
from typing import Any

import numpy as np
from pages import TABLES, write_table

from coupler.fe import mesh
from coupler.fe.explicit import Target
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_window
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.plan.reading import Scene

STEPS, REPEATS = 40, 7

#: Time that this process has run: other work on the machine does not count.
clock = time.process_time


def fastest(work: Callable[[], object], repeats: int = REPEATS, now: Callable[[], float] = clock) -> float:
    """Seconds of the fastest of several calls, the first (compilation) left out: other work on the machine only ever adds."""
    work()
    times = []
    for _ in range(repeats):
        start = now()
        work()
        times.append(now() - start)
    return min(times)


def block(size: float, plastic: bool) -> Target:
    """A cube of SS304 of about 20 000 tetrahedra that twists, slowly or fast."""
    m = mesh.prepare(*mesh.box((1e-4, 1e-4, 1e-4), size))
    target = Target(m, law_record(material("SS304"), rate_filter=1e-9), 300.0, fixed=(), sleeping=False)
    x = m.points / 1e-4 - 0.5
    speed = 800.0 if plastic else 0.01
    target.v[:] = speed * np.stack([-x[:, 1] * x[:, 2], x[:, 0] * x[:, 2], 0.3 * np.sin(3 * x[:, 0])], axis=1)
    dt = 0.5 * target.stable_dt()[0]
    for _ in range(60 if plastic else 1):
        step(target, dt)
    return target


def step(target: Target, dt: float) -> None:
    """One step without contact."""
    target.advance(dt)
    target.finish()


def elements(rows: list[tuple[str, float, str]]) -> None:
    """Microseconds per element and step."""
    for plastic in (False, True):
        target = block(4.2e-6, plastic)
        dt = 0.3 * target.stable_dt()[0]
        seconds = fastest(lambda t=target, d=dt: [step(t, d) for _ in range(STEPS)], 4 * REPEATS) / STEPS
        name = f"tet4 {'plastic' if plastic else 'elastic'}"
        rows.append((name, seconds / len(target.mesh.conn) * 1e6, "us per element and step"))
        if plastic:
            rows.append(("share of elements that flow", float(np.mean(target.rate > 0)), ""))
    rows.append(("scikit-fem forms for the same forces", forms(block(4.2e-6, False)), "us per element and step"))


def forms(target: Target) -> float:
    """Microseconds per element that scikit-fem takes to assemble the internal forces of a given stress once."""
    from skfem import Basis, ElementTetP1, ElementVector, LinearForm, MeshTet, asm
    from skfem.helpers import ddot, grad

    m = target.mesh
    skm = MeshTet(np.ascontiguousarray(m.points.T), np.ascontiguousarray(m.conn.T.astype(np.int64)), sort_t=False)
    basis = Basis(skm, ElementVector(ElementTetP1()), intorder=1)
    P = np.ones((3, 3, len(m.conn), 1)) * 1e9
    form = LinearForm(lambda v, w: -ddot(w["P"], grad(v)))
    return fastest(lambda: asm(form, basis, P=P), REPEATS) / len(m.conn) * 1e6


def points(rows: list[tuple[str, float, str]], count: int) -> None:
    """Microseconds per point and step of a real impact: LAMMPS, each part of the coupler, and the coupler's share.

    The coupler's share is all that is neither the target nor LAMMPS itself: its commands, without the callback in them.
    Plain LAMMPS, without our callback and law, runs the same deck on an unhurt body in turn with the impact, a stretch of
    each at a time: what slows down one slows down the other.
    """
    from coupler.sph.engine import ENGINES

    scene = Scene.from_text(
        f'[particle]\nmaterial="Ni"\ndiameter="25 um"\nvelocity="500 m/s"\n[substrate]\nmaterial="SS304"\n'
        f'[resolution]\nspacing="{(np.pi / 6 * 25.0**3 / count) ** (1 / 3):.6f} um"\n',
        "bench",
    )
    domains = build_domains(plan(scene))
    p = domains.particle
    impact = Impact(domains)
    plain = ENGINES["machdyn"](p.local.X, p.local.volume_of_point, p.local.law, (0.0, 0.0, -500.0), 300.0)
    plain.v += np.random.default_rng(1).standard_normal(plain.v.shape)  # no arithmetic with zeros
    plain.lmp.command("unfix coupler")
    plain.lmp.command("run 0 post no")
    while impact.time < 15e-9:  # into the impact: points flow, surfaces touch
        advance_window(impact)

    spent = dict.fromkeys(
        ("target", "LAMMPS", "callback", "our law", "contact", "surface to points and back", "search"), 0.0
    )

    def timed(original: Callable[..., Any], part: str) -> Callable[..., Any]:
        def wrapper(*args: Any) -> Any:
            start = clock()
            value = original(*args)
            spent[part] += clock() - start
            return value

        return wrapper

    for owner, name, part in (
        (impact.target, "advance", "target"),
        (impact.target, "finish", "target"),
        (impact.target, "stable_dt", "target"),
        (p.local, "_update_stress", "our law"),
        (p.local.lmp, "command", "LAMMPS"),
        (domains.contact, "forces", "contact"),
        (domains.contact, "search", "search"),
        (domains.surface, "contacts", "surface to points and back"),
        (domains.surface, "spread", "surface to points and back"),
        (domains.surface, "support", "surface to points and back"),
    ):
        setattr(owner, name, timed(getattr(owner, name), part))
    p.local.lmp.set_fix_external_callback("coupler", timed(p.local._callback, "callback"), None)
    plain.lmp.command(f"timestep {p.dt:.17g}")

    def stretch() -> dict[str, float]:
        """Seconds per step of everything, over STEPS steps or a little more."""
        for part in spent:
            spent[part] = 0.0
        before, start = p.steps, clock()
        while p.steps < before + STEPS:
            advance_window(impact)
        whole, steps = clock() - start, p.steps - before
        spent["LAMMPS"] -= spent.pop("callback")
        found = {part: seconds / steps for part, seconds in spent.items()}
        spent["callback"] = 0.0
        start = clock()
        plain.lmp.command(f"run {STEPS} pre no post no")
        return found | {"outside": whole / steps - found["target"], "plain": (clock() - start) / STEPS}

    stretch()
    found = [stretch() for _ in range(2 * REPEATS)]

    def median(value: Callable[[dict[str, float]], float]) -> float:
        return statistics.median(value(one) for one in found)

    point, per_point = "us per point and step", 1e6 / p.n
    rows.append(("points", float(p.n), ""))
    rows.append(("plain LAMMPS, same deck", median(lambda f: f["plain"]) * per_point, point))
    rows.append(("LAMMPS itself, in the impact", median(lambda f: f["LAMMPS"]) * per_point, point))
    for part in ("our law", "contact", "surface to points and back", "search"):
        rows.append((part, median(lambda f, part=part: f[part]) * per_point, point))  # type: ignore[misc]
    rows.append(("all but the target, in the impact", median(lambda f: f["outside"]) * per_point, point))
    share = median(lambda f: 1.0 - f["LAMMPS"] / f["outside"])
    rows.append(("the coupler's share of the SPH step", share, "of all but the target"))
    elements = len(impact.target.mesh.conn)
    rows.append(("target, in the impact", median(lambda f: f["target"]) / elements * 1e6, "us per element and step"))
    p.local.close()
    plain.close()


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=5000)
    a = parser.parse_args()
    rows: list[tuple[str, float, str]] = []
    elements(rows)
    points(rows, a.points)
    for name, value, unit in rows:
        print(f"{name:45s} {value:10.4g} {unit}")
    machine = f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}"
    table = [{"part": name, "value": f"{value:.4g}", "unit": unit} for name, value, unit in rows]
    write_table(TABLES / "bench.csv", table, f"remake: make bench; {machine}")


if __name__ == "__main__":
    main()
