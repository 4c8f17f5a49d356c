# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The four exchanges of a child with a niece: the best one is done, and no rotation raises the
cost.
"""

import numpy as np
import pytest

from bvh_ros.tree.access import OpenTree
from bvh_ros.tree.nodes import (
    HIGHEST,
    NONE,
    ROOT,
    SERIAL,
    SLOT_BITS,
    is_leaf,
    refit_node,
    take_inner,
    take_leaf,
)
from bvh_ros.tree.rotation import rotate

Shape = int | tuple['Shape', 'Shape']  # a row of boxes, or two subtrees


def hang(tree: OpenTree, shape: Shape, at: list[float]) -> int:
    """Link a tree of exactly this shape over unit boxes at the given places on the x axis; return
    its root.
    """
    held = tree.view().tree
    nodes, heights, state = held.nodes, held.heights, held.state
    if isinstance(shape, int):
        leaf = int(take_leaf(nodes, state))
        nodes[leaf]['lo'], nodes[leaf]['hi'] = (at[shape], 0), (at[shape] + 1, 1)
        nodes[leaf]['mask'], heights[leaf] = 1, 0
        held.handles[leaf >> 1] = state[SERIAL] << SLOT_BITS | leaf >> 1
        state[SERIAL] += 1
        return leaf
    node = int(take_inner(nodes, state))
    for side, below in zip(('left', 'right'), shape, strict=True):
        child = hang(tree, below, at)
        nodes[node][side] = child
        nodes[child]['parent'] = node
    nodes[node]['parent'] = NONE
    refit_node(nodes, heights, node)
    return node


def shape_of(tree: OpenTree, node: int, at: list[float]) -> Shape:
    record = tree.view().tree.nodes[node]
    if is_leaf(node):
        return at.index(record['lo'][0])
    return shape_of(tree, int(record['left']), at), shape_of(tree, int(record['right']), at)


ROTATIONS = {
    # places, shape, shape after, cost before and after: of inner nodes' widths + 1 over the root's
    # A (B, C (F, G)): B <-> F and B <-> G
    'B <-> F': ([0, 9, 1], (0, (1, 2)), (1, (0, 2)), 1 + 10 / 11, 1 + 3 / 11),
    'B <-> G': ([0, 1, 9], (0, (1, 2)), (2, (1, 0)), 1 + 10 / 11, 1 + 3 / 11),
    # A (B (D, E), C): C <-> D and C <-> E
    'C <-> D': ([9, 1, 0], ((0, 1), 2), ((2, 1), 0), 1 + 10 / 11, 1 + 3 / 11),
    'C <-> E': ([1, 9, 0], ((0, 1), 2), ((0, 2), 1), 1 + 10 / 11, 1 + 3 / 11),
    'none pays': ([0, 8, 9], (0, (1, 2)), (0, (1, 2)), 1 + 3 / 11, 1 + 3 / 11),
    'two leaves': ([0, 5], (0, 1), (0, 1), 1, 1),
    # B is a subtree too: the best of the four
    'the best of four': (
        [0, 1, 2, 20],
        ((0, 3), (1, 2)),
        (((1, 2), 0), 3),
        1 + 22 / 22 + 3 / 22,
        1 + 4 / 22 + 3 / 22,
    ),
}


@pytest.mark.parametrize(
    ('at', 'before', 'after', 'cost', 'less'), ROTATIONS.values(), ids=ROTATIONS.keys()
)
def test_exchanges(at: list[float], before: Shape, after: Shape, cost: float, less: float) -> None:
    at = [float(x) for x in at]
    tree = OpenTree(2, capacity=len(at))
    tree.view().tree.state[ROOT] = root = hang(tree, before, at)
    tree.validate()
    assert tree.cost() == pytest.approx(cost)
    held = tree.view().tree
    assert rotate(held.nodes, held.heights, root, HIGHEST) == (before != after)
    tree.validate()
    assert tree.cost() == pytest.approx(less)
    assert unordered(shape_of(tree, root, at)) == unordered(after)


def unordered(shape: Shape) -> object:
    return shape if isinstance(shape, int) else frozenset(unordered(below) for below in shape)


def test_at_equal_cost_the_lower_tree() -> None:
    """A list of four coincident boxes becomes a balanced tree; a balanced one stays."""
    at = [0.0, 0.0, 0.0, 0.0]
    tree = OpenTree(2, capacity=4)
    tree.view().tree.state[ROOT] = root = hang(tree, (0, (1, (2, 3))), at)
    assert tree.height == 3
    assert rotate(tree.view().tree.nodes, tree.view().tree.heights, root, HIGHEST)
    assert tree.height == 2
    tree.validate()
    assert not rotate(tree.view().tree.nodes, tree.view().tree.heights, root, HIGHEST)


@pytest.mark.parametrize('ndim', [2, 3])
def test_no_rotation_raises_the_cost(ndim: int) -> None:
    rng = np.random.default_rng(9)
    done = 0
    for _ in range(20):
        lo = rng.uniform(0, 10, (50, ndim))
        tree = OpenTree.from_boxes(lo, lo + rng.uniform(0, 3, lo.shape))
        shuffle_leaves(tree, rng)
        for node in np.repeat(inner_nodes(tree), 2).tolist():
            cost, height = tree.cost(), tree.height
            rotated = rotate(tree.view().tree.nodes, tree.view().tree.heights, node, HIGHEST)
            repair_heights(tree)
            tree.validate()
            assert tree.cost() <= cost * (1 + 1e-12)
            assert rotated or (tree.cost(), tree.height) == (cost, height)
            done += rotated
    assert done > 100


def inner_nodes(tree: OpenTree) -> list[int]:
    """Children before parents."""
    nodes, found, stack = tree.view().tree.nodes, [], [int(tree.view().tree.state[ROOT])]
    while stack:
        node = stack.pop()
        if not is_leaf(node):
            found.append(node)
            stack += [int(nodes[node]['left']), int(nodes[node]['right'])]
    return found[::-1]


def shuffle_leaves(tree: OpenTree, rng: np.random.Generator) -> None:
    """Deal the boxes out anew over the leaves, so that the tree is bad."""
    nodes, leaves = tree.view().tree.nodes, 2 * (tree.ids() & 0xFFFF)
    order = rng.permutation(leaves)
    for side in ('lo', 'hi'):
        nodes[side][leaves] = nodes[side][order].copy()
    repair_heights(tree)


def repair_heights(tree: OpenTree) -> None:
    for node in inner_nodes(tree):
        refit_node(tree.view().tree.nodes, tree.view().tree.heights, node)
