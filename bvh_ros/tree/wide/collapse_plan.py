# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which nodes of the tree become wide nodes of sixteen children, and which are left out."""

import numpy as np

from ..area import longest_edge, node_area, unit_scale
from ..build.building import post_order
from ..compiler import WIDTH, lean_kernel, stack_array
from ..entries import entry_points
from ..nodes import DEEPEST, ROOT, is_leaf
from ..store.turns import begin_query, end_query

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
