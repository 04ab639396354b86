"""How many processors a process counts on: what it is bound to, less where a container or Slurm grants less. How it ends."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

from coupler.core import process


@pytest.mark.parametrize(
    ("quota", "slurm", "granted"),
    [
        ("max 100000", None, 6),
        ("250000 100000", None, 3),
        ("50000 100000", None, 1),
        ("max 100000", "4", 4),
        ("", "x", 6),
    ],
)
def test_what_is_granted_counts(
    quota: str, slurm: str | None, granted: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Of six processors: a quota of two and a half lets three threads work most of the time."""
    monkeypatch.setattr(os, "sched_getaffinity", lambda _: set(range(6)))
    monkeypatch.setattr(process, "CGROUP", tmp_path)
    (tmp_path / "cpu.max").write_text(quota)
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    if slurm is not None:
        monkeypatch.setenv("SLURM_CPUS_PER_TASK", slurm)
    assert process.cores() == granted


def test_a_system_without_affinity_grants_all_its_processors(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """As macOS."""
    monkeypatch.delattr(os, "sched_getaffinity")
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    monkeypatch.setattr(process, "CGROUP", tmp_path)
    monkeypatch.setattr(os, "cpu_count", lambda: 10)
    assert process.cores() == 10


CYCLE = """
from coupler.core.process import search_cycles_less
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
