# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that touch a box at a time: the traversal of `query.overlap` among moving nodes."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined, lean_kernel, stack_array
from ..nodes import entry_points
from ..query.overlap import FIRST, NO_QUERIES, fill_rows, find_touching, name_slots
from ..query.ray import of_row
from ..query.slab import RAY_ROWS, set_swept_box
from ..simd.moving_sides import FRONTS, is_behind, is_beside
from ..store.turns import NOT_FINITE, end_query
from .bounds import (
    OUTSIDE,
    begin_asking,
    begin_rows,
    covers,
    fetch_children,
    no_motion,
    set_fronts,
)
from .entries import enter_bounds, is_sound, path_at
from .exact_contact import box_of, course_of, elapsed, meet, moment_of, surely_below


class BoxAt(NamedTuple):
    """A query at a time, among moving boxes."""

    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    at: float
    """s"""
    moving: Any
    """`Moving`"""
    bounded: bool
    """Whether the bounds of nodes hold for the time."""
    ahead: float
    """From the start of their span to the time, s."""
    fronts: NDArray[np.float64]
    """What the sides of a node are compared with, see `moving_sides`."""


@inlined
def box_at(moving, at, lo, hi):
    """The query of a box at a time."""
    fronts = stack_array(FRONTS, np.float64)
    set_fronts(fronts, moving, lo, hi, lo)
    return BoxAt(lo, hi, at, moving, covers(moving, at, 0.0, 0.0) > 0, at - moving.start, fronts)


@lean_kernel
def touches_at(box, low, high, at, moving):
    """Whether a moving box touches the one from low to high at a time: exactly."""
    lo, hi, velocity, reference = box
    at = moment_of(box, at, moving.left)
    since, _ = elapsed(at, reference, moving.nanoseconds)
    clear, nowhere = True, stack_array(3, np.float64)
    for axis in range(lo.shape[0]):
        shift, nowhere[axis] = velocity[axis] * since, 0.0
        if surely_below(high[axis], lo[axis], -shift) or surely_below(hi[axis], low[axis], shift):
            return False
        clear &= surely_below(lo[axis], high[axis], shift)
        clear &= surely_below(low[axis], hi[axis], -shift)
    if clear:
        return True
    course = course_of(stack_array((RAY_ROWS, 3), np.float64), at, 0.0, moving)
    set_swept_box(course.ray, low, high, nowhere)
    return meet(box, course, 0.0)[0]


@inlined
def _node_may_touch(nodes, node, query):
    if query.bounded and is_beside(nodes, node, query.fronts, query.ahead):
        return False
    fetch_children(nodes, node)
    return True


@inlined
def _leaf_touches(tree, leaf, query):
    nodes, ahead = query.moving.nodes, query.ahead
    if query.bounded and is_behind(nodes, leaf, query.fronts, ahead, nodes[leaf].loose):
        return True
    box = box_of(tree, query.moving, leaf >> 1)
    return touches_at(box, query.lo, query.hi, query.at, query.moving)


@lean_kernel
def overlap_at(tree, moving, at, lo, hi, mask, found, count):
    """`find_touching` of the closed box from lo to hi at a time."""
    query = box_at(moving, at, lo, hi)
    return find_touching(
        tree, moving.nodes, query, mask, found, count, _node_may_touch, _leaf_touches
    )


@inlined
def _bounds_may_meet(nodes, node, path):
    return enter_bounds(nodes, node, path, 1.0) < np.inf


@inlined
def _leaf_may_meet(_tree, leaf, path):
    return enter_bounds(path.moving.nodes, leaf, path, 1.0) < np.inf


@lean_kernel
def overlap_swept_at(tree, moving, times, lo, hi, translation, mask, found):
    """`query.overlap.overlap_swept` among moving boxes; times = (when the box starts, s, how many
    seconds its translation takes).
    """
    course = course_of(stack_array((RAY_ROWS, 3), np.float64), times[0], times[1], moving)
    fronts = stack_array(FRONTS, np.float64)
    set_swept_box(course.ray, lo, hi, translation)
    set_fronts(fronts, moving, lo, hi, translation)
    path = path_at(tree, moving, course, 1.0, mask, fronts)
    return find_touching(
        tree, moving.nodes, path, mask, found, 0, _bounds_may_meet, _leaf_may_meet
    )


@lean_kernel
def overlap_one(tree, moving, at, lo, hi, mask, found):
    """`query.overlap.overlap_one` at a time; NOT_FINITE if that is not finite, OUTSIDE if the
    bounds do not hold for it.
    """
    if not is_sound(lo, hi, lo, (at, 0.0)):
        return np.int64(NOT_FINITE)
    if covers(moving, at, 0.0, 0.0) == 0:
        return np.int64(OUTSIDE)
    why = begin_asking(tree, moving, 1)
    if why != 0:
        return why
    count = overlap_at(tree, moving, at, lo, hi, mask, found, 0)
    name_slots(tree, found, 0, min(count, found.shape[0]))
    end_query(tree.state)
    return count


@inlined
def _overlap_row(tree, queries, row, when, found, count):
    (moving, at), lo, hi = when, queries.lo[row], queries.hi[row]
    mask = of_row(queries.masks, row)
    return overlap_at(tree, moving, of_row(at, row), lo, hi, mask, found, count)


@lean_kernel
def overlap_rows(tree, moving, at, queries, start, stop, found, offsets):
    """`fill_rows` at times, one for all or one a row. A call from FIRST on counts the queries, and
    returns OUTSIDE if bounds do not hold for a time for which they could, NOT_FINITE if one is not
    finite.
    """
    if start == FIRST:
        why = begin_rows(tree, moving, at, queries.lo.shape[0])
        if why != 0:
            return why, np.int64(0), np.int64(0)
    when = moving, at
    return fill_rows(
        tree, moving.version, queries, start, stop, found, offsets, _overlap_row, when
    )


_ROW, _IDS = np.empty(0), np.empty(0, np.int64)
one_entry = entry_points(overlap_one, no_motion, 0.0, _ROW, _ROW, np.uint32(0), _IDS)
rows_entry = entry_points(overlap_rows, no_motion, _ROW, NO_QUERIES, 0, 0, _IDS, _IDS)
