# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays against the boxes of wide nodes, in float32: what surely misses is left out.

The distance of a plane is fma(plane, 1 / d, -o / d) in the snapshot's units. With e = 2**-24, the
rounding of 1 / d, of o / d and of the result make an error of at most |1 / d| (1 + |o|) 2 e (1 + 4
e), so every entry is lowered and every exit raised by PAD32 |1 / d| (1 + |o|), twice that. (Ize
2013 bounds (plane - o) * (1 / d); the fused form needs the term with |o|.) Directions are scaled
to a largest component of 1, and components below 2**-40 are taken for 2**-40: such an axis' exit
then is beyond 2**17 at least, further than anything that a ray from within 2**10 scene sizes can
meet. Other rays take the binary tree.
"""

import functools
import math
from typing import Any

import numpy as np

from ..compiler import inlined
from ..nodes import NONE, ROOT
from ..rays.slab import INSIDE
from ..simd.float64x4 import FOUR, set_slopes

PAD32 = 2.0**-22
FARTHEST_ORIGIN = 2.0**10
STEEPEST = 2.0**40
CORNERS = 2 * FOUR  # numbers of a box around all boxes
_BOUNDS = FARTHEST_ORIGIN, 1e-290, 1e200, STEEPEST, PAD32
NOWHERE = np.float32(-1.0)  # a limit that no box is within


@functools.cache
def ray_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a ray on its way through the snapshot, of one cache line: its best hit so far, and
    what `stream16` reads. `set_slopes` writes four bytes more than each of its three fields, one
    after the other.
    """
    three = np.float32, (ndim,)
    fields = {
        'best_t': (np.float64, 0),  # about
        'unit': (np.float64, 8),  # t times this is a distance in the snapshot's units
        'slope': (three, 16),  # inverses of the direction
        'near_shift': (three, 16 + 4 * ndim),
        'far_shift': (three, 16 + 8 * ndim),
        'limit': (np.float32, 52),  # surely not less than best_t
        'slot': (np.int32, 56),  # of the best hit, or NONE
        'axis': (np.int16, 60),
        'exact': (np.bool_, 62),  # whether a decision took exact arithmetic
        'octant': (np.uint8, 63),  # bit k: it flies down axis k
    }
    kinds, offsets = zip(*fields.values(), strict=True)
    return np.dtype({'names': list(fields), 'formats': kinds, 'offsets': offsets, 'itemsize': 64})


@inlined
def limit32(t, unit):
    """A distance in the snapshot's units, surely not less than t."""
    return np.float32(t * unit) * np.float32(1.0 + PAD32) + np.float32(1e-30)


@inlined
def start_ray(ray, origin, direction, center, per_length, t_max):
    """Fill a record; return whether the ray is suited, origin and direction as of `set_slopes`.
    What is not finite is not: NaN is in no range.
    """
    largest, suited = set_slopes(ray, origin, direction, center, per_length, _BOUNDS)
    unit = largest * per_length
    ray.best_t, ray.unit, ray.limit = t_max, unit, limit32(t_max, unit)
    ray.slot, ray.axis, ray.exact = NONE, INSIDE, False
    return suited & (largest > 1e-200) & (unit > 1e-290) & (unit < 1e290)


@inlined
def fill_whole(tree, whole):
    """Write the box around all boxes as of `look_ahead`; of none, everything."""
    root = tree.state[ROOT]
    for axis in range(FOUR):
        whole[axis], whole[FOUR + axis] = -np.inf, np.inf
    if root != NONE:
        for axis in range(tree.nodes[0].lo.shape[0]):
            whole[axis], whole[FOUR + axis] = tree.nodes[root].lo[axis], tree.nodes[root].hi[axis]


@inlined
def octant_of(direction):
    """Bit k: the ray flies down axis k, as its slope does, that of -0.0, too."""
    octant = 0
    for axis in range(direction.shape[0]):
        octant |= (math.copysign(1.0, direction[axis]) < 0.0) << axis
    return octant
