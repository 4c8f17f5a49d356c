# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""When a swept ball touches a convex solid, where no closed form says.

The walk is Newton's on the distance, a convex function of the way, and ends with a proof. Each
step looks for a plane through, or next to, the solid's closest point, with the ball before it and
all of the solid behind it:

      ball ->            |  ___            The ball is surely free until it touches the plane;
        ( )   - - - - -  | /   solid       there the next step begins. It is free for ever where
                         |(                it moves along the plane, or away from it.

So no answer is `free` that a plane does not prove, however much noise there is in its normal. What
no plane proves is a hit: there the ball is as near to the solid as rounding tells.
"""

from typing import Any

import numpy as np

from ...tree.jit.compiling import inlined, lean_kernel

MOST_STEPS = 64
ROUNDING = 2.0**-50


@inlined
def slope_of(normal, direction):
    slope = 0.0
    for axis in range(direction.shape[0]):
        slope += normal[axis] * direction[axis]
    return slope


def approach_by(measure: Any) -> Any:
    """The walk to solids whose distances a kernel measures.

    `measure(solid, point, normal)` gives (low, high) around the distance of a point: that by which
    a plane with the unit normal that it fills in keeps the solid off, and that of a point of the
    solid. Apart from rounding they are equal.
    """

    @lean_kernel
    def approach(solid, radius, reach, slack, work):
        """(s, slope): how far a ball goes until it touches, inf if it does not, and the slope of
        its distance there; s is 0 if it touches at the start. Rows of `work`: where it starts, the
        unit vector along its way, two to work in.
        """
        origin, direction, point, normal = work[0], work[1], work[2], work[3]
        s, slope, near = 0.0, -np.inf, np.inf  # near: first within rounding
        for _ in range(MOST_STEPS):
            for axis in range(direction.shape[0]):
                point[axis] = origin[axis] + s * direction[axis]
            low, high = measure(solid, point, normal)
            if high <= radius or low <= radius:
                return s, slope
            if high <= radius + slack:
                near = min(near, s)
            slope = slope_of(normal, direction)
            if slope >= 0.0 or s == reach:
                return near, slope
            step = (low - radius) / -slope
            if s + step > reach:
                if low + slope * (reach - s) > radius + slack:
                    return near, slope
                s = reach
            elif step <= ROUNDING * s:
                return s, slope
            else:
                s += step
        return s, slope

    return approach
