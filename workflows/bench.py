"""Time of a step: python workflows/bench.py   # docs/tables/bench.csv

Elastic and plastic elements; the same forces with forms of scikit-fem; points with all engines; an impact (medians; all other times:
the fastest of several repeats). The column over_loop is the time over that of a reference loop in the same run, to compare machines.
Rows of other versions stay in the table.
"""

import time
import timeit
from collections.abc import Callable, Iterator

import numpy as np
from pages import impact_tables, machine, options, reference, spacing_of
from serial_share import Spent
from study_table import study

from coupler.core.threads import threads_of
from coupler.fe import mesh
from coupler.fe.explicit import Target
from coupler.geometry import mesher
from coupler.impact.domains import build_domains
from coupler.impact.exchange import Impact
from coupler.impact.loop import advance_chunk
from coupler.particle import packing
from coupler.particle.engine import ENGINES
from coupler.physics.constitutive import law_record
from coupler.physics.materials import material
from coupler.plan.planning import plan
from coupler.plan.reading import Scene

STEPS, REPEATS = 40, 7
BEGUN = 15e-9  # s after the first contact
Part = tuple[str, float, str]  # name, value and unit of a row
clock = time.process_time  # other work on the machine does not count


def fastest(work: Callable[[], object], repeats: int = REPEATS, now: Callable[[], float] = clock) -> float:
    """Seconds of the fastest of several calls, without the first one (compilation): other work on the machine only adds time."""
    return min(timeit.repeat(work, number=1, repeat=repeats + 1, timer=now)[1:])


def block(plastic: bool) -> Target:
    """A cube of SS304 of about 20 000 tetrahedra that twists, slowly or fast."""
    m = mesh.prepare(*mesher.box((1e-4, 1e-4, 1e-4), 4.2e-6))
    target = Target(m, law_record(material("SS304"), rate_filter=1e-9), 300.0, fixed=(), track_wave=False)
    x = m.points / 1e-4 - 0.5
    speed = 800.0 if plastic else 0.01
    target.nodes.v[:] = speed * np.stack([-x[:, 1] * x[:, 2], x[:, 0] * x[:, 2], 0.3 * np.sin(3 * x[:, 0])], axis=1)
    dt = 0.5 * target.stable_dt()
    for _ in range(60 if plastic else 1):
        step(target, dt)
    return target


def step(target: Target, dt: float) -> None:
    """One step without contact."""
    target.advance(dt)
    target.finish()


def elements() -> Iterator[Part]:
    """Microseconds per element and step."""
    for name in ("elastic", "plastic"):
        target = block(name == "plastic")

        def steps(target: Target = target, dt: float = 0.3 * target.stable_dt()) -> None:
            for _ in range(STEPS):
                step(target, dt)

        seconds = fastest(steps, 4 * REPEATS) / STEPS
        yield f"tet4 {name}", seconds / len(target.mesh.conn) * 1e6, "us per element and step"
        one = fastest(steps, 2 * REPEATS, time.perf_counter)
        with threads_of(2):
            two = fastest(steps, 2 * REPEATS, time.perf_counter)
        yield f"tet4 {name}, one thread over two", one / two, "of wall time"
    yield "share of elements that flow", float(np.mean(target.elements.rate > 0)), ""
    yield "scikit-fem forms for the same forces", forms(block(False)), "us per element and step"


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


def engines(count: int) -> Iterator[Part]:
    """Microseconds per point and step of a whole LAMMPS step with the law, for a sphere in which all points flow.

    All engines run in turn, so that other work slows down all alike. The passes of the default engine are also timed on two threads.
    """
    cloud, volume = packing.sphere(25e-6, count)
    law = law_record(material("Ni"), rate_filter=5e-10)
    particles = {name: engine(cloud, volume, law, (0.0, 0.0, 0.0), 300.0) for name, engine in ENGINES.items()}
    for p in particles.values():
        p.points.v[:] = p.X * np.array([4e7, 3e7, -7e7])
        p.points.vest[:] = p.points.v
        p.run(80, 1e-11, lambda: None)
    steps = max(STEPS, 40_000 // len(cloud))
    times = {name: np.inf for name in particles}
    for _ in range(REPEATS):
        for name, p in particles.items():
            times[name] = min(times[name], fastest(lambda p=p: p.run(steps, 1e-13, lambda: None), 1))  # type: ignore[misc]
    default = particles["enriched"]
    n, unit = len(cloud), "us per point and step"
    for name, seconds in times.items():
        yield f"whole step, {n} points, {name}", seconds / steps / n * 1e6, unit

    def passes() -> None:
        for _ in range(steps):
            default._update_stress()

    one = fastest(passes, REPEATS, time.perf_counter)
    with threads_of(2):
        two = fastest(passes, REPEATS, time.perf_counter)
    yield f"passes alone, {n} points, one thread", one / steps / n * 1e6, unit
    yield f"one thread over two, {n} points", one / two, "of wall time"
    for p in particles.values():
        p.close()


def begun(points: int, until: float = BEGUN) -> Impact:
    """An impact of about `points` points, `until` s after the first contact: points flow, surfaces touch."""
    scene = Scene.from_dict(impact_tables("Ni", 25.0, 500.0, spacing=spacing_of(points)), "bench")
    impact = Impact(build_domains(plan(scene)))
    while impact.time < until:
        advance_chunk(impact)
    return impact


def per_step(impact: Impact, now: Callable[[], float] = clock) -> float:
    """Seconds per step of an impact, over STEPS steps or a little more."""
    before, start = impact.particle.steps, now()
    while impact.particle.steps < before + STEPS:
        advance_chunk(impact)
    return (now() - start) / (impact.particle.steps - before)


def whole(points: int) -> Iterator[Part]:
    """Microseconds per point and step of a real impact, and per element and step of its target."""
    impact = begun(points)
    p, spent = impact.particle, Spent()
    for name in ("advance", "finish", "stable_dt"):
        setattr(impact.target, name, spent.timed("target", getattr(impact.target, name)))

    def parts() -> tuple[float, float]:
        """Seconds per step of the target and of all else."""
        spent.seconds.clear()
        before = p.steps
        seconds = per_step(impact)
        target = spent.seconds["target"] / (p.steps - before)
        return target, seconds - target

    parts()
    target, others = np.median([parts() for _ in range(2 * REPEATS)], axis=0)
    yield "points of the impact", float(p.n), ""
    yield "all but the target, in the impact", others / p.n * 1e6, "us per point and step"
    yield "target, in the impact", target / len(impact.target.mesh.conn) * 1e6, "us per element and step"
    p.close()


if __name__ == "__main__":
    options(__doc__)
    rows = list(elements())
    for points in (1000, 5000, 16000):
        rows += engines(points)
    rows += whole(5000)
    loop = reference(clock) * 1e6
    table = study("bench", ("part", "version"), remake="make bench")
    for name, value, unit in rows:
        over = f"{value / loop:.4g}" if unit.startswith("us") else ""
        print(f"{name:45s} {value:10.4g} {unit}")
        table.add({"part": name, "value": f"{value:.4g}", "unit": unit, "over_loop": over})
    print(machine())
