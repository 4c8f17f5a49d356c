# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that go until some time, and stand from then on where they are: `meeting` for both parts
of their way, as exactly.

The end is a double, as any time; who has not reached it when a course starts is on its way until
t = (end - at) / pace, a quotient as those that faces are met at. At that t both parts are at one
place, so a box that stands is met on its second part only if not on its first.
"""

import numpy as np

from ..jit.compiling import inlined, lean_kernel
from ..nodes import NONE
from ..rays.slab import INSIDE
from .meeting import Course, box_of, compare, meet, quotient_of, side_of
from .sums import gap

STOPPED = 16  # more than its face says that a box stood when it was met


@inlined
def _stop(end):
    """A side that is met when time is up: its gap is end - at, its rate the pace."""
    return 0.0, 0.0, -1.0, end, 0.0


@inlined
def _goes_on(course, end):
    """Whether the end is not before the course."""
    return gap(0.0, 0.0, -1.0, course.at, end, course.nanoseconds)[0] >= 0.0


@inlined
def standing(course, end):
    """A course past a box that stands where it is at the end."""
    return Course(course.ray, end, 0.0, course.nanoseconds)


@inlined
def as_met(box, course, face, left):
    """The course as a box sees it that was met, until `left` after its reference or from then on,
    and the face.
    """
    if face >= STOPPED + INSIDE:
        return standing(course, box[3] + left), face - STOPPED
    return course, face


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
def meet_going(box, course, t_max, end):
    """`meet` until the end."""
    if not _goes_on(course, end):
        return False, np.inf, np.int64(INSIDE)
    hit, t, face = meet(box, course, t_max)
    if hit and face != INSIDE and course.pace != 0.0:
        hit = _after_the_end(box, course, t, face, course, end) <= 0
    return hit, t, face


@lean_kernel
def meet_standing(box, course, t_max, end):
    """`meet` from the end on, for who was not met before it; STOPPED is added to the face."""
    goes_on, seen = _goes_on(course, end), standing(course, end)
    if goes_on and course.pace == 0.0:
        return False, np.inf, np.int64(INSIDE)
    hit, t, face = meet(box, seen, t_max)
    if hit and goes_on:
        hit = face != INSIDE and _after_the_end(box, seen, t, face, course, end) >= 0
    return hit, t, face + STOPPED


@lean_kernel
def is_sooner(tree, moving, course, left, hit, other):
    """`is_before` of hits of which either may have STOPPED, `left` after its reference."""
    (slot, t, face), (other_slot, other_t, other_face) = hit, other
    if other_slot == NONE:
        return True
    box, other_box = box_of(tree, moving, slot), box_of(tree, moving, other_slot)
    seen, face = as_met(box, course, face, left)
    other_seen, other_face = as_met(other_box, course, other_face, left)
    order = np.int64(face != INSIDE) - np.int64(other_face != INSIDE)
    if face != INSIDE and other_face != INSIDE:
        times, other_times = (seen.at, seen.pace), (other_seen.at, other_seen.pace)
        side = side_of(box, seen, face)
        other_side = side_of(other_box, other_seen, other_face)
        order = compare(course, t, side, times, other_t, other_side, other_times)
    return order < 0 or (order == 0 and tree.handles[slot] < tree.handles[other_slot])
