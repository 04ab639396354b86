"""What can go wrong, and who has to act on it.

The command line turns each of these into one message and an exit code; anything else is a bug and keeps its traceback.
"""

import os

# what launchers of MPI programs tell a process of its rank
_RANK = ("PMI_RANK", "PMIX_RANK", "OMPI_COMM_WORLD_RANK")


def is_first_rank() -> bool:
    """Whether this process prints messages: the only process, or rank 0."""
    return all(os.environ.get(name, "0") == "0" for name in _RANK)


class ColdsprayError(Exception):
    """Something the user can mend: the message names the field or file and the remedy."""

    exit_code = 2


class SceneError(ColdsprayError):
    """A scene that cannot be computed. `problems` holds one line for each thing wrong, all found at once."""

    def __init__(self, problems: list[str], source: str = "scene"):
        self.problems = problems
        self.source = source
        head = f"{source}: {len(problems)} problem{'s' if len(problems) > 1 else ''}"
        super().__init__("\n  - ".join([head, *problems]))

    def __reduce__(self) -> tuple[type["SceneError"], tuple[list[str], str]]:
        return type(self), (self.problems, self.source)  # errors travel between ranks


class StoreError(ColdsprayError):
    """A result folder or file that cannot be read or written."""


class UnreadableError(StoreError):
    """A file that exists but cannot be read, such as one without permission: its content may be complete."""


class CheckpointError(StoreError):
    """A checkpoint from which a run cannot continue: the message says why, and what to do."""


class SplatError(ColdsprayError):
    """A cloud of points that cannot become a finite-element body: says what is wrong with it and what to change."""


class DependencyError(ColdsprayError):
    """A package that is missing or broken: names it, and how to install it."""


class PlacementError(ColdsprayError):
    """Ranks that cannot be arranged as asked."""


class WorkerError(ColdsprayError):
    """A process that computed a part of a run and was ended from outside."""


class InterruptedRunError(ColdsprayError):
    """A run of a study that was stopped from outside: it is not finished, and the next attempt continues it."""

    exit_code = 130


class NoContactError(ColdsprayError):
    """A particle that has not touched the target: there is no impact to measure."""

    exit_code = 3


class SolverError(ColdsprayError):
    """A computation that failed: the message says where, when, and what to try. Files written before stay readable."""

    exit_code = 3
