"""The impacting particle: total-Lagrangian SPH. LAMMPS stores its points, divides them among ranks and runs the steps.

In each step LAMMPS calls this module (`fix external`) between its pair forces and its velocity update, with positions at n+1 and
velocities at n+1/2. In this callback an engine (`particle.machdyn`, `particle.compiled`, `particle.enriched`) updates stress and
internal forces, and `on_step` writes the external forces. LAMMPS (engine `machdyn`, which uses its SPH package MACHDYN) or the engine
integrates the motion of the points, with the same numbers.
"""

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, fields, replace
from pathlib import Path
from typing import Annotated, ClassVar

import numpy as np
from mpi4py import MPI

from ..core import safety
from ..core.loops import PARTS
from ..core.records import Rows, Shape, arrays_of, copied, new_rows, put, rows_of, take, unfit
from ..core.threads import share, together
from ..errors import SolverError
from ..physics import motion
from ..physics.constitutive import sound_speed, specialised, yield_stress
from ..physics.metal import MetalState, carried
from . import law as k
from .law import LEAST_POINTS
from .model import State
from .start import H, silence, start


@dataclass(frozen=True)
class Numerics:
    """Parameters of the numerical scheme.

    kernel_radius: half the distance at which the kernel is zero, in spacings: 0.75 includes the 12 nearest neighbours of a face-centred
    cubic lattice, 0.9 includes 18 and converges more slowly; Q1, Q2: linear and quadratic viscosity; hourglass: amplitude of hourglass
    control; control: 1 for hourglass control in place of residuals; courant, stretch: c dt / dx is at most courant, and at most stretch
    times the smallest principal stretch; frequency: time step of the enriched scheme divided by the stability limit; inertia: time
    step with which crushed cells of the enriched scheme are made stable (`particle.inertia`), times speed of sound / spacing; 0: no
    added inertia.
    """

    kernel_radius: float = 0.75
    Q1: float = 0.06
    Q2: float = 0.0
    hourglass: float = 1.0
    control: float = 0.0
    courant: float = safety.COURANT
    stretch: float = safety.STRETCH
    frequency: float = safety.POINTS
    inertia: float = 0.0


@dataclass(frozen=True)
class PointState(MetalState):
    """State of n points with any engine: a new particle with this state continues with the same results.

    Arrays marked lammps=True are stored by LAMMPS under its own names: x (m), v and vest (m/s), f (N), esph (J/kg) ...
    State of the law: rate (1/s); sigma_y (Pa); J: volume ratio; p (Pa); energy, plastic work: J per reference m3. f_old (N): internal
    forces of the last step. Engines add further arrays.
    """

    x: Annotated[np.ndarray, Rows(3, lammps=True)]
    v: Annotated[np.ndarray, Rows(3, lammps=True)]
    vest: Annotated[np.ndarray, Rows(3, lammps=True)]
    f: Annotated[np.ndarray, Rows(3, lammps=True)]
    esph: Annotated[np.ndarray, Rows(lammps=True)]
    desph: Annotated[np.ndarray, Rows(lammps=True)]
    eff_plastic_strain: Annotated[np.ndarray, Rows(lammps=True)]
    eff_plastic_strain_rate: Annotated[np.ndarray, Rows(lammps=True)]
    damage: Annotated[np.ndarray, Rows(lammps=True)]
    vfrac: Annotated[np.ndarray, Rows(lammps=True)]
    molecule: Annotated[np.ndarray, Rows(lammps=True, dtype=np.int32)]
    smd_stress: Annotated[np.ndarray, Rows(6, lammps=True)]
    smd_data_9: Annotated[np.ndarray, Rows(9, lammps=True)]
    rate: Annotated[np.ndarray, Rows()]
    sigma_y: Annotated[np.ndarray, Rows()]
    J: Annotated[np.ndarray, Rows(fill=1.0)]
    p: Annotated[np.ndarray, Rows()]
    energy: Annotated[np.ndarray, Rows()]
    work: Annotated[np.ndarray, Rows()]
    f_old: Annotated[np.ndarray, Rows(3)]


@dataclass(eq=False)
class LocalState:
    """State of the points of one rank. internal_work (J); time (s); steps: number since the start; dt (s).

    sums (4,) J: plastic work, heat that raises pressure, losses by viscosity, losses by hourglass control; the losses are zero with
    an engine that does not measure them.
    """

    points: PointState
    sums: Annotated[np.ndarray, Shape(4)] = field(default_factory=lambda: np.zeros(4))
    internal_work: float = 0.0
    time: float = 0.0
    steps: int = 0
    dt: float = 0.0


@dataclass(frozen=True)
class PointTotals:
    """Totals of points for the ledger and the time step. dt (s): stable time step; stretch_min: smallest principal stretch; fastest
    (m/s): largest speed; momentum (3,) kg m/s; all others: energies, J. viscosity and hourglass are losses, zero with an engine
    that does not measure them."""

    dt: float
    stretch_min: float
    fastest: float
    kinetic: float
    elastic: float
    internal_work: float
    plastic: float
    viscosity: float
    hourglass: float
    momentum: Annotated[np.ndarray, Shape(3)]

    @classmethod
    def over(cls, parts: "Sequence[PointTotals]") -> "PointTotals":
        """Totals of all points from the totals of parts."""
        fold = {"dt": min, "stretch_min": min, "fastest": max}
        names = [f.name for f in fields(cls)]
        return cls(**{name: fold.get(name, sum)([vars(part)[name] for part in parts]) for name in names})


DISTORTED = "its volume ratio is outside the range 0.2 to 2"
UNDEFINED_STRESS = "its stress is not a finite number"


class Particle(LocalState, ABC):
    """State and motion of one SPH particle, or of its n points on this rank. An engine adds stress and internal forces. SI units.

    points: state; LAMMPS stores some of its arrays. f_ext (n,3) N: external forces, which the callback writes; X (n,3): reference
    positions; ids (n,): numbers of these points in the whole particle. A rank keeps its points: neighbours are those of the
    reference configuration.
    """

    PAIR: ClassVar[str]  # LAMMPS input of the engine's pair style
    POINTS: ClassVar[type[PointState]]  # the record of the engine's points

    def __init__(
        self,
        points: np.ndarray,
        volume: float,
        law: np.ndarray,
        velocity: tuple[float, float, float] | np.ndarray,
        temperature: float,
        numerics: Numerics | None = None,
        comm: MPI.Comm | None = None,
        log: Path | None = None,
        strain: float = 0.0,
        law_of: np.ndarray | None = None,
    ):
        """points (n,3) m: positions; volume (m3): volume of each point; law (k,): LAW records, the first is that of the surface;
        velocity (m/s): (3,), or (n,3) for each point; temperature (K); comm: communicator of the ranks that share the particle, in
        slabs along x with equal numbers of points; log: log file of LAMMPS; strain: initial plastic strain of the first law's points;
        law_of (n,): index of the law of each point; default: the first law for all points."""
        self.numerics = numerics or Numerics()
        self.law, self._special, self.initial_strain = law, specialised(law), strain
        self.law_of = np.zeros(len(points), np.int32) if law_of is None else law_of
        self.X = np.ascontiguousarray(points, float)
        self.total, self.volume_of_point, self.spacing = len(points), volume, volume ** (1.0 / 3.0)
        self.wave_speed = max(sound_speed(float(r["rho"]), float(r["K"]), float(r["G"])) for r in law)
        self.comm = comm or MPI.COMM_SELF
        self._on_step: Callable[[], None] | None = None
        self.failure: BaseException | None = None
        self.is_shared = False
        self.stretch_min = 1.0
        with silence():
            try:
                self._start(velocity, float(temperature), log)
            except Exception as problem:
                if not str(problem).startswith("ERROR"):  # errors of LAMMPS start so; they have no class of their own
                    raise
                text = str(problem).splitlines()[0]
                raise SolverError(
                    f"LAMMPS cannot create this particle ({text}): try fewer points, or fewer ranks"
                ) from problem

    def _start(self, velocity: Sequence[float] | np.ndarray, temperature: float, log: Path | None) -> None:
        """Start LAMMPS with the points, and give the points of this rank their state and velocities."""
        num = self.numerics
        coefficients = {"Q1": num.Q1, "Q2": num.Q2, "hourglass": num.hourglass}
        self.lmp = start(
            self.X, self.volume_of_point, self.spacing, self.law[0], num.kernel_radius * self.spacing, coefficients, self.PAIR,
            self._callback, log, self.comm,
        )  # fmt: skip
        self.lmp.command("run 0 post no")  # here MACHDYN lists the neighbours of the reference configuration
        self.n = int(self.lmp.extract_setting("nlocal"))
        self.ids = self.lmp.numpy.extract_atom("id")[: self.n].astype(np.int64) - 1
        self._whole, self.X = self.X, self.X[self.ids]
        self._whole_law_of, self.law_of = self.law_of, self.law_of[self.ids]
        self.volume, self.f_ext = np.full(self.n, self.volume_of_point), np.zeros((self.n, 3))
        kept = {name: self._lammps(name, *spec.shape[1:]) for name, spec in rows_of(self.POINTS).items() if spec.lammps}
        super().__init__(new_rows(self.POINTS, self.n, **kept))
        self._mass = self._lammps("rmass")
        self._mass[:] = self.volume * self.law["rho"][self.law_of]
        p, velocities = self.points, np.asarray(velocity, float)
        self._state = State(
            self.law_of, p.smd_stress, p.sigma_y, p.eps_p, p.rate, p.T, p.J, p.p, p.energy, p.work, p.eps_gradient
        )
        p.T[:] = temperature
        for i, law in enumerate(self.law):
            own, strain = self.law_of == i, 0.0 if i else self.initial_strain
            p.eps_p[own], p.sigma_y[own] = strain, yield_stress(law, strain, 0.0, temperature)
        p.v[:] = p.vest[:] = velocities[self.ids] if velocities.ndim == 2 else velocities
        p.eff_plastic_strain[:] = p.sigma_y / H
        self._start_engine()
        self.mass = self._mass.copy()

    def _lammps(self, name: str, columns: int = 1) -> np.ndarray:
        """The array `name` of LAMMPS for the points of this rank, without copies of neighbours."""
        return self.lmp.numpy.extract_atom(name, nelem=self.n, dim=columns)

    def run(self, steps: int, dt: float, on_step: Callable[[], None]) -> None:
        """Make `steps` steps of dt s. Each step calls on_step() when the positions are those at n+1; on_step writes f_ext.

        Raises the error of on_step, or SolverError when LAMMPS stops or MACHDYN deletes a point. If other ranks share the particle,
        on_step is called in all steps even after a failure; `failure` keeps the error, which is raised after the last step.
        """
        self._on_step, self.dt, self.failure, self._steps_left = on_step, dt, None, steps
        self.f_ext[:] = 0.0
        try:
            with silence():
                self.lmp.command(f"timestep {dt:.17g}")
                self.lmp.command(f"run {steps} pre no post no")
        except Exception as problem:
            raise self.failure or SolverError(self._failure(str(problem).splitlines()[0])) from problem
        finally:
            self._on_step = None
        if self.failure is not None:
            raise self.failure
        if self.points.molecule.min(initial=1) < 0:
            raise SolverError(self._failure(DISTORTED, int(np.argmin(self.points.molecule))))
        self._end_chunk()

    def _callback(self) -> None:
        """Work between the pair forces of LAMMPS and the end of its step: stress and internal forces, `on_step`, sums of forces."""
        if self._on_step is None:
            return
        self._try(self._move_on if self.failure is None else self._skip_step)
        if self.failure is not None and not self.is_shared:
            self.lmp.force_timeout()
            return
        self._try(self._on_step)
        self._try(self._hand_over)

    def _try(self, work: Callable[[], None]) -> None:
        """Call work(). Its error is stored as `failure`: an exception that passes through ctypes would be printed and lost."""
        try:
            work()
        except BaseException as problem:
            self.failure = self.failure or problem

    def _move_on(self) -> None:
        self.time += self.dt
        self.steps += 1
        self._steps_left -= 1
        self._update_stress()

    def _hand_over(self) -> None:
        self._add_inertia()
        if self.failure is None:
            work = np.zeros(PARTS)
            self._book(work)
            self.internal_work -= float(work.sum())

    def _book(self, work: np.ndarray) -> None:
        """Compute the work of the internal forces in this step, part by part, in work (PARTS,) J, and add the external forces to f.
        Then LAMMPS, or the engine, computes the velocities at n+1."""
        p = self.points
        together(motion.book_all, self.dt, p.f_old, p.f, p.v, self.f_ext, work)

    @abstractmethod
    def _update_stress(self) -> None:
        """Update the state of the law to n+1 and write the internal forces to f. Raises SolverError if a point fails."""

    @abstractmethod
    def _strain(self) -> np.ndarray:
        """Green-Lagrange strain (n,6), xx yy zz xy xz yz, of the last step."""

    @abstractmethod
    def stress(self) -> np.ndarray:
        """Cauchy stress (n,6) Pa along the fixed axes, Voigt order xx yy zz yz xz xy."""

    def _end_chunk(self) -> None:
        """Add plastic work and losses to the sums after the last step of a `run`; an engine that does so in each step does nothing."""
        return

    def _add_inertia(self) -> None:
        """Change the internal forces f of cells with added inertia, after f_ext is known. Called also in steps after a failure."""
        return

    def _skip_step(self) -> None:
        """Send the data that other ranks need, in a step after a failure on this rank. LAMMPS sends its own data."""
        return

    def _start_engine(self) -> None:
        """Prepare the engine, after the points have their final ranks and their velocities."""
        self.lmp.command("run 0 post no")

    def stable_dt(self) -> float:
        """Largest stable time step in s: it decreases with the smallest principal stretch, which the bound of MACHDYN ignores.

        Raises SolverError when a point is crushed or its strain is not a finite number.
        """
        if self.n == 0:  # LAMMPS has given this rank no points
            return np.inf
        strain, found = self._strain(), list[tuple[float, int]]()
        share(lambda lo, hi: found.append(k.smallest_stretch(lo, hi, strain)), self.n, LEAST_POINTS)
        stretch, where = min(found)
        if not stretch > 0.02:
            raise SolverError(self._failure(f"it is compressed to {stretch:.3g} of its initial length", where))
        self.stretch_min = float(stretch)
        return self.spacing / self.wave_speed * min(self.numerics.courant, self.numerics.stretch * stretch)

    def _failure(self, reason: str, point: int | None = None) -> str:
        """Error message with time and place. point: the point that has failed, which is the subject of the sentence `reason`."""
        place = ""
        if point is not None and point >= 0:
            x, y, z = self.points.x[point] * 1e6
            place = f" at point {self.ids[point]} near ({x:.2f}, {y:.2f}, {z:.2f}) um"
        return f"the particle failed at t = {self.time * 1e9:.3f} ns{place}: {reason}. Try a finer preset"

    def _recoverable(self, stored: float) -> float:
        """Recoverable part (J) of the energy `stored` (J): the part of the stored energy that is due to heat is subtracted."""
        return stored - float(self.sums[1])

    def warm(self, heat: np.ndarray) -> None:
        """Add heat (n,) J to points, between calls of `run`: temperature and yield stress change at once, pressure in the next step."""
        heat, pressing = np.ascontiguousarray(heat, float), np.zeros(PARTS)
        together(k.warm_points, self.law, H, self.volume, heat, self.points.eff_plastic_strain, self._state, pressing)
        self.sums[1] += float(pressing.sum())

    def totals(self) -> PointTotals:
        """Sums and extremes over the points of this rank, between calls of `run`. Raises SolverError as `stable_dt`."""
        plastic, _, viscosity, hourglass = self.sums.tolist()
        dt, parts, p = self.stable_dt(), np.zeros((PARTS, 6)), self.points
        together(k.add_up, self.law, self.dt, self.volume, self.mass, p.v, p.f, self._state, parts)
        kinetic, stored, *momentum = parts[:, :5].sum(axis=0).tolist()
        return PointTotals(
            dt, self.stretch_min, float(parts[:, 5].max()) ** 0.5, kinetic, self._recoverable(stored), self.internal_work, plastic,
            viscosity, hourglass, np.array(momentum),
        )  # fmt: skip

    def get(self, name: str) -> object:
        """An attribute or a field of these points by name, or "stress". Arrays are copied."""
        value = self.stress() if name == "stress" else (vars(self) | arrays_of(self.points))[name]
        return np.array(value) if isinstance(value, np.ndarray) else value

    def carried(self) -> dict[str, np.ndarray]:
        """State of the metal, by name (`physics.metal`), for a mesh of the points in their present positions."""
        return carried(self.points)

    def state(self) -> LocalState:
        """State of these points, as a record for a checkpoint."""
        return copied(self)

    def restore(self, state: LocalState, first: bool = True) -> None:
        """Restore a `state` of the whole particle (all points in their original order) in a new particle. first: whether this rank
        is the first one, which gets the sums. Raises CheckpointError for another number of points or another engine.
        """
        if not isinstance(state.points, self.POINTS) or len(state.points.x) != self.total:
            raise unfit("the particle has other points or another engine")
        put(replace(state, points=take(state.points, self.ids)), self)
        if not first:
            self.sums[:], self.internal_work = 0.0, 0.0

    def close(self) -> None:
        """Close the LAMMPS instance of this rank."""
        self.lmp.close()
