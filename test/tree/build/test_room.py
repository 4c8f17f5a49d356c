# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Room that builds leave to the next one."""

import numpy as np
import pytest

from bvh_ros import DynamicBVH
from bvh_ros.tree.build import building


@pytest.fixture(autouse=True)
def no_spare(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(building, 'spare', [])


def test_nobody_else_has_it() -> None:
    first = building.spare_room(100)
    building.leave_room(first)
    again = building.spare_room(100)
    assert again is first
    assert building.spare_room(100) is not first


@pytest.mark.parametrize('count', [49, 101])
def test_what_does_not_fit_is_not_taken(count: int) -> None:
    building.leave_room(building.room_to_build(100))
    assert len(building.spare_room(count).made) == count


def test_large_room_is_given_back() -> None:
    building.leave_room(building.room_to_build(building.KEPT // 64))
    assert building.spare == []


def test_trees_built_in_turns_in_the_same_room() -> None:
    rng = np.random.default_rng(0)
    trees = []
    for count in (1000, 900, 600, 2, 1000):
        lo = rng.uniform(0, 1, (count, 3))
        trees.append((DynamicBVH.from_boxes(lo, lo + 0.1), lo))
    for tree, lo in trees:
        tree.validate()
        assert np.array_equal(tree.boxes(tree.ids())[0], lo)
        tree.rebuild()
        tree.validate()
