"""Where many computations run: a `concurrent.futures.Executor` over processes here, MPI ranks of an allocation, or jobs of Slurm.

Whoever has many independent computations submits functions of a module with arguments that can be pickled, and does not know where
they run.
"""

import contextlib
import os
import re
import shutil
import signal
import sys
import threading
import time
from collections.abc import Iterator, Mapping
from concurrent.futures import Executor, Future, ProcessPoolExecutor, ThreadPoolExecutor
from multiprocessing import get_context, resource_tracker
from pathlib import Path
from typing import Any

from ..errors import PlacementError
from ..units import nearest

KINDS = ("processes", "mpi", "slurm")
# option of a Slurm job -> its value unless given; any other is passed on to sbatch
SLURM = {"cores": "1", "time": "01:00:00"}
RETRIES = 3  # of a computation whose Slurm job ended before it
# a Python program that ends with the process that started it (prctl 1); Parsl's server of the jobs: else, where the sweep was killed,
# they wait for work until their time is over
WITH_PARENT = "import ctypes, signal; ctypes.CDLL(None).prctl(1, signal.SIGTERM)"
_SERVER = (
    f"{WITH_PARENT}; import runpy; runpy.run_module('parsl.executors.high_throughput.interchange', run_name='__main__')"
)
# glibc takes huge pages where the system has them: to find the arrays of a late impact in memory takes up to a tenth of its time;
# a single impact, which is small, gains nothing
MEMORY = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
# variables by which a process joins the ranks of its parent
_OF_MPI = ("PMI", "PMIX", "OMPI_", "MPI_", "MPICH_", "HYDI_", "HYDRA_")


def executor(
    kind: str, count: int, folder: Path, slurm: Mapping[str, str] | None = None, *, starts_processes: bool = False
) -> Executor:
    """An executor of a kind of KINDS, `count` computations at a time (those of `mpi` are as many as the ranks but the first).

    folder: for logs of Slurm jobs. slurm: `cores`: computations at a time in each job; `time` of a job; any other option of sbatch.
    starts_processes: the functions start a process themselves, so that threads are enough for `processes`; else MEMORY is put into this
    process's environment, where it is not set, for the processes to inherit. Raises PlacementError.
    """
    if kind == "processes":
        if starts_processes:
            return ThreadPoolExecutor(count)
        for name, value in MEMORY.items():  # read as a process starts
            os.environ.setdefault(name, value)
        return _Processes(count, get_context("spawn"), end_with, (os.getpid(),))
    if kind == "mpi":
        return _mpi()
    if kind == "slurm":
        return _slurm(count, folder, {**SLURM, **(slurm or {})})
    raise PlacementError(f"unknown executor {kind!r}{nearest(kind, KINDS)}; known: {', '.join(KINDS)}")


class _Processes(ProcessPoolExecutor):
    """Processes that get no interrupt from the terminal, not even while they start: the parent handles it."""

    def submit(self, *arguments: Any, **options: Any) -> Future[Any]:
        """As in the base class, which starts processes; they inherit the mask of signals."""
        with without_interrupts():
            return super().submit(*arguments, **options)


@contextlib.contextmanager
def without_interrupts() -> Iterator[None]:
    """Context in which new processes get no interrupt from the terminal."""
    resource_tracker.ensure_running()  # else it starts with the first process, and lets SIGINT through again
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with(parent: int) -> None:
    """Make this process end when its parent ends, also after a crash of the parent."""

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def own_environment() -> dict[str, str]:
    """The environment for a process that a worker starts: it is no rank of the worker's MPI, and computes on one core."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_OF_MPI)}
    return kept | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _mpi() -> Executor:
    """The ranks of `mpiexec -n N python -m mpi4py.futures ...` (Rogowski et al. 2023, doi:10.1109/TPDS.2022.3225481)."""
    from mpi4py import MPI
    from mpi4py.futures import MPIPoolExecutor

    if MPI.COMM_WORLD.Get_size() < 2:
        raise PlacementError(
            "the executor mpi needs two ranks or more: mpiexec -n N python -m mpi4py.futures -m coupler sweep ... --executor mpi"
        )
    pool: Executor = MPIPoolExecutor(main=False)
    return pool


def _slurm(count: int, folder: Path, options: dict[str, str]) -> Executor:
    """Pilot jobs (Babuji et al. 2019, doi:10.1145/3307681.3325400): each takes computations until none is left or its time is over."""
    if shutil.which("sbatch") is None:
        raise PlacementError(
            "the executor slurm needs the command sbatch, which is not installed here: use a Slurm cluster, or another --executor"
        )
    try:
        from parsl.concurrent import ParslPoolExecutor
        from parsl.config import Config
        from parsl.executors import HighThroughputExecutor
        from parsl.launchers import SimpleLauncher
        from parsl.providers import SlurmProvider
    except ModuleNotFoundError as error:
        raise PlacementError("the executor slurm needs Parsl: pip install coldspray[cluster]") from error
    cores = options.pop("cores")
    if not (cores.isdecimal() and int(cores) > 0):
        raise PlacementError(
            f"--slurm cores={cores}: give a whole number of at least 1: runs computed at the same time in one Slurm job"
        )
    at_once, time = min(int(cores), count), options.pop("time")
    if not re.fullmatch(r"\d+:\d\d:\d\d", time):
        raise PlacementError(f"--slurm time={time}: give hours, minutes and seconds, such as 04:00:00")
    provider = SlurmProvider(
        partition=options.pop("partition", None),
        account=options.pop("account", None),
        cores_per_node=at_once,
        init_blocks=0,
        max_blocks=-(-count // at_once),
        walltime=time,
        scheduler_options="".join(f"#SBATCH --{name}={value}\n" for name, value in options.items()),
        worker_init=f"export PATH={Path(sys.executable).parent}:$PATH PYTHONPATH={os.pathsep.join(filter(None, sys.path))}",
        exclusive=False,
        launcher=SimpleLauncher(),
    )
    workers = HighThroughputExecutor(
        "slurm",
        provider,
        interchange_launch_cmd=[sys.executable, "-c", _SERVER],
        max_workers_per_node=at_once,
        encrypted=True,
        working_dir=str(folder),
    )
    config = Config(
        [workers],
        run_dir=str(folder / "slurm"),
        retries=RETRIES,
        strategy="simple",
        initialize_logging=False,
        usage_tracking=0,
    )
    return ParslPoolExecutor(config)
