# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`meeting` of boxes that may stop: they go until some time, and stand from then on where they
are. Both parts of their way are decided exactly.

The end is a double, as any time; who has not reached it when a course starts is on its way until
t = (end - at) / pace, a quotient as those that faces are met at. At that t both parts are at one
place, so a box that stands is met on its second part only if not on its first.
"""

import numpy as np

from ..compiler import inlined, lean_kernel
from ..rays.slab import INSIDE
from .meeting import Course, box_of, compare, meet, moves, quotient_of, side_of
from .sums import A_NANOSECOND

STOPPED = 16  # more than its face says that a box stopped on the way and stood when it was met
LATER = 2.0**-40  # of times: more than is lost as the last of a course is computed


@inlined
def end_of(box, left):
    """When a box stops, s; inf if it never does."""
    return box[3] + left if moves(box) else np.inf


@inlined
def moment_of(box, at, left):
    """A time, or the end if that was before: the box is at one place at both."""
    return min(at, box[3] + left)


@inlined
def _standing(course, end):
    """A course past a box that stands where it is at the end."""
    return Course(course.ray, end, 0.0, course.nanoseconds, np.inf)


@inlined
def _stop(end):
    """A side that is met when time is up: its gap is end - at, its rate the pace."""
    return 0.0, 0.0, -1.0, end, 0.0


@inlined
def as_met(box, course, face):
    """The course as a box sees it that was met, while it went or as it stood, and the face."""
    end = end_of(box, course.left)
    if face >= STOPPED + INSIDE:
        return _standing(course, end), face - STOPPED
    return (_standing(course, end) if end < course.at else course), face


@inlined
def _after_the_end(box, seen, t, face, course, end):
    """Sign of the t at which a face is met, by the course as the box is seen, less that at which
    time is up.
    """
    stop = _stop(end)
    times, other = (seen.at, seen.pace), (course.at, course.pace)
    return compare(
        seen, t, side_of(box, seen, face), times, quotient_of(course, stop), stop, other
    )


@lean_kernel
def _meet_both(box, course, t_max, end):
    """`meet_box` of one that goes when the course starts, and may stop on the way."""
    hit, t, face = meet(box, course, t_max)
    if hit and (face == INSIDE or _after_the_end(box, course, t, face, course, end) <= 0):
        return hit, t, face
    seen = _standing(course, end)
    hit, t, face = meet(box, seen, t_max)
    if hit:
        hit = face != INSIDE and _after_the_end(box, seen, t, face, course, end) >= 0
    return hit, t, face + STOPPED


@inlined
def meet_box(box, course, t_max):
    """`meeting.meet` of a box that may stop: (hit, t, face); `as_met` reads the face."""
    end = end_of(box, course.left)
    if end < course.at:
        return meet(box, _standing(course, end), t_max)
    if course.pace > 0.0 and not _is_over(course, t_max, end):
        return _meet_both(box, course, t_max, end)
    return meet(box, course, t_max)


@inlined
def _is_over(course, t_max, end):
    """Whether a course surely is before the end."""
    way = course.pace * t_max
    more = (abs(course.at) + way) * LATER + (1.0 + t_max) * A_NANOSECOND
    return course.at + way + more < end or end == np.inf


@inlined
def face_met(box, course, t_max, t, face):
    """The face that `meet_box` says, of which t and the axis are known."""
    end = end_of(box, course.left)
    if end < course.at or course.pace <= 0.0 or _is_over(course, t, end):
        return face
    more = (abs(end) + abs(course.at)) * LATER + (1.0 + t) * A_NANOSECOND
    if course.at + course.pace * t > end + more:
        return face + STOPPED
    return meet_box(box, course, t_max)[2]


@inlined
def distance_of(box, course, face):
    """t of `meet_box`, which has told the face."""
    seen, face = as_met(box, course, face)
    return 0.0 if face == INSIDE else quotient_of(seen, side_of(box, seen, face))


@lean_kernel
def is_before(tree, moving, course, hit, other):
    """Whether the first of two hits of a course, each (slot, t, face), is the nearer, or as near
    with the smaller handle.
    """
    (slot, t, face), (other_slot, other_t, other_face) = hit, other
    box, other_box = box_of(tree, moving, slot), box_of(tree, moving, other_slot)
    seen, face = as_met(box, course, face)
    other_seen, other_face = as_met(other_box, course, other_face)
    order = np.int64(face != INSIDE) - np.int64(other_face != INSIDE)
    if face != INSIDE and other_face != INSIDE:
        times, other_times = (seen.at, seen.pace), (other_seen.at, other_seen.pace)
        side = side_of(box, seen, face)
        other_side = side_of(other_box, other_seen, other_face)
        order = compare(course, t, side, times, other_t, other_side, other_times)
    return order < 0 or (order == 0 and tree.handles[slot] < tree.handles[other_slot])
