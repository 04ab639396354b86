"""`python -m coupler ...` is `coldspray ...`; what mpiexec starts."""

from .commands.main import main

raise SystemExit(main())
