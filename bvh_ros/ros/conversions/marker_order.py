# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a MarkerArray leaves standing, when its markers are read in order.

A later marker undoes earlier ones: DELETE those of its name, DELETEALL those of its namespace or
all. What is undone need not be done. So a message of any length and order comes down to this:
remove some, then add some.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.conversions.marker_table import Integers, MarkerTable
from bvh_ros.scene import ShapeKind

# visualization_msgs/msg/Marker
ADD_OR_MODIFY, DELETE, DELETE_ALL = 0, 2, 3
SINGLE_SHAPES = {1: ShapeKind.BOX, 2: ShapeKind.SPHERE, 3: ShapeKind.CYLINDER}
LISTED_SHAPES = {6: ShapeKind.BOX, 7: ShapeKind.SPHERE}
TRIANGLES = 11
TYPE_NAMES = (
    *('ARROW', 'CUBE', 'SPHERE', 'CYLINDER', 'LINE_STRIP', 'LINE_LIST', 'CUBE_LIST'),
    *('SPHERE_LIST', 'POINTS', 'TEXT_VIEW_FACING', 'MESH_RESOURCE', 'TRIANGLE_LIST'),
    'ARROW_STRIP',
)

SINGLE, LISTED, MESH, REMOVAL, SWEEP, NOTHING = range(6)  # what a marker asks for
NEVER = -1  # instead of a row

Mask = NDArray[np.bool_]


class Order(NamedTuple):
    """What n markers ask for, and what comes of it."""

    wish: Integers  # (n,) NOTHING where it cannot be understood
    alive: Mask  # (n,) adds an obstacle that no later marker removes
    key: Integers | None  # (n,) the same for equal names; None where no name matters
    clears: bool  # all of the source's obstacles go first
    swept: Integers  # namespaces, as the table numbers them, whose obstacles go first
    removed: Integers  # rows of the names that go first


def order_of(table: MarkerTable, refused: Mask) -> Order:
    """Read the actions of markers in order; refused ones ask for nothing."""
    wish = _wishes(table)
    wish[refused] = NOTHING
    adds = wish <= MESH
    if (wish == SINGLE).all():
        none = np.empty(0, np.int64)
        return Order(wish, adds, None, False, none, none)
    rows = np.arange(len(wish))
    sweep, removal = wish == SWEEP, wish == REMOVAL
    nameless = np.array([not namespace for namespace in table.namespaces], np.bool_)
    everything = np.flatnonzero(sweep & nameless[table.namespace])
    last_clear = int(everything[-1]) if len(everything) else NEVER
    last_sweep = _last(rows[sweep], table.namespace[sweep], len(table.namespaces))
    key = np.unique((table.namespace << 32) + table.id, return_inverse=True)[1].reshape(-1)
    last_removal = _last(rows[removal], key[removal], len(rows))
    before = np.maximum(last_sweep[table.namespace], last_clear)
    return Order(
        wish,
        adds & (rows > np.maximum(before, last_removal[key])),
        key,
        last_clear > NEVER,
        np.flatnonzero((last_sweep > last_clear) & ~nameless),
        rows[removal & (rows > before) & (rows == last_removal[key])],
    )


def last_of_lists(order: Order, good: Mask) -> Mask:
    """Of good rows, which to keep: of a name that is a list somewhere only the last.

    Of single markers of one name the scene takes the last good one; but a list that becomes
    shorter, or a single marker, must not leave elements of an earlier one behind.
    """
    listed = good & (order.wish == LISTED)
    if order.key is None or not listed.any():
        return good
    rows = np.arange(len(good))
    last = _last(rows[good], order.key[good], len(rows))
    in_lists = np.zeros(len(rows), np.bool_)
    in_lists[order.key[listed]] = True
    return good & (~in_lists[order.key] | (rows == last[order.key]))


def _last(rows: Integers, of: Integers, count: int) -> Integers:
    """The last of ascending rows for each of so many numbers, else NEVER."""
    last = np.full(count, NEVER)
    last[of] = rows  # of several, the last is written last
    return last


# What a marker that adds wants, by its type; the last is for types that there are not.
_ADDED = np.full(TRIANGLES + 2, NOTHING)
_ADDED[list(SINGLE_SHAPES)], _ADDED[list(LISTED_SHAPES)], _ADDED[TRIANGLES] = SINGLE, LISTED, MESH


def _wishes(table: MarkerTable) -> Integers:
    kind, action = table.type, table.action
    known = (kind >= 0) & (kind <= TRIANGLES)
    wish: Integers = _ADDED[np.where(known, kind, TRIANGLES + 1)]
    wish[(action != ADD_OR_MODIFY) | (table.lifetime < 0)] = NOTHING
    wish[action == DELETE] = REMOVAL
    wish[action == DELETE_ALL] = SWEEP
    return wish


def why_not(table: MarkerTable, row: int) -> str:
    """Say why a marker of this type and action cannot be used."""
    kind, action = int(table.type[row]), int(table.action[row])
    if action != ADD_OR_MODIFY:
        return f'unknown marker action {action}'
    if table.lifetime[row] < 0:
        return f'negative lifetime {table.lifetime[row] / 1e9:g} s'
    type_name = TYPE_NAMES[kind] if 0 <= kind < len(TYPE_NAMES) else 'unknown'
    return f'marker type {kind} ({type_name}) is not a box, sphere, cylinder or list of triangles'
