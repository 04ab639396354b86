"""Kill a run at random moments and go on: python workflows/kill_and_resume.py [--kills 20]   # docs/tables/kills.csv

Each run is killed by SIGKILL at a random share of the wall time an undisturbed one takes (some while they start, some while they
write a checkpoint, which happens every 0.1 s here), then resumed, and its summary compared with the undisturbed one's.
"""

import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from pages import TABLES, options, single_impact, write_table

COLUMNS = ("kill", "reached ns", "checkpoints", "half-written", "exit code of resume", "largest relative difference")
OF_THE_MACHINE = {"wall_s", "wall_loop_s", "ranks", "idle_share", "memory_peak_bytes"}


def numbers(tree: dict[str, object], prefix: str = "") -> dict[str, float]:
    """All numbers of a summary that are physics, by their path."""
    values: dict[str, float] = {}
    for name, value in tree.items():
        if isinstance(value, dict):
            values |= numbers(value, f"{prefix}{name}.")
        elif name in ("impacts", "joins") and isinstance(value, list):
            values |= numbers({str(k): item for k, item in enumerate(value)}, f"{prefix}{name}.")
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and name not in OF_THE_MACHINE:
            values[prefix + name] = float(value)
    return values


def command(*arguments: str) -> list[str]:
    """The command line of this environment."""
    return [sys.executable, "-m", "coupler", *arguments, "--quiet"]


def main() -> None:
    """Kill, go on, compare, record."""
    a = options(__doc__, kills=20, seed=1)
    dice = random.Random(a.seed)
    rows: list[dict[str, object]] = []
    with tempfile.TemporaryDirectory() as place:
        scene = Path(place) / "scene.toml"
        scene.write_text(single_impact("Ni", 25.0, 500.0, spacing=2.6))
        start = time.perf_counter()
        subprocess.run(command("run", str(scene), "--out", f"{place}/whole"), check=True)
        wall = time.perf_counter() - start
        whole = numbers(json.loads((Path(place) / "whole" / "summary.json").read_text()))
        for kill in range(a.kills):
            out = Path(place) / f"run{kill}"
            run = subprocess.Popen(command("run", str(scene), "--out", str(out), "--checkpoint", "0.1"))
            while not (out / "scene.toml").exists():  # before, there is nothing to go on with
                time.sleep(0.005)
            moment = dice.random() * 0.9 * wall
            time.sleep(0.0 if kill == 0 else moment)
            os.kill(run.pid, signal.SIGKILL)
            run.wait()
            history = out / "history.csv"
            last = history.read_text().splitlines()[-1].split(",")[0] if history.exists() else "time"
            reached = float(last) * 1e9 if last and last != "time" else 0.0
            files = [len(list(out.glob(name))) for name in ("checkpoint-*.ckpt", "*.part")]
            done = subprocess.run(command("resume", str(out)), capture_output=True, text=True)
            worst = float("nan")
            if done.returncode == 0:
                got = numbers(json.loads((out / "summary.json").read_text()))
                scale = {k: max(abs(v), 1e-12) for k, v in whole.items()}
                worst = max(abs(got[k] - whole[k]) / scale[k] for k in whole)
            values = kill, f"{reached:.1f}", *files, done.returncode, f"{worst:.1e}"
            rows.append(dict(zip(COLUMNS, values, strict=True)))
            print(*values, done.stderr.strip(), flush=True)
    ended = sum(float(str(row[COLUMNS[-1]])) < 1e-6 for row in rows)
    print(f"{ended} of {len(rows)} ended with the undisturbed summary to 1e-6")
    write_table(TABLES / "kills.csv", rows, "remake: python workflows/kill_and_resume.py")


if __name__ == "__main__":
    main()
