"""What a step costs, part by part: python workflows/bench.py [--out docs/tables/bench.csv]

Elements elastic and plastic, on one and two threads; scikit-fem's own forms for the same forces; points in plain LAMMPS and with our
law and contact in its step. Each figure is the median of several repeats; machines differ, ratios within a table compare.
"""

import argparse
import csv
import os
import platform
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from coupler.constitutive import law_record
from coupler.coupling import Impact
from coupler.fe import mesh
from coupler.fe.explicit import Target
from coupler.materials import material
from coupler.plan import plan
from coupler.scene import Scene

STEPS, REPEATS = 40, 7


def median_seconds(work: Callable[[], object], repeats: int = REPEATS) -> float:
    """Median wall time of one call, the first (compilation, cold caches) left out."""
    work()
    times = []
    for _ in range(repeats):
        start = time.perf_counter()
        work()
        times.append(time.perf_counter() - start)
    return statistics.median(times)


def block(size: float, threads: int, plastic: bool) -> Target:
    """A cube of SS304 of about 20 000 tetrahedra that twists, slowly or fast."""
    m = mesh.prepare(*mesh.box((1e-4, 1e-4, 1e-4), size))
    target = Target(
        m, law_record(material("SS304"), rate_filter=1e-9), 300.0, fixed=(), sleeping=False, threads=threads
    )
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
        for threads in (1, 2):
            target = block(4.2e-6, threads, plastic)
            dt = 0.3 * target.stable_dt()[0]
            seconds = median_seconds(lambda t=target, d=dt: [step(t, d) for _ in range(STEPS)]) / STEPS
            share = float(np.mean(target.rate > 0)) if plastic else 0.0
            name = f"tet4 {'plastic' if plastic else 'elastic'}, {threads} thread{'s' if threads > 1 else ''}"
            rows.append((name, seconds / len(target.mesh.conn) * 1e6, "us per element and step"))
            if plastic and threads == 1:
                rows.append(("share of elements that flow", share, ""))
    rows.append(("scikit-fem forms for the same forces", forms(block(4.2e-6, 1, False)), "us per element and step"))


def forms(target: Target) -> float:
    """Microseconds per element that scikit-fem takes to assemble the internal forces of a given stress once."""
    from skfem import Basis, ElementTetP1, ElementVector, LinearForm, MeshTet, asm
    from skfem.helpers import ddot, grad

    m = target.mesh
    skm = MeshTet(np.ascontiguousarray(m.points.T), np.ascontiguousarray(m.conn.T.astype(np.int64)), sort_t=False)
    basis = Basis(skm, ElementVector(ElementTetP1()), intorder=1)
    P = np.ones((3, 3, len(m.conn), 1)) * 1e9
    form = LinearForm(lambda v, w: -ddot(w["P"], grad(v)))
    return median_seconds(lambda: asm(form, basis, P=P), 3) / len(m.conn) * 1e6


def points(rows: list[tuple[str, float, str]], count: int) -> None:
    """Microseconds per point and step: plain LAMMPS, with our law, and the share of each part of the coupler in a real impact."""
    from coupler.deposition import build

    scene = Scene.from_text(
        f'[particle]\nmaterial="Ni"\ndiameter="25 um"\nvelocity="500 m/s"\n[substrate]\nmaterial="SS304"\n'
        f'[resolution]\nspacing="{(np.pi / 6 * 25.0**3 / count) ** (1 / 3):.6f} um"\n',
        "bench",
    )
    setting = build(plan(scene))
    impact = Impact(setting.particle, setting.target, setting.surface, setting.contact)
    while impact.time < 15e-9:  # into the impact: points flow, surfaces touch
        impact.advance()
    p, n = setting.particle, setting.particle.n
    spent: dict[str, float] = {"target": 0.0, "contact": 0.0, "surface to points and back": 0.0, "search": 0.0}

    def timed(owner: Any, name: str, part: str) -> None:
        original = getattr(owner, name)

        def wrapper(*args: Any) -> Any:
            start = time.perf_counter()
            value = original(*args)
            spent[part] += time.perf_counter() - start
            return value

        setattr(owner, name, wrapper)

    timed(setting.target, "advance", "target")
    timed(setting.target, "finish", "target")
    timed(setting.contact, "forces", "contact")
    timed(setting.contact, "search", "search")
    timed(setting.surface, "contacts", "surface to points and back")
    timed(setting.surface, "spread", "surface to points and back")
    before, start = p.steps, time.perf_counter()
    while p.steps < before + 200:
        impact.advance()
    whole, steps = time.perf_counter() - start, p.steps - before
    dt = p.dt
    law = median_seconds(lambda: p.run(STEPS, dt * 1e-3, lambda: None)) / STEPS
    p.lmp.command("unfix coupler")
    plain = median_seconds(lambda: p.lmp.command(f"run {STEPS} pre no post no")) / STEPS
    per_point = 1e6 / n
    rows.append(("points", float(n), ""))
    rows.append(("plain LAMMPS, same deck", plain * per_point, "us per point and step"))
    rows.append(("with our law in its step", law * per_point, "us per point and step"))
    for part, seconds in spent.items():
        if part != "target":
            rows.append((part, seconds / steps * per_point, "us per point and step"))
    outside = whole / steps - spent["target"] / steps
    rows.append(("all but the target, in the impact", outside * per_point, "us per point and step"))
    rows.append(("the coupler's share of the SPH step", 1.0 - plain / outside, "of all but the target"))
    rows.append(
        (
            "target, in the impact",
            spent["target"] / steps / len(setting.target.mesh.conn) * 1e6,
            "us per element and step",
        )
    )
    p.close()


def main() -> None:
    """Measure, print, record."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--points", type=int, default=5000)
    parser.add_argument("--out", type=Path, default=Path("docs/tables/bench.csv"))
    a = parser.parse_args()
    rows: list[tuple[str, float, str]] = []
    elements(rows)
    points(rows, a.points)
    for name, value, unit in rows:
        print(f"{name:45s} {value:10.4g} {unit}")
    a.out.parent.mkdir(parents=True, exist_ok=True)
    with a.out.open("w", newline="") as file:
        file.write(
            f"# remake: make bench; {os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}\n"
        )
        csv.writer(file).writerows([("what", "value", "unit"), *((n, f"{v:.4g}", u) for n, v, u in rows)])


if __name__ == "__main__":
    main()
