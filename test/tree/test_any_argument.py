# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Numbers that numpy takes for others, and subclasses of a tree; see test_odd_arguments, too."""

import copy
import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from odd_values import masked
from tree.arguments import HI, LO, ONE, some_tree
from tree.reference import snapshot

from bvh_ros import DynamicBVH
from bvh_ros.tree.access import OpenTree


def test_an_array_of_which_nothing_is_masked_is_taken() -> None:
    for taken in (masked((3,)).filled(7), np.ma.array(masked((3,)).filled(7))):
        some_tree().nearest(taken)


@pytest.mark.parametrize('name', ['ndim', 'margin', 'sibling_search'])
def test_what_a_tree_is_made_with_stays(name: str) -> None:
    with pytest.raises(AttributeError):
        setattr(some_tree(), name, 2)


# ---- subclasses


class Named(DynamicBVH):
    """With other arguments than the class itself."""

    def __init__(self, name: str, tags: list[str]) -> None:
        super().__init__(2, margin=0.5)
        self.name, self.tags = name, tags


class Counted(DynamicBVH):
    """With the same, and more."""

    def __init__(self, *args: Any, owner: str = 'nobody', **options: Any) -> None:
        super().__init__(*args, **options)
        self.owner = owner


COPIES: dict[str, Callable[[Any], Any]] = {
    'copy': copy.copy,
    'deepcopy': copy.deepcopy,
    'pickle': lambda tree: pickle.loads(pickle.dumps(tree)),
}


@pytest.mark.parametrize('way', COPIES.values(), ids=COPIES.keys())
def test_a_subclass_is_copied_with_what_it_adds(way: Callable[[Any], Any]) -> None:
    tree = Named('north', ['a'])
    handle = tree.insert([0, 0], [1, 1])
    twin = way(tree)
    assert type(twin) is Named
    assert (twin.name, twin.tags, twin.margin) == ('north', ['a'], 0.5)
    assert twin.ids().tolist() == [handle]
    assert (twin.tags is tree.tags) == (way is copy.copy)
    twin.remove(handle)
    assert handle in tree


def test_only_a_copy_is_not_validated(monkeypatch: pytest.MonkeyPatch) -> None:
    tree = some_tree()
    tree.set_velocities(tree.ids()[:3], LO[:3] + 1)
    pickled, state = pickle.dumps(tree), tree.__getstate__()

    def refuse(_: DynamicBVH) -> None:
        raise RuntimeError('looked at')

    monkeypatch.setattr(DynamicBVH, 'validate', refuse)
    for copied in (copy.copy(tree), copy.deepcopy(tree)):
        assert snapshot(copied) == snapshot(tree)
        assert np.array_equal(copied.velocities(tree.ids())[0], tree.velocities(tree.ids())[0])
        copied.insert(ONE, ONE)
    assert len(tree) == 8
    for load in (lambda: pickle.loads(pickled), lambda: DynamicBVH().__setstate__(state)):
        with pytest.raises(ValueError, match='looked at'):
            load()


def test_a_subclass_is_loaded_and_built(tmp_path: Path) -> None:
    tree = Named('north', [])
    tree.insert([0, 0], [1, 1])
    tree.save(tmp_path / 'tree')
    for made in (Named.load(tmp_path / 'tree'), Named.from_boxes([[0, 0]], [[1, 1]])):
        assert type(made) is Named
        made.insert([0, 0], [2, 2])
        made.validate()
        assert len(made) == 2
    built = Counted.from_boxes(LO, HI, margin=0.25)
    assert (built.owner, built.margin, len(built)) == ('nobody', 0.25, 5)


def test_no_handle_is_looked_for_under_a_mask() -> None:
    tree = some_tree()
    openly = OpenTree.from_boxes(*tree.boxes(tree.ids()))
    ids = np.ma.masked_array(tree.ids(), [True] + [False] * 7)
    rays = np.zeros((8, 3)), np.ones((8, 3))
    for call in (openly.slots, tree.boxes, tree.remove_many, lambda x: tree.exits(*rays, x)):
        with pytest.raises(ValueError, match=r'masked'):
            call(ids)
    assert len(tree) == 8


def test_a_memoryview_has_a_number_a_row() -> None:
    tree = some_tree()
    tree.set_masks(tree.ids(), np.arange(1, 9))
    limits, masks = np.arange(5) * 9.0, np.arange(1, 6)
    told = tree.raycast_many(LO, HI, limits, masks)
    again = tree.raycast_many(LO, HI, memoryview(limits), memoryview(masks))
    assert all(np.array_equal(one, other) for one, other in zip(told, again, strict=True))
    with pytest.raises(ValueError, match='mask must'):
        tree.raycast_many(LO, HI, limits, memoryview(masks[:1]))
