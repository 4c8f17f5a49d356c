# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Merging the answers of several nodes about the same rows: the nearest obstacle of each."""

from __future__ import annotations

from collections.abc import Mapping
from typing import Any

import numpy as np
from numpy.typing import NDArray

from bvh_ros.client.coverage import Coverage
from bvh_ros.ros.conversions.query_clouds import FREE, UNANSWERED

HANDLE_BITS = 32  # of an obstacle's number; above them is the number of its node

Numbers = NDArray[np.int64]


class Nearest:
    """The nearest obstacle of each of n rows so far.

    Of equal distances at one place, the answer of the node counts in whose region the place lies:
    it knows all that is there. At different places the names decide, see `settle`.
    """

    def __init__(self, kind: Any, bad: NDArray[np.bool_], coverage: Coverage) -> None:
        count = len(bad)
        self._kind, self._coverage = kind, coverage
        self.unknown = bad.copy()
        """(n,) rows about which a node does not know all."""
        blank: dict[str, Any] = {
            't': np.inf,
            'distances': np.inf,
            'points': np.nan,
            'normals': 0.0,
            'obstacles': FREE,
            'counts': 0,
        }
        self._columns: dict[str, Any] = {
            name: np.full(
                (count, 3) if name in ('points', 'normals') else count,
                blank[name],
                np.int64 if name in ('obstacles', 'counts') else np.float64,
            )
            for name in kind._fields
        }
        self._far = 't' if 't' in self._columns else 'distances'
        self.distances = self._columns[self._far]
        self._obstacles, self._points = self._columns['obstacles'], self._columns['points']
        self._ties: list[tuple[Numbers, dict[str, Any]]] = []

    def add(self, rows: Numbers, region: int, answer: Any) -> None:
        """Add the answer of the node of a region about some rows."""
        its = answer._asdict()
        handles = its['obstacles'].astype(np.int64)
        hit = (handles != FREE) & (handles != UNANSWERED)
        self.unknown[rows[handles == UNANSWERED]] = True
        its['obstacles'] = handles | region << HANDLE_BITS
        if 'counts' in its:
            self._count(rows[hit], its.pop('counts')[hit].astype(np.int64))
        rows, its = rows[hit], {name: column[hit] for name, column in its.items()}
        distances = its[self._far]
        known = self._obstacles[rows] != FREE
        nearer = ~known | (distances < self.distances[rows])
        tied = known & (distances == self.distances[rows])
        same = tied & (its['points'] == self._points[rows]).all(axis=1)
        at_home = self._coverage.holds(its['obstacles'] >> HANDLE_BITS, its['points'])
        other = self._coverage.holds(self._obstacles[rows] >> HANDLE_BITS, its['points'])
        self._put(rows, its, nearer | (same & at_home & ~other))
        apart = tied & ~same
        if apart.any():
            self._ties.append((rows[apart], {name: its[name][apart] for name in its}))

    def _count(self, rows: Numbers, counts: Numbers) -> None:
        """Counts of one node hold; those of several would count an obstacle of both twice."""
        mine = self._columns['counts']
        mine[rows] = np.where(mine[rows] > 0, UNANSWERED, counts)

    def _put(self, rows: Numbers, its: Mapping[str, Any], better: NDArray[np.bool_]) -> None:
        for name, column in its.items():
            self._columns[name][rows[better]] = column[better]

    def tied(self) -> set[int]:
        """Obstacles whose names decide."""
        tied: set[int] = set()
        for rows, its in self._ties:
            still = self._still(rows, its)
            tied |= {*its['obstacles'][still].tolist(), *self._obstacles[rows[still]].tolist()}
        return tied

    def settle(self, names: Mapping[int, str]) -> None:
        """Of obstacles as far away take the first by name; those without a name come last."""
        last = chr(0x10FFFF)
        for rows, its in self._ties:
            ours = [names.get(one, last) for one in self._obstacles[rows].tolist()]
            theirs = [names.get(one, last) for one in its['obstacles'].tolist()]
            first = np.array([a < b for a, b in zip(theirs, ours, strict=True)], np.bool_)
            self._put(rows, its, first & self._still(rows, its))

    def _still(self, rows: Numbers, its: Mapping[str, Any]) -> NDArray[np.bool_]:
        return np.asarray(its[self._far] == self.distances[rows])

    def answer(self) -> Any:
        """Return all rows; the unknown ones as a node writes an UNANSWERED row."""
        lost = {'t': np.nan, 'distances': np.nan, 'points': np.nan, 'normals': 0.0}
        for name, column in self._columns.items():
            column[self.unknown] = lost.get(name, UNANSWERED)
        return self._kind(**self._columns)
