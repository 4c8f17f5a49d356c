# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The surface area heuristic's measure (Goldsmith and Salmon 1987): surface area in 3D, perimeter
in 2D.

Only comparisons and ratios of areas matter, so all of one comparison are of boxes times one power
of two, chosen so that nothing overflows: float64 areas do from edges of 1e154 on, and vanish below
1e-162.
"""

import math

import numpy as np

from .compiler import inlined, lean_kernel, stack_array
from .nodes import DEEPEST, NONE, ROOT, is_leaf, next_node
from .store.turns import begin_query, end_query

# Edges between these need no scaling: their products, and sums of many, are normal doubles.
SMALLEST_EDGE, LARGEST_EDGE = 2.0**-400, 2.0**400


@inlined
def half_area(lo, hi, scale):
    """Half the surface area (3D) or half the perimeter (2D) of the box times `scale`."""
    x = hi[0] * scale - lo[0] * scale
    y = hi[1] * scale - lo[1] * scale
    if lo.shape[0] == 2:
        return x + y
    z = hi[2] * scale - lo[2] * scale
    return x * y + (x + y) * z


@inlined
def node_area(nodes, node, scale):
    here = nodes[node]
    return half_area(here.lo, here.hi, scale)


@inlined
def union_area(nodes, a, b, scale):
    """Half area of the smallest box around two nodes' boxes."""
    a_node, b_node = nodes[a], nodes[b]
    x = max(a_node.hi[0], b_node.hi[0]) * scale - min(a_node.lo[0], b_node.lo[0]) * scale
    y = max(a_node.hi[1], b_node.hi[1]) * scale - min(a_node.lo[1], b_node.lo[1]) * scale
    if a_node.lo.shape[0] == 2:
        return x + y
    z = max(a_node.hi[2], b_node.hi[2]) * scale - min(a_node.lo[2], b_node.lo[2]) * scale
    return x * y + (x + y) * z


@inlined
def longest_edge(nodes, a, b):
    """Of the union of two nodes' boxes; it may overflow to inf."""
    a_node, b_node = nodes[a], nodes[b]
    longest = 0.0
    for axis in range(a_node.lo.shape[0]):
        longest = max(
            longest, max(a_node.hi[axis], b_node.hi[axis]) - min(a_node.lo[axis], b_node.lo[axis])
        )
    return longest


@inlined
def unit_scale(longest):
    """Power of two that brings an edge near 1: sums of areas of boxes within it then fit even a
    float32.
    """
    if math.isinf(longest):
        return 2.0**-1022
    return math.ldexp(1.0, min(-math.frexp(longest)[1], 1022))


@inlined
def area_unit(longest):
    """`unit_scale`, if float64 products of edges up to this could leave the doubles; else 1."""
    if SMALLEST_EDGE < longest < LARGEST_EDGE:
        return 1.0
    return unit_scale(longest)


@inlined
def area_scale(nodes, a, b):
    """`area_unit` for the union of two nodes."""
    return area_unit(longest_edge(nodes, a, b))


@lean_kernel
def cost_now(tree, version):
    """`tree_cost` of the whole tree, 0 if it is empty; negative if it is changed meanwhile."""
    state, cost = tree.state, 0.0
    if not begin_query(state, version):
        return -1.0
    if state[ROOT] != NONE:
        cost = tree_cost(tree.nodes, state[ROOT])
    end_query(state)
    return cost


@lean_kernel
def tree_cost(nodes, root):
    """Sum over the inner nodes of area / area of the root; the number of inner nodes where the
    root's area is zero.

    Areas are of boxes times the power of two that brings the root's longest edge near 1: none
    overflows, and what vanishes is below 1e-300 of the root's.
    """
    if is_leaf(root):
        return 0.0
    scale = area_scale(nodes, root, root)
    root_area = node_area(nodes, root, scale)
    stack, top, node = stack_array(DEEPEST, np.int64), 0, np.int64(root)
    total, inner = 0.0, 0
    while node != NONE:
        if not is_leaf(node):
            inner += 1
            total += node_area(nodes, node, scale)
        node, top = next_node(nodes, node, not is_leaf(node), stack, top)
    return total / root_area if root_area > 0.0 else float(inner)
