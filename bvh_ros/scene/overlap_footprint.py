# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points of footprints that are closest to a query's centre, for planar scenes."""

import numpy as np

from ..tree.compiling import kernel
from .frame import scale_of
from .ray_footprint import closest_on_footprint


@kernel
def closest_points(prints, hulls, centre, points):
    """Fill `points` with each footprint's point closest to `centre`; inside the centre itself."""
    local, closest = np.empty(2), np.empty(2)
    for i in range(prints.shape[0]):
        largest = prints[i].radius + prints[i].straight + prints[i].half_axes[1]
        for axis in range(2):
            largest = max(largest, abs(centre[axis]), abs(prints[i].centre[axis]))
        scale = scale_of(largest)
        for axis in range(2):
            local[axis] = centre[axis] * scale - prints[i].centre[axis] * scale
        inside = closest_on_footprint(prints[i], hulls, scale, local, closest) == 0.0
        for axis in range(2):
            place = closest[axis] / scale + prints[i].centre[axis]
            points[i, axis] = centre[axis] if inside else place
