"""Executors for many independent computations: processes of this machine, MPI ranks of an allocation, or Slurm jobs.

Each executor is a `concurrent.futures.Executor`. The caller submits functions of a module with arguments that can be pickled.
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
from shlex import quote
from typing import Any

from ..errors import ColdsprayError
from ..units import nearest
from .process import search_cycles_less

KINDS = ("processes", "mpi", "slurm")
# option of a Slurm job -> default value; sbatch receives all other options
SLURM = {"cores": "1", "time": "01:00:00"}
RETRIES = 3  # of a computation that has not ended when its Slurm job ends
# Program of Parsl's server of the jobs. It ends when the process that started it ends (prctl 1): otherwise the jobs of a killed sweep
# wait for work until their time limit.
WITH_PARENT = "import ctypes, signal; ctypes.CDLL(None).prctl(1, signal.SIGTERM)"
_SERVER = (
    f"{WITH_PARENT}; import runpy; runpy.run_module('parsl.executors.high_throughput.interchange', run_name='__main__')"
)
# glibc uses huge pages where the system has them: this saves up to a tenth of the time of a late impact of a coating
MEMORY = {"GLIBC_TUNABLES": "glibc.malloc.hugetlb=1"}
# variables by which a process joins the ranks of its parent
_OF_MPI = ("PMI", "PMIX", "OMPI_", "MPI_", "MPICH_", "HYDI_", "HYDRA_")


def executor(
    kind: str, count: int, folder: Path, slurm: Mapping[str, str] | None = None, *, starts_processes: bool = False
) -> Executor:
    """An executor of one of KINDS for `count` computations at a time; `mpi` uses all ranks but the first.

    folder: for logs of Slurm jobs. slurm: options by name: `cores` is the number of computations at a time in a job, `time` the limit
    of a job, all others are options of sbatch. starts_processes: whether the functions start processes themselves: `processes` then
    uses threads; if not, it adds MEMORY to the environment of this process. Raises ColdsprayError if `kind` cannot be used.
    """
    if kind == "processes":
        if starts_processes:
            return ThreadPoolExecutor(count)
        for name, value in MEMORY.items():  # a process reads it when it starts
            os.environ.setdefault(name, value)
        return _Processes(count, get_context("spawn"), begin_worker, (os.getpid(),))
    if kind == "mpi":
        return _mpi()
    if kind == "slurm":
        return _slurm(count, folder, {**SLURM, **(slurm or {})})
    raise ColdsprayError(f"unknown executor {kind!r}{nearest(kind, KINDS)}; known: {', '.join(KINDS)}")


class _Processes(ProcessPoolExecutor):
    """Processes that receive no interrupt from the terminal, also while they start: the parent handles it."""

    def submit(self, *arguments: Any, **options: Any) -> Future[Any]:
        """Submit a call as the base class does. This starts processes, which inherit the signal mask."""
        with without_interrupts():
            return super().submit(*arguments, **options)


@contextlib.contextmanager
def without_interrupts() -> Iterator[None]:
    """Context in which new processes receive no interrupt from the terminal."""
    resource_tracker.ensure_running()  # otherwise it starts with the first process and unblocks SIGINT
    before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def begin_worker(parent: int) -> None:
    """Prepare this process to compute for its parent process, and to end when the parent ends or crashes. parent: process id."""
    search_cycles_less()

    def watch() -> None:
        while os.getppid() == parent:
            time.sleep(1.0)
        os._exit(1)

    threading.Thread(target=watch, daemon=True).start()


def own_environment() -> dict[str, str]:
    """The environment for a process that a worker starts: it does not join the MPI of the worker, and computes on one core."""
    kept = {name: value for name, value in os.environ.items() if not name.startswith(_OF_MPI)}
    return kept | {"OMP_NUM_THREADS": "1", "OPENBLAS_NUM_THREADS": "1"}


def _mpi() -> Executor:
    """Executor on the ranks of `mpiexec -n N python -m mpi4py.futures ...` (Rogowski et al. 2023, doi:10.1109/TPDS.2022.3225481)."""
    from mpi4py import MPI
    from mpi4py.futures import MPIPoolExecutor

    if MPI.COMM_WORLD.Get_size() < 2:
        start = "mpiexec -n N python -m mpi4py.futures -m coupler sweep ... --executor mpi"
        raise ColdsprayError(f"the executor mpi needs two ranks or more: {start}")
    return MPIPoolExecutor(main=False)


def _slurm(count: int, folder: Path, options: dict[str, str]) -> Executor:
    """Executor that uses pilot jobs of Slurm (Babuji et al. 2019, doi:10.1145/3307681.3325400). Each job computes until no
    computation is left or its time limit is reached."""
    if shutil.which("sbatch") is None:
        lacks = "the executor slurm needs the command sbatch, which is not installed on this machine"
        raise ColdsprayError(f"{lacks}: use a Slurm cluster, or another --executor")
    try:
        from parsl.concurrent import ParslPoolExecutor
        from parsl.config import Config
        from parsl.executors import HighThroughputExecutor
        from parsl.launchers import SimpleLauncher
        from parsl.providers import SlurmProvider
    except ModuleNotFoundError as error:
        raise ColdsprayError("the executor slurm needs Parsl: pip install coldspray[cluster]") from error
    cores = options.pop("cores")
    if not (cores.isdecimal() and int(cores) > 0):
        needed = "give the number of runs at the same time in one Slurm job, a whole number of at least 1"
        raise ColdsprayError(f"--slurm cores={cores}: {needed}")
    at_once, time = min(int(cores), count), options.pop("time")
    if not re.fullmatch(r"\d+:\d\d:\d\d", time):
        raise ColdsprayError(f"--slurm time={time}: give hours, minutes and seconds, such as 04:00:00")
    provider = SlurmProvider(
        partition=options.pop("partition", None),
        account=options.pop("account", None),
        cores_per_node=at_once,
        init_blocks=0,
        max_blocks=-(-count // at_once),
        walltime=time,
        scheduler_options="".join(f"#SBATCH --{name}={value}\n" for name, value in options.items()),
        worker_init=f'export PATH={quote(str(Path(sys.executable).parent))}:"$PATH"'
        f" PYTHONPATH={quote(os.pathsep.join(filter(None, sys.path)))}",
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
    return ParslPoolExecutor(
        Config([workers], run_dir=str(folder / "slurm"), retries=RETRIES, initialize_logging=False)
    )
