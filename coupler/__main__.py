"""Lets `python -m coupler ...` do the same as the command `coldspray ...`; mpiexec starts this module."""

from .commands.main import main

raise SystemExit(main())
