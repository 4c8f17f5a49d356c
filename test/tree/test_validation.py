# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""validate: each way to break a tree is seen and named; all other tests call it on sound trees."""

from collections.abc import Callable

import numpy as np
import pytest

from bvh_ros.tree.access import OpenTree
from bvh_ros.tree.nodes import COUNT, FREE_INNER, FREE_LEAF, NONE, ROOT, SLOT_BITS, is_leaf


def some_tree(ndim: int) -> OpenTree:
    rng = np.random.default_rng(1)
    lo = rng.uniform(0, 20, (30, ndim))
    tree = OpenTree(ndim, margin=0.1, capacity=40)
    tree.insert_many(lo, lo + 1, rng.integers(1, 2**32, 30, dtype=np.uint32))
    return tree


def root_of(tree: OpenTree) -> int:
    return int(tree.view().tree.state[ROOT])


def inner(tree: OpenTree) -> int:
    """An inner node that is not the root."""
    root = tree.view().tree.nodes[root_of(tree)]
    return next(int(root[side]) for side in ('left', 'right') if not is_leaf(int(root[side])))


def leaf(tree: OpenTree) -> int:
    return 2 * int(np.flatnonzero(tree.view().tree.handles >= 0)[7])


def write(
    field: str, value: Callable[[np.ndarray], object], node: Callable[[OpenTree], int]
) -> Callable[[OpenTree], None]:
    def act(tree: OpenTree) -> None:
        column = tree.view().tree.nodes[field]
        column[node(tree)] = value(column[node(tree)])

    return act


def set_state(place: int, value: Callable[[int], int]) -> Callable[[OpenTree], None]:
    def act(tree: OpenTree) -> None:
        tree.view().tree.state[place] = value(int(tree.view().tree.state[place]))

    return act


def swap_children_of_two(tree: OpenTree) -> None:
    """Two parents each take the other's left child, and the children still name the old ones."""
    a, b = root_of(tree), inner(tree)
    nodes = tree.view().tree.nodes
    nodes['left'][b], nodes['right'][b] = nodes['right'][b], nodes['left'][a]


def share_a_child(tree: OpenTree) -> None:
    node = inner(tree)
    tree.view().tree.nodes['left'][node] = tree.view().tree.nodes['right'][node]


def drop_handle(tree: OpenTree) -> None:
    tree.view().tree.handles[leaf(tree) >> 1] = NONE


def take_another_handle(tree: OpenTree) -> None:
    """Two slots with one handle: the second box cannot be named."""
    live = np.flatnonzero(tree.view().tree.handles >= 0)
    tree.view().tree.handles[live[3]] = tree.view().tree.handles[live[4]]


def handle_of_the_future(tree: OpenTree) -> None:
    tree.view().tree.handles[leaf(tree) >> 1] += 10**6 << SLOT_BITS


def lower_a_height(tree: OpenTree) -> None:
    tree.view().tree.heights[inner(tree)] -= 1


def leaf_with_a_height(tree: OpenTree) -> None:
    tree.view().tree.heights[leaf(tree)] = 1


def exact_box_outside(tree: OpenTree) -> None:
    tree.view().tree.tight['hi'][leaf(tree) >> 1] += 0.2


def exact_box_upside_down(tree: OpenTree) -> None:
    box = tree.view().tree.tight[leaf(tree) >> 1]
    box['lo'], box['hi'] = box['hi'].copy(), box['lo'].copy()


def exact_box_of_nothing(tree: OpenTree) -> None:
    tree.view().tree.tight['lo'][leaf(tree) >> 1, 0] = np.nan


def free_what_is_used(tree: OpenTree) -> None:
    tree.view().tree.nodes['parent'][int(tree.view().tree.state[FREE_LEAF])] = leaf(tree)


BREAKS: dict[str, tuple[Callable[[OpenTree], None], str]] = {
    'the root has a parent': (write('parent', lambda _: 3, root_of), 'root.*parent'),
    'a child of another parent': (write('parent', lambda p: p + 2, inner), 'parent'),
    'children swapped': (swap_children_of_two, 'parent|twice'),
    'a child twice': (share_a_child, 'twice'),
    'a child outside': (write('left', lambda _: 10**6, inner), 'outside|parent'),
    'a negative child': (write('right', lambda _: -7, inner), 'outside|parent'),
    'a root outside': (set_state(ROOT, lambda _: 81), 'outside|parent'),
    'a negative root': (set_state(ROOT, lambda _: -5), 'outside|parent'),
    'no root': (set_state(ROOT, lambda _: NONE), 'number'),
    'a leaf without a handle': (drop_handle, 'handle'),
    'one handle twice': (take_another_handle, 'handle'),
    'a handle never given': (handle_of_the_future, 'handle'),
    'a box too many': (set_state(COUNT, lambda n: n + 1), 'number'),
    'a box too few': (set_state(COUNT, lambda n: n - 1), 'number'),
    'free leaves lost': (set_state(FREE_LEAF, lambda _: NONE), 'free'),
    'free inner nodes lost': (set_state(FREE_INNER, lambda _: NONE), 'free'),
    'a free list in a circle': (write('parent', lambda _: 2 * 39, lambda t: 2 * 39), 'free'),
    'a free place in use': (free_what_is_used, 'free'),
    'an inner box too large': (write('hi', lambda hi: hi + 1, inner), 'union'),
    'an inner box too small': (write('lo', lambda lo: lo + 1, inner), 'union'),
    'an inner box of NaN': (write('lo', lambda lo: lo * np.nan, inner), 'union'),
    'a leaf grown': (write('hi', lambda hi: hi + 50, leaf), 'union'),
    'a mask with a bit too many': (write('mask', lambda mask: ~mask, inner), 'mask'),
    'a mask with a bit too few': (write('mask', lambda mask: mask & 0xFFFF, inner), 'mask'),
    'a height too low': (lower_a_height, 'height'),
    'a leaf with a height': (leaf_with_a_height, 'height'),
    'an exact box outside its fat box': (exact_box_outside, 'fat box'),
    'an exact box upside down': (exact_box_upside_down, 'fat box|lo'),
    'an exact box of NaN': (exact_box_of_nothing, 'fat box|finite'),
}


@pytest.mark.parametrize(('breaks', 'says'), BREAKS.values(), ids=BREAKS.keys())
@pytest.mark.parametrize('ndim', [2, 3])
def test_broken_trees_are_seen(breaks: Callable[[OpenTree], None], says: str, ndim: int) -> None:
    tree = some_tree(ndim)
    tree.validate()
    breaks(tree)
    with pytest.raises(RuntimeError, match=says):
        tree.validate()


def test_a_box_of_no_sense_in_a_tree_without_margin() -> None:
    for low, high in (([2.0, 2.0], [1.0, 1.0]), ([np.nan, 0.0], [1.0, 1.0])):
        tree = OpenTree(2)
        tree.insert([0, 0], [1, 1])
        tree.view().tree.nodes['lo'][0], tree.view().tree.nodes['hi'][0] = low, high
        with pytest.raises(RuntimeError):
            tree.validate()


def test_a_list_is_too_high() -> None:
    """40 boxes in a list, every link and box right: higher than 4 log2(40) + 4."""
    tree = OpenTree(2, capacity=40)
    for k in range(40):
        tree.insert([k, 0], [k, 1])
    nodes = tree.view().tree.nodes
    below = 0
    for k in range(1, 40):
        node = 2 * k + 1
        nodes['left'][node], nodes['right'][node], nodes['mask'][node] = below, 2 * k, 1
        nodes['parent'][[below, 2 * k]] = node
        nodes['lo'][node], nodes['hi'][node] = nodes['lo'][0], nodes['hi'][2 * k]
        tree.view().tree.heights[node] = k
        below = node
    nodes['parent'][below] = NONE
    tree.view().tree.state[ROOT] = below
    nodes['parent'][1] = NONE
    tree.view().tree.state[FREE_INNER] = 1
    assert tree.height == 39
    with pytest.raises(RuntimeError, match='4 log2'):
        tree.validate()
