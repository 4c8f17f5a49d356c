# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What markers are called in the scene: `ns/id`, and `ns/id#3` for an element of a list."""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from bvh_ros.ros.conversions.marker_order import Mask
from bvh_ros.ros.conversions.marker_table import Integers, MarkerTable
from bvh_ros.scene import Families


class MarkerNames(NamedTuple):
    """Names of the rows of a table."""

    table: MarkerTable
    prefix: str

    def of(self, row: int) -> str:
        """The name of one marker."""
        namespace = self.table.namespaces[self.table.namespace[row]]
        return f'{self.prefix}{namespace}/{self.table.id[row]}'

    def singles(self, rows: Integers) -> Families:
        """Two families a namespace: `ns/` and, for negative ids, `ns/-`."""
        table, number = self.table, self.table.id[rows]
        if not len(rows):
            return Families([], rows, number)
        used, place = np.array([0]), np.zeros(len(rows), np.int64)
        if len(table.namespaces) > 1:
            used, place = np.unique(table.namespace[rows], return_inverse=True)
        spaces = [f'{self.prefix}{table.namespaces[space]}/' for space in used.tolist()]
        prefixes = [spaces[i // 2] + '-' * (i % 2) for i in range(2 * len(spaces))]
        return Families(prefixes, 2 * place + (number < 0), np.abs(number))

    def with_elements(
        self, rows: Integers, counts: Integers, listed: Mask
    ) -> tuple[Families, Families, dict[str, int]]:
        """Names of all obstacles, of those that are no elements of lists, and list markers;
        `counts` is how many obstacles each row is.
        """
        single = self.singles(rows)
        if not listed.any():
            return single, single, {}
        lists = [self.of(row) for row in rows[listed].tolist()]
        prefixes = [*single.prefixes, *(f'{name}#' for name in lists)]
        family, numbers = single.family.copy(), np.repeat(single.numbers, counts)
        family[listed] = len(single.prefixes) + np.arange(len(lists))
        places = np.arange(len(numbers)) - np.repeat(np.cumsum(counts) - counts, counts)
        element = np.repeat(listed, counts)
        numbers[element] = places[element]
        sizes = dict(zip(lists, counts[listed].tolist(), strict=True))
        return (
            Families(prefixes, np.repeat(family, counts), numbers),
            single.take(np.flatnonzero(~listed)),
            sizes,
        )
