"""The command `coldspray job`: does it stick, how much of it, what coating?"""

import argparse
from pathlib import Path

from .arguments import Commands, add_command, add_jobs, add_quiet, jobs_of, path, teller


def add(commands: Commands) -> None:
    """Add the command to a parser's subcommands."""
    option = add_command(commands, "job", run, "answer on one page what a powder does on a substrate, in a given time")
    option("job", type=path, metavar="FILE", help="file of a job (TOML); coldspray new job NAME writes one")
    option("--out", type=path, metavar="DIR", help="folder of the runs and of the page (default: runs/job-<name>)")
    add_quiet(option)
    add_jobs(option, "cores that share the work")


def run(arguments: argparse.Namespace) -> int:
    """Run the command, or go on with it. Returns the exit code. Raises ColdsprayError for what a user can mend."""
    from ..files.inputs import read_text
    from ..plan.job import processor_time, read
    from ..studies import job as study
    from .accuracy import here

    job = read(arguments.job)
    out, say = arguments.out or Path("runs") / f"job-{job.name}", teller(arguments.quiet)
    try:
        known = study.compute(
            job, read_text(arguments.job), out, processor_time(here().factor), jobs_of(arguments), say
        )
    except KeyboardInterrupt:
        say(f"stopped; the same command goes on in {out}")
        raise
    if not arguments.quiet:
        print("\n".join(known["answer"]))
        print(f"\npage in {out / study.PAGE}, numbers in {out / study.RECORD}\n{known['more_time']}")
    return 0
