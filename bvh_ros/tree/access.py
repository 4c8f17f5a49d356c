# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package uses of the tree; all else is private to it."""

from . import box_checks, checks, plotting
from .batch.single import STACK, cast_few, few_entry, next_wide_leaf, push_loose
from .batch.snapshot import (
    FARTHEST_ORIGIN,
    LOOSE_NODES,
    Snapshot,
    begin_batch,
    blurred_entry,
    collapse_entry,
    limit32,
    no_snapshot,
    planning_entry,
    start_ray,
)
from .batch.streams import FOUND, MIXED, cast_entry, make_scratch, scratch_for, traverse
from .checks import BOOL, EVERYTHING, FLOAT64, INT64, NOTHING, UINT32
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
    leaf_box,
    node_dtype,
    slot_of,
)
from .open_tree import OpenTree
from .plotting import BLOCKED_WAY, CORNERS, EDGES, FREE_WAY, PALETTE, SIDES
from .query.exact import sign_of_four_products
from .query.nearest import (
    Near,
    PointQueries,
    are_dense,
    nearest,
    order_of,
    pruning_limit,
    visit_nearest,
)
from .query.overlap import overlap, overlap_swept
from .query.ray import (
    CLOSEST,
    EVERY,
    NO_HITS,
    NO_RAYS,
    Found,
    Hit,
    Rays,
    enter_box,
    every_hit,
    locate,
    of_row,
    raycast_one,
    rows_of,
)
from .query.ray_queries import answer_rays
from .query.slab import (
    DIRECTION,
    INSIDE,
    ORIGIN,
    RAY_FLOATS,
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
from .query.traversal import Stack, next_leaf, push_root
from .query.within import boxes_within
from .results import RayHits, shown_point, shown_rows
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
from .time_checks import FIRST_TIME, LAST_TIME, whole_ns
from .unrounded import two_product, two_sum
