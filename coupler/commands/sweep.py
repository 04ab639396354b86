"""The command `coldspray sweep`: many runs of one scene with varied keys, and the distributions of their measures."""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from ..errors import ColdsprayError, StoreError
from ..files.outputs import MARK, claim_folder
from ..measures import UNDECIDED
from ..studies.table import in_columns
from .arguments import Commands, add_command, add_jobs, add_quiet, jobs_of, path, teller, working

if TYPE_CHECKING:
    from ..studies.distribution import Spread
    from ..studies.sweep import Sweep

_PLANNED = 20  # points whose planned times represent those of all points in the forecast
_START = 2.0  # s: start of the process of a run
OUTPUTS = ("sweep.csv", "distribution.csv", "distribution.png")


def add(commands: Commands) -> None:
    option = add_command(commands, "sweep", run, "compute the points of a sweep that are not finished")
    text = "file of the sweep (TOML): coldspray new map NAME, or ensemble NAME"
    option("sweep", type=path, metavar="FILE", help=text)
    option("--out", type=path, metavar="DIR", help="folder of the runs (default: runs/<name of the sweep>)")
    add_jobs(option, "number of simultaneous runs")
    option("--executor", default="processes", metavar="WHERE",
           help="where the runs are computed: processes (this machine; default), mpi (ranks of an allocation:"
           " mpiexec -n N python -m mpi4py.futures -m coupler sweep"
           " ...), or slurm (jobs that compute one run after another)")  # fmt: skip
    option("--slurm", type=_slurm_option, action="append", default=[], metavar="KEY=VALUE",
           help="option of the Slurm jobs, may be repeated: cores=32 (runs at the same time in a job; default 1), time=04:00:00"
           " (default 01:00:00), partition=, account=, and any other option of sbatch")  # fmt: skip
    text = "compute points again whose results belong to another scene"
    option("--force", action="store_true", help=text)
    add_quiet(option)


def _slurm_option(text: str) -> tuple[str, str]:
    key, sign, value = text.lstrip("-").partition("=")
    if not sign or not key or "\n" in text:
        raise argparse.ArgumentTypeError(f"{text!r}: expected KEY=VALUE, such as partition=short")
    return key, value


def run(arguments: argparse.Namespace) -> int:
    from ..core.executors import executor
    from ..studies.runs import of_another_scene, run_points
    from ..studies.sweep import Sweep

    sweep = Sweep.load(arguments.sweep)
    out = arguments.out or Path("runs") / sweep.name
    if arguments.slurm and arguments.executor != "slurm":
        remedy = "leave --slurm out, or give --executor slurm"
        raise ColdsprayError(f"--slurm: the executor is {arguments.executor}: {remedy}")
    claim_folder(out, "sweep", OUTPUTS, force=None)
    if (others := of_another_scene(out, sweep.points)) and not arguments.force:
        there = f"{out} holds results of {len(others)} points, such as {others[0]}, for another scene"
        raise StoreError(f"{there}: name another folder with --out, or compute all points again with --force")
    here = arguments.executor == "processes"
    jobs = jobs_of(arguments) if here else arguments.jobs or 1
    pool = executor(arguments.executor, jobs, out.resolve(), dict(arguments.slurm), starts_processes=True)
    if not arguments.quiet:
        print(_forecast(sweep, jobs if here else 0), flush=True)
    statuses = run_points(out, sweep.points, jobs, teller(arguments.quiet, "stdout"), sweep.refused, pool)
    with working("reading the runs", arguments.quiet):
        summary = summarise(sweep, out)
    if not arguments.quiet:
        print("\n".join(summary))
    stopped = sum(status == "stopped" for status in statuses.values())
    if stopped:
        print(f"{stopped} of {len(statuses)} runs are not finished: repeat the command to continue them")
    return 3 if stopped else 0


def _forecast(sweep: "Sweep", jobs: int) -> str:
    """Text: number of points of the sweep, and wall time of all with `jobs` simultaneous runs on this machine. jobs 0: the runs are
    on other machines, and the text gives no time."""
    from ..plan.planning import plan
    from ..plan.reading import Scene
    from ..plan.text import duration
    from .accuracy import here

    count = len(sweep.points)
    if not jobs:
        return f"{count} points"
    names = [name for name in sweep.points if name not in sweep.refused]
    some = names[:: -(-len(names) // _PLANNED)]
    pace = here()
    each = sum(pace.seconds(plan(Scene.from_text(sweep.points[name], name))) for name in some) / len(some)
    seconds = len(names) * (each + _START) / jobs
    return f"{count} points, about {duration(seconds)} for all with {jobs} at a time, after compilation"


def summarise(sweep: "Sweep", out: Path) -> list[str]:
    """Write the table of all points and, for an ensemble, the distributions into a folder. Returns text lines."""
    from ..studies import distribution, runs_table

    rows = [row for row in runs_table.table(out) if row["point"] in sweep.points]
    keys = distribution.varied_numbers(rows, sweep.varied)
    for row in rows:
        row |= {key: row["keys"].get(key) for key in keys}
    runs_table.write_table(rows, out / OUTPUTS[0], f"{MARK} sweep; SI units", keys)
    count = runs_table.counts(rows)
    lines = [f"{len(rows)} points: " + ", ".join(f"{n} {status}" for status, n in count.items() if n)]
    bad = [row for row in rows if row["status"] in ("failed", "undecided")]
    lines += [f"  {row['point']}: {row['status']}: {str(row['reason'])[:160]}" for row in bad]
    measures = distribution.spreads(rows, keys) if sweep.is_ensemble else []
    if measures:
        verdicts = sorted(row["verdict"] or UNDECIDED for row in rows if row["status"] in ("done", "undecided"))
        told = ", ".join(f"{verdicts.count(word)} {word}" for word in dict.fromkeys(verdicts))
        lines += ["", *_table(measures), f"verdicts: {told}", ""]
        distribution.write_spreads(out / OUTPUTS[1], measures, f"{MARK} distribution; SI units")
        heading = f"{sweep.name}: {count['done']} runs; line: median, shaded: 5 % to 95 %"
        distribution.draw_spreads(out / OUTPUTS[2], measures, heading)
        return [*lines, f"tables in {out / OUTPUTS[0]} and {OUTPUTS[1]}, figure in {OUTPUTS[2]}"]
    axes = f" --axes {' '.join(keys)}" if keys else ""
    return [*lines, f"table in {out / OUTPUTS[0]}; maps: coldspray map {out}{axes}"]


def _table(measures: "Sequence[Spread]") -> list[str]:
    """The distributions as aligned text lines. The column `error` is the median of the resolution errors."""
    head = ("", "runs", "mean", "deviation", "error", "5 %", "median", "95 %", "unit", "strongest rank correlation")
    cells: list[tuple[str, ...]] = [head]
    for spread in measures:
        m = spread.measure
        low, middle, high = spread.quantiles[0], spread.quantiles[len(spread.quantiles) // 2], spread.quantiles[-1]
        numbers = (spread.values.mean(), spread.values.std(ddof=1), spread.error, low, middle, high)
        texts = ("-" if x is None else f"{m.factor * x:.4g}" for x in numbers)
        cells.append((m.label, str(len(spread.values)), *texts, m.unit, spread.strongest))
    return in_columns(cells, range(1, 8))
