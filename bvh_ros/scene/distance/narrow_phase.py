# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether true shapes touch: the narrow phase, for any pair of kinds.

Every shape is a `core` grown by a radius: of a sphere the core is its centre, of a capsule its
axis. Growing by a tolerance is the same again, so corners come out round (the Minkowski sum with a
ball). Two boxes are first asked for a separating plane; what that leaves open, `sure_gap` decides.
Seen from above they work on the shadows of the cores, whose axes and centres have z = 0.

**The solid meant** is that of the stored doubles: position, half sizes, and the quaternion brought
to unit length. Cores are seen from the position of one of the two, so that a pair far from the
world's origin is as well known as one next to it. A shape and another are one pair, whichever is
asked about: `ordered` puts the same first.

**Touching counts, and so does what nobody can tell apart**: shapes are said to be apart only where
a plane keeps them apart by more than SLACK of the largest length in play (how far their centres
are apart, a half size, the tolerance), and to touch only where a point of one is as near to a
point of the other. Axis-aligned boxes are decided exactly elsewhere, see `overlaps`.
"""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from ..geometry.hull import hull_of
from ..geometry.rotation import rotate
from ..geometry.shapes import CAPSULE, CYLINDER, MESH, SPHERE
from .gjk import AXES, CENTRE, CORE_ROWS, HALF, Core
from .separation import separation
from .simplex import SLACK, WAY_ROOM
from .sure_gap import sure_bounds


@lean_kernel
def half_size(shape, axis, planar):
    """Half of a size of a shape: how high it is matters to nobody who looks from above, unless it
    leans. So say `footprint.footprints`, too.
    """
    upright = shape.orientation[0] == 0.0 and shape.orientation[1] == 0.0
    return 0.0 if planar and upright and axis == 2 else shape.half[axis]


@lean_kernel
def largest_length(shape, origin, planar):
    """The largest coordinate or half size of a shape, seen from `origin`."""
    largest = 0.0
    for axis in range(3):
        largest = max(largest, half_size(shape, axis, planar))
        if axis < 2 or not planar:
            largest = max(largest, abs(shape.position[axis] - origin[axis]))
    return largest


@lean_kernel
def ordered(one, other):
    """Whether two shapes are in the order in which a pair is looked at."""
    if one.kind != other.kind:
        return one.kind < other.kind
    for axis in range(3):
        if one.position[axis] != other.position[axis]:
            return one.position[axis] < other.position[axis]
        if one.half[axis] != other.half[axis]:
            return one.half[axis] < other.half[axis]
    for axis in range(4):
        if one.orientation[axis] != other.orientation[axis]:
            return one.orientation[axis] < other.orientation[axis]
    return one.mesh <= other.mesh


@lean_kernel
def fill_core(shape, origin, exponent, planar, core):
    """Fill in the core of a shape, seen from `origin` and times 2**-exponent; return (whether it
    is round, radius by which it is grown).
    """
    for axis in range(3):
        half = 1.0 if shape.kind == MESH else half_size(shape, axis, planar)
        core[HALF, axis] = math.ldexp(half, -exponent)
        core[CENTRE, axis] = math.ldexp(shape.position[axis] - origin[axis], -exponent)
        for row in range(3):
            core[AXES + axis, row] = 1.0 if axis == row else 0.0
        if not (planar and shape.kind == MESH):  # a polygon, which is turned already
            rotate(shape.orientation, core[AXES + axis], 1.0)
    if planar:
        for row in range(AXES, CORE_ROWS):
            core[row, 2] = 0.0
    radius = 0.0
    if shape.kind == SPHERE or shape.kind == CAPSULE:
        radius = core[HALF, 0]
        for axis in range(3):
            core[HALF, axis] = max(core[HALF, axis] - radius, 0.0)
    return shape.kind == CYLINDER, radius


@lean_kernel
def fill_cores(one, hulls, other, other_hulls, planar, rows):
    """The cores of two shapes, seen from the place of the first and times 2**-exponent, by which
    the largest length in play is about 1: (cores, radii, exponent). `rows` is where they are put.
    """
    origin = one.position
    largest = max(largest_length(one, origin, planar), largest_length(other, origin, planar))
    exponent = math.frexp(largest)[1]
    round_one, radius = fill_core(one, origin, exponent, planar, rows[0])
    round_other, other_radius = fill_core(other, origin, exponent, planar, rows[1])
    hull, other_hull = hull_of(hulls, one), hull_of(other_hulls, other)
    cores = Core(rows[0], round_one, hull), Core(rows[1], round_other, other_hull)
    return cores, (radius, other_radius), exponent


@lean_kernel
def near(one, hulls, other, other_hulls, tolerance, planar):
    """Whether two shapes (records of `columns.GEOMETRY`) are within `tolerance` of each other; and
    whether that took more digits.
    """
    if ordered(one, other):
        return ordered_near(one, hulls, other, other_hulls, tolerance, planar)
    return ordered_near(other, other_hulls, one, hulls, tolerance, planar)


@lean_kernel
def ordered_near(one, hulls, other, other_hulls, tolerance, planar):
    first = stack_array((CORE_ROWS, 3), np.float64)
    second = stack_array((CORE_ROWS, 3), np.float64)
    # As `fill_cores`, but what many boxes need not comes after them: 5 % of a turned overlap.
    origin = one.position
    largest = max(largest_length(one, origin, planar), largest_length(other, origin, planar))
    exponent = math.frexp(max(largest, tolerance))[1]
    round_one, radius = fill_core(one, origin, exponent, planar, first)
    round_other, other_radius = fill_core(other, origin, exponent, planar, second)
    reach = radius + other_radius + math.ldexp(tolerance, -exponent)
    boxes = not (round_one or one.kind == MESH or round_other or other.kind == MESH)
    if boxes and not planar:
        gap, sure = separation(first, second, SLACK)
        if gap > reach:
            return False, False
        if gap == 0.0 and sure:
            return True, False
    way = stack_array(WAY_ROOM, np.float64)
    hull, other_hull = hull_of(hulls, one), hull_of(other_hulls, other)
    limit = reach + SLACK
    cores = Core(first, round_one, hull), Core(second, round_other, other_hull)
    low, _, more_digits = sure_bounds(cores[0], cores[1], limit, False, way)
    return low <= limit, more_digits


@lean_kernel
def near_pairs(records, hulls, pairs, planar, found):
    """Fill in which pairs (m, 2) of shapes touch; return how many took more digits."""
    count = 0
    for i in range(pairs.shape[0]):
        one, other = records[pairs[i, 0]], records[pairs[i, 1]]
        found[i], more = near(one, hulls, other, hulls, 0.0, planar)
        count += more
    return count
