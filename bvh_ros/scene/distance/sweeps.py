# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Shapes that go from pose to pose, and turn meanwhile: when each first touches an obstacle."""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.access import (
    ALL,
    CHANGES,
    INT64,
    REFUSED,
    Near,
    begin_query,
    end_query,
    of_row,
    overlap_swept,
    visit_nearest,
)
from ...tree.compiler import chosen_by_types, inlined, lean_kernel, stack_array
from ..results import NO_NODE, ShapeSweeps
from ..shapes.hull import Hulls, are_any, form_of, hull_of, surface_of, triangle_hull
from ..shapes.mesh import CONVEX
from ..shapes.shape import (
    CAPSULE,
    CYLINDER,
    LEAST,
    MESH,
    SPHERE,
    Floats,
    Records,
    fill_rotation,
    fill_unit,
    reach_along,
    rotate,
)
from ..shapes.surface import gap_square
from .certified import certified_bounds, plus, set_normal, times
from .distances import Distances
from .gjk import (
    AXES,
    CENTRE,
    CORE_ROWS,
    DIRECTION_ROOM,
    FIRST,
    HALF,
    SECOND,
    SLACK,
    Core,
    corner_of,
    dot,
    gap_bounds,
    support,
)
from .narrow_phase import FRAMES, fill_core, holds_part, to_frame
from .query import found_in

# ---- How a shape goes from one pose to another.
#
# Its centre, the position of the row, goes along a straight line at constant speed. It turns about
# one axis at constant rate, by at most half a turn: q(t) = (axis sin(t a), cos(t a)) q(0), a being
# half the angle between the two quaternions (Shoemake 1985, "Animating rotation with quaternion
# curves"). The sign of the product of the quaternions gives the shorter turn; it is computed
# with twice the digits, as either sign is another motion. Where it is zero, both turns are half a
# turn, and the quaternions are taken as they are given.
#
# `body` is the shape unturned, with its position at the origin, and `box` (2, 3) the corners of a
# box around it. A mesh may lie anywhere beside its position.

START, TRANSLATION, TURN, AXIS, HALF_ANGLE, ARM, REACH = 0, 3, 6, 10, 13, 14, 15
MOTION = 16  # floats: of these START, TRANSLATION and AXIS have three, TURN has four
OUTWARD = 1.0 + 2.0**-40  # no computed length is off by as much


@inlined
def fill_unit_as_given(turn, unit):
    """`fill_unit`, which makes a rotation by nothing the identity, with the sign that is given."""
    fill_unit(turn, unit)
    if unit[3] * turn[3] < 0.0:
        for part in range(4):
            unit[part] = -unit[part]


@lean_kernel
def set_motion(body, box, start, goal, turn, goal_turn, motion):
    """Fill in how a body goes from a start to a goal.

    ARM is a length beyond which no point of its core is from the axis about which it turns, REACH
    one beyond which no point of the shape is from its position.
    """
    first, last = stack_array(4, np.float64), stack_array(4, np.float64)
    fill_unit_as_given(turn, first)
    fill_unit_as_given(goal_turn, last)
    total = np.float64(0.0), np.float64(0.0)
    for part in range(4):
        product = times((turn[part], np.float64(0.0)), (goal_turn[part], np.float64(0.0)))
        total = plus(total, product)
    sign = -1.0 if total[0] < 0.0 else 1.0
    x, y, z, w = -first[0], -first[1], -first[2], first[3]
    a, b, c, d = sign * last[0], sign * last[1], sign * last[2], sign * last[3]
    motion[AXIS] = d * x + w * a + (b * z - c * y)
    motion[AXIS + 1] = d * y + w * b + (c * x - a * z)
    motion[AXIS + 2] = d * z + w * c + (a * y - b * x)
    length = math.sqrt(dot(motion[AXIS:], motion[AXIS:]))
    same = sign > 0.0
    for part in range(4):
        same = same and first[part] == last[part]
        motion[TURN + part] = first[part]
    for axis in range(3):
        motion[START + axis], motion[TRANSLATION + axis] = start[axis], goal[axis] - start[axis]
        motion[AXIS + axis] = motion[AXIS + axis] / length if length > 0.0 else 0.0
    motion[HALF_ANGLE] = 0.0
    if length > 0.0 and not same and body.kind != SPHERE:
        motion[HALF_ANGLE] = math.atan2(length, d * w - (a * x + b * y + c * z))
    set_reach(body, box, motion)


@lean_kernel
def set_reach(body, box, motion):
    """Fill in ARM and REACH, from the corners of the box around the core."""
    corner, radius = stack_array(3, np.float64), radius_of(body)
    arm, reach = 0.0, 0.0
    for number in range(8):
        for axis in range(3):
            low, high = min(box[0, axis] + radius, 0.0), max(box[1, axis] - radius, 0.0)
            if body.kind == MESH:
                low, high = box[0, axis], box[1, axis]
            corner[axis] = high if number >> axis & 1 == 1 else low
        reach = max(reach, math.sqrt(dot(corner, corner)))
        rotate(motion[TURN:AXIS], corner, 1.0)
        along = dot(corner, motion[AXIS:])
        for axis in range(3):
            corner[axis] -= along * motion[AXIS + axis]
        arm = max(arm, math.sqrt(dot(corner, corner)))
    motion[ARM] = arm + (OUTWARD - 1.0) * reach
    motion[REACH] = (reach + radius) * OUTWARD


@inlined
def radius_of(body):
    """The radius by which the core of a body is grown."""
    return body.half[0] if body.kind == SPHERE or body.kind == CAPSULE else 0.0


@inlined
def fill_turn(motion, t, turn):
    """Fill in the quaternion at t."""
    angle = t * motion[HALF_ANGLE]
    sine, w = math.sin(angle), math.cos(angle)
    x, y, z = sine * motion[AXIS], sine * motion[AXIS + 1], sine * motion[AXIS + 2]
    a, b, c, d = motion[TURN], motion[TURN + 1], motion[TURN + 2], motion[TURN + 3]
    turn[0] = w * a + x * d + (y * c - z * b)
    turn[1] = w * b + y * d + (z * a - x * c)
    turn[2] = w * c + z * d + (x * b - y * a)
    turn[3] = w * d - (x * a + y * b + z * c)


@lean_kernel
def fill_swept_box(body, box, motion, span, more, lo, hi, translation):
    """Fill in a box and its translation that hold the body, grown by `more`, for a span of t.

    A point that turns by an angle of 2 a leaves the line between its ends by at most
    ARM (1 - cos a).
    """
    turn, matrix = stack_array(4, np.float64), stack_array((3, 3), np.float64)
    offset, half = stack_array(3, np.float64), stack_array(3, np.float64)
    begin, length = span[0], span[1] - span[0]
    aside = motion[ARM] * (1.0 - math.cos(length * motion[HALF_ANGLE]))
    pad = (OUTWARD - 1.0) * (motion[REACH] + more) + LEAST
    for axis in range(3):
        lo[axis], hi[axis] = np.inf, -np.inf
        farthest = abs(motion[START + axis]) + abs(motion[TRANSLATION + axis])
        pad = max(pad, (OUTWARD - 1.0) * farthest)
    for end in range(2):
        fill_turn(motion, span[end], turn)
        fill_rotation(turn, matrix)
        for axis in range(3):
            offset[axis] = half[axis] = 0.0
            if body.kind == MESH:
                offset[axis] = 0.5 * box[0, axis] + 0.5 * box[1, axis]
                half[axis] = 0.5 * box[1, axis] - 0.5 * box[0, axis]
            else:
                half[axis] = body.half[axis]
        rotate(turn, offset, 1.0)
        for axis in range(3):
            reach = reach_along(body.kind, half, matrix, axis) + aside + more + pad
            lo[axis] = min(lo[axis], offset[axis] - reach)
            hi[axis] = max(hi[axis], offset[axis] + reach)
    for axis in range(3):
        place = motion[START + axis] + begin * motion[TRANSLATION + axis]
        lo[axis], hi[axis], translation[axis] = (
            lo[axis] + place,
            hi[axis] + place,
            length * motion[TRANSLATION + axis],
        )


@inlined
def goes_far(motion, span):
    """Whether a body goes farther than it is large."""
    turned = 2.0 * motion[HALF_ANGLE] * motion[ARM]
    translation = math.sqrt(dot(motion[TRANSLATION:], motion[TRANSLATION:]))
    return (span[1] - span[0]) * (translation + turned) > motion[REACH]


# ---- When a body in motion first touches an obstacle: conservative advancement.
#
# A plane between the two, with the unit normal n towards the body, leaves a gap g. A point of the
# body comes nearer along n at most at the rate -v . n + |n x w| ARM; v is the velocity of the
# centre, w that of the turn. So the body is free for g divided by that rate; from there the
# next plane is looked for (Mirtich, "Impulse-based dynamic simulation of rigid body systems",
# 1996, section 2.3; Zhang, Lee and Kim, "Interactive continuous collision detection for
# non-convex polyhedra", 2006). A plane stays in use while it leaves a good gap. Then GJK finds
# another, and where that leaves no more than the resolution, the certified distance decides: what
# is not farther than the resolution is contact.
#
# Beside an obstacle that it only grazes, a body needs ever more of these steps. There the plane
# holds for longer, as the motion is known to the second order: after a time s the height of a
# point y above the plane is at least n . y + s n . (v + w x y) - |w|^2 ARM s^2 / 2. The least of
# that over all points is concave in s, so where it is above zero at the end of a step, it is for
# all of the step. A plane that turns with the body, beside which the obstacle moves, is tried as
# well: a tilted plate that turns below a ball stays as near to it as it is.
#
# Each step but the last goes on by more than the resolution divided by the largest rate, so the
# search ends; where t is rounded to what it was, that is contact, too.
#
# Gaps are computed from poses that are rounded. ROUNDED is more than all of that, of the largest
# length in play: the distance of the two at the start, the translation, and their sizes. What a
# gap has beyond it is certain.

ROUNDED = 2.0**-46
FAR = 2.0**-49  # of where an obstacle lies, that a displacement or the middle of a mesh is off by
LESS = 1.0 - 2.0**-40  # of a step
ENDS = 1.0 + 2.0**-40  # past the end of the motion
ENOUGH = 0.25  # of its first gap, as long as a plane stays in use
LONGEST = 2.0**1000
MOST_TRIALS = 40  # of longer steps, each twice as long
ALL_ROWS = 3 * CORE_ROWS


class Drift(NamedTuple):
    """How an obstacle moves while the body moves."""

    before: Any
    """(3,) how far it has gone at the start."""
    velocity: Any
    """(3,) a unit of t."""
    stop: float
    """From this t on it rests."""
    since: float
    """Its age in s at the start, if it grows."""
    pace: float
    """s a unit of t."""
    growth: float
    """m/s, by which it grows with either sign of the time."""


@inlined
def growth_at(drift, t):
    """By how much an obstacle has grown at t."""
    return drift.growth * abs(drift.since + drift.pace * t)


@lean_kernel
def set_pose(motion, body, place, scale, t, core):
    """Fill in the core of the body at t; place = (start, translation), scaled, as the obstacle
    sees it.
    """
    (start, translation), turn = place, stack_array(4, np.float64)
    fill_turn(motion, t, turn)
    for axis in range(3):
        core[CENTRE, axis] = body.position[axis] * scale
        for row in range(3):
            core[AXES + axis, row] = 1.0 if axis == row else 0.0
        rotate(turn, core[AXES + axis], 1.0)
    rotate(turn, core[CENTRE], 1.0)
    for axis in range(3):
        core[CENTRE, axis] += start[axis] + t * translation[axis]


@inlined
def flatten(core, flat):
    """Fill in a core seen from above."""
    for row in range(AXES, CORE_ROWS):
        flat[row, 0], flat[row, 1], flat[row, 2] = core[row, 0], core[row, 1], 0.0


@inlined
def plane_gap(cores, normal, corner):
    """The gap that a plane with this normal leaves between two cores."""
    corner_of(cores[0], cores[1], normal, corner)
    return dot(normal, corner)


@inlined
def approach(motion, velocity, normal, scale):
    """At most how fast a body comes nearer along a normal, a unit of t."""
    a, b, c = motion[AXIS], motion[AXIS + 1], motion[AXIS + 2]
    x, y = normal[1] * c - normal[2] * b, normal[2] * a - normal[0] * c
    z = normal[0] * b - normal[1] * a
    turning = 2.0 * motion[HALF_ANGLE] * math.sqrt(x * x + y * y + z * z) * motion[ARM] * scale
    rate = turning * OUTWARD - dot(velocity, normal)
    # What rounding takes off the product.
    size = abs(velocity[0]) + abs(velocity[1]) + abs(velocity[2])
    return rate + (OUTWARD - 1.0) * (size + turning)


@inlined
def fastest(motion, velocity, scale):
    """At most how fast a body comes nearer along any normal."""
    turning = 2.0 * motion[HALF_ANGLE] * motion[ARM] * scale
    return (math.sqrt(dot(velocity, velocity)) + turning) * OUTWARD


@inlined
def height_after(motion, core, place, normal, velocity, scale, step, room):
    """A height above which the body's core surely is, along a normal, after a step; place is that
    of its position.
    """
    lever, lowest = room[0], room[1]
    rate, arm = 2.0 * motion[HALF_ANGLE], motion[ARM] * scale
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        cross = normal[y] * motion[AXIS + z] - normal[z] * motion[AXIS + y]
        lever[axis], lowest[axis] = normal[axis] + step * rate * cross, 0.0
    support(core.rows, core.is_round, core.hull, lever, 1.0, lowest)
    height = 0.0
    for axis in range(3):
        height += lever[axis] * (lowest[axis] - place[axis])
        height += normal[axis] * (place[axis] + step * velocity[axis])
    return height - 0.5 * (rate * step) * (rate * step) * arm * OUTWARD


@inlined
def top_after(motion, other, reach, place, normal, velocity, step, room):
    """A height that the obstacle's core surely does not reach, along a normal that turns with the
    body, seen from the body's position, after a step. No point of that core is farther than
    `reach` from its centre.
    """
    lever, farthest = room[0], room[1]
    rate, along, across = 2.0 * motion[HALF_ANGLE], dot(place, motion[AXIS:]), 0.0
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        cross = motion[AXIS + y] * normal[z] - motion[AXIS + z] * normal[y]
        lever[axis], farthest[axis] = normal[axis] + step * rate * cross, 0.0
        apart = place[axis] - along * motion[AXIS + axis]
        across += apart * apart
    support(other.rows, other.is_round, other.hull, lever, -1.0, farthest)
    speed = math.sqrt(dot(velocity, velocity))
    arm = (math.sqrt(across) + reach + speed * step) * OUTWARD
    top = 0.0
    for axis in range(3):
        top += lever[axis] * (-farthest[axis] - place[axis])
        top -= normal[axis] * step * velocity[axis]
    return top + 0.5 * step * step * rate * (rate * arm + 2.0 * speed) * OUTWARD


@lean_kernel
def contact_of_hulls(
    planar, body, hull, motion, obstacle, other_hull, drift, options, span, contact
):
    """The first t of a span, its ends included, at which a body touches an obstacle or is not
    surely farther from it than the resolution; inf if there is none, or after `latest`. span =
    (begin, end, latest), options = (tolerance, resolution).

    The two are convex; `hull` and `other_hull` are the vertices of their meshes.

    Fills in contact (2, 3): the obstacle's point that is closest then, and the unit vector from
    there to the body, zero where they overlap at the start.
    """
    tolerance, resolution = options
    rows, room = stack_array((ALL_ROWS, 3), np.float64), stack_array((9, 3), np.float64)
    direction, corner = stack_array(DIRECTION_ROOM, np.float64), stack_array(6, np.float64)
    start, translation, drifting, velocity, normal, last, place = (
        *(room[0], room[1], room[2]),
        *(room[3], room[4], room[5]),
        room[6],
    )
    largest, far = max(motion[REACH], tolerance, growth_at(drift, 0.0), growth_at(drift, 1.0)), 0.0
    for axis in range(3):
        start[axis] = (motion[START + axis] - obstacle.position[axis]) - drift.before[axis]
        if drift.before[axis] != 0.0:  # and that is rounded
            far = max(far, abs(drift.before[axis]), abs(motion[START + axis]))
        if obstacle.kind == MESH and not (planar and axis == 2):  # as is where its middle lies
            far = max(far, abs(obstacle.position[axis]))
        translation[axis], drifting[axis] = motion[TRANSLATION + axis], drift.velocity[axis]
        if planar and axis == 2:
            start[axis] = translation[axis] = drifting[axis] = 0.0
        largest = max(largest, abs(start[axis]), abs(translation[axis]), obstacle.half[axis])
        largest = max(largest, abs(drifting[axis]) * min(drift.stop, 1.0))
        contact[0, axis], contact[1, axis] = obstacle.position[axis] + drift.before[axis], 0.0
    if not largest < LONGEST:
        return 0.0  # not decided
    exponent = math.frexp(largest)[1] + 2
    scale = math.ldexp(1.0, -exponent)
    # A planar scene sees the shadow of a body, and that turns as the solid does.
    fixed, solid = rows[:CORE_ROWS], rows[CORE_ROWS : 2 * CORE_ROWS]
    moving = rows[2 * CORE_ROWS :] if planar else solid
    is_round, other_radius = fill_core(obstacle, obstacle.position, exponent, planar, fixed)
    radius = radius_of(body)
    for axis in range(3):
        half = 1.0 if body.kind == MESH else max(body.half[axis] - radius, 0.0)
        moving[HALF, axis] = solid[HALF, axis] = half * scale
        start[axis], translation[axis] = start[axis] * scale, translation[axis] * scale
        drifting[axis], last[axis] = drifting[axis] * scale, 0.0
    radius *= scale
    other = Core(fixed, is_round, other_hull)
    cores = Core(moving, body.kind == CYLINDER, hull), other
    solid_core = Core(solid, body.kind == CYLINDER, hull)
    extent, rounded = math.sqrt(dot(fixed[HALF], fixed[HALF])), ROUNDED + FAR * far * scale
    if obstacle.kind == MESH:
        extent = 2.0 * scale * math.sqrt(dot(obstacle.half, obstacle.half))
    # A plane that turns with the body stays upright, as a shadow needs it, or there is no shadow.
    turns = motion[HALF_ANGLE] > 0.0 and (
        not planar or (motion[AXIS] == 0.0 and motion[AXIS + 1] == 0.0)
    )
    reach, near = radius + other_radius + tolerance * scale, resolution * scale
    growing = drift.growth * abs(drift.pace) * scale
    (t, end, latest), low, high, checked = span, 0.0, 0.0, -1.0
    # The first plane lies across the line between the positions: that often does, without GJK.
    set_normal(start, normal)
    widest = 0.0
    while True:
        going = t < drift.stop
        set_pose(motion, body, (start, translation), scale, t, solid)
        for axis in range(3):
            velocity[axis] = translation[axis] - (drifting[axis] if going else 0.0)
            solid[CENTRE, axis] -= drifting[axis] * min(t, drift.stop)
        if planar:
            flatten(solid, moving)
        taken = reach + growth_at(drift, t) * scale + rounded
        gap = plane_gap(cores, normal, corner) - taken
        if not (gap > near and gap > ENOUGH * widest):
            low, high = gap_bounds(cores[0], cores[1], np.nan, direction)
            set_normal(direction, normal)
            gap = widest = plane_gap(cores, normal, corner) - taken
            checked = t
        rate = approach(motion, velocity, normal, scale) + growing
        following = next_time(t, gap, rate, drift.stop)
        if not (gap > near or following > end):
            if high - taken <= near:
                break
            low, high, _ = certified_bounds(cores[0], cores[1], taken, True, direction)
            set_normal(direction, normal)
            gap = widest = plane_gap(cores, normal, corner) - taken
            rate = approach(motion, velocity, normal, scale) + growing
            following = next_time(t, gap, rate, drift.stop)
            if low - taken > near:
                rate = fastest(motion, velocity, scale) + growing
                following = max(following, next_time(t, low - taken, rate, drift.stop))
            elif not following > end:
                break
        if gap > 0.0:
            for axis in range(3):
                last[axis] = normal[axis]
                place[axis] = (
                    start[axis] + t * translation[axis] - drifting[axis] * min(t, drift.stop)
                )
            # How high the obstacle reaches, and all that is taken off a gap.
            top = dot(normal, corner[3:]) - (gap + taken) + taken
            last_step = min(drift.stop, ENDS) if going else ENDS
            for _ in range(MOST_TRIALS):
                if not t < following <= latest:
                    break
                trial = min(t + 2.0 * (following - t), last_step)
                step = trial - t
                height = height_after(
                    motion, solid_core, place, normal, velocity, scale, step, room[7:]
                )
                if not height - growing * step > top and turns:
                    own = dot(normal, corner[3:]) - dot(normal, place) - taken - growing * step
                    higher = top_after(
                        motion, other, extent, place, normal, velocity, step, room[7:]
                    )
                    height = np.inf if own > higher else -np.inf
                if not (trial > following and height - growing * step > top):
                    break
                following = trial
        if following > latest:
            return np.inf
        if not following > t:
            break
        t = following
    if checked != t:
        low, high = gap_bounds(cores[0], cores[1], np.nan, direction)
    radii = radius, other_radius + growth_at(drift, t) * scale
    fill_contact(low, radii, direction, last)
    for axis in range(3):
        displaced = drift.before[axis] + drift.velocity[axis] * min(t, drift.stop)
        contact[0, axis] = direction[SECOND + axis] / scale + (obstacle.position[axis] + displaced)
        contact[1, axis] = last[axis]
    return t


@inlined
def next_time(t, gap, rate, stop):
    """Until when a gap lasts at a rate, from t on, at which it is next looked at."""
    following = t
    if gap > 0.0:
        following = t + gap / rate * LESS if rate > 0.0 else np.inf
    return min(following, stop) if t < stop else following


@lean_kernel
def fill_contact(low, radii, direction, last):
    """Fill in direction[SECOND:] with the obstacle's closest point, and `last` with the unit
    vector from it to the body, from what `gap_bounds` found. Where the two touch up to rounding,
    it is the normal of the last plane between them: zero if there was none.
    """
    length = 0.0
    for axis in range(3):
        apart = direction[FIRST + axis] - direction[SECOND + axis]
        length += apart * apart
    length, (radius, other_radius) = math.sqrt(length), radii
    if low > SLACK and length > radius + other_radius - SLACK:
        set_normal(direction, last)
    for axis in range(3):
        along = last[axis]
        if length > 0.0 and last[0] == 0.0 and last[1] == 0.0 and last[2] == 0.0:
            along = (direction[FIRST + axis] - direction[SECOND + axis]) / length
        direction[SECOND + axis] += along * min(other_radius, length)


# ---- Meshes that are not convex: triangle by triangle.


@lean_kernel
def contact_of_convex(hulls, bodies, body, box, motion, obstacle, drift, options, span, contact):
    """`first_contact` where all meshes are convex."""
    planar, hull = bodies.footprints is not None, hull_of(bodies.query_hulls, body)
    return contact_of_hulls(
        *(planar, body, hull, motion, obstacle, hull_of(hulls, obstacle)),
        *(drift, options, span, contact),
    )


class Approach(NamedTuple):
    """A convex body, or a triangle of one, that moves towards an obstacle."""

    planar: Any
    hulls: Any
    body: Any
    hull: Any
    box: Any
    """(2, 3) around the body, unturned."""
    motion: Any
    obstacle: Any
    drift: Any
    options: Any
    span: Any
    contact: Any


@lean_kernel
def fill_region(approach, region):
    """Fill in the box (2, 3), in the frame of the obstacle, of all places where the body may be in
    a span of t; the obstacle is where it is stored.
    """
    room, corner = stack_array((3, 3), np.float64), stack_array(3, np.float64)
    lo, hi, translation = room[0], room[1], room[2]
    drift, span, obstacle = approach.drift, approach.span, approach.obstacle
    more = approach.options[0] + approach.options[1]
    more += max(growth_at(drift, span[0]), growth_at(drift, span[1]))
    fill_swept_box(approach.body, approach.box, approach.motion, span, more, lo, hi, translation)
    size = 0.0
    for axis in range(3):
        first = drift.before[axis] + drift.velocity[axis] * min(span[0], drift.stop)
        last = drift.before[axis] + drift.velocity[axis] * min(span[1], drift.stop)
        lo[axis] += min(translation[axis], 0.0) - max(first, last)
        hi[axis] += max(translation[axis], 0.0) - min(first, last)
        size = max(size, abs(first), abs(last), abs(lo[axis]), abs(hi[axis]))
        size = max(size, abs(obstacle.position[axis]))
        region[0, axis], region[1, axis] = np.inf, -np.inf
    for number in range(8):
        for axis in range(3):
            corner[axis] = hi[axis] if number >> axis & 1 == 1 else lo[axis]
        to_frame(obstacle, approach.planar, corner)
        for axis in range(3):
            region[0, axis] = min(region[0, axis], corner[axis] - FRAMES * size)
            region[1, axis] = max(region[1, axis], corner[axis] + FRAMES * size)
    if approach.planar:
        region[0, 2], region[1, 2] = -np.inf, np.inf


@inlined
def _look_at_triangle(near_by, query, leaf, square, best, count, limit):
    approach, surface, places = near_by
    hull = triangle_hull(approach.hulls, surface, np.int64(leaf >> 1), places)
    _look_at_hull(approach, hull, best)
    return np.int64(1), limit


@inlined
def _look_at_hull(approach, other_hull, best):
    """Lower best[0] to the first contact with an obstacle, or its triangle."""
    begin, end, latest = approach.span
    contact = stack_array((2, 3), np.float64)
    found = contact_of_hulls(
        *(approach.planar, approach.body, approach.hull, approach.motion, approach.obstacle),
        *(other_hull, approach.drift, approach.options),
        *((begin, end, min(latest, best[0])), contact),
    )
    if found < best[0]:
        best[0] = found
        for row in range(2):
            for axis in range(3):
                approach.contact[row, axis] = contact[row, axis]


@lean_kernel
def meet_obstacle(approach, best):
    """Lower best[0] to the first contact of a convex body, or its triangle, with any obstacle."""
    if form_of(approach.hulls, approach.obstacle) == CONVEX:
        _look_at_hull(approach, hull_of(approach.hulls, approach.obstacle), best)
        return
    region, places = stack_array((2, 3), np.float64), stack_array((3, 3), np.float64)
    fill_region(approach, region)
    surface = surface_of(approach.hulls, approach.obstacle)
    query = Near(region[0], region[1], 1, 0.0, ALL)
    visit_nearest(
        *((approach, surface, places), surface.nodes, surface.root, query, best),
        *(0.0, gap_square, _look_at_triangle),
    )


@lean_kernel
def contact_of_any(hulls, bodies, body, box, motion, obstacle, drift, options, span, contact):
    """`first_contact` where meshes may be of any form."""
    mine, theirs = form_of(bodies.query_hulls, body), form_of(hulls, obstacle)
    if mine == CONVEX and theirs == CONVEX:
        return contact_of_convex(
            hulls, bodies, body, box, motion, obstacle, drift, options, span, contact
        )
    best, planar = stack_array(1, np.float64), bodies.footprints is not None
    best[0] = np.inf
    if not planar and span[0] == 0.0 and is_inside(bodies, body, motion, obstacle, drift, contact):
        return 0.0
    if mine == CONVEX:
        hull = hull_of(bodies.query_hulls, body)
        given = body, hull, box, motion, obstacle, drift, options, span, contact
        meet_obstacle(Approach(planar, hulls, *given), best)
        return best[0]
    surface = surface_of(bodies.query_hulls, body)
    places, own = stack_array((3, 3), np.float64), stack_array((2, 3), np.float64)
    for face in range(surface.corners.shape[0]):
        hull = triangle_hull(bodies.query_hulls, surface, face, places)
        node = surface.nodes[2 * face]
        for axis in range(3):
            own[0, axis] = body.position[axis] + node.lo[axis]
            own[1, axis] = body.position[axis] + node.hi[axis]
        given = body, hull, own, motion, obstacle, drift, options, span, contact
        meet_obstacle(Approach(planar, hulls, *given), best)
    return best[0]


@lean_kernel
def is_inside(bodies, body, motion, obstacle, drift, contact):
    """Whether one of the two is a solid that holds the other at the start; fill in the point."""
    records, place = stack_array(2, bodies.shapes), contact[0]
    records[0], records[1] = body, obstacle
    for axis in range(3):
        records[0].position[axis] = body.position[axis]
        records[1].position[axis] = obstacle.position[axis] + drift.before[axis]
        contact[1, axis] = 0.0
    rotate(motion[TURN:AXIS], records[0].position, 1.0)
    for axis in range(3):
        records[0].position[axis] += motion[START + axis]
    for part in range(4):
        records[0].orientation[part] = motion[TURN + part]
    hulls, own = bodies.hulls, bodies.query_hulls
    return holds_part(records[1], hulls, records[0], own, place) or holds_part(
        records[0], own, records[1], hulls, place
    )


@chosen_by_types
def first_contact(hulls, bodies, body, box, motion, obstacle, drift, options, span, contact):
    """The first t of a span, its ends included, at which a body touches an obstacle: see
    `contact_of_hulls`. `hulls` are the obstacle's.
    """
    return contact_of_any if are_any(hulls) else contact_of_convex


# ---- Rows of a batch.

MANY = 12  # obstacles near a motion: it is looked at in parts, the first part first
SHORTEST_PART = 2.0**-10  # of a motion: a body like a point may be near as many in each


class Rows(NamedTuple):
    """n sweeps of one body, for kernels."""

    body: Records
    """(1,)"""
    box: Floats
    """(2, 3)"""
    starts: Floats
    """(n, 3), as `goals`."""
    goals: Floats
    turns: Floats
    """(n, 4), or (1, 4) for all, as `goal_turns`."""
    goal_turns: Floats
    tolerances: Floats
    """One for all, or (n,)."""
    masks: NDArray[np.uint32]
    """One for all, or (n,)."""
    resolution: float
    pace: Any
    """s a unit of t, one for all or (n,); None among obstacles at rest."""


@inlined
def answer_sweeps(
    world, bodies, rows, place, options, node_handles, slots, results, candidates, drift_of
):
    """Fill in the rows [start, stop) of `results`, slots of obstacles and the columns of
    `ShapeSweeps`; place = (start, stop), options = (whether any contact will do,). Returns (rows
    done, room wanted in `slots`): fewer rows than there are where there is no room.

    candidates(world, row, box, span, mask, slots) writes the slots of all that a swept box may
    touch in a span of t, box = (lo, hi, translation), and returns how many they are, or a negative
    number, which ends it.
    drift_of(world, row, slot, room) returns the `Drift` of an obstacle.
    """
    (row, stop), (enough,) = place, options
    slots_met, handles, t, free_until, points, normals = results
    motion, contact = stack_array(MOTION, np.float64), stack_array((2, 3), np.float64)
    room = stack_array((5, 3), np.float64)
    lo, hi, translation = room[0], room[1], room[2]
    room[:] = 0.0
    wanted, body = np.int64(0), rows.body[0]
    while row < stop:
        turn = rows.turns[row if rows.turns.shape[0] > 1 else 0]
        goal_turn = rows.goal_turns[row if rows.goal_turns.shape[0] > 1 else 0]
        set_motion(body, rows.box, rows.starts[row], rows.goals[row], turn, goal_turn, motion)
        limits = of_row(rows.tolerances, row), rows.resolution
        first, best, mask = np.inf, np.int64(NO_NODE), of_row(rows.masks, row)
        begin, end, wanted = 0.0, 1.0, np.int64(0)
        while begin < 1.0 and not first < np.inf:
            span = begin, end
            fill_swept_box(
                body, rows.box, motion, span, limits[0] + limits[1], lo, hi, translation
            )
            wanted = candidates(world, row, (lo, hi, translation), span, mask, slots)
            if wanted > MANY and end - begin > SHORTEST_PART and goes_far(motion, span):
                end = 0.5 * (begin + end)  # a part is near fewer of them
                continue
            if wanted < 0 or wanted > slots.shape[0]:
                break
            for slot in slots[:wanted]:
                drift, shape = drift_of(world, row, slot, room[3:]), bodies.shapes[slot]
                times_of = begin, end, min(first, end)
                found = first_contact(
                    *(bodies.hulls, bodies, body, rows.box, motion),
                    *(shape, drift, limits, times_of, contact),
                )
                handle = np.int64(node_handles[slot])
                if found < first or (found == first and found < np.inf and handle < best):
                    first, best, slots_met[row] = found, handle, slot
                    for axis in range(3):
                        points[row, axis] = contact[0, axis]
                        normals[row, axis] = contact[1, axis]
                    if enough:
                        break
            begin, end = end, min(end + 2.0 * (end - begin), 1.0)
        if wanted < 0:
            row = wanted
            break
        if wanted > slots.shape[0]:
            break
        handles[row], t[row], free_until[row] = best, first, first
        if not first < np.inf:
            for axis in range(3):
                points[row, axis], normals[row, axis] = np.nan, 0.0
        elif bodies.footprints is not None:
            points[row, 2] = rows.starts[row, 2]
        row += 1
    return np.int64(row), wanted


@inlined
def _candidates(tree, _row, box, _span, mask, slots):
    ndim = tree.nodes[0].lo.shape[0]
    return overlap_swept(tree, box[0][:ndim], box[1][:ndim], box[2][:ndim], mask, slots)


@inlined
def _at_rest(_tree, _row, _slot, room):
    return Drift(room[0], room[1], np.inf, 0.0, 0.0, 0.0)


@lean_kernel
def sweep_rows(view, bodies, node_handles, memory, rows, place, options, results):
    """`answer_sweeps` among obstacles at rest, as `overlap_rows`."""
    tree, slots = view.tree, found_in(memory).slots
    if not begin_query(tree.state, view.version):
        return np.int64(REFUSED), np.int64(0), np.int64(0)
    done = answer_sweeps(
        tree, bodies, rows, place, options, node_handles, slots, results, _candidates, _at_rest
    )
    version = tree.state[CHANGES]
    end_query(tree.state)
    return (*done, version)


class ShapeSweeper(Distances):
    """Sweeps shapes in one scene, among obstacles as they are."""

    kernels = (sweep_rows,)

    def sweep(
        self, rows: Rows, hulls: Hulls | None, enough: bool, threads: int, at: Any
    ) -> tuple[NDArray[np.int64], ShapeSweeps]:
        """First contacts of n sweeps, and the slots of the obstacles; `hulls` are the body's.
        `enough`: of each row any contact will do. `at`: when they start, s, one for all or (n,).
        """
        count = len(rows.starts)
        slots, handles = np.empty(count, INT64), np.empty(count, np.uint32)
        places = np.empty((count, 3)), np.empty((count, 3))
        found = ShapeSweeps(handles, np.empty(count), np.empty(count), *places)
        batch = 0, rows, (enough,), (slots, *found), hulls, True, at
        self._answer(batch, count, threads)
        return slots, found
