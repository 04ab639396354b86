"""`python -m coupler ...` is `coldspray ...`; what mpiexec starts."""

from .cli import main

raise SystemExit(main())
