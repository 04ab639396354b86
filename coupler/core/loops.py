"""Loops that several threads go through together (numba).

All threads call the same compiled function with the same `team`, each when it is free. Its loops are divided into ranges that any
thread takes, and the next loop begins when all ranges of this one are done. What stands between the loops is done by every thread.
"""

from collections.abc import Callable, Iterator, Sequence
from typing import Protocol

from numba import types
from numba.core import cgutils
from numba.core.base import BaseContext
from numba.core.typing.templates import Signature
from numba.extending import intrinsic

from ..compiling import njit
from .arrays import Ints

LOOPS = 8  # in a compiled function, at most
PARTS = 64  # ranges that a loop is divided into, at most: four for each of sixteen threads
SPINS = 20_000  # looks at a counter before another thread may have the processor: some tenths of a millisecond
PATIENCE = 100_000  # looks, about a millisecond: longer than what one thread does alone between two loops of a step
FAILED = 2 * LOOPS  # place in a team that is not zero after a failure

_yield_processor = types.ExternalFunction("sched_yield", types.int32())


class _Builder(Protocol):
    """What is needed of LLVM's builder of instructions."""

    def atomic_rmw(self, op: str, ptr: object, val: object, ordering: str) -> object: ...


def _atomic_add(_: object, counters: types.Array, place: types.Type, amount: types.Type) -> tuple[Signature, object]:
    def code(context: BaseContext, builder: _Builder, signature: Signature, values: Sequence[object]) -> object:
        array = context.make_array(counters)(context, builder, values[0])
        pointer = cgutils.get_item_pointer(context, builder, counters, array, [values[1]])
        return builder.atomic_rmw("add", pointer, values[2], "seq_cst")

    return types.int64(counters, types.int64, types.int64), code


#: counters[place] += amount, at once for all threads; the value before.
_add: Callable[[Ints, int, int], int] = intrinsic(_atomic_add)  # type: ignore[assignment]


@njit(nogil=True)  # a generator from numba's cache cannot be compiled into its callers: it is cached with them
def ranges(team: Ints, loop: int, count: int, least: int) -> Iterator[tuple[int, int, int]]:
    """Ranges (lo, hi, part) that make up [0, count), `least` long or longer, left to this thread; ends when all are done.

    team (FAILED + 1,): how many ranges of each loop are taken and done, zero at the beginning; and FAILED, with which other threads
    stop waiting. The ranges depend on count and least alone: sums over parts, added in their order, have the same value
    with any number of threads. A thread may start after the caller has returned: it finds no ranges then, but evaluates the counts
    again, which must not have changed.
    """
    parts = max(1, min(PARTS, count // least))
    while True:
        part = _add(team, 2 * loop, 1)
        if part >= parts:
            break
        yield count * part // parts, count * (part + 1) // parts, part
        _add(team, 2 * loop + 1, 1)
    looks = 0
    while _add(team, 2 * loop + 1, 0) < parts and team[FAILED] == 0:
        looks += 1
        if looks > SPINS:
            _yield_processor()


@njit(cache=True, nogil=True)
def wait_for(team: Ints) -> None:
    """Wait for another thread to take a range, without sleeping, but not for long."""
    looks = 0
    while _add(team, 0, 0) == 0 and looks < PATIENCE:
        looks += 1
