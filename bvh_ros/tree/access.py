# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package uses of the tree; all else is private to it."""

from . import box_checks, checks, plotting
from .batch.single import STACK, cast_few, child_of, few_entry, push_children, push_loose
from .batch.snapshot import (
    FARTHEST_ORIGIN,
    LOOSE_NODES,
    Snapshot,
    begin_batch,
    blurred_entry,
    collapse_entry,
    limit32,
    no_snapshot,
    octant_of,
    planning_entry,
    start_ray,
)
from .batch.streams import ALL32, FOUND, MIXED, cast_entry, make_scratch, scratch_for, traverse
from .checks import BOOL, EVERYTHING, FLOAT64, INT64, NOTHING, UINT32
from .dynamic_bvh import DynamicBVH
from .entries import entry_points
from .moving import LARGEST
from .nodes import (
    ALL,
    CHANGES,
    COUNT,
    DEEPEST,
    NONE,
    ROOT,
    SLOT_MASK,
    Tree,
    View,
    empty_tree,
    is_leaf,
    leaf_box,
    node_dtype,
    slot_of,
)
from .plotting import BLOCKED_WAY, CORNERS, EDGES, FREE_WAY, PALETTE, SIDES
from .query.nearest import PointQueries, are_dense, nearest, order_of
from .query.overlap import overlap
from .query.ray import (
    CLOSEST,
    EVERY,
    NO_HITS,
    NO_RAYS,
    Rays,
    descend,
    every_hit,
    locate,
    of_row,
    raycast_one,
)
from .query.ray_queries import answer_rays, rows_of
from .query.slab import (
    DIRECTION,
    INSIDE,
    ORIGIN,
    PAD,
    RAY_FLOATS,
    RAY_ROWS,
    TINY,
    compare_hits,
    intersect_exact,
    intersect_node,
    is_finite,
    prepare_ray,
    set_ray,
    set_swept_box,
    traversal_distance,
)
from .query.within import boxes_within
from .results import RayHits
from .simd.float32x16 import seen16, stream16
from .simd.int32x8 import AT_ONCE
from .store import mapped
from .store.arrays import Floats, Ids
from .store.memory import copy_bytes, touch
from .store.storage import inherit_entry
from .store.turns import (
    ANY_VERSION,
    IS_CHANGED,
    NOT_FINITE,
    REFUSED,
    accepted,
    begin_query,
    count_rays,
    end_query,
)
from .store.workers import in_threads
from .unrounded import two_product, two_sum
