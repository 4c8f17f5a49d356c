# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Threads that share the rows of a batch."""

import collections
import contextlib
import functools
import os
import threading
from collections.abc import Callable
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

from .. import checks

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
