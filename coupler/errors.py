"""Errors for the user. The command line turns each of them into one message and an exit code. Other exceptions are bugs and keep
their traceback."""

import os

# environment variables in which launchers of MPI give the rank of a process
_RANK = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK")
# and the number of ranks
_SIZE = ("PMI_SIZE", "OMPI_COMM_WORLD_SIZE", "SLURM_STEP_NUM_TASKS")


def is_first_rank() -> bool:
    """Whether this process prints messages: it is the only process, or rank 0."""
    return all(os.environ.get(name, "0") == "0" for name in _RANK)


def is_only_process() -> bool:
    """Whether no launcher of MPI has started other processes of this run."""
    return is_first_rank() and all(os.environ.get(name, "1") == "1" for name in _SIZE)


class ColdsprayError(Exception):
    """An error that the user can correct: the message names the field or file and the remedy."""

    exit_code = 2


class SceneError(ColdsprayError):
    """A scene that cannot be computed. problems: one line for each problem of the scene."""

    def __init__(self, problems: list[str], source: str = "scene"):
        self.problems = problems
        self.source = source
        head = f"{source}: {len(problems)} problem{'s' if len(problems) > 1 else ''}"
        super().__init__("\n  - ".join([head, *problems]))

    def __reduce__(self) -> tuple[type["SceneError"], tuple[list[str], str]]:
        return type(self), (self.problems, self.source)  # for pickle: MPI ranks send errors to each other


class StoreError(ColdsprayError):
    """A result folder or file that cannot be read or written."""


class UnreadableError(StoreError):
    """A file that exists but cannot be read, for example without permission: its content may be intact."""


class CheckpointError(StoreError):
    """A checkpoint from which a run cannot continue: the message gives reason and remedy."""


class SplatError(ColdsprayError):
    """A cloud of points that cannot become a finite-element body: the message gives reason and remedy."""


class DependencyError(ColdsprayError):
    """A package that is missing or broken: the message gives its name and how to install it."""


class InterruptedRunError(ColdsprayError):
    """A run of a study that was stopped from outside: the next attempt continues it."""

    exit_code = 130


class NoContactError(ColdsprayError):
    """A particle that does not touch the target."""

    exit_code = 3


class SolverError(ColdsprayError):
    """A computation that failed: the message says where, when, and what to try. Earlier results stay readable."""

    exit_code = 3
