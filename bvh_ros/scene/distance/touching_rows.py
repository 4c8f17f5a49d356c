# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of overlap queries and of questions for what is nearest: row by row the kernels that
answer one.
"""

from typing import Any, Literal, NamedTuple, TypeAlias

import numpy as np

from ...tree.access import (
    BOOL,
    CHANGES,
    INT64,
    IS_CHANGED,
    NOT_FINITE,
    UINT32,
    begin_query,
    end_query,
    is_finite,
    of_row,
)
from ...tree.access import COUNT as COUNTED
from ...tree.compiler import entry_point, inlined, lean_kernel, stack_array
from ..geometry.canonical import FINE
from ..results import NO_NODE
from ..store.columns import Bodies, Columns
from ..store.mesh_store import NO_HULLS, Hulls
from .query_rows import FAULTY, NARROW, make_row
from .query_shape import QueryShape
from .touching import REFUSED, ROUNDED, found_in, nearest_to, touching

# Whether distances have a sign: None, not False, so that kernels without it do not have its code.
Signed: TypeAlias = Literal[True] | None

ANY, COUNT, FIRST, ALL, HITS = range(5)  # what is wanted of each row
OPEN = -1  # only exact arithmetic tells
FEW = 64  # handles that there is room for at first
WANTED = {'any': ANY, 'count': COUNT, 'first': FIRST, 'all': ALL, 'hits': HITS}


class Answers(NamedTuple):
    """What overlap queries find: of each row, if it is wanted."""

    touched: Any
    """(n,) whether there is any, if that is all that is wanted."""
    numbers: Any
    """(n,) how many there are; where ALL are wanted (n + 1,), offsets of theirs."""
    handles: Any
    """(n,) of the first, NO_NODE without any; where ALL are wanted those of all that are met, row
    after row."""
    distances: Any
    """(n,) of the first, inf without any."""
    points: Any
    """The same, (n, 3), NaN without any."""


NOBODY = np.empty(0, np.uint32)
NOT_WANTED = np.empty(0, np.bool_), np.empty(0, np.int64), NOBODY, np.empty(0), np.empty((0, 3))


def room_for(count: int, wanted: int) -> tuple[Any, ...]:
    """Room for what is wanted of so many rows, plain `Answers`."""
    touched, numbers, handles, distances, points = NOT_WANTED
    if wanted == ANY:
        touched = np.empty(count, BOOL)
    elif wanted == COUNT:
        numbers = np.empty(count, INT64)
    elif wanted == FIRST:
        handles = np.empty(count, UINT32)
    elif wanted == ALL:
        numbers, handles = np.empty(count + 1, INT64), np.empty(FEW, UINT32)
        numbers[0] = 0
    else:
        numbers, handles = np.empty(count, INT64), np.empty(count, UINT32)
        distances, points = np.empty(count), np.empty((count, 3))
    return touched, numbers, handles, distances, points


class Points(NamedTuple):
    """n points."""

    points: Any
    """(n, 3)"""
    reaches: Any
    """The largest distance, one for all or (n,)."""
    masks: Any
    """One for all, or (n,)."""
    order: Any
    """In which they are asked, (n,); without any as they stand."""


class Near(NamedTuple):
    """What is nearest to n points, k a row."""

    handles: Any
    distances: Any
    points: Any


@lean_kernel
def overlap_rows(view, bodies, rows, wanted, place, node_handles, memory, answers):
    """Answer the rows [start, stop) of `QueryRows` by `Answers`, both as plain tuples; place =
    (start, stop, handles before these rows). Returns (rows done, room wanted in `memory`, handles
    written, pairs compared, those of them that took more digits, version of the tree): fewer rows
    than there are where there is no room for the next one, or it is OPEN, which is said instead of
    the room; REFUSED if the tree is changed, FAULTY or NARROW if a row is.
    """
    tree, (row, stop, before), enough = view.tree, place, wanted == ANY
    found, (records, _, tolerances, masks, _) = found_in(memory), rows
    handles = answers[2]
    written, compared, more, needed = 0, 0, 0, 0
    own, box = stack_array(1, records), stack_array((2, 3), np.float64)
    if not begin_query(tree.state, view.version):
        return REFUSED, 0, 0, 0, 0, 0
    version = tree.state[CHANGES]
    while row < stop:
        record, bounds, fault = make_row(rows, row, own, box)
        aligned, height = not record[0].shaped, record[0].position[2]
        if fault != FINE or (bodies is None and not aligned):
            row = FAULTY if fault != FINE else NARROW
            break
        tolerance, mask = of_row(tolerances, row), of_row(masks, row)
        query = QueryShape(record, bounds, aligned, tolerance, height)
        count, doubtful, pairs, digits = touching(
            tree, bodies, query, mask, enough, node_handles, found
        )
        compared, more, needed = compared + pairs, more + digits, count
        if count > found.slots.shape[0]:
            break
        if wanted == ALL and written + count > handles.shape[0]:
            break
        if doubtful > 0 and (not enough or count == doubtful):
            needed = OPEN
            break
        written = tell_row(node_handles, found, count, wanted, answers, row, before, written)
        row += 1
    end_query(tree.state)
    return row, needed, written, compared, more, version


@inlined
def tell_row(node_handles, found, count, wanted, answers, row, before, written):
    """Write what is wanted of a row; return how many handles are written, with those of rows
    before it, behind `before` others.
    """
    touched, numbers, handles, _, _ = answers
    if wanted == ANY:
        touched[row] = count > 0
    elif wanted == ALL:
        for i in range(count):
            handles[written + i] = node_handles[found.slots[found.order[i]]]
        written += count
        numbers[row + 1] = before + written
    if wanted in (FIRST, HITS):
        tell_first(node_handles, found, count, wanted, answers, row)
    if wanted in (COUNT, HITS):
        numbers[row] = count
    return written


@inlined
def tell_first(node_handles, found, count, wanted, answers, row):
    """Write what is known of the first."""
    first, (_, _, handles, distances, points) = found.order[0], answers
    handles[row] = node_handles[found.slots[first]] if count > 0 else NO_NODE
    if wanted == HITS:
        distances[row] = found.distances[first] if count > 0 else np.inf
        for axis in range(3):
            points[row, axis] = found.points[first, axis] if count > 0 else np.nan


@lean_kernel
def nearest_rows(view, bodies, points, asked, place, node_handles, memory, near):
    """Fill in the rows [start, stop) of `near`; asked = (k, whether an obstacle may stand at two
    places, see slicing.py, `Signed`), place = (start, stop). Returns (rows done, room wanted in
    `memory`) as `overlap_rows`; NOT_FINITE rows if a point is not.
    """
    (k, twice, signed), found = asked, found_in(memory)
    tree, (done, stop), everybody = view.tree, place, view.tree.state[COUNTED]
    in_order = bodies is None and signed is None and not twice  # as the tree has them
    if not begin_query(tree.state, view.version):
        return -1, 0
    wanted = 0
    while done < stop:
        row = points.order[done] if points.order.shape[0] > 0 else done
        reach, mask = of_row(points.reaches, row), of_row(points.masks, row)
        point, limit = points.points[row], max(reach * ROUNDED, reach)
        if not is_finite(point, point):
            end_query(tree.state)
            return NOT_FINITE, 0
        wanted, kept = min(k if in_order else k + 1, everybody + 1), 0
        while wanted <= found.slots.shape[0]:
            question = (wanted, limit, mask)
            count = nearest_to(tree, bodies, point, question, signed, node_handles, found)
            kept = keep(found, count, (k, reach, twice), node_handles, near, row)
            if (
                in_order
                or count < wanted
                or (
                    kept == k
                    and found.bounds[count - 1] > max(near.distances[row, k - 1], 0.0) * ROUNDED
                )
            ):
                break
            wanted = min(wanted * 4, everybody + 1)
        if wanted > found.slots.shape[0]:
            break
        pad(near, row, kept)
        done += 1
    end_query(tree.state)
    return done, wanted


@lean_kernel
def keep(found, count, asked, node_handles, near, row):
    """Write the first k that are within reach to a row of `near`; return how many there are."""
    k, reach, twice = asked
    kept = 0
    for i in range(count):
        place = found.order[i]
        handle, known = node_handles[found.slots[place]], False
        if kept == k or not found.distances[place] <= reach:
            break
        if twice:
            for j in range(kept):
                known = known or near.handles[row, j] == handle
        if known:
            continue
        near.handles[row, kept], near.distances[row, kept] = handle, found.distances[place]
        for axis in range(3):
            near.points[row, kept, axis] = found.points[place, axis]
        kept += 1
    return kept


@inlined
def pad(near, row, kept):
    """Write that there is nothing more."""
    for j in range(kept, near.handles.shape[1]):
        near.handles[row, j], near.distances[row, j] = NO_NODE, np.inf
        near.points[row, j] = np.nan


def bodies_of(columns: Columns, hulls: Hulls | None) -> Bodies:
    """What the narrow phase reads of a scene, and of the meshes of queries."""
    if hulls is None:
        return columns.bodies
    return columns.bodies._replace(hulls=columns.hulls or NO_HULLS, query_hulls=hulls)


class RowKernel:
    """A kernel of this module as machine code, one for boxes alone, one for all shapes, one for
    meshes too.
    """

    def __init__(self, kernel: Any) -> None:
        self._kernel = kernel
        self._codes: dict[bool | None, Any] = {}

    def call(self, given: tuple[Any, ...]) -> Any:
        """Call it with (view, bodies or None, ...); RuntimeError if the tree is changed
        meanwhile.
        """
        bodies = given[1]
        variant = None if bodies is None else bodies[2] is not None
        code = self._codes.get(variant)
        if code is None:
            code = self._codes[variant] = entry_point(self._kernel, *given)
        counted = code(*given)
        if counted[0] == REFUSED:
            raise RuntimeError(IS_CHANGED)
        return counted
