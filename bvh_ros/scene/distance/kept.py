# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is kept from one question at a time to the next, see `timed`."""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import UINT32
from ..geometry.footprint import FOOTPRINT
from ..geometry.records import GEOMETRY
from .moving import ROOM, Then
from .nearness import NO_ORDER
from .touching import FOUND, Found, found_in
from .touching_rows import COUNT, Near, Points
from .touching_rows import room_for as answers_for

FEW = 64  # obstacles that there is room for at first


class Known(NamedTuple):
    """What kernels are told of a world while it is of one version and its arrays are these."""

    version: int
    bodies: Any
    then: Then
    memory: tuple[Any, Any]
    """See `moving.room_in`."""


class Scratch:
    """Room that kernels write to, see `spare`. And what they read of one query, as making arrays
    of one row would take longer than most queries.
    """

    def __init__(self) -> None:
        self.at, self.limits, self.masks = np.empty(1), np.empty(1), np.empty(1, np.uint32)
        self.point = np.empty((1, 3))
        self.points = Points(self.point, self.limits, self.masks, NO_ORDER)
        self.answers, self.told = answers_for(1, COUNT), no_rows(1, 1)
        self.make_room(FEW)

    def make_room(self, count: int) -> None:
        """Have room for at least so many."""
        self.known: Known | None = None
        self.floats = np.zeros(ROOM * 2 * count)
        self.shape, self.footprint = np.empty(1, GEOMETRY), np.empty(1, FOOTPRINT)
        self.found: Found = found_in.py_func(self.floats[: FOUND * 2 * count])

    def memory(self, then: Then) -> tuple[Any, Any]:
        """What of it kernels write to as they look at what stands there then."""
        footprint = None if then.bodies.footprints is None else self.footprint
        spare = then.bodies._replace(shapes=self.shape, footprints=footprint)
        return self.floats, spare

    def have_room(self, count: int) -> None:
        """`make_room` if there is less."""
        if count > len(self.found.slots):
            self.make_room(count)


def no_rows(count: int, k: int) -> Near:
    # As Near(...), which would take one more call of a function of Python's.
    parts = np.empty((count, k), UINT32), np.empty((count, k)), np.empty((count, k, 3))
    return tuple.__new__(Near, parts)
