"""The impacting particle: total-Lagrangian SPH whose points LAMMPS keeps, integrates and shares among ranks.

`fix external` calls back between LAMMPS's pair forces and its kick, when positions are at n+1 and velocities at n+1/2. There stress
and internal forces move on (by an engine: `particle.machdyn`, `particle.compiled`, `particle.enriched`); the coupler fills in `f_ext`.
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
from ..core.records import Rows, Shape, arrays_of, copied, new_rows, put, rows_of, take
from ..core.threads import share, together
from ..errors import CheckpointError, SolverError
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

    kernel_radius: smoothing radius over spacing (0.75: the 12 nearest neighbours of a face-centred cubic lattice; 0.9 takes 18
    and converges more slowly). Q1: linear viscosity. hourglass: amplitude; control: 1 for hourglass control in place of residuals.
    courant: bound on c dt / dx, and `stretch`: that bound as a share of the smallest principal stretch. frequency: bound of the
    enriched scheme, as a share of the step that its highest frequency allows. inertia: step, in spacings over the speed of sound, that
    crushed cells of the enriched scheme are to bear (`particle.inertia`); 0 for none.
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
    """State of n points, in any engine: a new particle with this state continues with the same numbers.

    lammps=True: arrays that LAMMPS stores and integrates, by its names: x m, v and vest m/s, f N, esph J/kg ... The others are the
    state of the law: rate 1/s, sigma_y Pa, J volume ratio, p Pa, energy J per reference m3, work J; f_old N: internal forces of the
    last step. An engine adds its own.
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
    """The points of one rank; internal_work J; time s, steps, dt s.

    sums (4,) J: their plastic work, the heat put into their energy, and the losses by viscosity and by hourglass control, zero with an
    engine that does not measure these.
    """

    points: PointState
    sums: Annotated[np.ndarray, Shape(4)] = field(default_factory=lambda: np.zeros(4))
    internal_work: float = 0.0
    time: float = 0.0
    steps: int = 0
    dt: float = 0.0


@dataclass(frozen=True)
class PointTotals:
    """Totals of points for the ledger and the choice of dt: dt s, their stable step; stretch_min; fastest m/s; energies J, of which
    viscosity and hourglass are losses, zero with an engine that does not measure them; momentum (3,) kg m/s."""

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
        """Totals of the points of all parts together."""
        fold = {"dt": min, "stretch_min": min, "fastest": max}
        names = [f.name for f in fields(cls)]
        return cls(**{name: fold.get(name, sum)([vars(part)[name] for part in parts]) for name in names})


_WIDE = {"smd_stress": 6, "smd_data_9": 9}  # arrays of which LAMMPS does not tell the columns


class Particle(LocalState, ABC):
    """State and motion of one SPH particle, or of this rank's n points of it; an engine adds stress and internal forces.

    points: its state, of which LAMMPS keeps some arrays itself. f_ext (n,3) N: forces from outside, which the callback adds to.
    X (n,3): reference positions; ids (n,): which of the points given these are (they stay: neighbours are those of the reference
    configuration). SI units.
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
    ):
        """points (n,3) m in place, volume m3 of each, law a LAW record (1,), velocity (3,) m/s, temperature K.

        log: LAMMPS's log file. velocity may also be that of each point, (n,3).
        comm: the communicator of the ranks that share the particle, by slabs along x, in equal parts.
        strain: plastic strain that the points begin with.
        """
        self.numerics = numerics or Numerics()
        self.law, self._special, self.initial_strain = law, specialised(law), strain
        self.X = np.ascontiguousarray(points, float)
        self.total, self.volume_of_point, self.spacing = len(points), volume, volume ** (1.0 / 3.0)
        r = law[0]
        self.wave_speed = sound_speed(float(r["rho"]), float(r["K"]), float(r["G"]))
        self.comm = comm or MPI.COMM_SELF
        self._on_step: Callable[[], None] | None = None
        self.failure: BaseException | None = None
        self.is_shared = False
        self.stretch_min = 1.0
        with silence():
            try:
                self._start(velocity, float(temperature), log)
            except Exception as problem:
                if not str(problem).startswith("ERROR"):  # all of LAMMPS's do, and have no class of their own
                    raise
                text = str(problem).splitlines()[0]
                raise SolverError(f"LAMMPS cannot create this particle ({text}): try fewer points") from problem

    def _own(self, temperature: float) -> None:
        """State of the points of this rank at the start."""
        self.volume = np.full(self.n, self.volume_of_point)
        self.f_ext = np.zeros((self.n, 3))
        kept = {name: self._lammps(name) for name, spec in rows_of(self.POINTS).items() if spec.lammps}
        super().__init__(new_rows(self.POINTS, self.n, **kept))
        self._mass = self._lammps("rmass")
        p = self.points
        self._state = State(p.smd_stress, p.sigma_y, p.eps_p, p.rate, p.T, p.J, p.p, p.energy, p.work, p.eps_gradient)
        self.points.T[:], self.points.eps_p[:] = temperature, self.initial_strain
        self.points.sigma_y[:] = yield_stress(self.law[0], self.initial_strain, 0.0, temperature)

    def _start(
        self, velocity: tuple[float, float, float] | np.ndarray, temperature: float, log: Path | None
    ) -> None:  # fmt: skip
        num = self.numerics
        coefficients = {"Q1": num.Q1, "Q2": num.Q2, "hourglass": num.hourglass}
        self.lmp = start(
            self.X, self.volume_of_point, self.spacing, self.law[0], num.kernel_radius * self.spacing, coefficients, self.PAIR,
            self._callback, log, self.comm,
        )  # fmt: skip
        self.lmp.command("run 0 post no")  # builds the reference neighbours
        self.n = int(self.lmp.extract_setting("nlocal"))
        self.ids = self.lmp.numpy.extract_atom("id")[: self.n].astype(np.int64) - 1
        self._whole, self.X = self.X, self.X[self.ids]
        self._own(temperature)
        velocity = np.asarray(velocity, float)
        velocity = velocity[self.ids] if velocity.ndim == 2 else velocity
        self.points.v[:] = velocity
        self.points.vest[:] = velocity
        self.points.eff_plastic_strain[:] = self.points.sigma_y / H
        self._start_engine()
        self._f_out = self.lmp.numpy.fix_external_get_force("coupler")  # LAMMPS adds them to f
        self.mass = self._mass.copy()

    def _lammps(self, name: str) -> np.ndarray:
        """LAMMPS's own array of the points of this rank, without those of its neighbours."""
        columns = _WIDE.get(name, 0)
        if columns:
            return self.lmp.numpy.extract_atom(name, nelem=self.n, dim=columns)
        return self.lmp.numpy.extract_atom(name)[: self.n]

    def run(self, steps: int, dt: float, on_step: Callable[[], None]) -> None:
        """Make `steps` steps of dt seconds; on_step() is called in each, at positions n+1, and fills in f_ext.

        Raises what on_step raised, or SolverError when LAMMPS stops or a point is switched off. Where other ranks count on
        this one, on_step is called to the end of the `steps` all the same: `failure` then says what happened.
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
            lost = int(np.argmin(self.points.molecule))
            raise SolverError(
                self._failure(f"point {self.ids[lost]} was distorted beyond what the kernel can follow", lost)
            )
        self._end_chunk()

    def _callback(self) -> None:
        """Between LAMMPS's forces and its kick: stress and internal forces, `on_step`, and all forces to LAMMPS."""
        if self._on_step is None:
            return
        self._try(self._move_on if self.failure is None else self._skip_step)
        if self.failure is not None and not self.is_shared:
            self.lmp.force_timeout()
            return
        self._try(self._on_step)
        self._try(self._hand_over)

    def _try(self, work: Callable[[], None]) -> None:
        """Do work. What it raises is kept as `failure`: an exception that leaves through ctypes is printed and forgotten."""
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
            work, p = np.zeros(PARTS), self.points
            together(motion.book, self.dt, p.f_old, p.f, p.v, self.f_ext, self._f_out, work)
            self.internal_work -= float(work.sum())

    @abstractmethod
    def _update_stress(self) -> None:
        """Move the state of the law on to n+1 and leave the internal forces in f. Raises SolverError where a point fails."""

    @abstractmethod
    def _strain(self) -> np.ndarray:
        """Green-Lagrange strain (n,6), xx yy zz xy xz yz, of the last step."""

    @abstractmethod
    def stress(self) -> np.ndarray:
        """True Cauchy stress (n,6) Pa in Voigt order xx yy zz yz xz xy."""

    def _end_chunk(self) -> None:
        """Book plastic work and losses after the last step of a `run`; nothing in an engine that does so in each step."""
        return

    def _add_inertia(self) -> None:
        """Change the internal forces f, once f_ext is known, where cells have inertia of their own; after a failure too."""
        return

    def _skip_step(self) -> None:
        """What other ranks need of a step after a failure here: nothing beyond what LAMMPS sends itself."""
        return

    def _start_engine(self) -> None:
        """What an engine needs once the points are where they stay and have their velocities."""
        self.lmp.command("run 0 post no")

    def stable_dt(self) -> float:
        """Largest stable time step in s: it falls with the smallest principal stretch, which MACHDYN's own bound
        ignores.

        Raises SolverError when a point is crushed flat, or is not a finite number.
        """
        if self.n == 0:  # a rank that the balance left without points
            return np.inf
        strain, found = self._strain(), list[tuple[float, int]]()
        share(lambda lo, hi: found.append(k.smallest_stretch(lo, hi, strain)), self.n, LEAST_POINTS)
        stretch, where = min(found)
        if not stretch > 0.02:
            raise SolverError(
                self._failure(f"point {self.ids[where]} is compressed to {stretch:.3g} of its length", where)
            )
        self.stretch_min = float(stretch)
        return self.spacing / self.wave_speed * min(self.numerics.courant, self.numerics.stretch * stretch)

    def _failure(self, reason: str, point: int | None = None) -> str:
        place = ""
        if point is not None and point >= 0:
            at = self.points.x[point] * 1e6
            place = f" near ({at[0]:.2f}, {at[1]:.2f}, {at[2]:.2f}) um"
        return f"the particle failed at t = {self.time * 1e9:.3f} ns{place}: {reason}. Try more points, or a smaller time step"

    def _summed(self) -> np.ndarray:
        """The sums (6,) of `law.add_up`, between runs; the last is the largest."""
        parts, p = np.zeros((PARTS, 6)), self.points  # LAMMPS has added f_ext to f
        together(k.add_up, self.law, self.dt, self.volume, self.mass, p.v, p.f, self._state, parts)
        return np.append(parts[:, :5].sum(axis=0), parts[:, 5].max())

    def _recoverable(self, stored: float) -> float:
        """Recoverable part, J, of `stored`, J, the energy of the stresses: without the part due to heat."""
        return stored - float(self.sums[1])

    def warm(self, heat: np.ndarray) -> None:
        """Put heat (n,) J into points, between runs: temperature and yield stress at once, pressure in the next step."""
        heat, pressing = np.ascontiguousarray(heat, float), np.zeros(PARTS)
        together(k.warm_points, self.law, H, self.volume, heat, self.points.eff_plastic_strain, self._state, pressing)
        self.sums[1] += float(pressing.sum())

    def totals(self) -> PointTotals:
        """Sums and extremes over these points; raises as `stable_dt` does."""
        plastic, _, viscosity, hourglass = self.sums.tolist()
        dt, (kinetic, stored, *momentum, square) = self.stable_dt(), self._summed().tolist()
        return PointTotals(
            dt, self.stretch_min, square**0.5, kinetic, self._recoverable(stored), self.internal_work, plastic, viscosity, hourglass,
            np.array(momentum),
        )  # fmt: skip

    def get(self, name: str) -> object:
        """An attribute or a field of these points by name, or "stress"; an array as a copy."""
        value = self.stress() if name == "stress" else (vars(self) | arrays_of(self.points))[name]
        return np.array(value) if isinstance(value, np.ndarray) else value

    def carried(self) -> dict[str, np.ndarray]:
        """State of the metal for a mesh of the points in their present positions, by name (`physics.metal`)."""
        return carried(self.points)

    def state(self) -> LocalState:
        """State of these points, as a checkpoint holds it."""
        return copied(self)

    def restore(self, state: LocalState, first: bool = True) -> None:
        """Put a `state` of the whole particle (all points in the order given) into a fresh one; sums go to the first rank.

        Raises CheckpointError for another number of points or another engine.
        """
        if not isinstance(state.points, self.POINTS) or len(state.points.x) != self.total:
            raise CheckpointError(
                "the checkpoint does not fit: the particle has other points or another engine;"
                " start again with coldspray run --force"
            )
        put(replace(state, points=take(state.points, self.ids)), self)
        if not first:
            self.sums[:], self.internal_work = 0.0, 0.0

    def close(self) -> None:
        """Close LAMMPS."""
        self.lmp.close()
