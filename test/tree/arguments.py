# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Good arguments for each method of a tree, of which tests replace one at a time."""

from typing import Any

import numpy as np

from bvh_ros import DynamicBVH

LO, HI, ONE = np.zeros((5, 3)), np.ones((5, 3)), [1.0, 1.0, 1.0]
LOW, HIGH = [-1e300] * 3, [1e300] * 3  # around whatever replaces the other corner


def some_tree(count: int = 8, margin: float = 0.0) -> DynamicBVH:
    """A tree whose first handles are always the same."""
    lo = np.random.default_rng(1).uniform(0, 20, (count, 3))
    return DynamicBVH.from_boxes(lo, lo + 1, margin=margin)


def moving(tree: DynamicBVH) -> DynamicBVH:
    """The tree, of which some boxes have velocities from now on."""
    tree.set_velocities(tree.ids()[:3], LO[:3])
    return tree


IDS = some_tree().ids()[:5]
RAY: dict[str, Any] = {'origin': ONE, 'direction': ONE, 't_max': np.inf, 'mask': 1}
RAY |= {'skip_inside': False, 'at': 0.0, 'pace': 0.0}
RAYS: dict[str, Any] = {'origins': LO, 'directions': HI, 't_max': np.inf, 'mask': 1}
RAYS |= {'skip_inside': False, 'threads': 1, 'at': 0.0, 'pace': 0.0}

TREE: dict[str, dict[str, Any]] = {
    '__init__': {'ndim': 3, 'margin': 0.0, 'sibling_search': 'greedy', 'capacity': 16},
    '__contains__': {'handle': 1},
    'boxcast': {'lo': LOW, 'hi': HIGH, 'translation': ONE, 'mask': 1, 'at': 0.0, 'pace': 0.0},
    'boxes': {'handles': IDS},
    'contains': {'lo': LOW, 'hi': HIGH, 'mask': 1},
    'exits': {'origins': LO, 'directions': HI, 'ids': [-1] * 5},
    'from_boxes': {'lo': LO, 'hi': HI, 'mask': 1, 'margin': 0.0},
    'insert': {'lo': LOW, 'hi': HIGH, 'mask': 1},
    'insert_many': {'lo': LO, 'hi': HI, 'mask': 1},
    'levels': {'first': 0, 'last': 2, 'most': 9},
    'load': {'path': 'saved', 'mmap': True, 'verify': True},
    'masks': {'handles': IDS},
    'move': {'handle': IDS[1], 'lo': LOW, 'hi': HIGH, 'displacement': ONE},
    'move_many': {'handles': IDS, 'lo': LO, 'hi': HI, 'displacement': HI},
    'nearest': {'point': ONE, 'k': 1, 'max_distance': np.inf, 'mask': 1, 'at': 0.0},
    'nearest_many': {'points': LO, 'k': 1, 'max_distance': np.inf, 'mask': 1, 'at': 0.0},
    'occluded': RAY,
    'occluded_many': RAYS,
    'overlap': {'lo': LOW, 'hi': HIGH, 'mask': 1, 'at': 0.0},
    'overlap_many': {'lo': LO, 'hi': HI, 'mask': 1, 'threads': 1, 'at': 0.0},
    'overlap_pairs': {'mask': 1},
    'pairs_with': {'other': some_tree(), 'mask': 1},
    'query_ball': {'points': LO, 'r': 1.0, 'mask': 1, 'threads': 1},
    'raycast': RAY,
    'raycast_all': RAY,
    'raycast_all_many': {name: good for name, good in RAYS.items() if name != 'threads'},
    'raycast_many': RAYS,
    'remove': {'handle': IDS[0]},
    'remove_many': {'handles': IDS},
    'save': {'path': 'saved too', 'mapped': False},
    'set_masks': {'handles': IDS, 'mask': 1},
    'set_velocities': {'handles': IDS, 'velocities': LO, 'reference': 0.0},
    'velocities': {'handles': IDS},
}
ARGUMENTS = [f'{method} {name}' for method, good in TREE.items() for name in good]


def ask(tree: DynamicBVH, what: str, value: Any) -> Any:
    """Call the method with the argument that `what` names, and good other ones."""
    method, name = what.split(' ')
    given = {**TREE[method], name: value}
    return DynamicBVH(**given) if method == '__init__' else getattr(tree, method)(**given)
