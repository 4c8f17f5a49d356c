# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which obstacles touch a query shape, and how they lie to its centre: one kernel a query.

Broad phase, exact decision between axis-aligned boxes, narrow phase for the others. Where all are
boxes, the kernels read the tree alone.
"""

from typing import Any, NamedTuple

import numpy as np

from ...tree.access import ANY_VERSION, begin_query, end_query, leaf_box, nearest, overlap
from ...tree.compiler import inlined, lean_kernel, stack_array
from .closest import closest_from_above, closest_in_box, closest_in_obstacle, length, look_back
from .narrow_phase import near
from .query_shape import grow
from .sinking import sink_in_box, sink_in_obstacle

FOUND = 11  # floats of a row of `Found`
REFUSED = -1  # the tree is being changed
ROUNDED = 1.0 + 2.0**-48  # no computed distance is off by as much
CLOSE = 2.0**-49  # of a tolerance: how far a computed distance from it says nothing


class Found(NamedTuple):
    """Obstacles that touch a query, one a row, and how each lies to its centre."""

    slots: Any
    distances: Any
    points: Any
    normals: Any
    doubtful: Any
    """Two boxes as far apart as the tolerance, up to rounding: `overlaps` decides exactly."""
    bounds: Any
    """How far the tree says that the boxes are; where they are what was asked for."""
    order: Any
    """Rows by distance, then node handle."""


@inlined
def found_in(memory):
    """What is found in one array, FOUND floats a row: to hand it over takes a fifth of the time of
    seven.
    """
    rows = memory.shape[0] // FOUND
    return Found(
        memory[:rows].view(np.int64),
        memory[rows : 2 * rows],
        memory[2 * rows : 5 * rows].reshape(rows, 3),
        memory[5 * rows : 8 * rows].reshape(rows, 3),
        memory[8 * rows : 9 * rows].view(np.bool_),  # more than needed
        memory[9 * rows : 10 * rows],
        memory[10 * rows : FOUND * rows].view(np.int64),
    )


@inlined
def reached(tree, query, mask, found):
    """Write the slots whose boxes touch the grown query's; return how many, which may be more
    than fit.
    """
    grown = stack_array((2, 3), np.float64)
    grow(query, grown)
    return overlap(tree, grown[0], grown[1], mask, found.slots, 0)


@inlined
def within(lo, hi, query):
    """(whether an axis-aligned box is within the tolerance of the query's, whether that is
    sure).
    """
    gaps = stack_array(3, np.float64)
    for axis in range(lo.shape[0]):
        below, above = query.bounds[0, axis] - hi[axis], lo[axis] - query.bounds[1, axis]
        gaps[axis] = max(above, below, 0.0)
    distance = length(gaps[: lo.shape[0]])
    sure = not abs(distance - query.tolerance) <= CLOSE * query.tolerance
    return distance <= query.tolerance, sure


@lean_kernel
def touching(tree, bodies, query, mask, enough, node_handles, found):
    """Fill in what touches a query; return (how many, how many are doubtful, how many pairs were
    compared, how many of them took more digits). `bodies` is None where all are axis-aligned
    boxes, the query's, too. More than fit: none is filled in. Where one is `enough`, the first
    that surely touches is the last, and nothing is filled in.
    """
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED), 0, 0, 0
    total, count, doubtful, compared, more = reached(tree, query, mask, found), 0, 0, 0, 0
    if total <= found.slots.shape[0]:
        solid = query.record[0]
        for i in range(total):
            slot, near_by, sure, narrow = found.slots[i], True, True, False
            if bodies is not None:
                shape, planar = bodies.shapes[slot], bodies.footprints is not None
                narrow = shape.shaped or not query.aligned
                if narrow:
                    near_by, digits = near(
                        shape, bodies.hulls, solid, bodies.query_hulls, query.tolerance, planar
                    )
                    compared += 1
                    more += digits
            if not narrow and query.tolerance > 0.0:
                lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
                near_by, sure = within(lo, hi, query)
            if not (near_by or not sure):
                continue
            doubtful += not sure
            if enough:
                count += 1
                if sure:
                    break
                continue
            found.slots[count], found.doubtful[count] = slot, not sure
            found.points[count, 2] = query.height
            if bodies is None:
                lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
                look_at_box(lo, hi, solid.position, found, count)
            else:
                look_at(shape, bodies.footprints, bodies.hulls, solid.position, found, count)
            count += 1
        if not enough:
            order_found(found, count, node_handles)
    end_query(tree.state)
    count = total if total > found.slots.shape[0] else count
    return np.int64(count), doubtful, compared, more


@lean_kernel
def nearest_to(tree, bodies, point, asked, signed, node_handles, found):
    """Fill in what is in the boxes nearest to a point, `bodies` as of `touching`; asked = (count,
    max_distance, mask). Return how many there are. Where it is `signed`, not None, those that hold
    the point lie as deep as it is in them: see `sinking`.
    """
    count, max_distance, mask = asked
    if not begin_query(tree.state, ANY_VERSION):
        return np.int64(REFUSED)
    count = nearest(tree, point, point, count, max_distance, mask, found.slots, found.bounds)
    for i in range(count):
        slot, found.points[i, 2] = found.slots[i], point[2]
        if bodies is None:
            lo, hi = leaf_box(tree.nodes, tree.tight, 2 * slot)
            look_at_box(lo, hi, point, found, i)
            if signed is not None:
                sink_in_box(lo, hi, point, found, i)
        else:
            shape = bodies.shapes[slot]
            look_at(shape, bodies.footprints, bodies.hulls, point, found, i)
            if signed is not None:
                sink_in_obstacle(shape, bodies, point, found, i)
    order_found(found, count, node_handles)
    end_query(tree.state)
    return np.int64(count)


@inlined
def look_at_box(lo, hi, centre, found, row):
    """Fill in how the axis-aligned box of a row lies to a centre."""
    closest_in_box(lo, hi, centre, found.points[row])
    found.distances[row] = look_back(found.points[row], centre, lo.shape[0], found.normals[row])


@lean_kernel
def look_at(shape, footprints, hulls, centre, found, row):
    """Fill in how the obstacle of a row lies to a centre."""
    point, normal = found.points[row], found.normals[row]
    if footprints is None:
        found.distances[row] = closest_in_obstacle(shape, hulls, centre, point, normal)
    else:
        footprint = footprints[found.slots[row]]
        found.distances[row] = closest_from_above(shape, footprint, hulls, centre, point, normal)


@inlined
def comes_before(found, node_handles, one, other):
    """Whether a row comes before another one."""
    if found.distances[one] != found.distances[other]:
        return found.distances[one] < found.distances[other]
    handle, other_handle = node_handles[found.slots[one]], node_handles[found.slots[other]]
    return handle < other_handle or (handle == other_handle and one < other)


@lean_kernel
def order_found(found, count, node_handles):
    """Fill in the order of the rows: heapsort, the last one on top."""
    order = found.order
    for row in range(count):
        order[row] = row
    for root in range(count // 2 - 1, -1, -1):
        sift_down(found, node_handles, root, count)
    for end in range(count - 1, 0, -1):
        order[0], order[end] = order[end], order[0]
        sift_down(found, node_handles, 0, end)


@inlined
def sift_down(found, node_handles, root, count):
    order = found.order
    while 2 * root + 1 < count:
        child = 2 * root + 1
        if child + 1 < count and comes_before(found, node_handles, order[child], order[child + 1]):
            child += 1
        if not comes_before(found, node_handles, order[root], order[child]):
            return
        order[root], order[child] = order[child], order[root]
        root = child


class Scratch:
    """Room for what queries find, see `spare`."""

    def __init__(self) -> None:
        self.make_room(32)

    def make_room(self, count: int) -> None:
        """Have room for at least so many rows."""
        self.memory = np.empty(FOUND * 2 * count)
        self.found: Found = found_in.py_func(self.memory)
