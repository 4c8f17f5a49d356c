# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows go to the parts that they meet, wherever those are asked."""

from collections.abc import Iterator
from concurrent.futures import Executor, as_completed
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tree import DynamicBVH
from ..tree.access import NONE
from .parts import ask

# Rows that are answered at once, and rows of one task: what bounds the memory of who asks, and of
# a worker.
ROWS_AT_ONCE, ROWS_A_TASK = 1 << 20, 1 << 17


class Asking(NamedTuple):
    """Where a forest is, and who asks its parts."""

    folder: str
    checksums: list[int]
    executor: Executor | None

    def each(
        self,
        query: str,
        rows: NDArray[np.int64],
        parts: NDArray[np.int64],
        columns: Any,
        *rest: Any,
    ) -> Iterator[tuple[NDArray[np.int64], int, Any]]:
        """Ask row ``rows[i]`` of part ``parts[i]``, all i: (rows, part, answer) as they come.

        `columns`: arrays of what is asked, one entry a row; `rest`: the same for all rows.
        """

        def call(some: NDArray[np.int64], part: int) -> tuple[Any, ...]:
            given = (column[some] for column in columns)
            return self.folder, self.checksums[part], part, query, *given, *rest

        tasks = _tasks(rows, parts)
        if self.executor is None:
            for task in tasks:
                yield *task, ask(*call(*task))
            return
        submit = self.executor.submit
        submitted = {submit(ask, *call(*task)): (task, False) for task in tasks}
        try:
            while submitted:
                for future in as_completed(list(submitted)):
                    task, is_again = submitted.pop(future)
                    try:
                        found = future.result()
                    except Exception:
                        if is_again:
                            raise
                        # Dask may lose an answer together with the worker that gave it.
                        submitted[submit(ask, *call(*task))] = task, True
                        break  # wait for this one, too
                    yield *task, found
        finally:  # an error, or an interruption: what was not begun is not wanted any more
            for future in submitted:
                future.cancel()


def _tasks(
    rows: NDArray[np.int64], parts: NDArray[np.int64]
) -> Iterator[tuple[NDArray[np.int64], int]]:
    """Rows of one part, not too many."""
    order = np.argsort(parts, kind='stable')
    for group in np.split(order, np.flatnonzero(np.diff(parts[order])) + 1):
        for first in range(0, len(group), ROWS_A_TASK):
            some = group[first : first + ROWS_A_TASK]
            yield rows[some], int(parts[some[0]])


def parts_of(top: DynamicBVH, handles: NDArray[np.int64]) -> NDArray[np.int64]:
    """Numbers of parts, by their handles in the tree over the parts; NONE stays."""
    return np.where(handles == NONE, NONE, np.searchsorted(top.ids(), handles))


def pieces(count: int) -> Iterator[slice]:
    """All rows, so many at once; one piece of none where there are none."""
    for start in range(0, max(count, 1), ROWS_AT_ONCE):
        yield slice(start, min(start + ROWS_AT_ONCE, count))
