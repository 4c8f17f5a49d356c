# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Threads: turns of queries and changes, and the pool that shares rows."""

import collections
import contextlib
import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from numba import types
from numba.extending import intrinsic

from .. import checks
from ..compiler import elements_at, index, inlined
from ..nodes import CHANGES, EXACT_RAYS, RAYS, TURN

ANY_VERSION = -1

# The word counts queries; these are far below zero, whatever is counted on top of them.
CHANGING = -(1 << 40)
UNFILLED = -(1 << 50)  # storage that waits for what it is to hold

# Why a kernel did nothing.
QUERIED, CHANGED = -1, -2
# Why a query of one box or ray did nothing: its numbers are not finite, or it got no turn.
NOT_FINITE, REFUSED = -2, -3
IS_QUERIED = 'the tree is being queried by another thread'
IS_CHANGED = 'the tree is being changed by another thread'


@intrinsic
def add_atomically(typingctx, array, place, amount):
    """array[place] += amount (an int64 array); what it was before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = elements_at(context, builder, signature.args[0], args[0], args[1], index(1))
        return builder.atomic_rmw('add', word, args[2], 'acq_rel')

    return types.int64(array, types.int64, types.int64), codegen


@intrinsic
def replace_atomically(typingctx, array, place, expected, value):
    """array[place] = value if it is as expected (an int64 array); what it was before."""

    def codegen(context: Any, builder: Any, signature: Any, args: Any) -> Any:
        word = elements_at(context, builder, signature.args[0], args[0], args[1], index(1))
        previous = builder.cmpxchg(word, args[2], args[3], 'acq_rel', 'acquire')
        return builder.extract_value(previous, 0)

    return types.int64(array, types.int64, types.int64, types.int64), codegen


@inlined
def begin_query(state, version):
    """Whether there is a turn, and the tree is of this version (or ANY_VERSION will do)."""
    if add_atomically(state, TURN, 1) >= 0 and (
        version == ANY_VERSION or state[CHANGES] == version
    ):
        return True
    add_atomically(state, TURN, -1)
    return False


@inlined
def end_query(state):
    add_atomically(state, TURN, -1)


def accepted(done: int) -> int:
    """What a query's kernel returned; RuntimeError if that is negative: it did not get a turn."""
    if done < 0:
        raise RuntimeError(IS_CHANGED)
    return done


@inlined
def count_rays(state, rays, exact):
    """Count rays, and those of them that took exact arithmetic, while others do."""
    add_atomically(state, RAYS, rays)
    add_atomically(state, EXACT_RAYS, exact)


@inlined
def begin_change(state, version):
    """0 if there is a turn, and the tree is of this version; else QUERIED or CHANGED."""
    previous = replace_atomically(state, TURN, 0, CHANGING)
    if previous != 0:
        return QUERIED if previous > 0 else CHANGED
    if version != ANY_VERSION and state[CHANGES] != version:
        add_atomically(state, TURN, -CHANGING)
        return CHANGED
    return 0


@inlined
def end_change(state, changed):
    """Give the turn back; `changed`: the tree is of another version now."""
    state[CHANGES] += changed
    add_atomically(state, TURN, -CHANGING)


# ---- Threads that share the rows of a batch


PIECES_A_THREAD = 4


def in_threads(
    work: Callable[[int, int], Any], count: int, threads: int, together: int = 1
) -> list[Any]:
    """Do work(start, stop) over `count` rows, shared among so many threads; results in the order
    of the rows.

    Kernels release the GIL. There are more pieces than threads, and a thread that has finished a
    piece takes the next one, so that a thread which the operating system interrupts does not hold
    up the others. A piece has at least `together` rows: below that, a batch loses what it gains
    from answering rows together.
    """
    if type(threads) is not int or threads != 1:  # else it is not worth a microsecond
        threads = max(1, min(checks.whole('threads', threads, 1), count))
    if threads == 1:
        return [work(0, count)]
    pieces = max(threads, min(PIECES_A_THREAD * threads, count // together))
    edges = [count * i // pieces for i in range(pieces + 1)]
    waiting = iter(range(pieces))
    results: list[Any] = [None] * pieces

    def take() -> None:
        for piece in waiting:
            results[piece] = work(edges[piece], edges[piece + 1])

    begun: list[Future[None]] = []

    def help_out() -> None:
        done: Future[None] = Future()
        begun.append(done)  # before the first piece: a helper that has one is waited for
        try:
            take()
        except BaseException as error:
            done.set_exception(error)
        else:
            done.set_result(None)

    try:
        _ask_for_help(help_out, threads - 1)
        take()  # this thread is one of them: it is awake already
    finally:
        # An interrupted call leaves no work behind: a helper that begins now finds none.
        collections.deque(waiting, 0)
        for done in list(begun):
            done.exception()
    for done in list(begun):
        done.result()
    return results


def _ask_for_help(help_out: Callable[[], None], helpers: int) -> None:
    """Ask the pool, as far as it has threads to give: none at the end of the process, or where no
    more can be started. Nor is it asked by a signal handler that interrupted this thread just
    here: the pool's locks cannot be taken twice, and the handler would wait for ever.
    """
    if getattr(_asking, 'now', False):
        return
    try:
        _asking.now = True
        with contextlib.suppress(RuntimeError):
            for _ in range(helpers):
                _workers().submit(help_out)
    finally:
        _asking.now = False


_asking = threading.local()


@functools.cache
def _workers() -> ThreadPoolExecutor:
    """One pool for all, no larger than the machine; kept for the life of the process: starting
    threads costs as much as casting 1,000 rays. Python ends it at exit.
    """
    return ThreadPoolExecutor(os.cpu_count() or 1, 'bvh_ros')


if hasattr(os, 'register_at_fork'):  # a child has the pool, but not its threads
    os.register_at_fork(after_in_child=_workers.cache_clear)
