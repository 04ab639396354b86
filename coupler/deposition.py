"""From a scene to a result: builds the domains a plan calls for, runs the impact, writes what comes out."""

import os
import time as clock
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from .errors import SolverError
from .plan import Plan, plan
from .result import Result
from .scene import Scene

SURFACE_EDGE = 0.8  # edges of the particle's contact surface over the spacing of its points
DRIFT_BOUND = 0.02  # of the initial kinetic energy: beyond it a run is not called finished
MOMENTUM_BOUND = 1e-6
DISSIPATION_BOUND = -0.01  # a scheme that gives energy away is unstable
# fields written without a change of name, and how they read in ParaView's order of tensors, xx yy zz xy yz xz
_VTK_ORDER = [0, 1, 2, 5, 3, 4]


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Any = None,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
) -> Result:
    """Compute a scene (a Scene or the path of one) and return its Result.

    out: folder for the files, runs/<scene name> by default. force: replace a finished run there. progress: told how
    far it is; see `coupler.progress`. threads: 2 computes the target beside the particle on a second core, 1 in
    turn with it (default: 2 where there are two cores); the numbers are the same. numerics: for studies of the
    scheme, values in place of the defaults of `coupler.sph.machdyn.Numerics`. Raises SceneError, StoreError or
    SolverError; whatever was written before an error or an interrupt stays readable.
    """
    from .store import Store

    scene = scene if isinstance(scene, Scene) else Scene.load(scene)
    what = plan(scene)
    folder = Path(out) if out is not None else Path("runs") / scene.name
    with Store.create(folder, scene.to_toml(), force) as store:
        started = clock.perf_counter()
        setting = build(what, log=folder / "log.lammps", numerics=numerics)
        try:
            _Run(what, setting, store, progress, started, threads or cores()).go()
        finally:
            setting.particle.close()
            if progress is not None:
                progress.stop()
    result = Result(folder)
    from .report import section_picture

    section_picture(result)
    return result


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class Setting:
    """The domains of one impact, ready to run."""

    particle: Any
    target: Any
    contact: Any
    surface: Any


def build(what: Plan, log: Path | None = None, numerics: Mapping[str, float] | None = None) -> Setting:
    """Mesh the target, pack the particle, and put contact between them. Starts LAMMPS and gmsh."""
    from .constitutive import law_record
    from .contact.penalty import STIFFNESS, PointContact
    from .fe import mesh as meshes
    from .fe.explicit import Target
    from .sph import shapes
    from .sph.machdyn import Numerics, Particle
    from .splat.carry import CarriedSurface

    knobs = dict(numerics or {})
    stiffness = knobs.pop("contact_stiffness", STIFFNESS)
    i, t = what.impact, what.target
    on = {row.name: row.on for row in what.effects.rows}
    centre = (i.offset[0], i.offset[1])
    points, tets = meshes.cylinder(t.diameter, t.height, t.element_size, t.refined_radius, t.growth, centre)
    mesh = meshes.prepare(points, tets, (*centre, 0.0))
    sides = {"sides": t.sides, "bottom": t.bottom}
    absorbing = tuple(name for name, kind in sides.items() if kind == "absorbing" and on["absorbing_boundaries"])
    target = Target(
        mesh,
        law_record(t.material, on, what.rate_filter),
        t.temperature,
        fixed=tuple(name for name, kind in sides.items() if kind == "fixed"),
        absorbing=absorbing,
        conduction=on["conduction"],
    )

    body = shapes.shape(i.shape, i.diameter, i.points, i.tilt, SURFACE_EDGE)
    place = np.array([*centre, body.half_height + i.gap])
    law = law_record(i.material, on, what.rate_filter)
    particle = Particle(body.points + place, body.volume, law, i.velocity, i.temperature, Numerics(**knobs), log=log)
    surface = CarriedSurface(body.points + place, body.vertices + place, body.triangles, body.spacing)

    top = mesh.sets["top"]
    contact = PointContact(
        surface.touching.shape[0],
        mesh.facets[top],
        body.spacing,
        body.area / len(body.vertices),
        min(i.material.K, t.material.K),
        what.friction if on["friction"] else 0.0,
        share=_heat_share(i.material, i.temperature, t.material, t.temperature),
        factor=stiffness,
        facet_ids=top,
    )
    return Setting(particle, target, contact, surface)


def _heat_share(a: Any, Ta: float, b: Any, Tb: float) -> float:
    """Share of friction heat that goes to body a: by effusivity sqrt(k rho cp), as for two half-spaces in contact."""
    ea = float(np.sqrt(a.k_at(Ta) * a.rho * a.cp_at(Ta)))
    eb = float(np.sqrt(b.k_at(Tb) * b.rho * b.cp_at(Tb)))
    return ea / (ea + eb)


class _Run:
    """One impact while it runs: the loop that a reader can follow, and its books."""

    def __init__(self, what: Plan, setting: Setting, store: Any, progress: Any, started: float, threads: int):
        from .coupling import Impact, Watch

        self.what, self.setting, self.store, self.progress, self.started = what, setting, store, progress, started
        self.impact = Impact(setting.particle, setting.target, setting.surface, setting.contact, threads)
        crossing = what.impact.diameter / float(np.linalg.norm(what.impact.velocity))
        self.watch = Watch(what.end_time, what.end_at_rest, 0.1 * crossing)
        self.expected = min(what.end_time, 1.1 * crossing) if what.end_at_rest else what.end_time
        self.greatest: dict[str, float] | None = None
        self.next_output = 0.0
        self.row_every = crossing / 400.0
        self.next_row = 0.0

    def go(self) -> None:
        from .coupling import check_books

        if self.progress is not None:
            self.progress.start(self.expected)
        impact, particle = self.impact, self.setting.particle
        self._write()
        until = None if self.what.end_at_rest else self.what.end_time
        looping = clock.perf_counter()
        while True:
            dt = impact.advance(until)
            sinking = -float(particle.momentum()[2] / particle.mass.sum())
            over = self.watch.look(impact.time, sinking, float(impact.force[2]))
            if self.watch.turned is not None and self.greatest is None:
                self.greatest = self._measure()
                self._write()
            if over or impact.time >= self.next_row:
                self._row(dt)
            if over or impact.time >= self.next_output:
                self._write()
            if over:
                break
        loop = clock.perf_counter() - looping
        check_books(impact.ledger, DRIFT_BOUND, MOMENTUM_BOUND)
        dissipated = impact.ledger.rows["numerical_particle"] / impact.ledger.kinetic_0
        if dissipated < DISSIPATION_BOUND:
            raise SolverError(
                f"the SPH scheme gave away {-dissipated:.2%} of the initial kinetic energy: it is unstable"
            )
        self.store.finish(self._summary(loop))

    def _row(self, dt: float) -> None:
        from .measures import crater_depth

        impact, particle, target = self.impact, self.setting.particle, self.setting.target
        books = impact.ledger.close(particle, target, self.setting.contact)
        skin = self.setting.surface.positions(particle.x)
        row = {"time": impact.time, "dt": dt, "step": float(particle.steps), **books}
        row["height"] = float(skin[:, 2].max())
        row["thickness"] = float(np.ptp(skin[:, 2]))
        row["crater_depth"] = crater_depth(target.x[impact.surface_nodes])
        row["velocity_z"] = float(particle.momentum()[2] / particle.mass.sum())
        row["contact_force"] = float(impact.force[2])
        row["T_max"] = float(particle.T.max())
        row["eps_p_mean"] = float(particle.eps_p.mean())
        row["stretch_min"] = particle.stretch_min
        self.store.record(row)
        self.next_row = impact.time + self.row_every
        if not np.isfinite(books["drift"]):
            raise SolverError(f"the energy is no longer a number at t = {impact.time * 1e9:.3f} ns: try a finer preset")
        if self.progress is not None:
            self.progress.update(impact.time, books["kinetic"] / impact.ledger.kinetic_0, dt, particle.steps)

    def _write(self) -> None:
        from .measures import von_mises_of

        t, p, s = self.impact.time, self.setting.particle, self.setting.surface
        stress = p.stress()
        fields = {
            "velocity": p.v, "stress": stress[:, _VTK_ORDER], "von_mises": von_mises_of(stress), "eps_p": p.eps_p,
            "eps_p_rate": p.rate, "T": p.T,
        }  # fmt: skip
        self.store.write("particle", t, p.x, np.arange(p.n)[:, None], fields)
        skin = {name: s.values(field) for name, field in fields.items()}
        self.store.write("surface", t, s.positions(p.x), s.triangles, skin)
        e = self.setting.target
        stress = e.stress()
        cells = {"stress": stress[:, _VTK_ORDER], "von_mises": von_mises_of(stress), "eps_p": e.eps_p, "T": e.T}
        self.store.write("target", t, e.x, e.mesh.conn, {"velocity": e.velocity()}, cells)
        self.next_output = t + self.what.output_every

    def _measure(self) -> dict[str, float]:
        from .measures import measure

        setting = self.setting
        m = measure(
            setting.particle, setting.target, setting.surface, self.impact.surface_nodes, self.what.impact.diameter
        )
        return {"time_s": self.impact.time, **m}

    def _summary(self, loop: float) -> dict[str, Any]:
        from . import __version__

        impact, particle, target = self.impact, self.setting.particle, self.setting.target
        books, kinetic_0 = impact.ledger.rows, impact.ledger.kinetic_0
        end = self._measure()
        energies = {name: value / kinetic_0 for name, value in books.items() if name not in ("drift", "momentum_error")}
        return {
            **{name: value for name, value in end.items() if name != "time_s"},
            "rebound_velocity_m_s": max(end["velocity_z_m_s"], 0.0),
            "energy_drift": books["drift"],
            "momentum_error": books["momentum_error"],
            "numerical_dissipation": (books["numerical_particle"] + books["numerical_target"]) / kinetic_0,
            "penetration_max_m": impact.deepest,
            "points": particle.n,
            "elements": len(target.mesh.conn),
            "nodes": len(target.x),
            "spacing_m": particle.spacing,
            "element_size_m": self.what.target.element_size,
            "steps": particle.steps,
            "dt_mean_s": impact.time / particle.steps,
            "dt_limited_by": impact.limits,
            "numerics": asdict(particle.numerics),
            "sim_time_s": impact.time,
            "wall_s": clock.perf_counter() - self.started,
            "wall_loop_s": loop,
            "kinetic_energy_0_J": kinetic_0,
            "energies": energies,
            "greatest_deformation": self.greatest,
            "end": end,
            "effects": self.what.effects.active,
            "warnings": list(self.what.warnings),
            "version": __version__,
        }
