# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Lists of rays that visit a wide node together.

A ray alone spends most of its time on branches that the processor guesses wrong: whether a child
is met, how many are, whether the stack is empty. So a node's boxes are tested for a list of rays
without a branch, each ray is put on the lists of the children that it meets, and the guesses are
one a list instead of one a ray (Barringer and Akenine-Möller 2014, "Dynamic Ray Stream
Traversal").

The lists of a node's children lie behind each other in one array, the nearest child's last and
behind it those of its own children: the traversal is depth first, so what lies behind the list of
a node that is visited is done with.
"""

import threading
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import WIDTH, inlined, trailing_zeros
from ..nodes import aligned_empty
from ..rays.slab import RAY_ROWS
from ..simd.int32x8 import AT_ONCE
from .filtering import ray_dtype
from .snapshot import LOOSE_NODES

# How many rays go together at most.
RAYS_AT_ONCE = 4096
RAYS_SORTED = 8 * RAYS_AT_ONCE

OCTANTS = 8  # of two dimensions, four are empty

# Scratch for so many rays is kept by a thread, 0.5 MB among 10,000 boxes: to make it takes 5 us, a
# sixth of 400 short rays, and less than 3 % of more rays.
KEPT_RAYS = 1024

# The columns of the stack: a node or ~slot of a leaf, and its list.
NODE, START, COUNT = range(3)
FOUND, DECIDED_EXACTLY, BAD = range(3)  # what is counted
TALLY = 3


class Scratch(NamedTuple):
    """Memory for the rays of one thread."""

    ray: NDArray[np.float64]
    """One ray, as of `slab`."""
    octants: NDArray[np.uint8]
    """Of rays that are sorted, see `motion.starting`."""
    rows: NDArray[np.int64]
    """Of rays, octant by octant."""
    records: NDArray[Any]
    """Of `filtering.ray_dtype`, as many."""
    lists: NDArray[np.int32]
    """Places in `records`."""
    found: NDArray[np.int32]
    """Places in `records` of those that hit anything."""
    met: NDArray[np.uint32]
    """Bit masks of the children that the rays of a list meet."""
    stack: NDArray[np.int32]
    """A node a row."""


def make_scratch(count: int, ndim: int, depth: int) -> Scratch:
    """For `count` rays through a snapshot of so many levels of wide nodes."""
    together, piled = min(count, RAYS_AT_ONCE), min(OCTANTS * count, RAYS_SORTED)
    return Scratch(
        np.empty((RAY_ROWS, ndim)),
        np.empty(min(count, RAYS_SORTED), np.uint8),
        np.empty(piled, np.int64),
        aligned_empty(piled, ray_dtype(ndim)),
        np.empty(together * (1 + WIDTH * depth) + AT_ONCE, np.int32),
        np.empty(together, np.int32),
        np.empty(together + AT_ONCE, np.uint32),
        np.empty((WIDTH * depth + LOOSE_NODES, 3), np.int32),
    )


class Kept(threading.local):
    """What a thread keeps of it, by number of dimensions. Kernels write it before they read it."""

    def __init__(self) -> None:
        self.rooms: dict[int, Scratch] = {}


_kept = Kept()


def scratch_for(count: int, ndim: int, depth: int) -> Scratch:
    """`make_scratch`, or what is kept of as much or more."""
    if count > KEPT_RAYS:
        return make_scratch(count, ndim, depth)
    scratch = _kept.rooms.get(ndim)
    if scratch is None or len(scratch.stack) < WIDTH * depth + LOOSE_NODES:
        scratch = _kept.rooms[ndim] = make_scratch(KEPT_RAYS, ndim, depth)
    return scratch


@inlined
def without_lowest(bits):
    """Without the lowest bit that is set, if any is."""
    return np.uint32(bits & np.uint32(bits - np.uint32(bits != np.uint32(0))))


@inlined
def farthest_first(met, nearest, keys):
    """Sort the children of `met`; return how many. The lane is in the last four bits of a key."""
    count = 0
    while met != np.uint32(0):
        lane = np.int64(trailing_zeros(met))
        met = without_lowest(met)
        key = np.int64(nearest[lane]) << 32 | lane
        place = count
        while place > 0 and keys[place - 1] < key:
            keys[place] = keys[place - 1]
            place -= 1
        keys[place] = key
        count += 1
    return count
