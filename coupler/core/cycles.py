"""The search of Python for cycles of references."""

import atexit
import gc

# New objects before a search. Modules and kernels are 200 000 objects that stay: with Python's 700 the searches take 0.3 s of a short
# run.
SEARCH_AFTER = 10_000


def search_cycles_less() -> None:
    """Let this process search for cycles of references less often, and not as it ends: the system frees its memory, and the last
    searches would take 0.5 s."""
    gc.set_threshold(SEARCH_AFTER)
    atexit.register(gc.freeze)
