"""How many processors a process counts on: what it is bound to, less where a container or Slurm grants less."""

import os
from pathlib import Path

import pytest

from coupler.core import cores


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
    monkeypatch.setattr(cores, "CGROUP", tmp_path)
    (tmp_path / "cpu.max").write_text(quota)
    monkeypatch.delenv("SLURM_CPUS_PER_TASK", raising=False)
    if slurm is not None:
        monkeypatch.setenv("SLURM_CPUS_PER_TASK", slurm)
    assert cores.cores() == granted
