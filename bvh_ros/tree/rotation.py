# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Tree rotations: the four exchanges of a child with a niece (Kopta et al. 2012, "Fast, Effective
BVH Updates for Animated Scenes").

                A                          A
              /   \\                      /   \\
             B     C      B <-> F       F     C
            / \\   / \\     ------>            / \\
           D   E F   G                      B   G

A keeps its box; C's becomes the union of B and G. The exchange pays if that is smaller than C's
before. The other three are B <-> G, C <-> D and C <-> E. They keep sorted input from making a
list.
"""

import numpy as np

from .area import area_scale, node_area, union_area
from .compiler import inlined, lean_kernel
from .nodes import NONE, is_leaf, refit_node


@inlined
def _exchange(nodes, heights, node, child, uncle_of, niece):
    """Swap `child` of `node` with `niece`, a child of `uncle_of`, the other child of `node`."""
    if nodes[node].left == child:
        nodes[node].left = niece
    else:
        nodes[node].right = niece
    if nodes[uncle_of].left == niece:
        nodes[uncle_of].left = child
    else:
        nodes[uncle_of].right = child
    nodes[niece].parent = node
    nodes[child].parent = uncle_of
    refit_node(nodes, heights, uncle_of)
    refit_node(nodes, heights, node)


@lean_kernel
def rotate(nodes, heights, node, highest):
    """Do the exchange below `node` that lowers the cost most, or at equal cost the height; true if
    one was done. None makes the subtree higher than `highest`.
    """
    left, right = np.int64(nodes[node].left), np.int64(nodes[node].right)
    if is_leaf(left) and is_leaf(right):
        return False
    scale = area_scale(nodes, left, right)
    if scale == 1.0:  # nearly always, and faster when known
        return _rotate(nodes, heights, node, left, right, 1.0, highest)
    return _rotate(nodes, heights, node, left, right, scale, highest)


@inlined
def _rotate(nodes, heights, node, left, right, scale, highest):
    best_change, best_height = 0.0, np.int64(heights[node])
    best_child = best_uncle = best_niece = np.int64(NONE)
    highest = max(highest, best_height)
    for child, uncle in ((left, right), (right, left)):
        if is_leaf(uncle):
            continue
        before = node_area(nodes, uncle, scale)
        first, second = np.int64(nodes[uncle].left), np.int64(nodes[uncle].right)
        for niece, stays in ((first, second), (second, first)):
            change = union_area(nodes, child, stays, scale) - before
            if change > best_change:
                continue
            height = 1 + max(
                np.int64(heights[niece]),
                1 + max(np.int64(heights[child]), np.int64(heights[stays])),
            )
            if height > highest:
                continue
            if change < best_change or height < best_height:
                best_change, best_height = change, height
                best_child, best_uncle, best_niece = child, uncle, niece
    if best_child == NONE:
        return False
    _exchange(nodes, heights, node, best_child, best_uncle, best_niece)
    return True
