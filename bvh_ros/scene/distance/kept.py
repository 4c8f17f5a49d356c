# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is kept from one question at a time to the next, see `timed`."""

from typing import Any, NamedTuple

import numpy as np

from ..geometry.footprint import FOOTPRINT
from ..geometry.records import GEOMETRY
from .moving import Room, Then
from .nearness import NO_ORDER
from .touching import Found
from .touching_rows import COUNT, Near, Points
from .touching_rows import room_for as answers_for

FEW = 64  # obstacles that there is room for at first


class Known(NamedTuple):
    """What kernels are told of a world while it is of one version and its arrays are these."""

    version: int
    geometry: Any
    hulls: Any
    until: float
    """From then on somebody rests."""
    then: Then
    room: Room


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
        rows = 2 * count
        self.known: Known | None = None
        self.slots, self.handles = np.empty((2, rows), np.int64)
        self.gaps = np.empty(rows)
        self.found = Found(
            *(np.empty(rows, np.int64), np.empty(rows), np.zeros((rows, 3)), np.zeros((rows, 3))),
            *(np.empty(0, np.bool_), np.empty(0), np.empty(rows, np.int64)),
        )
        self.shape, self.footprint = np.empty(1, GEOMETRY), np.empty(1, FOOTPRINT)

    def room(self, then: Then) -> Room:
        """What of it kernels write to as they look at what stands there then."""
        footprint = None if then.bodies.footprints is None else self.footprint
        spare = then.bodies._replace(shapes=self.shape, footprints=footprint)
        return Room(self.slots, self.handles, self.gaps, spare)

    def have_room(self, count: int) -> None:
        """`make_room` if there is less."""
        if count > len(self.gaps):
            self.make_room(count)


def no_rows(count: int, k: int) -> Near:
    return Near(np.empty((count, k), np.uint32), np.empty((count, k)), np.empty((count, k, 3)))
