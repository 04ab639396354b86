"""From a scene to a result: who runs where, the domains a plan calls for, the impacts one after another."""

import hashlib
import os
import sys
import time as clock
import traceback
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from ..errors import ColdsprayError
from ..files.result import Result
from ..plan.planning import Plan, plan
from ..ranks import ranks as parallel
from ..scene.model import Scene

SURFACE_EDGE = 0.8  # edges of the particle's contact surface over the spacing of its points
CHECKPOINT_EVERY = 60.0  # s of wall time

Probe = Callable[[Any], None]


def run(
    scene: Scene | str | Path,
    out: str | Path | None = None,
    *,
    force: bool = False,
    progress: Any = None,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    placement: str | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
) -> Result:
    """Compute a scene (a Scene or the path of one) and return its Result.

    out: folder for the files, runs/<scene name> by default. force: replace a finished run there. progress: told how
    far it is; see `coupler.progress`. threads: 2 computes the target beside the particle on a second core, 1 in
    turn with it (default: 2 where there are two cores); the numbers are the same. numerics: for studies of the
    scheme, values in place of the defaults of `coupler.sph.particle.Numerics`. probe(impact): called after every few steps
    with the `coupling.Impact`, on the rank that has the target. checkpoint_every: s of wall time.

    Started by mpiexec, all ranks call it; placement: "split" (the default: the particle on all ranks but the last, the target
    there) or "spread" (the particle on all). Raises SceneError, StoreError, PlacementError or SolverError, on all ranks;
    whatever was written before an error or an interrupt stays readable.
    """
    scene = scene if isinstance(scene, Scene) else Scene.load(scene)
    folder = Path(out) if out is not None else Path("runs") / scene.name
    how = _How(progress, threads, dict(numerics or {}), placement, probe, checkpoint_every)
    return _compute(scene, folder, how, anew=True, force=force)


def resume(
    out: str | Path,
    *,
    progress: Any = None,
    threads: int | None = None,
    numerics: Mapping[str, float] | None = None,
    placement: str | None = None,
    probe: Probe | None = None,
    checkpoint_every: float = CHECKPOINT_EVERY,
) -> Result:
    """Go on with the unfinished run in a folder from its last whole checkpoint, or from its start if there is none.

    The number of ranks and their placement may differ from before. A finished run is returned as it is. Arguments and errors
    as for `run`; raises CheckpointError for a checkpoint of another version or another scene.
    """
    folder = Path(out)
    result = Result(folder)
    if result.finished:
        return result
    scene = Scene.from_text(result.scene_text, str(folder / "scene.toml"))
    how = _How(progress, threads, dict(numerics or {}), placement, probe, checkpoint_every)
    return _compute(scene, folder, how, anew=False, force=False)


@dataclass(frozen=True)
class _How:
    """How to run: nothing of it changes the numbers but `numerics`."""

    progress: Any
    threads: int | None
    numerics: dict[str, float]
    placement: str | None
    probe: Probe | None
    checkpoint_every: float


def _compute(scene: Scene, folder: Path, how: _How, anew: bool, force: bool) -> Result:
    what = plan(scene)
    ranks = parallel.arrange(parallel.world(), how.placement)
    log = folder / "log.lammps"
    if not ranks.at_home:
        parallel.follow(ranks, lambda i, place: build_particle(what, i, place, ranks, how.numerics, log))
        return Result(folder)
    try:
        _Lead(what, folder, how, ranks).go(anew, force)
        result = Result(folder)
        from ..report import section_picture

        section_picture(result)
    except (ColdsprayError, KeyboardInterrupt) as error:
        parallel.dismiss(ranks, error)
        raise
    except BaseException:
        if ranks.size > 1:
            traceback.print_exc()
            parallel.abort(ranks.comm, "coldspray: the rank with the target failed; all ranks are stopped", 1)
        raise
    parallel.dismiss(ranks)
    return result


class _Lead:
    """The rank that has the target: impacts one after another, each a function from target to target with one splat more."""

    def __init__(self, what: Plan, folder: Path, how: _How, ranks: parallel.Ranks):
        from .. import __version__

        self.what, self.folder, self.how, self.ranks = what, folder, how, ranks
        self.text = what.scene.to_toml()
        self.about = {"version": __version__, "scene": hashlib.sha256(self.text.encode()).hexdigest()}
        self.about["numerics"] = repr(sorted(how.numerics.items()))
        self.log = how.progress.log if how.progress is not None else _to_stderr
        self.started, self.before = clock.perf_counter(), 0.0
        self.threads = (how.threads or cores()) if ranks.size == 1 else 1
        self.records: list[dict[str, Any]] = []  # summaries of the finished impacts
        self.joins: list[dict[str, Any]] = []  # what it took to make bodies of their splats
        self.skin = np.zeros((0, 3))  # surface of the last splat, m

    @property
    def wall(self) -> float:
        """Wall time so far, s, that before a resumption included."""
        return self.before + clock.perf_counter() - self.started

    def go(self, anew: bool, force: bool) -> None:
        from ..files import checkpoint
        from ..files.store import Store

        with Store.create(self.folder, self.text, force) if anew else Store.reopen(self.folder) as store:
            state = None if anew else self._found(store)
            if state is not None:
                bodies = bodies_from(self.what, state["bodies"])
                self.records, self.joins, self.before = state["records"], state["joins"], state["wall"]
            else:
                bodies = build_bodies(self.what)
            first = len(self.records)
            for i in range(first, len(self.what.impacts)):
                inside = state["running"] if state is not None and i == first else None
                bodies = self._impact(i, bodies, store, inside)
            store.finish(self._summary(bodies))
            checkpoint.clear(self.folder)

    def _found(self, store: Any) -> dict[str, Any] | None:
        """State of the last whole checkpoint, the files brought to its moment; None if there is none."""
        from ..files import checkpoint

        kept = checkpoint.latest(self.folder, self.about, self.log)
        if kept is None:
            self.log(f"{self.folder} has no checkpoint: the run starts from its beginning")
        store.go_on(kept[0]["store"] if kept else None, self.log)
        return kept[0] if kept else None

    def _save(self, bodies: Any, store: Any, running: dict[str, Any] | None) -> None:
        from ..files import checkpoint

        whole = {
            "running": running, "bodies": bodies.whole(), "store": store.state(), "records": self.records,
            "joins": self.joins, "wall": self.wall,
        }  # fmt: skip
        checkpoint.write(self.folder, whole, self.about)

    def _impact(self, i: int, bodies: Any, store: Any, inside: dict[str, Any] | None) -> Any:
        """Impact i on the bodies; the bodies that the next one meets."""
        from ..impact.rebound import outcome
        from ..impact.retry import numerics_of
        from ..impact.running import Running
        from .joining import join

        how, before = self.how, sum(record["sim_time_s"] for record in self.records)
        level = None if inside is None else inside["level"]
        numerics = numerics_of(None if inside is None else inside["impact"], how.numerics)
        setting = build(self.what, i, bodies, self.folder / "log.lammps", numerics, self.ranks, level)
        started = self.wall if inside is None else inside["started"]

        def rebuild(failed: Setting, state: dict[str, Any], numerics: dict[str, float]) -> Setting:
            nonlocal setting
            failed.particle.close()
            again = bodies_from(self.what, failed.bodies.whole_with(state))
            setting = build(self.what, i, again, self.folder / "log.lammps", numerics, self.ranks, failed.level)
            return setting

        try:
            running = Running(
                self.what, i, setting, store, how.progress, self.threads, rebuild, self.log, before, how.numerics
            )
            if inside is not None:
                running.restore(inside["impact"])
                self.log(f"going on from {(before + running.impact.time) * 1e9:.1f} ns")
            known = {"started": started, "level": setting.level}
            running.go(
                lambda now: self._save(setting.bodies, store, {"impact": now, **known}), how.checkpoint_every, how.probe
            )
            bodies, hold = setting.bodies, running.impact.hold
            self.records.append(running.summary(self.wall - started) | outcome(self.what, i, setting.particle, hold))
            self.skin = setting.surface.positions(setting.particle.x)
            if i + 1 == len(self.what.impacts):
                return bodies
            bodies, report = join(self.what, i, setting, bodies, self.log, hold)
            self.joins.append(report)
        finally:
            setting.particle.close()
            if how.progress is not None:
                how.progress.stop()
        self._save(bodies, store, None)
        return bodies

    def _summary(self, bodies: Any) -> dict[str, Any]:
        """The last impact's measures, what all of them took, and each of them in the list `impacts`."""
        from ..impact.rebound import deposition_efficiency
        from ..impact.validity import merged
        from .joining import splats_at_end

        splats_at_end(self.what, self.records, self.joins, bodies, self.skin)
        last = self.records[-1]
        whole = {
            "wall_s": self.wall,
            "wall_loop_s": sum(record["wall_loop_s"] for record in self.records),
            "sim_time_s": sum(record["sim_time_s"] for record in self.records),
            "steps": sum(record["steps"] for record in self.records),
            "rescues": [rescue for record in self.records for rescue in record["rescues"]],
            "warnings": merged([text for record in self.records for text in record["warnings"]]),
            "deposition_efficiency": deposition_efficiency(self.records),
        }
        return {**last, **whole, "impacts": self.records, "joins": self.joins}


def _to_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class Setting:
    """The domains of one impact, ready to run. particle: a `team.Team`; bodies: `bodies.Bodies`; level: height (m) of the
    surface where the particle first touches it; paths: where heat goes between chunks of steps (`heat_paths.HeatPaths`)."""

    particle: Any
    bodies: Any
    contact: Any
    surface: Any
    body: Any
    place: np.ndarray
    level: float
    paths: Any = None

    @property
    def target(self) -> Any:
        return self.bodies.target


def build_bodies(what: Plan) -> Any:
    """Mesh the substrate: the bodies that the first impact meets. Starts gmsh."""
    from ..fe import mesh as meshes
    from ..fe.explicit import Target
    from ..impact.bodies import Bodies
    from ..physics.constitutive import law_record
    from .mass_scaling import prepare

    t, on = what.target, {row.name: row.on for row in what.effects.rows}
    points, tets = meshes.cylinder(t.diameter, t.height, t.element_size, t.refined_radius, t.growth, t.centre)
    law = law_record(t.material, on, what.impacts[0].rate_filter)
    fixed, absorbing = held_faces(what)
    mesh = meshes.prepare(points, tets, (*what.impacts[0].offset, 0.0))
    target = Target(
        mesh, law, t.temperature, fixed=fixed, absorbing=absorbing, conduction=on["conduction"],
        sleeping=not on["ahead_of_waves"],
    )  # fmt: skip
    bodies = Bodies(target, np.zeros(len(mesh.conn), np.int32), fixed, absorbing, friction_of(what))
    prepare(what, 0, bodies)
    return bodies


def bodies_from(what: Plan, state: Mapping[str, Any]) -> Any:
    """The bodies of a checkpoint (`Bodies.whole`)."""
    from ..impact.bodies import Bodies

    on = {row.name: row.on for row in what.effects.rows}
    return Bodies.from_whole(state, *held_faces(what), friction_of(what), on["conduction"])


def friction_of(what: Plan) -> float:
    """Coulomb's coefficient, 0 where the effect is off."""
    return what.friction if what.effects.on("friction") else 0.0


def held_faces(what: Plan) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """Names of the substrate's faces that are fixed, and of those that absorb."""
    kinds = {"sides": what.target.sides, "bottom": what.target.bottom}
    fixed = tuple(name for name, kind in kinds.items() if kind == "fixed")
    absorbs = what.effects.on("absorbing_boundaries")
    return fixed, tuple(name for name, kind in kinds.items() if kind == "absorbing" and absorbs)


def build(
    what: Plan,
    i: int = 0,
    bodies: Any = None,
    log: Path | None = None,
    numerics: Mapping[str, float] | None = None,
    ranks: parallel.Ranks | None = None,
    level: float | None = None,
) -> Setting:
    """Pack the particle of impact i above the bodies (default: the bare substrate), with contact between. Starts LAMMPS.

    ranks: who runs where (default: this process alone). level: height (m) of the surface where the particle first touches it;
    None: as the bodies lie now.
    """
    from ..contact.penalty import JUMP, STIFFNESS, PointContact
    from ..impact.bodies import level_under
    from ..ranks.distributed import Team
    from ..sph.carried_surface import CarriedSurface

    ranks, bodies = ranks or parallel.Ranks(), bodies if bodies is not None else build_bodies(what)
    p, t = what.impacts[i], what.target
    body = body_of(what, i)
    mesh, x = bodies.target.mesh, bodies.target.x
    facets = bodies.reachable()
    offset = np.array([*p.offset, 0.0])
    if level is None:
        level = (
            level_under(body.vertices + offset, x, mesh.facets[facets], 0.0) - body.half_height
            if bodies.count > 1
            else 0.0
        )
    place = offset + np.array([0.0, 0.0, body.half_height + level + p.gap])
    parallel.begin_impact(ranks, i, place)
    piece = build_particle(what, i, place, ranks, numerics, log) if ranks.has_points else None
    particle = Team(ranks, piece, len(body.points), body.spacing)
    surface = CarriedSurface(body.points + place, body.vertices + place, body.triangles, body.spacing)
    contact = PointContact(
        surface.touching.shape[0],
        mesh.facets[facets],
        body.spacing,
        body.area / len(body.vertices),
        min(p.material.K, float(bodies.target.laws["K"].min())),
        friction_of(what),
        share=_heat_share(p.material, p.temperature, t.material, t.temperature),
        factor=dict(numerics or {}).get("contact_stiffness", STIFFNESS),
        facet_ids=facets,
        jump=JUMP,
    )
    return Setting(particle, bodies, contact, surface, body, place, level, _paths(what, particle, body))


def _paths(what: Plan, particle: Any, body: Any) -> Any:
    """The ways that the plan's effects leave open for heat."""
    from ..impact.heat import HeatPaths
    from ..sph.heat import PointConduction

    on, points = what.effects.on, None
    if on("particle_conduction"):
        points = PointConduction(body.points, body.spacing, np.full(len(body.points), body.volume), particle.law)
    return HeatPaths(on("friction_heat"), points, np.inf if on("interface_conduction") else 0.0)


def body_of(what: Plan, i: int) -> Any:
    """Points and surface of the particle of impact i, about its centre (`sph.shapes.Body`)."""
    from ..sph import shapes

    p = what.impacts[i]
    return shapes.shape(p.shape, p.diameter, p.points, p.tilt, SURFACE_EDGE)


def build_particle(
    what: Plan, i: int, place: np.ndarray, ranks: parallel.Ranks, numerics: Mapping[str, float] | None, log: Path | None
) -> Any:
    """This rank's part of the particle of impact i, its centre at place (3,) m. Starts LAMMPS, on all ranks that share it."""
    from ..physics.constitutive import law_record
    from ..sph.engine import ENGINES
    from ..sph.particle import Numerics

    p, body = what.impacts[i], body_of(what, i)
    law = law_record(p.material, {row.name: row.on for row in what.effects.rows}, p.rate_filter)
    knobs = {name: value for name, value in dict(numerics or {}).items() if name != "contact_stiffness"}
    return ENGINES["machdyn"](
        body.points + place, body.volume, law, p.velocity, p.temperature, Numerics(**knobs),
        comm=ranks.sph_comm, log=log, shares=ranks.shares,
    )  # fmt: skip


def _heat_share(a: Any, Ta: float, b: Any, Tb: float) -> float:
    """Share of friction heat that goes to body a: by effusivity sqrt(k rho cp), as for two half-spaces in contact."""
    ea = float(np.sqrt(a.k_at(Ta) * a.rho * a.cp_at(Ta)))
    eb = float(np.sqrt(b.k_at(Tb) * b.rho * b.cp_at(Tb)))
    return ea / (ea + eb)
