# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which way a batch of rays takes, and room for its answers."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from ..checks import INT64
from ..nodes import COUNT, Tree
from ..results import RayHits
from ..wide.few_rays import few_entry
from ..wide.ray_streams import scratch_for
from ..wide.raycasting import cast_entry
from ..wide.snapshot import Snapshot
from .ray_hits import rows_entry
from .raycasting import CLOSEST, Rays

Floats = NDArray[np.float64]

# Smaller batches go through the snapshot ray by ray. Measured with other rays in each batch, with
# AVX-512 and AVX2 alike: in lists, segments of 1 and 5 m and rays of a scan take 0.97 to 1.03
# times as long for 64, 0.85 to 0.96 times for 128, 0.77 to 0.9 times for 256.
FEW_TOGETHER = 72
# Rays from anywhere are the farther apart, the more boxes there are: in lists they take as long
# for 80 among 1,000, for 200 among 10,000, for 370 among 30,000, for 1,500 among 100,000, for
# 3,000 among more.
BOXES_A_RAY, FEW_RAYS = 64, 3000
# From so many rays on the answers of a batch are one piece of memory.
LARGE = 1024
_NOT_DESCRIBED = {ndim: (np.empty(0), np.empty((0, ndim))) for ndim in (2, 3)}


def cast(tree: Tree, version: int, snapshot: Snapshot | None, rays: Rays, hits: RayHits) -> int:
    """Answer rays: how many took exact arithmetic, or why not."""
    ndim = rays.origins.shape[1]
    done: int
    if snapshot is None:
        done = rows_entry(ndim)(tree, version, rays, hits)
    elif are_few(rays.origins, rays.t_max, tree):
        done = few_entry(ndim)(tree, version, snapshot, tuple(rays), hits)
    else:
        done = cast_in_lists(tree, version, snapshot, rays, hits)
    return done


def cast_in_lists(tree: Tree, version: int, snapshot: Snapshot, rays: Rays, hits: RayHits) -> int:
    """The same, of rays that are not few."""
    count, ndim = rays.origins.shape
    scratch = scratch_for(count, ndim, snapshot.depth)
    done: int = cast_entry(ndim)(tree, version, snapshot, rays, scratch, hits)
    return done


def are_few(origins: Floats, t_max: Floats, tree: Tree) -> bool:
    """Whether rays go through the snapshot one by one."""
    count = len(origins)
    return count < FEW_RAYS and (
        count < FEW_TOGETHER
        or (
            count < tree.state.item(COUNT) // BOXES_A_RAY
            and t_max.item(0) == np.inf
            and not is_scan(origins)
        )
    )


def is_scan(origins: NDArray[np.float64]) -> bool:
    """Whether rays seem to come from one place."""
    first = origins[0].tolist()
    return origins[-1].tolist() == first == origins[len(origins) // 2].tolist()


def rows_of(table: Any, count: int, rows: Any) -> Any:
    """Some rows of a named tuple of so many; what stands for all, or for none, stays as it is."""
    return type(table)(
        *(
            column[rows] if isinstance(column, np.ndarray) and len(column) == count else column
            for column in table
        )
    )


def room_for(count: int, ndim: int, mode: int) -> RayHits:
    """Room for the answers of so many rays."""
    if mode != CLOSEST:
        return tuple.__new__(RayHits, (np.empty(count, INT64), *_NOT_DESCRIBED[ndim]))
    if count < LARGE:
        parts = np.empty(count, INT64), np.empty(count), np.empty((count, ndim))
        return tuple.__new__(RayHits, parts)
    # One piece of memory: three make the allocator give theirs back to the system after each
    # batch, and fetching it anew, page by page, costs a tenth of a ray among 1,000 boxes.
    room = np.empty(count * (2 + ndim))
    ids, ts, normals = room[:count].view(INT64), room[count : 2 * count], room[2 * count :]
    return RayHits(ids, ts, normals.reshape(count, ndim))
