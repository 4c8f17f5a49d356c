# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows of an update, and parts of them."""

from collections.abc import Iterator
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from ..tree.access import ALL
from .geometry.shapes import Shapes, as_shapes
from .speeds import Follow, velocity_rows
from .store.names import Families, Names, as_families
from .store.updating import FIRST_TIME, LAST_TIME, column


class Part(NamedTuple):
    """Some rows of an update, as for `Scene.update`."""

    names: Names
    shapes: Shapes
    stamp: ArrayLike
    expires: ArrayLike = 0
    categories: ArrayLike | None = None
    velocities: ArrayLike | Follow | None = None

    def cut(self, length: int) -> Iterator['Part']:
        """The same in parts of at most so many rows."""
        if isinstance(self.shapes, Shapes) and np.size(self.shapes.kind) <= length:
            yield self
            return
        names, given = as_families(self.names), as_shapes(self.shapes)
        total = len(given.kind)
        require_a_name_each(names, total)
        columns: list[Any] = [
            column('stamp', self.stamp, total, LAST_TIME, FIRST_TIME),
            column('expires', self.expires, total, LAST_TIME),
            None,
            None,
        ]
        if self.categories is not None:
            columns[2] = column('categories', self.categories, total, ALL)
        follow = self.velocities if callable(self.velocities) else None
        if self.velocities is not None and not follow:
            columns[3] = velocity_rows(self.velocities, total)
        for begin in range(0, max(total, 1), length):
            rows = slice(begin, begin + length)
            shapes = given.take(rows)
            rest: list[Any] = [None if each is None else each[rows] for each in columns]
            rest[3] = follow or rest[3]
            yield Part(names.take(rows), shapes, *rest)


def require_a_name_each(names: Families, count: int) -> None:
    """ValueError if there are more or fewer names than shapes."""
    if len(names) != count:
        raise ValueError(f'there are {len(names)} names for {count} shapes')
