# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The leaves of what is swept.

Most that a ray meets are elsewhere when it is there. To tell that, a record of each holds what a
rounded test needs, in one cache line: bounds at the start, a velocity as a float32, with which
they hold over the span, and how loose they are.
"""

import functools
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import CACHE_LINE, inlined
from .bounds import LEAST, WIDER
from .meeting import moves
from .rounded import FASTEST, LEAST_32
from .stopping import LATER
from .sums import A_NANOSECOND

MARGIN, WIDER_32 = 2.0**-38, 2.0**-22


@functools.cache
def leaf_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a leaf, by slot."""
    wide, narrow = (np.float64, (ndim,)), (np.float32, (ndim,))
    return np.dtype(
        {
            'names': ['lo', 'hi', 'velocity', 'loose'],
            'formats': [wide, wide, narrow, np.float32],
            'offsets': [0, 8 * ndim, 16 * ndim, 20 * ndim],
            'itemsize': CACHE_LINE,
        }
    )


class Leaves(NamedTuple):
    """What a rounded test needs."""

    records: NDArray[Any]
    """Of `leaf_dtype`; behind them one more, whose `lo` is the drift: at that velocity the planes
    of the snapshot go on; `loose` is 0 if there is none. (An argument more takes 0.2 us.)
    """
    start: float
    """When boxes are where they say, s, and planes, too."""


@inlined
def swept_side(box, axis, moving, drift):
    """The bounds of a box on an axis over the span as who drifts sees it, surely wide enough."""
    least, most, more = _ways(box, axis, moving, drift[axis])
    return box[0][axis] + least - more, box[1][axis] + most + more


@inlined
def _ways(box, axis, moving, drift):
    """How far a box has gone in the span, the least and the most, where who goes at `drift` from
    the start on sees it, and how wrong its place may be then.
    """
    lo, hi, velocity, reference = box
    speed, end, length = velocity[axis], reference + moving.left, moving.stop - moving.start
    first = speed * (min(moving.start, end) - reference)
    # Where it stops it stays: on the way there, and from there on, its place is linear in time.
    gone = speed * (min(moving.stop, end) - reference)
    bent = gone - drift * min(max(end - moving.start, 0.0), length)
    last = gone - drift * length
    extent, times = abs(lo[axis]) + abs(hi[axis]), abs(moving.start) + abs(moving.stop)
    extent += abs(speed) * (times + abs(reference)) + abs(drift) * times
    return min(first, bent, last), max(first, bent, last), extent * WIDER + LEAST


@inlined
def speed_of(box, axis, moving):
    """Of a box that may stop, on the average over the span."""
    end = box[3] + moving.left
    if end < moving.stop:
        passed = max(end - moving.start, 0.0)
        return box[2][axis] * (passed / (moving.stop - moving.start)) if passed > 0.0 else 0.0
    return box[2][axis]


@inlined
def may_stop(box, moving):
    """Whether a box is going at the start of the span and may stop before a course is over whose
    last time, as it is rounded, is in the span.
    """
    soon = (abs(moving.start) + abs(moving.stop)) * LATER + A_NANOSECOND
    return moving.start <= box[3] + moving.left < moving.stop + soon and moves(box)


@inlined
def set_leaf(leaf, box, axis, moving, per_length):
    """Write an axis of a leaf's record.

    It is wider by MARGIN of the scene. That is more than all that `rounded.quick_decision`
    loses: with its origin within 2**10 scenes and within the span, a ray goes no further than that
    along an axis, relative to a box, nor does that go further than `sweeping.FARTHEST_DRIFT`
    and a scene.
    """
    speed = speed_of(box, axis, moving)
    speed = np.float32(speed if abs(speed) < FASTEST else 0.0)
    least, most, more = _ways(box, axis, moving, np.float64(speed))
    margin = MARGIN / per_length
    more += margin
    leaf.velocity[axis] = speed
    leaf.lo[axis] = box[0][axis] + least - more
    leaf.hi[axis] = box[1][axis] + most + more
    loose = most - least + 2.0 * more + margin
    leaf.loose = max(leaf.loose, np.float32(loose * (1.0 + WIDER_32)) + LEAST_32)
