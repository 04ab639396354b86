"""A queued process: it waits until no other process of its workspace computes, then it executes `coldspray WORDS`."""

import fcntl
import os
import resource
import signal
import sys


def main(lock: str, *words: str) -> None:
    """Wait for the lock on a file, then execute `coldspray WORDS`. The command holds the lock until it ends. lock: path of the file."""
    # the run must not inherit the memory limit of the server, nor that SIGINT is ignored, which a shell can cause
    signal.signal(signal.SIGINT, signal.SIG_DFL)
    most = resource.getrlimit(resource.RLIMIT_DATA)[1]
    resource.setrlimit(resource.RLIMIT_DATA, (most, most))
    descriptor = os.open(lock, os.O_RDWR | os.O_CREAT, 0o600)
    fcntl.flock(descriptor, fcntl.LOCK_EX)
    os.set_inheritable(descriptor, True)
    print("coldspray", *words, flush=True)
    os.execv(sys.executable, [sys.executable, "-m", "coupler", *words])


if __name__ == "__main__":
    main(*sys.argv[1:])
