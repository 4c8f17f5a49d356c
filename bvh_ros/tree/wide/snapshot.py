# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A read-only snapshot of the tree for batches of rays: nodes of sixteen children, whose boxes are
tested with one vector operation.

The snapshot is a filter and decides nothing: see `wide.raycasting`. Its boxes are float32 in units
in which the scene fits into [-1, 1], rounded outwards. It is built when a batch comes that is
worth it, and again after the tree has changed.
"""

import math
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..area import longest_edge, node_area, unit_scale
from ..build.building import count_leaves
from ..jit.compiling import inlined, lean_kernel
from ..jit.intrinsics import WIDTH, stack_array
from ..nodes import COUNT, DEEPEST, ROOT, is_leaf
from ..store.turns import IS_CHANGED, begin_query, end_query

# Batches for which building pays, measured: a ray through the binary tree costs five times one
# through the snapshot, and building costs a box what that saves on 0.2 (100,000 boxes) to 0.4
# rays (1,000 boxes).
RAYS_PER_BOX = 0.4
LEAST_RAYS = 64

# Fixed cost of visiting a wide node, in units of testing one ray against it, divided by the number
# of rays in a batch. Measured: from 0.0003 to 0.001 there is no difference. With 0 the snapshot of
# 100,000 boxes has 2.4 times the nodes, and a ray takes 1.15 times as long.
NODE_COST = 0.0005

# Scenes of other sizes (m) are left to the binary tree: here no distance in a float64 leaves the
# normal doubles.
SMALLEST_SCENE, LARGEST_SCENE = 1e-200, 1e200

# Boxes within so little of the scene are one place to a float32: every ray that comes near would
# be tested against all of them. Where many are, as of a robot's world with one box beyond the
# moon, the binary tree is faster, by as much as there are boxes.
BLURRED = 2.0**-18
MOST_BLURRED = 64


DEEPEST_WIDE = (
    DEEPEST * (WIDTH - 1) + 1
)  # a stack of wide nodes: all but one of the lanes on every level


class Snapshot(NamedTuple):
    """The arrays that `wide.raycasting` reads."""

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
    depth: int
    """Levels of nodes."""

    @property
    def nbytes(self) -> int:
        return self.planes.nbytes + self.children.nbytes + self.masks.nbytes


def take_snapshot(view: tuple[Any, ...]) -> Snapshot | None:
    """Collapse a tree of two boxes or more, see `arrays.View`; None where float32 would see too
    little of the scene, RuntimeError if the tree is changed meanwhile.
    """
    nodes, _, _, state, version = view
    root, inner = state.item(ROOT), state.item(COUNT) - 1
    lo, hi = nodes['lo'][root], nodes['hi'][root]
    half = float((hi * 0.5 - lo * 0.5).max())
    if (
        not SMALLEST_SCENE < half < LARGEST_SCENE
        or float(np.abs(nodes['lo'][root]).max()) > LARGEST_SCENE
    ):
        return None
    center, per_length = lo * 0.5 + hi * 0.5, 2.0 ** -math.ceil(math.log2(half))
    blurred = is_blurred(nodes, state, version, BLURRED / per_length)
    if blurred < 0:
        raise RuntimeError(IS_CHANGED)
    if blurred:
        return None
    places = len(nodes) // 2
    least, shares = np.empty((places, WIDTH), np.float32), np.empty((places, WIDTH), np.uint8)
    order = np.empty(max(inner, 1), np.int64)
    count = plan_collapse(nodes, state, version, least, shares, order)
    if count < 0:
        raise RuntimeError(IS_CHANGED)
    planes = _on_cache_lines(count * 2 * WIDTH * nodes['lo'].shape[1])
    children, masks = np.empty(count * WIDTH, np.int32), np.empty(count * WIDTH, np.uint32)
    arrays = planes, children, masks
    depth = collapse(nodes, state, version, shares, center, per_length, arrays, order)
    if depth < 0:
        raise RuntimeError(IS_CHANGED)
    return Snapshot(planes, children, masks, center, per_length, depth)


def _on_cache_lines(count: int) -> NDArray[np.float32]:
    """Floats that begin where a cache line of 64 bytes does, as numpy's need not: sixteen that lie
    across two lines take two reads, a tenth of a ray among 1,000 boxes.
    """
    room = np.empty(count + 15, np.float32)
    start = -room.ctypes.data % 64 // 4
    return room[start : start + count]


@lean_kernel
def is_blurred(nodes, state, version, least_edge):
    """Whether more than MOST_BLURRED boxes lie in a subtree with no edge of `least_edge`; negative
    if the tree is changed meanwhile.
    """
    if not begin_query(state, version):
        return -1
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top, blurred = state[ROOT], 1, 0
    while top > 0 and blurred == 0:
        top -= 1
        node = stack[top]
        if is_leaf(node):
            continue
        if longest_edge(nodes, node, node) < least_edge:
            if count_leaves(nodes, node) > MOST_BLURRED:
                blurred = 1
            continue
        stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
        top += 2
    end_query(state)
    return blurred


@lean_kernel
def post_order(nodes, root, order):
    """Number the inner nodes below and with `root`, parents before children: read it backwards for
    children first. Returns how many there are.
    """
    stack = stack_array(DEEPEST, np.int64)
    stack[0], top, count = root, 1, 0
    while top > 0:
        top -= 1
        node = stack[top]
        if is_leaf(node):
            continue
        order[count] = node
        count += 1
        stack[top], stack[top + 1] = nodes[node].left, nodes[node].right
        top += 2
    return count


@lean_kernel
def plan_collapse(nodes, state, version, least, shares, order):
    """Least cost of wide nodes, their area and `NODE_COST` each, by dynamic programming (Ylitie et
    al. 2017, section 3.1).

    least[k, j - 1]: of the subtree of inner node 2 k + 1 when it may take up to j lanes of the
    wide node above. shares[k, j - 1]: how many of those lanes its left child gets; 0 if it takes
    one lane, as a wide node of its own. `order` is scratch. Returns how many wide nodes the plan
    makes, negative if the tree is changed meanwhile.

    Whatever the costs are, shares[k, WIDTH - 1] is from 1 to WIDTH - 1, and no other one is more
    than its lanes allow: what fills the nodes needs nothing else to stay within them.
    """
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
        for i in range(_gather(nodes, shares, stack[top], members)):
            if not is_leaf(members[i]):
                stack[top], top = members[i], top + 1
    return count


@lean_kernel
def _gather(nodes, shares, node, members):
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


@inlined
def _down32(x):
    return np.nextafter(np.float32(x), np.float32(-np.inf))


@inlined
def _up32(x):
    return np.nextafter(np.float32(x), np.float32(np.inf))


@lean_kernel
def collapse(nodes, state, version, shares, center, per_length, arrays, queue):
    """Fill the arrays of a `Snapshot`; return its depth, negative if the tree is changed
    meanwhile. `queue` is scratch.

    Node by node in the order of breadth, so that the top, which every ray visits, lies together.
    """
    if not begin_query(state, version):
        return -1
    planes, children, masks = arrays
    root = state[ROOT]
    ndim = nodes[root].lo.shape[0]
    stride = 2 * ndim * WIDTH
    members = stack_array(WIDTH, np.int64)
    queue[0], made, at = root, 1, 0
    depth, level_end = 0, 0
    while at < made:
        if at == level_end:
            depth, level_end = depth + 1, made
        size = _gather(nodes, shares, queue[at], members)
        for lane in range(WIDTH):
            place = at * stride + lane
            here = nodes[members[lane if lane < size else 0]]
            visible = lane < size and here.mask != 0
            for axis in range(ndim):
                lo, hi = np.float32(np.inf), np.float32(-np.inf)
                if visible:
                    lo = _down32((here.lo[axis] - center[axis]) * per_length)
                    hi = _up32((here.hi[axis] - center[axis]) * per_length)
                planes[place + axis * WIDTH] = lo
                planes[place + (axis + ndim) * WIDTH] = hi
            place = at * WIDTH + lane
            masks[place], children[place] = 0, -1
            if visible:
                masks[place] = here.mask
                if is_leaf(members[lane]):
                    children[place] = ~np.int32(members[lane] >> 1)
                else:
                    children[place] = made
                    queue[made] = members[lane]
                    made += 1
        at += 1
    end_query(state)
    return depth
