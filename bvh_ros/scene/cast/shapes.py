# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A thin ray, or a ball swept along it, against one shape in the shape's own frame.

**Frames.** Lengths are scaled by a power of two, which rounds nothing, so that products of four
neither overflow nor vanish. In everyday scenes the scale is 1.

**Closed forms.** A ball of radius r meets a shape where its centre meets the shape grown by r with
rounded edges (Ericson, Real-Time Collision Detection, 2005, section 5.5.7). Each `enter_...` gives
(s, feature): the distance at which `origin + s * direction`, a unit vector, enters the shape, inf
if it does not at 0 <= s <= reach, and the part of the surface there: INSIDE where the ray
starts in the (grown) shape, the axis of a flat face, ROUND elsewhere.

The error is one of place: origin + s * direction, computed exactly, is within 8 u L of the
surface of the shape (u = 2**-53, L the largest length in play: a coordinate of the ray or of the
shape, or an edge). How far s itself is off follows from the angle at which the ray meets the
surface.

**Rims of cylinders, and triangles.** `approach_by` takes Newton's steps on the distance, a convex
function of the path, and ends with a proof. Each step looks for a plane through, or next to, the
solid's closest point, with the ball before it and all of the solid behind it:

      ball ->            |  ___            The ball is surely free until it touches the plane;
        ( )   - - - - -  | /   solid       there the next step begins. It is free for ever where
                         |(                it moves along the plane, or away from it.

So no answer is `free` that a plane does not prove, however much noise there is in its normal. What
no plane proves is a hit: there the ball is as near to the solid as rounding can decide.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import DIRECTION, INSIDE, LARGEST
from ...tree.compiler import inlined, lean_kernel, stack_array
from ..shapes.footprint import ROUND
from ..shapes.shape import hypot, length, scale_of

# ---- frames


# What rounding cannot tell apart touches: shares of the largest length in play, as seen from the
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
    return min(s / pace, t_max, LARGEST)


class RayAndBox(NamedTuple):
    """A ray, and the box in the tree of the obstacle that it may meet."""

    ray: Any
    lo: Any
    hi: Any
    doubt: Any
    """By how much rounding may have moved the ray, or an axis-aligned box, m: 0 at rest."""


class Frame(NamedTuple):
    """A shape's frame, for one ray."""

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


# ---- a ball that has no closed form


MOST_STEPS = 64
ROUNDING = 2.0**-50


@inlined
def slope_of(normal, direction):
    slope = 0.0
    for axis in range(direction.shape[0]):
        slope += normal[axis] * direction[axis]
    return slope


def approach_by(measure: Any) -> Any:
    """Newton's steps towards solids whose distances a kernel measures.

    `measure(solid, point, normal)` gives (low, high) around the distance of a point: that by which
    a plane with the unit normal that it fills in keeps the solid off, and that of a point of the
    solid. Apart from rounding they are equal.
    """

    @lean_kernel
    def approach(solid, radius, reach, slack, work):
        """(s, slope): how far a ball goes until it touches, inf if it does not, and the slope of
        its distance there; s is 0 if it touches at the start. Rows of `work`: where it starts, the
        unit vector along its path, two to work in.
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


# ---- closed forms


BEYOND = -1.0  # entered after the reach


@lean_kernel
def disc_interval(along, square, across, radius):
    """Where across^2 + square * (s - along)^2 <= radius^2: an interval of s, (inf, -inf) if empty.

    `along` is where the line is closest to the centre and `across` how close. Hit or miss is
    decided by the difference of two lengths, not of two squares, so a far origin costs no digits.
    """
    if across > radius:
        return np.inf, -np.inf
    if square == 0.0:
        return -np.inf, np.inf
    half = math.sqrt(radius - across) * math.sqrt(radius + across) / math.sqrt(square)
    return along - half, along + half


@lean_kernel
def enter_sphere(origin, direction, radius, reach):
    if length(origin) <= radius:
        return 0.0, INSIDE
    along = 0.0
    for axis in range(origin.shape[0]):
        along -= origin[axis] * direction[axis]
    across = 0.0
    for axis in range(origin.shape[0]):
        across = math.hypot(across, origin[axis] + along * direction[axis])
    entry, leave = disc_interval(along, 1.0, across, radius)
    if leave < 0.0 or entry > reach:
        return np.inf, ROUND
    return max(entry, 0.0), ROUND


@lean_kernel
def enter_box(origin, direction, lo, hi, reach):
    """Slabs (Kay and Kajiya 1986)."""
    entry, leave, entered = 0.0, reach, INSIDE
    for axis in range(lo.shape[0]):
        if lo[axis] <= origin[axis] <= hi[axis] and direction[axis] == 0.0:
            continue
        if direction[axis] == 0.0:
            return np.inf, INSIDE
        near, far = (lo[axis], hi[axis]) if direction[axis] > 0.0 else (hi[axis], lo[axis])
        first = (near - origin[axis]) / direction[axis]
        leave = min(leave, (far - origin[axis]) / direction[axis])
        if first > entry:
            entry, entered = first, axis
    return (entry if entry <= leave else np.inf), entered


@inlined
def slab_times(origin, direction, lo, hi):
    """How a coordinate lies to its slab: (offset from the plane that it meets first, until when it
    is before that, offset from the other plane, until when it is before that).
    """
    below, above = origin - lo, origin - hi
    if direction == 0.0:  # beside the slab, or in it, for ever
        outside = below < 0.0 or above > 0.0
        return (below if below < 0.0 else above), (np.inf if outside else -np.inf), 0.0, np.inf
    first, second = (below, above) if direction > 0.0 else (above, below)
    return first, -first / direction, second, -second / direction


@lean_kernel
def enter_rounded_box(origin, direction, lo, hi, radius, reach):
    """The box grown by one radius."""
    radii, ts = stack_array(1, np.float64), stack_array(1, np.float64)
    features, radii[0] = stack_array(1, np.int64), radius
    enter_rounded_boxes(origin, direction, lo, hi, radii, reach, (ts, features))
    return ts[0], features[0]


@lean_kernel
def enter_rounded_boxes(origin, direction, lo, hi, radii, reach, found):
    """(s, feature) of the box grown by each radius, to the rows of `found`; those that are not
    positive meet nothing.

    The squared distance to a box is a sum, over the axes, of squared distances to slabs. Between
    two crossings of face planes it is one quadratic in s, and the whole is convex: of at most
    seven pieces the first in which it falls to radius^2 holds the entry.
    """
    ss, features = found
    distance, left = box_distance(origin, lo, hi), 0
    for i in range(radii.shape[0]):
        ss[i], features[i] = np.inf, ROUND
        if radii[i] > 0.0 and distance <= radii[i]:
            ss[i], features[i] = 0.0, INSIDE
        elif radii[i] > 0.0:
            left += 1
    planes, begin = stack_array((3, 4), np.float64), 0.0
    for axis in range(lo.shape[0]):
        crossing = slab_times(origin[axis], direction[axis], lo[axis], hi[axis])
        planes[axis, 0], planes[axis, 1], planes[axis, 2], planes[axis, 3] = crossing
    while begin <= reach and begin < np.inf and left > 0:
        end, square, along, across = next_piece(direction, planes[: lo.shape[0]], begin)
        for i in range(radii.shape[0]):
            if radii[i] > 0.0 and ss[i] == np.inf and features[i] == ROUND:
                entry, leave = disc_interval(along, square, across, radii[i])
                if entry <= end and leave >= begin:
                    entry, left = max(entry, begin), left - 1
                    ss[i] = entry if entry <= reach else BEYOND
        begin = end
    for i in range(radii.shape[0]):
        ss[i] = np.inf if ss[i] == BEYOND else ss[i]


@inlined
def next_piece(direction, planes, begin):
    """The piece from s = `begin` on, as `disc_interval` wants it: (its end, square, along,
    across).
    """
    end, square, product, across = np.inf, 0.0, 0.0, 0.0
    offsets = stack_array(3, np.float64)
    for axis in range(planes.shape[0]):
        enters, leaves = planes[axis, 1], planes[axis, 3]
        before, after = begin < enters, begin >= leaves
        offsets[axis] = planes[axis, 0] if before else planes[axis, 2]
        end = min(end, enters if before else (np.inf if after else leaves))
        square += direction[axis] * direction[axis] if before or after else 0.0
        product += offsets[axis] * direction[axis] if before or after else 0.0
    along = -product / square if square > 0.0 else 0.0
    for axis in range(planes.shape[0]):
        if begin < planes[axis, 1] or begin >= planes[axis, 3]:
            across = hypot(across, offsets[axis] + along * direction[axis])
    return end, square, along, across


@lean_kernel
def enter_cylinder(origin, direction, radius, half_height, reach):
    """A cylinder about the z axis: the overlap of an endless one and a slab."""
    if math.hypot(origin[0], origin[1]) <= radius and abs(origin[2]) <= half_height:
        return 0.0, INSIDE
    square = direction[0] * direction[0] + direction[1] * direction[1]
    along = (
        -(origin[0] * direction[0] + origin[1] * direction[1]) / square if square > 0.0 else 0.0
    )
    across = math.hypot(origin[0] + along * direction[0], origin[1] + along * direction[1])
    entry, leave = disc_interval(along, square, across, radius)
    feature = ROUND
    if direction[2] != 0.0:
        cap = math.copysign(half_height, direction[2])
        leave = min(leave, (cap - origin[2]) / direction[2])
        if (-cap - origin[2]) / direction[2] > entry:
            entry, feature = (-cap - origin[2]) / direction[2], 2
    elif abs(origin[2]) > half_height:
        return np.inf, ROUND
    entry = max(entry, 0.0)
    return (entry if entry <= min(leave, reach) else np.inf), feature


@lean_kernel
def measure_cylinder(solid, point, normal):
    """`approach`'s measure: the distance, and a unit vector from the closest point."""
    radius, half_height = solid
    across = math.hypot(point[0], point[1])
    sideways, beyond = max(across - radius, 0.0), max(abs(point[2]) - half_height, 0.0)
    distance = math.hypot(sideways, beyond)
    if distance > 0.0:
        normal[0] = normal[1] = 0.0
        if sideways > 0.0:
            normal[0] = sideways / distance * (point[0] / across)
            normal[1] = sideways / distance * (point[1] / across)
        normal[2] = math.copysign(beyond / distance, point[2])
    return distance, distance


approach_cylinder = approach_by(measure_cylinder)


@lean_kernel
def enter_rounded_cylinder(radius, half_height, ball, reach, slack, work):
    """The grown cylinder is the union of a wider one, a longer one and two tori along the rims.

    A ray enters a union where it first enters a part. `work` as for `approach`.
    """
    origin, direction = work[0], work[1]
    if cylinder_distance(origin[0], origin[1], origin[2], radius, half_height) <= ball:
        return 0.0, INSIDE
    side, _ = enter_cylinder(origin, direction, radius + ball, half_height, reach)
    cap, _ = enter_cylinder(origin, direction, radius, half_height + ball, reach)
    face = min(side, cap)
    solid, limit = (radius, half_height), min(face, reach)
    rim, slope = approach_cylinder(solid, ball, limit, slack, work)
    # A grazing ball: `approach` stops where the distance is right to the last digit, the closed
    # forms where s is.
    size = length(origin) + radius + half_height + ball
    if rim == np.inf or (face < np.inf and (rim - face) * slope <= ROUNDING * size):
        rim = face
    return rim, ROUND


@lean_kernel
def box_distance(point, lo, hi):
    total = 0.0
    for axis in range(lo.shape[0]):
        total = hypot(total, max(lo[axis] - point[axis], 0.0, point[axis] - hi[axis]))
    return total


@lean_kernel
def cylinder_distance(x, y, z, radius, half_height):
    return math.hypot(max(math.hypot(x, y) - radius, 0.0), max(abs(z) - half_height, 0.0))
