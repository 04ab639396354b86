"""The command `coldspray track`: cross-sections of one pass and of a raster of the spray."""

import argparse
import json
from pathlib import Path

from ..files.outputs import MARK, claim_folder, write_text
from .arguments import Commands, add_command, add_force, add_quiet, path, remake, working


def add(commands: Commands) -> None:
    text = "cross-section of one pass of the gun and of a raster; waviness against step"
    option = add_command(commands, "track", run, text)
    option("track", type=path, metavar="FILE", help="file of a track (TOML, coldspray new track NAME) or of a job")
    option("--out", type=path, metavar="DIR", help="folder of the files (default: runs/track-<name>)")
    add_quiet(option)
    add_force(option)


def run(arguments: argparse.Namespace) -> int:
    from ..plan.job import read
    from ..scene.job import TrackData
    from ..studies import track as study

    job = read(arguments.track, TrackData)
    out = arguments.out or Path("runs") / f"track-{job.name}"
    claim_folder(out, "track", study.FILES, [arguments.track], arguments.force)
    with working("computing the powder at the target", arguments.quiet) as progress:
        profiles, known = study.compute(job, arguments.track.parent, progress.stage)
    write_text(out / study.RECORD, json.dumps(known, indent=1) + "\n")
    study.write(profiles, known, out, f"{' + '.join(job.powders)}, {job.name}", f"{MARK} track; {remake(arguments)}")
    if not arguments.quiet:
        print("\n".join([*study.words(known), f"{', '.join(study.FILES)} in {out}"]))
    return 0
