# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points of footprints that are closest to a query's centre, for planar scenes."""

import numpy as np

from ...tree.jit.compiling import kernel
from ..casting.frame import scale_of
from ..casting.ray_footprint import closest_on_footprint


@kernel
def closest_points(footprints, hulls, centre, points):
    """Fill `points` with each footprint's point closest to `centre`; inside the centre itself."""
    local, closest = np.empty(2), np.empty(2)
    for i in range(footprints.shape[0]):
        largest = footprints[i].radius + footprints[i].straight + footprints[i].half_axes[1]
        for axis in range(2):
            largest = max(largest, abs(centre[axis]), abs(footprints[i].centre[axis]))
        scale = scale_of(largest)
        for axis in range(2):
            local[axis] = centre[axis] * scale - footprints[i].centre[axis] * scale
        inside = closest_on_footprint(footprints[i], hulls, scale, local, closest) == 0.0
        for axis in range(2):
            place = closest[axis] / scale + footprints[i].centre[axis]
            points[i, axis] = centre[axis] if inside else place
