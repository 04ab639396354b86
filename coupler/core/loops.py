"""Loops of a compiled function that several threads share (numba).

All threads call the same compiled function with the same `team`. Each loop is divided into ranges, and each range is done by one
thread. The next loop begins when all ranges are done. Every thread executes the statements between the loops.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Any

from numba import types
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from ..compiling import njit
from .arrays import Ints

LOOPS = 8  # in a compiled function, at most
PARTS = 64  # ranges of a loop, at most: four for each of sixteen threads
SPINS = 20_000  # reads of a counter before the thread yields its processor: some tenths of a millisecond
PATIENCE = 100_000  # reads of a counter, about a millisecond: longer than the work between two loops of a step
FAILED = 2 * LOOPS  # index in a team whose value is not zero after a failure

_yield_processor = types.ExternalFunction("sched_yield", types.int32())


def _atomic_add(_: object, counters: types.Array, place: types.Type, amount: types.Type) -> tuple[Signature, object]:
    def code(context: BaseContext, builder: Any, signature: Signature, values: Sequence[object]) -> object:
        array = context.make_array(counters)(context, builder, values[0])
        pointer = cgutils.get_item_pointer(context, builder, counters, array, [values[1]])
        return builder.atomic_rmw("add", pointer, values[2], "seq_cst")

    return types.int64(counters, types.int64, types.int64), code


#: Atomic counters[place] += amount. Returns the value before.
_add: Callable[[Ints, int, int], int] = intrinsic(_atomic_add)  # type: ignore[assignment]


@njit(nogil=True)  # a generator from numba's cache cannot be compiled into its callers: it is cached with them
def ranges(team: Ints, loop: int, count: int, least: int) -> Iterator[tuple[int, int, int]]:
    """Ranges (lo, hi, part) of [0, count) for this thread, each of at least `least` rows. Ends when all threads have done their ranges.

    team (FAILED + 1,): for each loop the number of ranges begun and done, zero at the start; a value at FAILED ends the waiting. The
    ranges depend on count and least only: sums over parts, added in their order, are equal for any number of threads. A thread may
    start after the caller has returned. Then it finds no range, but it still evaluates `count`. Therefore `count` must not change.
    """
    parts = max(1, min(PARTS, count // least))
    while True:
        part = _add(team, 2 * loop, 1)
        if part >= parts:
            break
        yield count * part // parts, count * (part + 1) // parts, part
        _add(team, 2 * loop + 1, 1)
    polls = 0
    while _add(team, 2 * loop + 1, 0) < parts and team[FAILED] == 0:
        polls += 1
        if polls > SPINS:
            _yield_processor()


@njit(cache=True, nogil=True)
def wait_for(team: Ints) -> None:
    """Wait about a millisecond at most until another thread begins a range, without sleeping."""
    polls = 0
    while _add(team, 0, 0) == 0 and polls < PATIENCE:
        polls += 1
