import subprocess
import sys

import pytest

CYCLE = """
from coupler.core.cycles import search_cycles_less
class Cycle:
    def __init__(self):
        self.itself = self
    def __del__(self):
        print("found")
{first}
Cycle()
"""


@pytest.mark.parametrize(("first", "found"), [("", "found\n"), ("search_cycles_less()", "")])
def test_a_process_does_not_search_for_cycles_as_it_ends(first: str, found: str) -> None:
    done = subprocess.run([sys.executable, "-c", CYCLE.format(first=first)], capture_output=True, text=True, check=True)
    assert done.stdout == found
