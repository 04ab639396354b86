"""A mesher for tests that dies or hangs in its first try, as SPLAT_FAILURE says; after that it is the real one."""

import os
import signal
import sys
import time
from pathlib import Path

from coupler.geometry import mesher
from coupler.splat import worker

real = mesher.fill


def fill(*arguments):
    if len((Path(sys.argv[1]) / "attempts.jsonl").read_text().splitlines()) == 1:
        if os.environ["SPLAT_FAILURE"] == "dies":
            os.kill(os.getpid(), signal.SIGSEGV)
        Path(os.environ["SPLAT_HANGS"]).touch()
        time.sleep(600)
    return real(*arguments)


mesher.fill = fill
if __name__ == "__main__":
    worker.main(Path(sys.argv[1]))
