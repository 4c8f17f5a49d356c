# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A read-only snapshot of the tree for batches of rays: nodes of sixteen children, whose boxes are
tested with one vector operation.

The snapshot is a filter and decides nothing: see `streams`. Its boxes are float32 in units
in which the scene fits into [-1, 1], rounded outwards. It is built when a batch comes that is
worth it, and again after the tree has changed.

Rays against the boxes of wide nodes, in float32: what surely misses is left out.

The distance of a plane is fma(plane, 1 / d, -o / d) in the snapshot's units. With e = 2**-24, the
rounding of 1 / d, of o / d and of the result make an error of at most |1 / d| (1 + |o|) 2 e (1 + 4
e), so every entry is lowered and every exit raised by PAD32 |1 / d| (1 + |o|), twice that. (Ize
2013 bounds (plane - o) * (1 / d); the fused form needs the term with |o|.) Directions are scaled
to a largest component of 1, and components below 2**-40 are taken for 2**-40: such an axis' exit
then is beyond 2**17 at least, further than anything that a ray from within 2**10 scene sizes can
meet. Other rays take the binary tree.
"""

import functools
import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..area import longest_edge, node_area, unit_scale
from ..build.building import count_leaves, post_order
from ..compiler import WIDTH, inlined, lean_kernel, stack_array
from ..nodes import (
    COUNT,
    DEEPEST,
    NONE,
    RECENT,
    RECENT_PLACES,
    ROOT,
    WRITTEN,
    View,
    entry_points,
    is_leaf,
    next_node,
)
from ..query.slab import INSIDE
from ..simd.float64x4 import FOUR, set_slopes
from ..store.turns import REFUSED, accepted, begin_query, end_query

PAD32 = 2.0**-22
WIDER = 2.0**-20  # far above the rounding of a float32
FARTHEST_ORIGIN = 2.0**10
STEEPEST = 2.0**40
CORNERS = 2 * FOUR  # numbers of a box around all boxes
_BOUNDS = FARTHEST_ORIGIN, 1e-290, 1e200, STEEPEST, PAD32
NOWHERE = np.float32(-1.0)  # a limit that no box is within


@functools.cache
def ray_dtype(ndim: int) -> np.dtype[Any]:
    """Record of a ray in the snapshot, of one cache line: its best hit so far, and
    what `stream16` reads. `set_slopes` writes four bytes more than each of its three fields, one
    after the other.
    """
    three = np.float32, (ndim,)
    fields = {
        'best_t': (np.float64, 0),  # about
        'unit': (np.float64, 8),  # t times this is a distance in the snapshot's units
        'slope': (three, 16),  # inverses of the direction
        'near_shift': (three, 16 + 4 * ndim),
        'far_shift': (three, 16 + 8 * ndim),
        'limit': (np.float32, 52),  # surely not less than best_t
        'slot': (np.int32, 56),  # of the best hit, or NONE
        'axis': (np.int16, 60),
        'exact': (np.bool_, 62),  # whether a decision took exact arithmetic
        'octant': (np.uint8, 63),  # bit k: it flies down axis k
    }
    kinds, offsets = zip(*fields.values(), strict=True)
    return np.dtype({'names': list(fields), 'formats': kinds, 'offsets': offsets, 'itemsize': 64})


@inlined
def limit32(t, unit):
    """A distance in the snapshot's units, surely not less than t."""
    return np.float32(t * unit) * np.float32(1.0 + PAD32) + np.float32(1e-30)


@inlined
def start_ray(ray, origin, direction, center, per_length, t_max):
    """Fill a record; return whether the ray is suited, origin and direction as of `set_slopes`.
    What is not finite is not: NaN is in no range.
    """
    largest, suited = set_slopes(ray, origin, direction, center, per_length, _BOUNDS)
    unit = largest * per_length
    ray.best_t, ray.unit, ray.limit = t_max, unit, limit32(t_max, unit)
    ray.slot, ray.axis, ray.exact = NONE, INSIDE, False
    return suited & (largest > 1e-200) & (unit > 1e-290) & (unit < 1e290)


@inlined
def widen(record, reach):
    """Let a ray meet boxes as if they were larger by `reach`, in the snapshot's units. Numbers
    that may be as large as reach * slope are rounded once more here, so there is a pad of more
    than that.
    """
    for axis in range(record.slope.shape[0]):
        slope, shift = (
            abs(np.float64(record.slope[axis])),
            abs(np.float64(record.near_shift[axis])),
        )
        more = slope * (reach * (1.0 + WIDER) + WIDER) + shift * WIDER
        record.near_shift[axis] = np.float32(record.near_shift[axis] - more)
        record.far_shift[axis] = np.float32(record.far_shift[axis] + more)


@inlined
def fill_whole(tree, whole):
    """Write the box around all boxes as of `look_ahead`; of none, everything."""
    root = tree.state[ROOT]
    for axis in range(FOUR):
        whole[axis], whole[FOUR + axis] = -np.inf, np.inf
    if root != NONE:
        for axis in range(tree.nodes[0].lo.shape[0]):
            whole[axis], whole[FOUR + axis] = tree.nodes[root].lo[axis], tree.nodes[root].hi[axis]


@inlined
def octant_of(direction):
    """Bit k: the ray flies down axis k, as its slope does, that of -0.0, too."""
    octant = 0
    for axis in range(direction.shape[0]):
        octant |= (math.copysign(1.0, direction[axis]) < 0.0) << axis
    return octant


# Fixed cost of visiting a wide node, in units of testing one ray against it, divided by the number
# of rays in a batch. Measured: from 0.0003 to 0.001 there is no difference. With 0 the snapshot of
# 100,000 boxes has 2.4 times the nodes, and a ray takes 1.15 times as long.
NODE_COST = 0.0005

# A stack of wide nodes: all but one of the lanes on every level.
DEEPEST_WIDE = DEEPEST * (WIDTH - 1) + 1


@lean_kernel
def plan_collapse(tree, version, least, shares, order):
    """Least cost of wide nodes, their area and `NODE_COST` each, by dynamic programming (Ylitie et
    al. 2017, section 3.1).

    least[k, j - 1]: of the subtree of inner node 2 k + 1 when it may take up to j lanes of the
    wide node above. shares[k, j - 1]: how many of those lanes its left child gets; 0 if it takes
    one lane, as a wide node of its own. `order` is scratch. Returns how many wide nodes the plan
    makes, negative if the tree is changed meanwhile.

    Whatever the costs are, shares[k, WIDTH - 1] is from 1 to WIDTH - 1, and no other one is more
    than its lanes allow: what fills the nodes needs nothing else to stay within them.
    """
    nodes, state = tree.nodes, tree.state
    if not begin_query(state, version):
        return -1
    root = state[ROOT]
    scale = unit_scale(longest_edge(nodes, root, root))
    visit = np.float32(NODE_COST * node_area(nodes, root, scale))
    for place in range(post_order(nodes, root, order) - 1, -1, -1):
        node = order[place]
        left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
        here, share = least[node >> 1], shares[node >> 1]
        for lanes in range(2, WIDTH + 1):
            best, best_share = np.float32(np.inf), 1
            for given in range(1, lanes):
                cost = np.float32(0.0)
                if not is_leaf(left):
                    cost += least[left >> 1, given - 1]
                if not is_leaf(right):
                    cost += least[right >> 1, lanes - given - 1]
                if cost < best:
                    best, best_share = cost, given
            here[lanes - 1], share[lanes - 1] = best, best_share
        here[0] = np.float32(node_area(nodes, node, scale)) + visit + here[WIDTH - 1]
        share[0] = 0
        for lanes in range(2, WIDTH):
            if here[lanes - 2] < here[lanes - 1]:
                here[lanes - 1], share[lanes - 1] = here[lanes - 2], share[lanes - 2]
    count = count_wide(nodes, root, shares)
    end_query(state)
    return count


@lean_kernel
def count_wide(nodes, root, shares):
    """How many wide nodes the plan makes."""
    stack, members = stack_array(DEEPEST_WIDE, np.int64), stack_array(WIDTH, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        count += 1
        for i in range(gather_members(nodes, shares, stack[top], members)):
            if not is_leaf(members[i]):
                stack[top], top = members[i], top + 1
    return count


@lean_kernel
def gather_members(nodes, shares, node, members):
    """The descendants that share the lanes of the wide node made of inner node `node`; return how
    many.
    """
    members[0], members[1] = nodes[node].left, nodes[node].right
    lanes = stack_array(WIDTH, np.int64)
    lanes[0] = shares[node >> 1, WIDTH - 1]
    lanes[1] = WIDTH - lanes[0]
    count, i = 2, 0
    while i < count:
        member = members[i]
        given = 0 if is_leaf(member) else shares[member >> 1, lanes[i] - 1]
        if given == 0:
            i += 1
            continue
        members[i], members[count] = nodes[member].left, nodes[member].right
        lanes[count] = lanes[i] - given
        lanes[i] = given
        count += 1
    return count


_COSTS, _SHARES = np.empty((0, WIDTH), np.float32), np.empty((0, WIDTH), np.uint8)
planning_entry = entry_points(plan_collapse, 0, _COSTS, _SHARES, np.empty(0, np.int64))


# Batches for which building pays, measured: a ray through the binary tree costs five times one
# through the snapshot, and building costs a box what that saves on 0.2 (100,000 boxes) to 0.4
# rays (1,000 boxes).
RAYS_PER_BOX = 0.4
LEAST_RAYS = 64
# How often rays have visited loose nodes when building would have cost as much.
LOOSE_VISITS_PER_BOX = 6

# Scenes of other sizes (m) are left to the binary tree: here no distance in a float64 leaves the
# normal doubles.
SMALLEST_SCENE, LARGEST_SCENE = 1e-200, 1e200

# Boxes within so little of the scene are one place to a float32: every ray that comes near would
# be tested against all of them. Where many are, as of a robot's world with one box beyond the
# moon, the binary tree is faster, by as much as there are boxes.
BLURRED = 2.0**-18
MOST_BLURRED = 64

LOOSE_NODES = RECENT_PLACES // WIDTH
BEYOND = -2


class Snapshot(NamedTuple):
    """The arrays that `streams` reads."""

    planes: NDArray[np.float32]
    """Per node and axis sixteen lower, then per axis sixteen upper planes."""
    children: NDArray[np.int32]
    """Sixteen a node: a wide node, or ~slot of a leaf."""
    masks: NDArray[np.uint32]
    """Sixteen a node."""
    center: NDArray[np.float64]
    """Of the scene, in its units, shape (ndim,)."""
    per_length: float
    """Snapshot units per scene unit, a power of two."""
    size: int
    """How many nodes there are; behind them there is room for LOOSE_NODES."""
    depth: int
    """Levels of nodes."""
    written: int
    """`state[WRITTEN]` of the tree when it was taken."""
    loose: int
    """How many of the nodes behind the others hold what was written since, see `patched`."""
    record: NDArray[Any]
    """None, but of `filtering.ray_dtype`: for kernels that make one."""

    @property
    def nbytes(self) -> int:
        return self.planes.nbytes + self.children.nbytes + self.masks.nbytes


@inlined
def begin_batch(tree, version, snapshot):
    """`begin_query`, where a snapshot that nothing was added to is of the tree as it is; of no
    snapshot, anyhow.
    """
    if not begin_query(tree.state, version):
        return False
    if snapshot.size > 0 and snapshot.loose == 0 and tree.state[WRITTEN] != snapshot.written:
        end_query(tree.state)
        return False
    return True


def take_snapshot(view: View) -> Snapshot | None:
    """Collapse a tree of two boxes or more; None where float32 would see too little of the scene,
    RuntimeError if the tree is changed meanwhile.
    """
    tree, version = view
    nodes, state = tree.nodes, tree.state
    written = state.item(WRITTEN)
    root, inner, ndim = state.item(ROOT), state.item(COUNT) - 1, nodes['lo'].shape[1]
    lo, hi = nodes['lo'][root], nodes['hi'][root]
    half = float((hi * 0.5 - lo * 0.5).max())
    if (
        not SMALLEST_SCENE < half < LARGEST_SCENE
        or float(np.abs(nodes['lo'][root]).max()) > LARGEST_SCENE
    ):
        return None
    center, per_length = lo * 0.5 + hi * 0.5, 2.0 ** -math.ceil(math.log2(half))
    if accepted(blurred_entry(ndim)(tree, version, BLURRED / per_length)):
        return None
    places = len(nodes) // 2
    least, shares = np.empty((places, WIDTH), np.float32), np.empty((places, WIDTH), np.uint8)
    order = np.empty(max(inner, 1), np.int64)
    count = accepted(planning_entry(ndim)(tree, version, least, shares, order))
    places = count + LOOSE_NODES
    planes = on_cache_lines(places * 2 * WIDTH * ndim)
    children, masks = np.empty(places * WIDTH, np.int32), np.empty(places * WIDTH, np.uint32)
    sizes, record = (count, 0, written, 0), np.empty(0, ray_dtype(ndim))
    snapshot = Snapshot(planes, children, masks, center, per_length, *sizes, record)
    depth = accepted(collapse_entry(ndim)(tree, version, shares, snapshot, order))
    return snapshot._replace(depth=depth)


def patched(snapshot: Snapshot, view: View) -> Snapshot | None:
    """The snapshot for a tree of which some leaves were written since; None if they are too many,
    or one lies outside the units of the snapshot; RuntimeError if the tree is changed meanwhile.

    Each of them is put into a node behind the others, which every ray visits. What the other nodes
    say of them is left there: a leaf is looked at as it is now. Threads that do this at once write
    the same into the same memory. A reader names a version of the tree, and so reads what was
    written for that version.
    """
    if view.tree.state.item(WRITTEN) - snapshot.written > RECENT_PLACES:
        return None
    nodes = loose_entry(len(snapshot.center))(*view, snapshot)
    return None if nodes == BEYOND else snapshot._replace(loose=accepted(nodes))


def on_cache_lines(count: int) -> NDArray[np.float32]:
    """Floats that begin where a cache line of 64 bytes does, as numpy's need not: sixteen that lie
    across two lines take two reads, a tenth of a ray among 1,000 boxes.
    """
    room = np.empty(count + 15, np.float32)
    start = -room.ctypes.data % 64 // 4
    return room[start : start + count]


@lean_kernel
def is_blurred(tree, version, least_edge):
    """Whether more than MOST_BLURRED boxes lie in a subtree with no edge of `least_edge`; negative
    if the tree is changed meanwhile.
    """
    nodes, state = tree.nodes, tree.state
    if not begin_query(state, version):
        return -1
    stack, top, node = stack_array(DEEPEST, np.int64), 0, np.int64(state[ROOT])
    blurred = 0
    while node != NONE and blurred == 0:
        large = not is_leaf(node) and longest_edge(nodes, node, node) >= least_edge
        if not large and not is_leaf(node) and count_leaves(nodes, node) > MOST_BLURRED:
            blurred = 1
        node, top = next_node(nodes, node, large, stack, top)
    end_query(state)
    return blurred


@inlined
def _down32(x):
    return np.nextafter(np.float32(x), np.float32(-np.inf))


@inlined
def _up32(x):
    return np.nextafter(np.float32(x), np.float32(np.inf))


@inlined
def outwards(lo, hi, center, per_length):
    """Planes in units of a snapshot, as float32."""
    return _down32((lo - center) * per_length), _up32((hi - center) * per_length)


@inlined
def write_planes(planes, lane, axis, ndim, sides):
    """Write both planes of one axis of a lane, counted through all wide nodes."""
    place = lane // WIDTH * (2 * ndim * WIDTH) + lane % WIDTH
    planes[place + axis * WIDTH], planes[place + (axis + ndim) * WIDTH] = sides


@inlined
def write_lane(snapshot, nodes, node, lane, child):
    """Let a lane, counted through all wide nodes, hold a node of the tree, or NONE."""
    ndim = snapshot.center.shape[0]
    for axis in range(ndim):
        sides = np.float32(np.inf), np.float32(-np.inf)
        if node != NONE:
            lo, hi = nodes[node].lo[axis], nodes[node].hi[axis]
            sides = outwards(lo, hi, snapshot.center[axis], snapshot.per_length)
        write_planes(snapshot.planes, lane, axis, ndim, sides)
    snapshot.masks[lane] = nodes[node].mask if node != NONE else np.uint32(0)
    snapshot.children[lane] = child


@inlined
def _fits_units(snapshot, nodes, leaf):
    """Whether the error of a float32 is bounded for this box as for those of the scene."""
    fits = True
    for axis in range(snapshot.center.shape[0]):
        center = snapshot.center[axis]
        fits &= (nodes[leaf].lo[axis] - center) * snapshot.per_length >= -1.0
        fits &= (nodes[leaf].hi[axis] - center) * snapshot.per_length <= 1.0
    return fits


@lean_kernel
def add_loose(tree, version, snapshot):
    """Write the leaves that were written since the snapshot was taken into the nodes behind the
    others, all lanes of these; return how many nodes. BEYOND if one does not lie in the units of
    the snapshot, REFUSED if the tree is changed meanwhile.
    """
    nodes, state = tree.nodes, tree.state
    if not begin_query(state, version):
        return np.int64(REFUSED)
    begin = snapshot.size * WIDTH
    end = begin
    for number in range(snapshot.written, state[WRITTEN]):
        slot = state[RECENT + number % RECENT_PLACES]
        known = nodes[2 * slot].mask == 0
        for lane in range(begin, end):
            known |= snapshot.children[lane] == ~slot
        if known:
            continue
        if not _fits_units(snapshot, nodes, 2 * slot):
            end_query(state)
            return np.int64(BEYOND)
        write_lane(snapshot, nodes, 2 * slot, end, ~slot)
        end += 1
    while end == begin or end % WIDTH != 0:  # one node at least says that it is patched
        write_lane(snapshot, nodes, np.int64(NONE), end, -1)
        end += 1
    end_query(state)
    return np.int64((end - begin) // WIDTH)


@lean_kernel
def collapse(tree, version, shares, snapshot, queue):
    """Fill the arrays of a `Snapshot`; return its depth, negative if the tree is changed
    meanwhile. `queue` is scratch.

    Node by node in the order of breadth, so that the top, which every ray visits, lies together.
    """
    nodes, state = tree.nodes, tree.state
    if not begin_query(state, version):
        return -1
    root = state[ROOT]
    members = stack_array(WIDTH, np.int64)
    queue[0], made, at = root, 1, 0
    depth, level_end = 0, 0
    while at < made:
        if at == level_end:
            depth, level_end = depth + 1, made
        size = gather_members(nodes, shares, queue[at], members)
        for lane in range(WIDTH):
            member = members[lane] if lane < size else np.int64(NONE)
            if member == NONE or nodes[member].mask == 0:
                write_lane(snapshot, nodes, np.int64(NONE), at * WIDTH + lane, -1)
            elif is_leaf(member):
                write_lane(snapshot, nodes, member, at * WIDTH + lane, ~(member >> 1))
            else:
                write_lane(snapshot, nodes, member, at * WIDTH + lane, made)
                queue[made] = member
                made += 1
        at += 1
    for lane in range(made * WIDTH, snapshot.size * WIDTH):  # planned for what no mask sees
        write_lane(snapshot, nodes, np.int64(NONE), lane, -1)
    end_query(state)
    return depth


@functools.cache
def no_snapshot(ndim: int) -> Snapshot:
    """Empty arrays of the right types, where there is no snapshot."""
    lanes = np.empty(0, np.float32), np.empty(0, np.int32), np.empty(0, np.uint32)
    return Snapshot(*lanes, np.empty(0), 1.0, 0, 0, 0, 0, np.empty(0, ray_dtype(ndim)))


_SHARES, _ORDER = np.empty((0, WIDTH), np.uint8), np.empty(0, np.int64)
blurred_entry = entry_points(is_blurred, 0, 0.0)
collapse_entry = entry_points(collapse, 0, _SHARES, no_snapshot, _ORDER)
loose_entry = entry_points(add_loose, 0, no_snapshot)
