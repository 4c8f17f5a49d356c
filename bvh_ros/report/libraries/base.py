# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is asked of every library."""

from collections.abc import Iterator
from importlib.util import find_spec
from itertools import cycle
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..scenes import Boxes, Floats, Rays, incoherent_rays, moved, query_edge, spread, uniform_boxes

SOME = 32  # one box in so many jumps in the task `move_some`


class Jump(NamedTuple):
    """Some of the boxes, and where they are now."""

    rows: NDArray[np.int64]
    boxes: Boxes


class Work(NamedTuple):
    """One scene and what is asked about it; the same for every library."""

    boxes: Boxes
    rays: Rays
    small: Boxes
    """Boxes to ask overlaps for; each meets half a box on average."""
    points: Floats
    """Points to ask the nearest box centre for, shape (m, 3)."""
    states: tuple[Boxes, Boxes]
    """All boxes, at home and up to one edge away."""
    jumps: tuple[Jump, ...]
    """One box in 32, each time others, somewhere else in the cube."""

    def moving(self) -> Iterator[Boxes]:
        """All boxes, away and home again, for ever."""
        return cycle((self.states[1], self.states[0]))

    def jumping(self) -> Iterator[Jump]:
        """One jump after the other, for ever."""
        return cycle(self.jumps)


def make_work(count: int, asked: int) -> Work:
    """Make a scene of `count` boxes, and `asked` rays, small boxes and points."""
    rng = np.random.default_rng(0)
    boxes = uniform_boxes(count, rng)
    edges = boxes.hi - boxes.lo
    corner = spread(asked, rng)
    return Work(
        boxes,
        incoherent_rays(asked, rng),
        Boxes(corner, corner + query_edge(boxes, 0.5)),
        spread(asked, rng),
        (boxes, moved(boxes, rng.uniform(-1, 1, edges.shape) * edges)),
        tuple(_jump(boxes, rng) for _ in range(8)),
    )


def _jump(boxes: Boxes, rng: np.random.Generator) -> Jump:
    count = len(boxes.lo)
    rows = np.sort(rng.choice(count, max(1, count // SOME), replace=False))
    half = (boxes.hi[rows] - boxes.lo[rows]) / 2
    centers = spread(len(rows), rng)
    return Jump(rows, Boxes(centers - half, centers + half))


class Library:
    """A library under test: a method named as a task returns the job; what it can't do is missing.

    Attributes
    ----------
    name : str
        As it stands in the tables.
    module : str
        What must be importable.
    note : str
        How it is used, so that a reader can judge whether that is fair.
    """

    name: str
    module: str
    note: str

    def installed(self) -> bool:
        """Whether it is on this machine."""
        return find_spec(self.module) is not None
