# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The traversal of the binary tree that visits near leaves first.

Rays, swept boxes, balls and nearest boxes share it, at rest and at a time. It goes depth first,
the nearer child first; the other child waits on a stack with its distance. A node that lies beyond
the limit is not visited. A query calls `next_leaf` until there is none, and lowers the limit as
it finds something.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..compiler import inlined
from ..nodes import NONE, is_leaf
from .slab import PAD, TINY


class Stack(NamedTuple):
    """The nodes that wait."""

    nodes: NDArray[np.int64]
    """Shape (DEEPEST,)."""
    entries: NDArray[np.float64]
    """Their distances."""


@inlined
def push_root(nodes, root, query, limit, stack, enter):
    """Put the root of a tree on an empty stack, if there is one; return the top of the stack."""
    if root == NONE:
        return 0
    stack.nodes[0], stack.entries[0] = root, enter(nodes, np.int64(root), query, limit)
    return 1 if stack.entries[0] < np.inf else 0


@inlined
def next_leaf(nodes, query, limit, stack, top, enter):
    """The next leaf that a query may reach within a limit: (leaf or NONE, top of the stack). The
    distance of the leaf is stack.entries[top].

    enter(nodes, node, query, limit) is the distance of a node: it may be too small, not too large;
    inf if the query surely does not reach the node within the limit.
    """
    while top > 0:
        top -= 1
        node, entry = stack.nodes[top], stack.entries[top]
        if entry > limit * PAD + TINY:
            continue
        while entry < np.inf and not is_leaf(node):
            near, far = np.int64(nodes[node].left), np.int64(nodes[node].right)
            entry = enter(nodes, near, query, limit)
            far_entry = enter(nodes, far, query, limit)
            if far_entry < entry:
                near, far, entry, far_entry = far, near, far_entry, entry
            if far_entry < np.inf:
                stack.nodes[top], stack.entries[top] = far, far_entry
                top += 1
            node = near
        if entry < np.inf:
            stack.entries[top] = entry
            return node, top
    return np.int64(NONE), top
