# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the rest of the package uses of the tree; all else is private to it."""

from . import checks, plotting
from .batch.single import (
    STACK,
    Surroundings,
    cast_few,
    few_entry,
    leaf_within,
    meet_boxes,
    meet_ray,
    next_line_leaf,
    next_near_leaf,
    next_wide_leaf,
    no_plane32,
    push_loose,
    set_plane32,
    square32,
    surround,
)
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
    take_snapshot,
    widen,
)
from .batch.streams import (
    FOUND,
    MIXED,
    cast_entry,
    defer_leaves,
    fetch_nothing,
    leaves_of,
    make_scratch,
    scratch_for,
    traverse,
    visit_nothing,
    without_lowest,
)
from .checks import (
    BOOL,
    EVERYTHING,
    FIRST_TIME,
    FLOAT64,
    INT64,
    LAST_TIME,
    NOTHING,
    UINT32,
    whole_ns,
)
from .dynamic_bvh import OpenTree
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
    entry_points,
    leaf_box,
    node_dtype,
    slot_of,
)
from .plotting import BLOCKED_COLOUR, CORNERS, FREE_COLOUR, PALETTE, SIDES
from .query.box_queries import boxes_within
from .query.exact import two_product, two_sum
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
from .results import RayHits, shown_point, shown_rows
from .simd.float32x16 import at_most16, crossed16, least16
from .simd.int32x8 import AT_ONCE
from .store import mapped
from .store.arrays import Floats, Ids
from .store.storage import copy_bytes, inherit_entry, touch
from .store.turns import (
    ANY_VERSION,
    IS_CHANGED,
    NOT_FINITE,
    REFUSED,
    accepted,
    begin_query,
    count_rays,
    end_query,
    in_threads,
)
