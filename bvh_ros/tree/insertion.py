# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Insertion in three stages, and its reverse: find the best sibling, link a new parent, refit and rotate the ancestors.

The cost of a tree is the sum of the areas of its inner nodes. Inserting a box beside a sibling adds the area of their new parent
(direct cost) and the growth of every ancestor (inherited cost). Catto, GDC 2019, "Dynamic Bounding Volume Hierarchies"; Bittner
et al. 2015, "Incremental BVH Construction for Ray Tracing", section 3, for the search in order of the lower bound.
"""

import numpy as np

from .area import area_scale, node_area, union_area
from .compiling import kernel, lean_kernel
from .nodes import NONE, ROOT, adopt, free_inner, is_leaf, replace_child, take_inner
from .rotation import rotate


@lean_kernel
def greedy_sibling(nodes, heights, root, leaf):
    """Descend towards the child with the smaller lower bound; stop when neither can beat the best sibling seen."""
    scale = area_scale(nodes, root, leaf)
    leaf_area = node_area(nodes, leaf, scale)
    node = root
    here_area = node_area(nodes, root, scale)
    direct = union_area(nodes, root, leaf, scale)
    inherited = 0.0
    best, best_cost = root, direct
    while not is_leaf(node):
        inherited += direct - here_area
        next_bound, next_node, next_direct, next_area = np.inf, NONE, 0.0, 0.0
        for child in (nodes[node].left, nodes[node].right):
            child_direct = union_area(nodes, child, leaf, scale)
            cost = inherited + child_direct
            lower = next_node != NONE and heights[child] < heights[next_node]
            if cost < best_cost or (cost == best_cost and heights[child] < heights[best]):
                best, best_cost = np.int64(child), cost
            if is_leaf(child):
                continue
            child_area = node_area(nodes, child, scale)
            # Whatever lies below this child costs its growth and at least the box itself.
            bound = cost - child_area + leaf_area
            if bound < next_bound or (bound == next_bound and lower):
                next_bound, next_node = bound, np.int64(child)
                next_direct, next_area = child_direct, child_area
        if next_node == NONE or next_bound > best_cost:
            break
        node, direct, here_area = next_node, next_direct, next_area
    return best


@lean_kernel
def _sift_up(bounds, entries, place):
    while place > 0 and bounds[(place - 1) >> 1] > bounds[place]:
        above = (place - 1) >> 1
        bounds[above], bounds[place] = bounds[place], bounds[above]
        entries[above], entries[place] = entries[place], entries[above]
        place = above


@lean_kernel
def _sift_down(bounds, entries, size):
    place = 0
    while True:
        child = 2 * place + 1
        if child >= size:
            return
        if child + 1 < size and bounds[child + 1] < bounds[child]:
            child += 1
        if bounds[place] <= bounds[child]:
            return
        bounds[place], bounds[child] = bounds[child], bounds[place]
        entries[place], entries[child] = entries[child], entries[place]
        place = child


@kernel
def branch_and_bound_sibling(nodes, heights, root, leaf):
    """The best of all siblings: a priority queue of subtrees, the least lower bound first, until none can beat the best."""
    scale = area_scale(nodes, root, leaf)
    leaf_area = node_area(nodes, leaf, scale)
    bounds, entries = np.empty(64), np.empty(64, np.int64)  # of a subtree: its inherited cost and its root
    bounds[0], entries[0], size = 0.0, root, 1
    best, best_cost = root, np.inf
    while size > 0 and bounds[0] + leaf_area < best_cost:
        inherited, node = bounds[0], entries[0]
        size -= 1
        bounds[0], entries[0] = bounds[size], entries[size]
        _sift_down(bounds, entries, size)
        direct = union_area(nodes, node, leaf, scale)
        cost = inherited + direct
        if cost < best_cost or (cost == best_cost and heights[node] < heights[best]):
            best, best_cost = node, cost
        below = cost - node_area(nodes, node, scale)
        if is_leaf(node) or below + leaf_area >= best_cost:
            continue
        if size + 2 > bounds.shape[0]:
            bounds, entries = np.append(bounds, bounds), np.append(entries, entries)
        for child in (nodes[node].left, nodes[node].right):
            bounds[size], entries[size] = below, child
            _sift_up(bounds, entries, size)
            size += 1
    return best


@lean_kernel
def refit_ancestors(nodes, heights, state, node):
    """Make the boxes from `node` up to the root tight again, rotating each; stop early where nothing changes any more."""
    quiet = 0
    while node != NONE and quiet < 2:
        changed = adopt(nodes, heights, node)
        rotated = rotate(nodes, heights, node)
        # A rotation looks two levels down, so two levels without change leave nothing to do above.
        quiet = 0 if changed or rotated else quiet + 1
        node = np.int64(nodes[node].parent)


@lean_kernel
def link_leaf(nodes, heights, state, leaf, branch_and_bound):
    """Insert a leaf whose box and mask are written: find its sibling, give both a new parent, refit and rotate above."""
    heights[leaf] = 0
    root = state[ROOT]
    if root == NONE:
        state[ROOT] = leaf
        nodes[leaf].parent = NONE
        return
    if branch_and_bound:
        sibling = branch_and_bound_sibling(nodes, heights, root, leaf)
    else:
        sibling = greedy_sibling(nodes, heights, root, leaf)
    parent = take_inner(nodes, state)
    replace_child(nodes, state, np.int64(nodes[sibling].parent), sibling, parent)
    nodes[parent].left, nodes[parent].right = sibling, leaf
    nodes[sibling].parent = parent
    nodes[leaf].parent = parent
    refit_ancestors(nodes, heights, state, parent)


@lean_kernel
def unlink_leaf(nodes, heights, state, leaf):
    """Take a leaf out of the tree: its sibling takes their parent's place; refit and rotate above. The leaf is not freed."""
    parent = np.int64(nodes[leaf].parent)
    if parent == NONE:
        state[ROOT] = NONE
        return
    sibling = np.int64(nodes[parent].right if nodes[parent].left == leaf else nodes[parent].left)
    grandparent = np.int64(nodes[parent].parent)
    replace_child(nodes, state, grandparent, parent, sibling)
    free_inner(nodes, state, parent)
    refit_ancestors(nodes, heights, state, grandparent)
