"""What can go wrong, and who has to act on it.

The command line turns each of these into one message and an exit code; anything else is a bug and keeps its traceback.
"""


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


class StoreError(ColdsprayError):
    """A result folder or file that cannot be read or written."""


class SolverError(ColdsprayError):
    """A computation that broke down: says where, when, and what to try. What was written before stays readable."""

    exit_code = 3
