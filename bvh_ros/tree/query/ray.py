# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept boxes through the binary tree: the first hit, any hit, all hits.

`cast` is the loop for boxes at rest and for boxes that move: functions that are handed in enter a
node, decide at a leaf, and order two hits.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..checks import INT64
from ..compiler import inlined, lean_kernel, stack_array
from ..nodes import (
    CHANGES,
    DEEPEST,
    EXACT_RAYS,
    NONE,
    RAYS,
    ROOT,
    Tree,
    View,
    entry_points,
    leaf_box,
)
from ..results import RayHits
from ..store.turns import (
    ANY_VERSION,
    NOT_FINITE,
    REFUSED,
    accepted,
    begin_query,
    count_rays,
    end_query,
)
from .slab import (
    EXACT,
    INSIDE,
    ORIGIN,
    RAY_ROWS,
    compare_hits,
    intersect_exact,
    intersect_node,
    is_finite,
    prepare_ray,
    set_ray,
    set_swept_box,
    traversal_distance,
)
from .traversal import Stack, next_leaf, push_root

Ids = NDArray[np.int64]
Floats = NDArray[np.float64]

CLOSEST, ANY, EVERY = range(3)
FEW = 64  # hits that there is room for at first
FEW_HITS = 12  # of one ray: sorted by insertion alone


class Rays(NamedTuple):
    """n rays, and what to find."""

    origins: Floats
    """Shape (n, ndim), as the directions."""
    directions: Floats
    t_max: Floats
    """A distance a ray, or one for all."""
    masks: NDArray[np.uint32]
    """A mask a ray, or one for all."""
    skip_inside: bool
    mode: int
    """CLOSEST, ANY or EVERY."""
    counted: bool = False
    """Whether the kernel counts the rays: it does where a batch is not cut into parts."""


class Found(NamedTuple):
    """What the traversal finds, hit by hit."""

    slots: Ids
    ts: Floats
    axes: Ids
    """The axis entered last, INSIDE where the ray starts in the box."""


class RayOptions(NamedTuple):
    """How far one ray goes, which boxes it sees, and what to find."""

    t_max: float
    mask: np.uint32
    skip_inside: bool
    mode: int


class Hit(NamedTuple):
    """One box that a ray meets."""

    slot: int
    t: float
    axis: int


class Path(NamedTuple):
    """A ray, or a swept box, among boxes at rest."""

    tree: Tree
    ray: NDArray[np.float64]
    """See `slab`."""
    mask: np.uint32
    wide: bool
    """See `slab.prepare_ray`."""


@inlined
def of_row(values, i):
    """The value of row i; where there is but one, it is for all."""
    return values[i if values.shape[0] > 1 else 0]


# ---- one ray


@inlined
def cast(nodes, root, path, scale, options, found, filled, enter, decide, precedes):
    """Write the hits of a path, `options` as of `RayOptions`, to `found` from `filled` on; return
    where the next would go.

    CLOSEST leaves one hit or none, ANY the first one found, EVERY all, in no order. A return
    beyond the arrays' end says how large they should have been: what did not fit is counted, not
    written.

    `enter` is as of `next_leaf`, in units of 2**scale. decide(path, slot, t_max) is (hit, t, axis)
    of a leaf. precedes(path, hit, other) says which of two `Hit`s comes first.
    """
    slots, ts, axes = found.slots, found.ts, found.axes
    begin, limit = filled, traversal_distance(options.t_max, scale)
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    top = push_root(nodes, root, path, limit, stack, enter)
    while top > 0:
        leaf, top = next_leaf(nodes, path, limit, stack, top, enter)
        if leaf == NONE:
            break
        slot = leaf >> 1
        hit, t, axis = decide(path, slot, options.t_max)
        if not hit or (options.skip_inside and axis == INSIDE):
            continue
        place = filled
        if options.mode == CLOSEST:
            if filled > begin and not precedes(
                path, Hit(slot, t, axis), Hit(slots[begin], ts[begin], axes[begin])
            ):
                continue
            place, limit = begin, traversal_distance(t, scale)
        if place < slots.shape[0]:
            slots[place], ts[place], axes[place] = slot, t, axis
        filled = place + 1
        if options.mode == ANY:
            break
    return filled


@inlined
def enter_box(nodes, node, path, limit):
    """`intersect_node` of a node that the mask of a `Path` selects."""
    if nodes[node].mask & path.mask == 0:
        return np.inf
    return intersect_node(nodes[node].lo, nodes[node].hi, path.ray, limit, path.wide)


@inlined
def decide_box(path, slot, t_max):
    lo, hi = leaf_box(path.tree.nodes, path.tree.tight, 2 * slot)
    return intersect_exact(lo, hi, path.ray, t_max)


@inlined
def precedes(path, hit, other):
    return is_before(path.tree, path.ray, hit, other)


@lean_kernel
def raycast(tree, ray, options, found, filled):
    """`cast` one ray, or swept box (see `slab`), among boxes at rest."""
    nodes, root = tree.nodes, tree.state[ROOT]
    if root == NONE:
        return filled
    scale, wide = prepare_ray(ray, nodes[root].lo, nodes[root].hi)
    path = Path(tree, ray, options.mask, wide)
    return cast(nodes, root, path, scale, options, found, filled, enter_box, decide_box, precedes)


@lean_kernel
def is_before(tree, ray, hit, other):
    """Whether the first of two `Hit`s of a ray is the nearer, or as near with the smaller
    handle.
    """
    lo, hi = leaf_box(tree.nodes, tree.tight, 2 * hit.slot)
    other_lo, other_hi = leaf_box(tree.nodes, tree.tight, 2 * other.slot)
    one, another = (hit.t, hit.axis), (other.t, other.axis)
    order = compare_hits(ray, lo, hi, one, other_lo, other_hi, another)
    return order < 0 or (order == 0 and tree.handles[hit.slot] < tree.handles[other.slot])


@inlined
def sort_hits(path, found, start, end, precedes):
    """Bring the hits [start, end) of a path into the order of the exact distance, then of handles.
    Each t then becomes the largest up to it: within 2 ulp still, and never falling.
    """
    slots, ts, axes = found.slots, found.ts, found.axes
    for i in range(start + 1, end):
        hit, place = Hit(slots[i], ts[i], axes[i]), i
        while place > start and precedes(
            path, hit, Hit(slots[place - 1], ts[place - 1], axes[place - 1])
        ):
            slots[place], ts[place] = slots[place - 1], ts[place - 1]
            axes[place] = axes[place - 1]
            place -= 1
        slots[place], ts[place], axes[place] = hit.slot, hit.t, hit.axis
    for i in range(start + 1, end):
        ts[i] = max(ts[i], ts[i - 1])


@lean_kernel
def sort_roughly(handles, found, start, end):
    """Bring hits into the order of the computed distance, then of handles: by insertion among
    those far apart, and ever closer (Shell 1959).
    """
    slots, ts, axes = found.slots, found.ts, found.axes
    gap = end - start
    while gap > 1:
        gap = max((gap * 5 - 1) // 11, 1)
        for i in range(start + gap, end):
            slot, t, axis, place = slots[i], ts[i], axes[i], i
            while place >= start + gap:
                other, before = place - gap, ts[place - gap]
                if before < t or (before == t and handles[slots[other]] < handles[slot]):
                    break
                slots[place], ts[place], axes[place] = slots[other], before, axes[other]
                place = other
            slots[place], ts[place], axes[place] = slot, t, axis


@lean_kernel
def raycast_every_row(tree, version, batch, named, offsets, room, before):
    """All hits of every ray, nearest first; those of ray i go to [offsets[i], offsets[i + 1]) of
    `room`, where handles take the place of slots if they are to be `named`. batch, room: plain
    `Rays` and `Found`, before = (rays done so far, how many of them took exact arithmetic).

    Returns (rays done, room wanted, how many took exact arithmetic, version of the tree): fewer
    than there are where there is no room for the hits of the next one; instead NOT_FINITE if a ray
    is not, REFUSED if the tree is changed meanwhile.
    """
    (done, exact), end, rays, found = before, np.int64(0), Rays(*batch), Found(*room)
    if not begin_query(tree.state, version):
        return np.int64(REFUSED), end, exact, np.int64(0)
    ray, version = stack_array((RAY_ROWS, 3), np.float64), tree.state[CHANGES]
    if done == 0:
        offsets[0] = 0
    while done < rays.origins.shape[0]:
        origin, direction, start = rays.origins[done], rays.directions[done], offsets[done]
        if not is_finite(origin, direction):
            end_query(tree.state)
            return np.int64(NOT_FINITE), end, exact, version
        set_ray(ray, origin, direction)
        t_max, mask = of_row(rays.t_max, done), of_row(rays.masks, done)
        question = RayOptions(t_max, mask, rays.skip_inside, EVERY)
        end = raycast(tree, ray, question, found, start)
        if end > found.slots.shape[0]:
            break
        exact += np.int64(ray[EXACT, 0])
        if end - start > FEW_HITS:
            sort_roughly(tree.handles, found, start, end)
        sort_hits(Path(tree, ray, mask, False), found, start, end, precedes)
        if named:
            for i in range(start, end):
                found.slots[i] = tree.handles[found.slots[i]]
        done += 1
        offsets[done] = end
    if done == rays.origins.shape[0]:
        count_rays(tree.state, done, exact)
    end_query(tree.state)
    return np.int64(done), end, exact, version


def room_for_hits(count: int) -> Found:
    """Arrays for so many hits."""
    parts = np.empty(count, INT64), np.empty(count), np.empty(count, INT64)
    return tuple.__new__(Found, parts)


def more_room(found: Found, wanted: int) -> Found:
    """The same in twice as large arrays, or for so many hits."""
    larger = room_for_hits(max(2 * len(found.slots), wanted))
    for old, new in zip(found, larger, strict=True):
        new[: len(old)] = old
    return larger


NO_RAYS = Rays(*(np.empty((0, 3)),) * 2, np.empty(0), np.empty(0, np.uint32), False, CLOSEST)
_NO_HITS = tuple(room_for_hits(0))
every_entry = entry_points(
    *(raycast_every_row, 0, tuple(NO_RAYS), False, np.empty(0, np.int64), _NO_HITS, (0, 0))
)


def every_hit(view: View, rays: tuple[Any, ...], named: bool) -> tuple[Ids, int, tuple[Any, ...]]:
    """All hits of all rays in their order, with as much room as it takes: offsets, how many there
    are in all, and what was found, as `raycast_every_row` has it. ValueError if a ray is not
    finite, RuntimeError if the tree is changed before they are found.
    """
    (count, ndim), (tree, version) = rays[0].shape, view
    room: tuple[Any, ...] = np.empty(FEW, INT64), np.empty(FEW), np.empty(FEW, INT64)
    offsets, kernel = np.empty(count + 1, INT64), every_entry(ndim)
    done, end, exact, version = kernel(tree, version, rays, named, offsets, room, (0, 0))
    while done != count:
        if done == NOT_FINITE:
            checks.finite('origins', rays[0])
            checks.finite('directions', rays[1])
        accepted(done)
        room = tuple(more_room(Found(*room), end))
        done, end, exact, _ = kernel(tree, version, rays, named, offsets, room, (done, exact))
    return offsets, end, room


@lean_kernel
def locate(nodes, tight, origin, direction, slot, t, axis, place):
    """Write a hit's point and normal as the first two rows of `place`.

    The point is in the closed box, and on the face entered; it is the origin where the ray starts
    inside. Coordinates beyond the tree's axes are neither read nor written.
    """
    lo, hi = leaf_box(nodes, tight, 2 * slot)
    for k in range(lo.shape[0]):
        place[0, k] = origin[k]
        place[1, k] = 0.0
        if axis == INSIDE:
            continue
        if k == axis:
            place[0, k] = lo[k] if direction[k] > 0.0 else hi[k]
            place[1, k] = -1.0 if direction[k] > 0.0 else 1.0
        elif direction[k] != 0.0:
            place[0, k] = min(max(origin[k] + t * direction[k], lo[k]), hi[k])


@lean_kernel
def locate_hit(tree, origin, direction, slot, t, axis, place):
    """`locate`, as Python calls it."""
    locate(tree.nodes, tree.tight, origin, direction, slot, t, axis, place)


@lean_kernel
def raycast_one(tree, origin, direction, t_max, mask, skip_inside, mode, place):
    """One ray in one call: (handle, t), and for CLOSEST its point and normal in `place`; instead
    of a handle NONE if there is none, NOT_FINITE if the input is not, REFUSED if the tree is being
    changed.
    """
    state = tree.state
    if not is_finite(origin, direction):
        return NOT_FINITE, np.inf
    if not begin_query(state, ANY_VERSION):
        return REFUSED, np.inf
    ray = stack_array((RAY_ROWS, 3), np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    ts = stack_array(1, np.float64)
    set_ray(ray, origin, direction)
    options, found = RayOptions(t_max, mask, skip_inside, mode), Found(slots, ts, axes)
    hits = raycast(tree, ray, options, found, 0)
    state[RAYS] += 1
    state[EXACT_RAYS] += np.int64(ray[EXACT, 0])
    handle = np.int64(NONE)
    if hits > 0:
        handle = tree.handles[slots[0]]
        if mode == CLOSEST:
            locate(tree.nodes, tree.tight, origin, direction, slots[0], ts[0], axes[0], place)
    end_query(state)
    return handle, (ts[0] if hits > 0 else np.inf)


@lean_kernel
def raycast_row(tree, ray, rays, row, found, hits):
    """The first hit (CLOSEST) of one ray of a batch, or of any (ANY) no more than an id; NONE
    where there is none. `ray` and `found` are scratch. Returns 1 if it took exact arithmetic, else
    0; NOT_FINITE if the ray is not.
    """
    origin, direction = rays.origins[row], rays.directions[row]
    if not is_finite(origin, direction):
        return np.int64(NOT_FINITE)
    set_ray(ray, origin, direction)
    options = RayOptions(
        of_row(rays.t_max, row), of_row(rays.masks, row), rays.skip_inside, rays.mode
    )
    slot, axis, t = np.int64(NONE), np.int64(INSIDE), np.inf
    if raycast(tree, ray, options, found, 0) > 0:
        slot, axis, t = found.slots[0], found.axes[0], found.ts[0]
    hits.ids[row] = tree.handles[slot] if slot != NONE else NONE
    if rays.mode == CLOSEST:
        hits.t[row] = t
        for k in range(origin.shape[0]):
            hits.normals[row, k] = 0.0
        if axis != INSIDE:
            hits.normals[row, axis] = -1.0 if direction[axis] > 0.0 else 1.0
    return np.int64(ray[EXACT, 0])


@lean_kernel
def raycast_rows(tree, version, rays, hits):
    """`raycast_row` for all rays. Returns how many took exact arithmetic; NOT_FINITE if a ray is
    not, REFUSED if the tree is changed meanwhile.
    """
    if not begin_query(tree.state, version):
        return np.int64(REFUSED)
    ray = stack_array((RAY_ROWS, 3), np.float64)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    found = Found(slots, stack_array(1, np.float64), axes)
    exact = np.int64(0)
    for row in range(rays.origins.shape[0]):
        done = raycast_row(tree, ray, rays, row, found, hits)
        if done < 0:
            exact = done
            break
        exact += done
    if rays.counted and exact >= 0:
        count_rays(tree.state, rays.origins.shape[0], exact)
    end_query(tree.state)
    return exact


@lean_kernel
def count_hits(tree, rays, exact):
    """Count rays, and those of them that took exact arithmetic."""
    count_rays(tree.state, rays, exact)


_POINT, _ROWS = np.empty(0), np.empty((0, 3))
NO_HITS = RayHits(np.empty(0, np.int64), np.empty(0), _ROWS)
locate_entry = entry_points(locate_hit, _POINT, _POINT, 0, 0.0, 0, _ROWS)
one_entry = entry_points(raycast_one, _POINT, _POINT, 0.0, np.uint32(0), False, CLOSEST, _ROWS)
count_entry = entry_points(count_hits, 0, 0)
rows_entry = entry_points(raycast_rows, 0, NO_RAYS, NO_HITS)


@lean_kernel
def boxcast(tree, lo, hi, translation, mask, place):
    """First box met: (handle, t); point and normal go to `place`. Instead of a handle NONE if
    there is none, NOT_FINITE if the input is not, or lo exceeds hi, REFUSED if the tree is being
    changed.
    """
    nodes, tight, state = tree.nodes, tree.tight, tree.state
    for axis in range(lo.shape[0]):
        finite = np.isfinite(lo[axis]) and np.isfinite(hi[axis])
        if not (finite and np.isfinite(translation[axis]) and lo[axis] <= hi[axis]):
            return NOT_FINITE, np.inf
    if not begin_query(state, ANY_VERSION):
        return REFUSED, np.inf
    ray = stack_array((RAY_ROWS, 3), np.float64)
    set_swept_box(ray, lo, hi, translation)
    slots, axes = stack_array(1, np.int64), stack_array(1, np.int64)
    ts = stack_array(1, np.float64)
    found = Found(slots, ts, axes)
    hits = raycast(tree, ray, RayOptions(1.0, mask, False, CLOSEST), found, 0)
    state[RAYS] += 1
    state[EXACT_RAYS] += np.int64(ray[EXACT, 0])
    if hits == 0:
        end_query(state)
        return NONE, np.inf
    # Of all points that touch, the closest to the swept box's centre: where that would be, brought
    # into the box that is met. On the axes along which it does not move, now; `locate` does the
    # others.
    met_lo, met_hi = leaf_box(nodes, tight, 2 * slots[0])
    centre = ray[ORIGIN]
    for axis in range(lo.shape[0]):
        centre[axis] = lo[axis] * 0.5 + hi[axis] * 0.5
        if axes[0] == INSIDE or translation[axis] == 0.0:
            centre[axis] = min(max(centre[axis], met_lo[axis]), met_hi[axis])
    locate(nodes, tight, centre, translation, slots[0], ts[0], axes[0], place)
    handle = tree.handles[slots[0]]
    end_query(state)
    return handle, ts[0]


boxcast_entry = entry_points(boxcast, *(_POINT,) * 3, np.uint32(0), np.empty((0, 3)))


# Rows of batches, and room for their answers.

LARGE_BATCH = 1024  # rays, whose answers are one piece of memory
_NOT_DESCRIBED = {ndim: (np.empty(0), np.empty((0, ndim))) for ndim in (2, 3)}


def rows_of(table: Any, count: int, rows: Any) -> Any:
    """Some rows of a named tuple of so many; what stands for all, or for none, stays as it is."""
    return type(table)(
        *(
            column[rows] if isinstance(column, np.ndarray) and len(column) == count else column
            for column in table
        )
    )


def room_for_rays(count: int, ndim: int, mode: int) -> RayHits:
    """Room for the answers of so many rays."""
    if mode != CLOSEST:
        return tuple.__new__(RayHits, (np.empty(count, INT64), *_NOT_DESCRIBED[ndim]))
    if count < LARGE_BATCH:
        parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
        return tuple.__new__(RayHits, parts)
    # One piece of memory: three make the allocator give theirs back to the system after each
    # batch, and fetching it anew, page by page, costs a tenth of a ray among 1,000 boxes.
    room = np.empty(count * (2 + ndim))
    ids, ts, normals = room[:count].view(INT64), room[count : 2 * count], room[2 * count :]
    return RayHits(ids, ts, normals.reshape(count, ndim))
