# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes against the tree. Closed boxes: touching counts. Comparisons of doubles, so all of it is
exact.
"""

import functools
from collections.abc import Callable
from typing import Any, NamedTuple, TypeAlias

import numpy as np
from numpy.typing import NDArray

from ..checks import INT64
from ..compiler import inlined, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import DEEPEST, NONE, ROOT, is_leaf, leaf_box, next_node
from ..query.ray import of_row
from ..store.turns import ANY_VERSION, NOT_FINITE, REFUSED, accepted, begin_query, end_query
from ..store.workers import in_threads

Ids = NDArray[np.int64]
# From query, to query, handles, and the most of one query.
Part: TypeAlias = tuple[int, int, Ids, int]
FEW = 64  # handles that there is room for at first
SORTED = 32  # of one query at most are put in order by the kernel
FIRST = -1  # where queries start that are asked for the first time


class Queries(NamedTuple):
    """Closed boxes that are asked about."""

    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    masks: NDArray[np.uint32]
    """A mask a box, or one for all."""


@inlined
def touch(lo, hi, other_lo, other_hi):
    for axis in range(lo.shape[0]):
        if lo[axis] > other_hi[axis] or other_lo[axis] > hi[axis]:
            return False
    return True


@lean_kernel
def overlap(tree, lo, hi, mask, found, count):
    """Write the slots whose box touches the closed one from lo to hi from found[count] on; return
    where the next would go.

    A return beyond the array's end says how large it should have been: what did not fit is
    counted, not written.
    """
    nodes, root = tree.nodes, tree.state[ROOT]
    if root == NONE:
        return np.int64(count)
    stack, top, node = stack_array(DEEPEST, np.int64), 0, np.int64(root)
    while node != NONE:
        here = nodes[node]
        met = here.mask & mask != 0 and touch(here.lo, here.hi, lo, hi)
        if met and is_leaf(node):
            leaf_lo, leaf_hi = leaf_box(nodes, tree.tight, node)
            if touch(leaf_lo, leaf_hi, lo, hi):
                if count < found.shape[0]:
                    found[count] = node >> 1
                count += 1
        node, top = next_node(nodes, node, met and not is_leaf(node), stack, top)
    return np.int64(count)


@lean_kernel
def overlap_one(tree, lo, hi, mask, found):
    """Handles of the boxes that touch the one from lo to hi, in no order: how many, of which as
    many are written as there is room for; NOT_FINITE if it is no box, REFUSED if the tree is being
    changed.
    """
    for axis in range(lo.shape[0]):
        if not (np.isfinite(lo[axis]) and np.isfinite(hi[axis]) and lo[axis] <= hi[axis]):
            return np.int64(NOT_FINITE)
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED)
    count = overlap(tree, lo, hi, mask, found, 0)
    for i in range(min(count, found.shape[0])):
        found[i] = tree.handles[found[i]]
    end_query(tree.state)
    return count


@inlined
def sort_few(handles):
    """Sort by insertion, up to SORTED of them."""
    if handles.shape[0] > SORTED:
        return
    for i in range(1, handles.shape[0]):
        handle, place = handles[i], i
        while place > 0 and handles[place - 1] > handle:
            handles[place] = handles[place - 1]
            place -= 1
        handles[place] = handle


@inlined
def fill_rows(tree, version, asked, start, stop, found, offsets, look):
    """Handles of the boxes that the queries [start, stop) touch, start FIRST as 0, asked =
    (queries, what else `look` needs), one query after the other: those of query i end before
    found[offsets[i + 1]], and ascend if they are no more than SORTED. look(tree, asked, i, found,
    count) writes slots as `overlap` does.

    Returns (queries done, room wanted, most handles of one): fewer queries than there are where
    there is no room for what the next one touches; NOT_FINITE if one is no box, REFUSED if the
    tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED), np.int64(0), np.int64(0)
    count, end, done, most = np.int64(0), np.int64(0), np.int64(max(start, 0)), np.int64(0)
    if done == 0:
        offsets[0] = 0
    while done < stop:
        lo, hi = asked[0].lo[done], asked[0].hi[done]
        for axis in range(lo.shape[0]):
            if not (-np.inf < lo[axis] <= hi[axis] < np.inf):
                end_query(tree.state)
                return np.int64(NOT_FINITE), np.int64(0), np.int64(0)
        end = look(tree, asked, done, found, count)
        if end > found.shape[0]:
            break
        for i in range(count, end):
            found[i] = tree.handles[found[i]]
        sort_few(found[count:end])
        most, count = max(most, end - count), end
        done += 1
        offsets[done] = end
    end_query(tree.state)
    return done, np.int64(end), most


@inlined
def _look(tree, asked, row, found, count):
    queries = asked[0]
    mask = of_row(queries.masks, row)
    return overlap(tree, queries.lo[row], queries.hi[row], mask, found, count)


@lean_kernel
def overlap_rows(tree, version, queries, start, stop, found, offsets):
    """`fill_rows`."""
    return fill_rows(tree, version, (queries,), start, stop, found, offsets, _look)


_ROWS, _IDS = np.empty((0, 3)), np.empty(0, np.int64)
_QUERIES = Queries(_ROWS, _ROWS, np.empty(0, np.uint32))
one_entry = entry_points(overlap_one, np.empty(0), np.empty(0), np.uint32(0), _IDS)
rows_entry = entry_points(overlap_rows, 0, _QUERIES, 0, 0, _IDS, _IDS)


def overlap_many(
    view: Any, queries: Any, threads: int, entry: Any = rows_entry
) -> tuple[Ids, Ids] | int:
    """(offsets, handles) of what all queries touch, those of each ascending; why not, if that is
    NOT_FINITE, as one is no box, or what the kernel of `entry` says to the first of them.
    RuntimeError if the tree is changed meanwhile. `view` and `queries` are what the kernel takes.
    """
    count, ndim = queries.lo.shape
    offsets, ask = np.empty(count + 1, INT64), functools.partial(entry(ndim), *view, queries)
    found = np.empty(max(FEW, count), INT64)
    done, end, most = ask(FIRST, count if threads == 1 else 0, found, offsets)
    if done == count:
        handles = found[:end]
    elif done < 0:
        return int(done)
    else:
        parts = _in_parts(ask, offsets, threads, (0, done, found[: offsets.item(done)], most))
        if parts is None:
            return NOT_FINITE
        handles, most = parts
    if most > SORTED:
        for row in np.flatnonzero(np.diff(offsets) > SORTED).tolist():
            handles[offsets[row] : offsets[row + 1]].sort()
    return offsets, handles


def _in_parts(
    ask: Callable[..., Any], offsets: Ids, threads: int, first: Part
) -> tuple[Ids, int] | None:
    """All handles, after those of the `first` part with as much room as they take, and the most of
    one query.
    """
    begun = first[1]

    def work(start: int, stop: int) -> list[Part]:
        parts: list[Part] = []
        start, stop = begun + start, begun + stop
        room = max(FEW, stop - start)
        while start < stop:
            found = np.empty(room, INT64)
            done, wanted, most = ask(start, stop, found, offsets)
            if done == NOT_FINITE:
                return [(start, done, found, most)]
            filled = offsets.item(done) if accepted(done) > start else 0
            parts.append((start, done, found[:filled], most))
            start, room = done, max(2 * room, wanted)
        return parts

    rows = len(offsets) - 1 - begun
    parts = [first, *(part for some in in_threads(work, rows, threads) for part in some)]
    if any(done == NOT_FINITE for _, done, _, _ in parts):
        return None
    before = 0
    for start, done, found, _ in parts:
        offsets[start + 1 : done + 1] += before
        before += len(found)
    return np.concatenate([part[2] for part in parts]), max(part[3] for part in parts)
