"""From a scene to a result: who runs where, the domains a plan calls for, the impacts one after another."""

import hashlib
import os
import sys
import time as clock
import traceback
from collections.abc import Callable, Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Any

import numpy as np

from . import parallel
from .errors import ColdsprayError
from .plan import Plan, plan
from .result import Result
from .scene import Scene

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
    scheme, values in place of the defaults of `coupler.sph.machdyn.Numerics`. probe(impact): called after every few steps
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
    ranks = parallel.arrange(parallel.world(), how.placement, what.home_load)
    if not ranks.at_home:
        parallel.follow(ranks, lambda: build_particle(what, ranks, how.numerics, folder / "log.lammps"))
        return Result(folder)
    try:
        _lead(what, folder, how, ranks, anew, force)
        result = Result(folder)
        from .report import section_picture

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


def _lead(what: Plan, folder: Path, how: _How, ranks: parallel.Ranks, anew: bool, force: bool) -> None:
    """Run the impacts on the rank that has the target."""
    from . import __version__, checkpoint
    from .running import Running
    from .store import Store

    started, before = clock.perf_counter(), 0.0
    text = what.scene.to_toml()
    about = {"version": __version__, "scene": hashlib.sha256(text.encode()).hexdigest()}
    about["numerics"] = repr(sorted(how.numerics.items()))
    log = how.progress.log if how.progress is not None else _to_stderr
    state: dict[str, Any] | None = None
    with Store.create(folder, text, force) if anew else Store.reopen(folder) as store:
        if not anew:
            kept = checkpoint.latest(folder, about, log)
            if kept is None:
                log(f"{folder} has no checkpoint: the run starts from its beginning")
            else:
                state, before = kept[0], kept[0]["wall"]
            store.go_on(state["store"] if state else None, log)
        mesh = state["mesh"] if state else None
        setting = build(what, folder / "log.lammps", how.numerics, ranks, mesh)
        try:
            running = Running(what, setting, store, how.progress, (how.threads or cores()) if ranks.size == 1 else 1)
            if state:
                running.restore(state["running"])
                log(f"going on from {running.impact.time * 1e9:.1f} ns")

            def save(now: dict[str, Any]) -> None:
                wall = before + clock.perf_counter() - started
                whole = {"running": now, "mesh": asdict(setting.target.mesh), "store": store.state(), "wall": wall}
                checkpoint.write(folder, whole, about)

            running.go(save, how.checkpoint_every, how.probe)
            store.finish(running.summary(before + clock.perf_counter() - started))
            checkpoint.clear(folder)
        finally:
            setting.particle.close()
            if how.progress is not None:
                how.progress.stop()


def _to_stderr(text: str) -> None:
    print(text, file=sys.stderr, flush=True)


def cores() -> int:
    """Processors this process may use."""
    return len(os.sched_getaffinity(0))


@dataclass
class Setting:
    """The domains of one impact, ready to run. particle: a `team.Team`."""

    particle: Any
    target: Any
    contact: Any
    surface: Any


def build(
    what: Plan,
    log: Path | None = None,
    numerics: Mapping[str, float] | None = None,
    ranks: parallel.Ranks | None = None,
    mesh: Mapping[str, Any] | None = None,
) -> Setting:
    """Mesh the target, pack the particle, and put contact between them. Starts LAMMPS and gmsh.

    ranks: who runs where (default: this process alone); mesh: fields of the target's `fe.mesh.TetMesh`, where it is known.
    """
    from .constitutive import law_record
    from .contact.penalty import STIFFNESS, PointContact
    from .fe import mesh as meshes
    from .fe.explicit import Target
    from .splat.carry import CarriedSurface
    from .team import Team

    ranks = ranks or parallel.Ranks()
    i, t = what.impact, what.target
    on = {row.name: row.on for row in what.effects.rows}
    if mesh is None:
        centre = (i.offset[0], i.offset[1])
        points, tets = meshes.cylinder(t.diameter, t.height, t.element_size, t.refined_radius, t.growth, centre)
        tetmesh = meshes.prepare(points, tets, (*centre, 0.0))
    else:
        tetmesh = meshes.TetMesh(**mesh)
    sides = {"sides": t.sides, "bottom": t.bottom}
    absorbing = tuple(name for name, kind in sides.items() if kind == "absorbing" and on["absorbing_boundaries"])
    target = Target(
        tetmesh,
        law_record(t.material, on, what.rate_filter),
        t.temperature,
        fixed=tuple(name for name, kind in sides.items() if kind == "fixed"),
        absorbing=absorbing,
        conduction=on["conduction"],
    )

    body, place = place_of(what)
    parallel.begin_impact(ranks)
    piece = build_particle(what, ranks, numerics, log) if ranks.has_points else None
    particle = Team(ranks, piece, len(body.points), body.spacing)
    surface = CarriedSurface(body.points + place, body.vertices + place, body.triangles, body.spacing)

    top = tetmesh.sets["top"]
    contact = PointContact(
        surface.touching.shape[0],
        tetmesh.facets[top],
        body.spacing,
        body.area / len(body.vertices),
        min(i.material.K, t.material.K),
        what.friction if on["friction"] else 0.0,
        share=_heat_share(i.material, i.temperature, t.material, t.temperature),
        factor=dict(numerics or {}).get("contact_stiffness", STIFFNESS),
        facet_ids=top,
    )
    return Setting(particle, target, contact, surface)


def place_of(what: Plan) -> tuple[Any, np.ndarray]:
    """The particle's body, and where its centre is at the start (3,) m."""
    from .sph import shapes

    i = what.impact
    body = shapes.shape(i.shape, i.diameter, i.points, i.tilt, SURFACE_EDGE)
    return body, np.array([i.offset[0], i.offset[1], body.half_height + i.gap])


def build_particle(what: Plan, ranks: parallel.Ranks, numerics: Mapping[str, float] | None, log: Path | None) -> Any:
    """This rank's part of the particle. Starts LAMMPS, on all ranks that share the particle at once."""
    from .constitutive import law_record
    from .sph.machdyn import Numerics, Particle

    i = what.impact
    body, place = place_of(what)
    law = law_record(i.material, {row.name: row.on for row in what.effects.rows}, what.rate_filter)
    knobs = {name: value for name, value in dict(numerics or {}).items() if name != "contact_stiffness"}
    return Particle(
        body.points + place, body.volume, law, i.velocity, i.temperature, Numerics(**knobs),
        comm=ranks.sph_comm, log=log, shares=ranks.shares,
    )  # fmt: skip


def _heat_share(a: Any, Ta: float, b: Any, Tb: float) -> float:
    """Share of friction heat that goes to body a: by effusivity sqrt(k rho cp), as for two half-spaces in contact."""
    ea = float(np.sqrt(a.k_at(Ta) * a.rho * a.cp_at(Ta)))
    eb = float(np.sqrt(b.k_at(Tb) * b.rho * b.cp_at(Tb)))
    return ea / (ea + eb)
