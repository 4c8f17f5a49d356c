# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Threads that share the rows of a batch."""

import collections
import functools
import os
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

    others: list[Future[None]] = []
    try:
        for _ in range(threads - 1):
            others.append(_workers().submit(take))
        take()  # this thread is one of them: it is awake already
    finally:
        # Who is interrupted leaves no work behind.
        collections.deque(waiting, 0)
        for other in others:
            if not other.cancel():  # it has begun
                other.exception()
    for other in others:
        if not other.cancelled():
            other.result()
    return results


@functools.cache
def _workers() -> ThreadPoolExecutor:
    """One pool for all, no larger than the machine; kept for the life of the process: starting
    threads costs as much as casting 1,000 rays. Python ends it at exit.
    """
    return ThreadPoolExecutor(os.cpu_count() or 1, 'bvh_ros')


if hasattr(os, 'register_at_fork'):  # a child has the pool, but not its threads
    os.register_at_fork(after_in_child=_workers.cache_clear)
