"""Number of processors that this process may use."""

import math
import os
from contextlib import suppress
from pathlib import Path

CGROUP = Path("/sys/fs/cgroup")


def cores() -> int:
    """Number of processors that this process may use: the limits are its affinity, its container and its Slurm job."""
    granted = [float(len(os.sched_getaffinity(0)))]
    with suppress(OSError, ValueError):
        quota, period = (CGROUP / "cpu.max").read_text().split()
        granted.append(float(quota) / float(period))
    with suppress(KeyError, ValueError):
        granted.append(float(os.environ["SLURM_CPUS_PER_TASK"]))
    return max(1, math.ceil(min(granted) - 1e-9))
