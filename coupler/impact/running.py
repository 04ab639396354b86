"""One impact while it runs: the loop that a reader can follow, its books, its files and its checkpoints."""

import resource
import signal
import threading
import time as clock
from collections.abc import Callable, Mapping
from dataclasses import asdict
from types import FrameType
from typing import Any

import numpy as np

from ..errors import SolverError
from ..plan.planning import Plan
from .loop import Impact, Watch, check_books
from .rebound import velocity_ratio
from .retry import SOUND, Rescuer
from .validity import Extremes

DRIFT_BOUND = 0.02  # of the initial kinetic energy: beyond it a run is not called finished
DRIFT_ALARM = 2.0 * DRIFT_BOUND  # on the way, where some of it may come back
MOMENTUM_BOUND = 1e-6
STILL = 0.005  # of an impact's speed: a particle that sinks more slowly into what others have left has come to rest
DISSIPATION_BOUND = -0.01  # a scheme that gives energy away is unstable
DISSIPATION_ALARM = 0.2  # beyond it what the schemes take is no longer small beside plastic work: said in the warnings
# fields written without a change of name, and how they read in ParaView's order of tensors, xx yy zz xy yz xz
_VTK_ORDER = [0, 1, 2, 5, 3, 4]


class Stopped(KeyboardInterrupt):
    """The run was asked to stop, and has written a checkpoint. signal: the number of what asked."""

    def __init__(self, number: int = signal.SIGINT):
        super().__init__(number)
        self.signal = number


class StopSignals:
    """While in use, SIGINT and SIGTERM are noted and the chunk is ended in peace; a second one interrupts at once."""

    def __init__(self) -> None:
        self.number = 0
        self._before: dict[int, Any] = {}

    def __enter__(self) -> "StopSignals":
        if threading.current_thread() is threading.main_thread():
            for number in (signal.SIGINT, signal.SIGTERM):
                self._before[number] = signal.signal(number, self._note)
        return self

    def _note(self, number: int, _frame: FrameType | None) -> None:
        if self.number:
            raise KeyboardInterrupt
        self.number = number

    def __exit__(self, *_: object) -> None:
        for number, handler in self._before.items():
            signal.signal(number, handler)


class Running:
    """One impact and what is written of it. setting: the domains (`deposition.Setting`); store: where it goes.

    i: which of the plan's impacts; before: simulated time (s) of those before it. rebuild(setting, state, numerics): domains made
    new from a kept `bodies` state, for a rescue; numerics: what the run was asked to change in the scheme; log(text).
    """

    def __init__(
        self, what: Plan, i: int, setting: Any, store: Any, progress: Any, threads: int, rebuild: Callable[..., Any],
        log: Callable[[str], None], before: float = 0.0, numerics: Mapping[str, float] | None = None,
    ):  # fmt: skip
        self.what, self.i, self.setting, self.store, self.progress = what, i, setting, store, progress
        self.mine, self.before = what.impacts[i], before
        self.threads, self.rebuild, self.log = threads, rebuild, log
        self.impact = Impact(setting.particle, setting.bodies, setting.surface, setting.contact, threads, setting.paths)
        self.rescuer = Rescuer(numerics or {})
        self.extremes = Extremes()
        self.over_rim = False  # matter of the particle beside the substrate, below its surface
        self.in_layer = False  # it touched where the target's window takes velocities away
        speed = float(np.linalg.norm(self.mine.velocity))
        crossing = self.mine.diameter / speed
        self.watch = Watch(self.mine.end_time, self.mine.end_at, 0.1 * crossing, STILL * speed if i else 0.0)
        self.greatest: dict[str, float] | None = None
        self.next_output = 0.0
        self.row_every = crossing / 400.0
        self.next_row = 0.0
        self.looped = 0.0  # s of wall time in the loop
        mesh = setting.target.mesh
        self.crater_nodes = np.unique(mesh.facets[mesh.sets["top"]])

    def state(self) -> dict[str, Any]:
        """All that goes on in the next chunk as if nothing had happened."""
        return {
            "impact": self.impact.state(), "watch": self.watch.state(), "greatest": self.greatest,
            "next_output": self.next_output, "next_row": self.next_row, "looped": self.looped,
            "rescues": self.rescuer.state(), "extremes": self.extremes.state(), "over_rim": self.over_rim,
            "in_layer": self.in_layer,
        }  # fmt: skip

    def restore(self, state: dict[str, Any]) -> None:
        """Put a `state` into a fresh one of the same plan."""
        self.impact.restore(state["impact"])
        self.watch.restore(state["watch"])
        self.rescuer.restore(state["rescues"])
        self.extremes.restore(state["extremes"])
        for name in ("greatest", "next_output", "next_row", "looped", "over_rim", "in_layer"):
            setattr(self, name, state[name])

    def go(
        self, save: Callable[[dict[str, Any]], None], save_every: float, probe: Callable[[Impact], None] | None = None
    ) -> None:
        """Run to the end. save(state) is called every `save_every` seconds of wall time, and before a signal stops the run.

        probe(impact) is called after every chunk of steps. A run in trouble goes back and tries again (`coupler.impact.retry`).
        Raises SolverError when that does not help, StoreError, or Stopped.
        """
        if self.progress is not None:
            self.progress.start(self.mine.expected)
        if self.impact.time == 0.0:
            self._write()
        self._keep()
        saved = clock.perf_counter()
        started = saved - self.looped
        with StopSignals() as asked:
            while True:
                try:
                    over = self._chunk(probe)
                    if over:
                        self._judge()
                except SolverError as error:
                    self._go_back(error)
                    over = False
                now = clock.perf_counter()
                self.looped = now - started
                if over:
                    break
                if asked.number or now - saved >= save_every:
                    save(self.state())
                    saved = clock.perf_counter()
                if asked.number:
                    raise Stopped(asked.number)

    def _chunk(self, probe: Callable[[Impact], None] | None) -> bool:
        """Some steps, and what is written of them. Returns whether the impact is over."""
        impact, particle = self.impact, self.setting.particle
        dt = impact.advance(self.mine.end_time if self.mine.end_at == "time" else None)
        sinking = -float(particle.momentum()[2] / particle.mass.sum())
        over = self.watch.look(impact.time, sinking, float(impact.force[2]))
        if self.watch.turned is not None and self.greatest is None:
            if self.what.adhesion.in_impact:
                impact.bond(self.what.adhesion, velocity_ratio(self.what, self.i))
            self.greatest = self._measure()
            self._write()
        if over or impact.time >= self.next_row:
            self._row(dt)
        if over or impact.time >= self.next_output:
            self._write()
        if probe is not None:
            probe(impact)
        if not over and self.rescuer.due():
            self._keep()
        return over

    def _keep(self) -> None:
        """Remember this state for a rescue, if its books are sound."""
        ledger, setting = self.impact.ledger, self.setting
        books = ledger.close(setting.particle, setting.bodies, setting.contact, self.impact.hold)
        given_away = books["numerical_particle"] / ledger.kinetic_0
        if abs(books["drift"]) < SOUND * DRIFT_BOUND and given_away > SOUND * DISSIPATION_BOUND:
            state = {"running": self.state(), "fe": setting.target.fe, "store": self.store.state()}
            self.rescuer.keep(self.before + self.impact.time, state)

    def _go_back(self, error: SolverError) -> None:
        """Take the next measure against `error`, or let it stand."""
        rescue, kept = self.rescuer.way_out(error, self.i + 1, self.before + self.impact.time)
        self.log(str(rescue))
        self.impact.close()
        made, running = self.rescuer.state(), kept["running"]
        # Everything is made new, as for a resumption: what failed inside LAMMPS may have left anything behind.
        self.setting = self.rebuild(self.setting, {**running["impact"]["bodies"], "fe": kept["fe"]}, rescue.numerics)
        s = self.setting
        self.impact = Impact(s.particle, s.bodies, s.surface, s.contact, self.threads, s.paths)
        self.restore(running | {"rescues": made})
        self.impact.dt_factor = rescue.dt_factor
        self.store.go_back(kept["store"], self.log)

    def _judge(self) -> None:
        """Refuse a run whose books do not close."""
        ledger = self.impact.ledger
        check_books(ledger, DRIFT_BOUND, MOMENTUM_BOUND)
        dissipated = ledger.rows["numerical_particle"] / ledger.kinetic_0
        if dissipated < DISSIPATION_BOUND:
            raise SolverError(
                f"the SPH scheme gave away {-dissipated:.2%} of the initial kinetic energy: it is unstable"
            )

    def _row(self, dt: float) -> None:
        from .measure import crater_depth

        impact, particle, target = self.impact, self.setting.particle, self.setting.target
        books = impact.ledger.close(particle, self.setting.bodies, self.setting.contact, impact.hold)
        skin = self.setting.surface.positions(particle.x)
        row = {
            "time": self.before + impact.time,
            "impact": float(self.i + 1),
            "dt": dt,
            "step": float(particle.steps),
            **books,
        }
        row["height"] = float(skin[:, 2].max())
        row["thickness"] = float(np.ptp(skin[:, 2]))
        row["crater_depth"] = crater_depth(target.x[self.crater_nodes])
        row["velocity_z"] = float(particle.momentum()[2] / particle.mass.sum())
        row["contact_force"] = float(impact.force[2])
        row["T_max"] = float(particle.T.max())
        row["eps_p_mean"] = float(particle.eps_p.mean())
        row["stretch_min"] = particle.stretch_min
        self.store.record(row)
        self.extremes.note(particle, target)
        substrate = self.what.target
        beside = np.hypot(*(skin[:, :2] - substrate.centre).T) > 0.5 * substrate.diameter
        self.over_rim |= bool(np.any(beside & (skin[:, 2] < 0.0)))
        facets = self.setting.contact.touching(len(skin))[1]
        self.in_layer |= bool(np.any(target.mesh.reach_node[target.mesh.facets[facets]] > target.undisturbed))
        self.next_row = impact.time + self.row_every
        if not np.isfinite(books["drift"]):
            raise SolverError(f"the energy is no longer a number at t = {impact.time * 1e9:.3f} ns: try a finer preset")
        check_books(impact.ledger, DRIFT_ALARM, MOMENTUM_BOUND)
        if self.progress is not None:
            self.progress.update(impact.time, books["kinetic"] / impact.ledger.kinetic_0, dt, particle.steps)

    def _write(self) -> None:
        from .measure import von_mises_of

        # a moment later than the last step of the impact before: viewers want each time once
        t = self.before + max(self.impact.time, 1e-15 if self.i else 0.0)
        p, s = self.setting.particle, self.setting.surface
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
        cells["body"] = self.setting.bodies.body  # 0 the substrate, then the splats as they joined
        self.store.write("target", t, e.x, e.mesh.conn, {"velocity": e.velocity()}, cells)
        self.next_output = self.impact.time + self.mine.output_every

    def _measure(self) -> dict[str, float]:
        from .measure import measure

        setting = self.setting
        m = measure(
            setting.particle, setting.target, setting.surface, self.crater_nodes, self.mine.diameter, setting.level
        )
        return {"time_s": self.impact.time, **m}

    def _beyond(self) -> list[str]:
        """Where the impact left the range that its models were fitted in."""
        metals = {"particle": self.mine.material, "target": self.what.target.material}
        beyond = self.extremes.warnings(self.i + 1, metals, self.what.effects.on("mie_gruneisen"))
        if self.over_rim:
            beyond.append(
                f"impact {self.i + 1}: the particle went over the rim of the substrate ({self.what.target.diameter * 1e6:.4g} um wide),"
                " which a real one does not have there: make substrate.diameter larger"
            )
        if self.in_layer:
            beyond.append(
                f"impact {self.i + 1}: the particle touched the rim of its window of {self.mine.window * 1e6:.4g} um, where the"
                " target is held back: make substrate.window larger"
            )
        eaten = self._eaten()
        if eaten > DISSIPATION_ALARM:
            beyond.append(
                f"impact {self.i + 1}: viscosity and hourglass control took {eaten:.0%} of the kinetic energy, more than"
                f" {DISSIPATION_ALARM:.0%}: they shape the splat beside the metal's own strength, try a finer preset"
            )
        return beyond

    def _eaten(self) -> float:
        """Share of the initial kinetic energy that the schemes of both domains have dissipated."""
        ledger = self.impact.ledger
        return (ledger.rows["numerical_particle"] + ledger.rows["numerical_target"]) / ledger.kinetic_0

    def _bands(self, end: dict[str, float]) -> dict[str, Any]:
        """How far each measure may be off at this resolution, and what drives it."""
        from ..plan.bands import Kind, of_summary

        mine, sideways = self.mine, bool(self.mine.velocity[0] or self.mine.velocity[1])
        speed, plain = float(np.linalg.norm(mine.velocity)), mine.shape == "sphere" and not sideways
        values = end | {"rebound_velocity_m_s": max(end["velocity_z_m_s"], 0.0)}
        return of_summary(values, Kind(self.setting.particle.n, speed, self.i + 1, plain), mine.temperature)

    def _molten(self) -> list[str]:
        """What is to be said of matter above its melting point: there is no latent heat and no liquid in the law."""
        particle, target = self.setting.particle, self.setting.target
        melting = target.laws["T_m"][target.law_of]
        found = []
        for name, T, T_m, share in (
            ("particle", particle.T, np.full(particle.n, particle.law["T_m"][0]), particle.mass / particle.mass.sum()),
            ("target", target.T, melting, target.mesh.V0 / (np.pi / 6.0 * self.mine.diameter**3)),
        ):
            beyond = T > T_m
            if beyond.any():
                worst = int(np.argmax(T / T_m))
                found.append(
                    f"impact {self.i + 1}: the {name} went beyond melting, to {T[worst]:.0f} K where it melts at {T_m[worst]:.0f} K"
                    f" ({share[beyond].sum():.2%} of the particle's volume): the law knows no latent heat and no melt"
                )
        return found

    def summary(self, wall: float) -> dict[str, Any]:
        """What is to be said of the finished impact. wall: s it has taken in all."""
        from .. import __version__

        impact, particle, target = self.impact, self.setting.particle, self.setting.target
        books, kinetic_0 = impact.ledger.rows, impact.ledger.kinetic_0
        end = self._measure()
        energies = {name: value / kinetic_0 for name, value in books.items() if name not in ("drift", "momentum_error")}
        return {
            **{name: value for name, value in end.items() if name != "time_s"},
            "material": self.mine.material.name,
            "diameter_m": self.mine.diameter,
            "speed_m_s": float(np.linalg.norm(self.mine.velocity)),
            "surface_level_m": self.setting.level,
            "rebound_velocity_m_s": max(end["velocity_z_m_s"], 0.0),
            "energy_drift": books["drift"],
            "momentum_error": books["momentum_error"],
            "numerical_dissipation": self._eaten(),
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
            "wall_s": wall,
            "wall_loop_s": self.looped,
            "placement": particle.ranks.placement,
            "ranks": particle.ranks.size,
            "idle_share": particle.idle(self.looped),
            "memory_peak_bytes": sum(particle.everywhere(peak_memory)),
            "kinetic_energy_0_J": kinetic_0,
            "energies": energies,
            "greatest_deformation": self.greatest,
            "end": end,
            "effects": self.what.effects.active,
            "warnings": [*self.what.warnings, *self._beyond(), *self._molten(), *map(str, self.rescuer.made)],
            "rescues": self.rescuer.state(),
            "bands": self._bands(end),
            "version": __version__,
        }


def peak_memory() -> float:
    """Largest resident memory of this process so far, bytes."""
    return 1024.0 * resource.getrusage(resource.RUSAGE_SELF).ru_maxrss
