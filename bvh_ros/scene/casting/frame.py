# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How a ray is seen from a shape: in lengths that may be squared, with what of them is rounding.

Lengths are brought by a power of two, which rounds nothing, to where products of four neither
overflow nor vanish. In everyday scenes they are there, and stay metres.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel
from ...tree.rays.slab import DIRECTION
from ..geometry.lengths import length, scale_of

# What nobody can tell apart touches: shares of the largest length in play, as seen from the
# shape, and of the largest coordinate, which was rounded before.
FRAME_SLACK = 2.0**-46
COORDINATES = 2.0**-51


@inlined
def reach_of(t_max, pace):
    """How far a ray goes that is `pace` long up to t = 1."""
    return t_max * pace if 0.0 < t_max < np.inf else t_max


@inlined
def time_of(s, pace, t_max):
    """The t at which a ray has gone so far; a hit has one even where it exceeds the doubles."""
    if not 0.0 < s < np.inf:
        return s
    return min(s / pace, t_max, 1.7976931348623157e308)


class Met(NamedTuple):
    """A ray, and the box in the tree of the obstacle that it may meet."""

    ray: Any
    lo: Any
    hi: Any


class Frame(NamedTuple):
    """How a ray is seen from a shape."""

    pace: Any
    """How far it goes up to t = 1, in the frame's lengths."""
    scale: Any
    """The frame's lengths are metres times this power of two."""
    slack: Any
    """What is no farther apart touches, in the frame's lengths."""


@lean_kernel
def point_along(ray, scale, out):
    """Fill `out` with the unit vector along a ray; return its length times `scale`."""
    largest = 0.0
    for axis in range(ray.shape[1]):
        largest = max(largest, abs(ray[DIRECTION, axis]))
    turn = scale_of(largest)
    for axis in range(ray.shape[1]):
        out[axis] = ray[DIRECTION, axis] * turn
    total = length(out)
    for axis in range(ray.shape[1]):
        out[axis] = out[axis] / total if total > 0.0 else 0.0
    return total * scale / turn
