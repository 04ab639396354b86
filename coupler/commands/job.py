"""The command `coldspray job`: one page that answers whether a powder sticks, with which deposition efficiency, and what coating it
makes."""

import argparse
from pathlib import Path

from ..files.inputs import read_text
from .arguments import Commands, add_command, add_jobs, add_quiet, continuing, jobs_of, path, teller


def add(commands: Commands) -> None:
    option = add_command(
        commands, "job", run, "compute, in a given time, one page that says whether a powder sticks to a substrate"
    )
    option("job", type=path, metavar="FILE", help="file of a job (TOML); coldspray new job NAME writes one")
    option("--out", type=path, metavar="DIR", help="folder of the runs and of the page (default: runs/job-<name>)")
    add_quiet(option)
    add_jobs(option, "cores that share the work")


def run(arguments: argparse.Namespace) -> int:
    """Compute a job, or continue an unfinished one. Returns the exit code. Raises ColdsprayError for an error of the user."""
    from ..plan.job import read
    from ..plan.planning import plan
    from ..studies import job as study
    from .accuracy import here

    job = read(arguments.job)
    out, say = arguments.out or Path("runs") / f"job-{job.name}", teller(arguments.quiet)
    with continuing(out, say):
        pace, text = here(), read_text(arguments.job)
        known = study.compute(job, text, out, lambda scene: pace.seconds(plan(scene)), jobs_of(arguments), say)
    if not arguments.quiet:
        print("\n".join(known["answer"]))
        print(f"\npage in {out / study.PAGE}, numbers in {out / study.RECORD}\n{known['more_time']}")
    return 0
