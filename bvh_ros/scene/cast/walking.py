# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The walk of a ray, or of a ball, through the nodes of a tree: of a scene's, or of a mesh's."""

import numpy as np

from ...tree.access import DEEPEST, NONE, Stack, next_leaf, push_root, traversal_distance
from ...tree.compiler import inlined, stack_array


@inlined
def walk_nodes(nodes, root, path, scale, t_max, enter, caster, room, found, visit):
    """Hand the leaves that a path may reach by t_max to a visitor; return what it found, `found`
    at first. `enter` is as of `next_leaf`, in units of 2**scale; visit(caster, room, slot, found)
    returns what is found now, and the t up to which the walk goes on.
    """
    limit = traversal_distance(t_max, scale)
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    top = push_root(nodes, root, path, limit, stack, enter)
    while top > 0:
        leaf, top = next_leaf(nodes, path, limit, stack, top, enter)
        if leaf == NONE:
            break
        found, t = visit(caster, room, leaf >> 1, found)
        limit = traversal_distance(t, scale)
    return found
