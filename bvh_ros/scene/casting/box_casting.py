# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Thin rays among axis-aligned boxes: the tree's own kernels answer them.

A ray here has three coordinates in a planar scene too, and so has what it meets. The kernels look
at as many as the tree has axes and leave the others as they are: a planar ray costs a copy no
more than a solid one.
"""

from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from ...tree import checks
from ...tree.dynamic_bvh import DynamicBVH
from ...tree.jit.compiling import lean_kernel
from ...tree.jit.intrinsics import stack_array
from ...tree.nodes import slot_of
from ...tree.rays import ray_hits, raycasting
from ...tree.rays.ray_hits import locate
from ...tree.rays.slab import INSIDE
from ...tree.store.turns import IS_CHANGED, REFUSED
from ..geometry.shapes import Floats, along_axes
from ..results import NO_NODE, require_few

BoxHit = tuple[int, float, Floats, Floats]  # slot, t, point, normal


def first(
    tree: DynamicBVH, origin: Floats, way: Floats, mask: np.uint32, skip_inside: bool
) -> BoxHit | None:
    """The first box from `origin` to `origin + way`, shape (3,) each and finite."""
    place = np.zeros((2, 3))
    place[0, 2] = origin[2]
    start, direction = checks.vector('origin', origin, 3), checks.vector('way', way, 3)
    handle, t = ray_hits.one_entry(tree.ndim)(
        tree.view().tree, *(start, direction, 1.0, mask, skip_inside, raycasting.CLOSEST, place)
    )
    if handle == REFUSED:
        raise RuntimeError(IS_CHANGED)
    return None if handle < 0 else (tree.slot(handle), t, place[0], place[1])


def every(
    tree: DynamicBVH,
    origin: Floats,
    way: Floats,
    mask: np.uint32,
    skip_inside: bool,
    most: int | None = None,
) -> Iterator[BoxHit]:
    """All boxes from `origin` to `origin + way`, nearest first, ties by handle; TooManyHitsError
    if there are more than `most`.
    """
    starts, ways = origin[None, : tree.ndim], way[None, : tree.ndim]
    view = tree.view()
    found = tree.every_hit(view, starts, ways, 1.0, mask, skip_inside)[1]
    tree.check_unchanged(view)
    require_few(len(found.slots), most)
    nodes, tight = view.tree.nodes, view.tree.tight
    places = np.zeros((len(found.slots), 2, 3))
    places[:, 0, 2] = origin[2]
    hits = zip(*(column.tolist() for column in found), places, strict=True)
    for slot, t, axis, place in hits:
        locate(nodes, tight, origin, way, slot, t, axis, place)
        yield slot, t, place[0], place[1]


def first_of_many(
    tree: DynamicBVH,
    node_handles: NDArray[np.int64],
    rays: tuple[Floats, Floats, Floats, NDArray[np.uint32]],
    skip_inside: bool,
) -> tuple[NDArray[np.uint32], Floats, Floats, Floats]:
    """Node handles, t, points and normals of n rays (origins, directions, t_max, masks)."""
    starts, ways, t_max, masks = rays
    ndim, count = tree.ndim, len(starts)
    flat = along_axes(starts, ndim), along_axes(ways, ndim)
    hits = tree.raycast_many(*flat, t_max, masks, skip_inside)
    found = np.empty(count, np.uint32), np.empty((count, 3)), np.zeros((count, 3))
    describe(*tree.arrays()[:2], node_handles, starts, ways, *hits, *found)
    handles, points, normals = found
    return handles, hits.t, points, normals


@lean_kernel
def describe(
    nodes, tight, node_handles, starts, ways, ids, ts, outwards, handles, points, normals
):
    """Fill in node handles, points and normals of a batch; `normals` are zero before."""
    place = stack_array(6, np.float64).reshape(2, 3)
    for i in range(starts.shape[0]):
        if ids[i] < 0:
            handles[i] = NO_NODE
            points[i] = np.nan
            continue
        slot, axis = slot_of(ids[i]), INSIDE
        for k in range(outwards.shape[1]):
            if outwards[i, k] != 0.0:
                normals[i, k], axis = outwards[i, k], k
        place[0, 2] = starts[i, 2]
        locate(nodes, tight, starts[i], ways[i], slot, ts[i], axis, place)
        handles[i] = node_handles[slot]
        for k in range(3):
            points[i, k] = place[0, k]
