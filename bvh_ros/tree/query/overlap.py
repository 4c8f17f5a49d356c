# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that touch a box: one traversal, at rest and at a time, for one query and for many.

Boxes are closed: touching counts. At rest all comparisons are of given doubles, so they are exact.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..checks import INT64
from ..compiler import inlined, lean_kernel, stack_array
from ..nodes import DEEPEST, NONE, ROOT, entry_points, is_leaf, leaf_box, next_node
from ..store.turns import (
    ANY_VERSION,
    NOT_FINITE,
    REFUSED,
    accepted,
    begin_query,
    end_query,
    in_threads,
)
from .ray import of_row
from .slab import RAY_ROWS, intersect_node, prepare_ray, set_swept_box, traversal_distance

Ids = NDArray[np.int64]
FEW = 64  # handles that there is room for at first
SORTED = 32  # the kernel sorts the handles of a query up to this number
FIRST = -1  # the start of a batch whose bounds are not checked yet, see `motion.overlap`


class Box(NamedTuple):
    """A query at rest."""

    lo: NDArray[np.float64]
    hi: NDArray[np.float64]


class Queries(NamedTuple):
    """A batch of n query boxes."""

    lo: NDArray[np.float64]
    """Shape (n, ndim), as `hi`."""
    hi: NDArray[np.float64]
    masks: NDArray[np.uint32]
    """A mask a box, or one for all."""


# ---- the traversal


@inlined
def find_touching(tree, nodes, query, mask, found, count, node_may_touch, leaf_touches):
    """Write the slots of the boxes that touch a query from found[count] on; return where the next
    would go.

    node_may_touch(nodes, node, query) may only err towards a visit; leaf_touches(tree, leaf,
    query) decides. A return beyond the array's end says how large it should have been: what did
    not fit is counted, not written.
    """
    stack, top, node = stack_array(DEEPEST, np.int64), 0, np.int64(tree.state[ROOT])
    while node != NONE:
        visited = nodes[node].mask & mask != 0 and node_may_touch(nodes, node, query)
        if visited and is_leaf(node) and leaf_touches(tree, node, query):
            if count < found.shape[0]:
                found[count] = node >> 1
            count += 1
        node, top = next_node(nodes, node, visited and not is_leaf(node), stack, top)
    return np.int64(count)


@inlined
def is_box(lo, hi):
    """Whether it is finite and not turned inside out."""
    sound = True
    for axis in range(lo.shape[0]):
        sound &= -np.inf < lo[axis] <= hi[axis] < np.inf
    return sound


@inlined
def touch(lo, hi, other_lo, other_hi):
    for axis in range(lo.shape[0]):
        if lo[axis] > other_hi[axis] or other_lo[axis] > hi[axis]:
            return False
    return True


@inlined
def _node_touches(nodes, node, query):
    return touch(nodes[node].lo, nodes[node].hi, query.lo, query.hi)


@inlined
def _leaf_touches(tree, leaf, query):
    lo, hi = leaf_box(tree.nodes, tree.tight, leaf)
    return touch(lo, hi, query.lo, query.hi)


@lean_kernel
def overlap(tree, lo, hi, mask, found, count):
    """`find_touching` of the closed box from lo to hi, at rest."""
    return find_touching(
        tree, tree.nodes, Box(lo, hi), mask, found, count, _node_touches, _leaf_touches
    )


class SweptBox(NamedTuple):
    """A box that is swept along a translation, for callers that decide by other shapes."""

    ray: NDArray[np.float64]
    """See `slab.set_swept_box`."""
    limit: float
    wide: bool


@inlined
def _node_may_meet(nodes, node, query):
    lo, hi = nodes[node].lo, nodes[node].hi
    return intersect_node(lo, hi, query.ray, query.limit, query.wide) < np.inf


@inlined
def _leaf_may_meet(tree, leaf, query):
    lo, hi = leaf_box(tree.nodes, tree.tight, leaf)
    return intersect_node(lo, hi, query.ray, query.limit, query.wide) < np.inf


@lean_kernel
def overlap_swept(tree, lo, hi, translation, mask, found):
    """`find_touching` of the box from lo to hi that is swept along a translation; it may err
    towards a box that is not touched, never away from one that is.
    """
    root = tree.state[ROOT]
    if root == NONE:
        return np.int64(0)
    ray = stack_array((RAY_ROWS, 3), np.float64)
    set_swept_box(ray, lo, hi, translation)
    scale, wide = prepare_ray(ray, tree.nodes[root].lo, tree.nodes[root].hi)
    query = SweptBox(ray, traversal_distance(1.0, scale), wide)
    return find_touching(tree, tree.nodes, query, mask, found, 0, _node_may_meet, _leaf_may_meet)


# ---- the kernels that Python calls


@inlined
def name_slots(tree, found, start, stop):
    """Replace slots by handles."""
    for i in range(start, stop):
        found[i] = tree.handles[found[i]]


@lean_kernel
def overlap_one(tree, lo, hi, mask, found):
    """Write the handles of the boxes that touch the one from lo to hi, in no order. Return how
    many there are, which may be more than fit; NOT_FINITE if it is no box, REFUSED if the tree is
    being changed.
    """
    if not is_box(lo, hi):
        return np.int64(NOT_FINITE)
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED)
    count = overlap(tree, lo, hi, mask, found, 0)
    name_slots(tree, found, 0, min(count, found.shape[0]))
    end_query(tree.state)
    return count


@inlined
def _sort_few(handles):
    """Sort up to SORTED handles by insertion; leave more as they are."""
    if handles.shape[0] > SORTED:
        return
    for i in range(1, handles.shape[0]):
        handle, place = handles[i], i
        while place > 0 and handles[place - 1] > handle:
            handles[place] = handles[place - 1]
            place -= 1
        handles[place] = handle


@inlined
def fill_rows(tree, version, queries, start, stop, found, offsets, overlap_row, when):
    """Write the handles of the boxes that the queries [start, stop) touch, one query after the
    other; FIRST as start is 0. Those of query i end before found[offsets[i + 1]]; they ascend if
    they are no more than SORTED. overlap_row(tree, queries, i, when, found, count) writes slots as
    `find_touching` does.

    Returns (queries done, room wanted, most handles of one query). Fewer queries are done if there
    is no room for the next one. NOT_FINITE if one is no box, REFUSED if the tree is changed
    meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED), np.int64(0), np.int64(0)
    count, end, done, most = np.int64(0), np.int64(0), np.int64(max(start, 0)), np.int64(0)
    if done == 0:
        offsets[0] = 0
    while done < stop:
        if not is_box(queries.lo[done], queries.hi[done]):
            end_query(tree.state)
            return np.int64(NOT_FINITE), np.int64(0), np.int64(0)
        end = overlap_row(tree, queries, done, when, found, count)
        if end > found.shape[0]:
            break
        name_slots(tree, found, count, end)
        _sort_few(found[count:end])
        most, count = max(most, end - count), end
        done += 1
        offsets[done] = end
    end_query(tree.state)
    return done, np.int64(end), most


@inlined
def _overlap_row(tree, queries, row, when, found, count):
    mask = of_row(queries.masks, row)
    return overlap(tree, queries.lo[row], queries.hi[row], mask, found, count)


@lean_kernel
def overlap_rows(tree, version, queries, start, stop, found, offsets):
    """`fill_rows`, at rest."""
    return fill_rows(tree, version, queries, start, stop, found, offsets, _overlap_row, None)


_ROWS, _IDS = np.empty((0, 3)), np.empty(0, np.int64)
NO_QUERIES = Queries(_ROWS, _ROWS, np.empty(0, np.uint32))
one_entry = entry_points(overlap_one, np.empty(0), np.empty(0), np.uint32(0), _IDS)
rows_entry = entry_points(overlap_rows, 0, NO_QUERIES, 0, 0, _IDS, _IDS)


# ---- growth of room, and threads


class _Part(NamedTuple):
    """What the queries [start, stop) touch."""

    start: int
    stop: int
    handles: Ids
    most: int
    """Handles of one query."""


def overlap_many(
    kernel: Callable[..., Any], queries: Queries, threads: int, *arrays: Any
) -> tuple[Ids, Ids] | int:
    """(offsets, handles) of what all queries touch, those of each ascending; NOT_FINITE if one is
    no box, or why `kernel` answers none of them. `arrays` are its arguments before the queries.
    RuntimeError if the tree is changed meanwhile.
    """
    count = len(queries.lo)
    offsets, ask = np.empty(count + 1, INT64), functools.partial(kernel, *arrays, queries)
    found = np.empty(max(FEW, count), INT64)
    done, end, most = ask(FIRST, count if threads == 1 else 0, found, offsets)
    if done == count:
        handles = found[:end]
    elif done < 0:
        return int(done)
    else:
        first = _Part(0, done, found[: offsets.item(done)], most)
        rest = _rest_in_parts(ask, offsets, threads, first)
        if rest is None:
            return NOT_FINITE
        handles, most = rest
    if most > SORTED:
        for row in np.flatnonzero(np.diff(offsets) > SORTED).tolist():
            handles[offsets[row] : offsets[row + 1]].sort()
    return offsets, handles


def _rest_in_parts(
    ask: Callable[..., Any], offsets: Ids, threads: int, first: _Part
) -> tuple[Ids, int] | None:
    """All handles, the `first` ones included, and the most of one query; None if a query is no
    box.
    """
    begun = first.stop

    def work(start: int, stop: int) -> list[_Part] | None:
        parts: list[_Part] = []
        start, stop = begun + start, begun + stop
        room = max(FEW, stop - start)
        while start < stop:
            found = np.empty(room, INT64)
            done, wanted, most = ask(start, stop, found, offsets)
            if done == NOT_FINITE:
                return None
            filled = offsets.item(done) if accepted(done) > start else 0
            parts.append(_Part(start, done, found[:filled], most))
            start, room = done, max(2 * room, wanted)
        return parts

    parts = [first]
    for some in in_threads(work, len(offsets) - 1 - begun, threads):
        if some is None:
            return None
        parts += some
    before = 0
    for part in parts:
        offsets[part.start + 1 : part.stop + 1] += before
        before += len(part.handles)
    return np.concatenate([part.handles for part in parts]), max(part.most for part in parts)
