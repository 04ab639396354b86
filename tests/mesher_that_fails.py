"""Fillings of a surface that die or take too long, for a process of their own."""

import os
import signal
import time


def dies(*_arguments: object) -> None:
    os.kill(os.getpid(), signal.SIGSEGV)


def hangs(*_arguments: object) -> None:
    time.sleep(600)
