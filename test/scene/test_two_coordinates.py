# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A planar scene takes two coordinates wherever it takes three, and one row for all."""

from collections.abc import Callable
from typing import Any

import numpy as np
import pytest

from bvh_ros import Scene, Shapes, quaternions

HERE, THERE = np.array([[0.0, 0.0]]), np.array([[9.0, 0.5], [5.0, 5.0], [0.0, 9.0]])
YAWS = quaternions(yaw=[0.0, 0.7, -2.0])
Places = Callable[[Any], Any]


def as_they_are(places: Any) -> Any:
    return places


def with_height(places: Any) -> Any:
    rows = np.asarray(places)
    return np.concatenate((rows, np.zeros((*rows.shape[:-1], 1))), axis=-1)


def some_scene(of: Places) -> Scene:
    scene = Scene(planar=True, region=(of([-np.inf, -9.0]), of([20.0, 20.0])))
    boxes = Shapes.boxes(of([[2.0, 0.0], [5.0, 1.0], [5.0, 5.0]]), of([1.0, 2.0]), YAWS)
    speeds = of([[0.0, 1.0], [0.0, 0.0], [-0.5, 0.0]])
    assert not scene.update('a', ['x', 'y', 'z'], boxes, stamp=0, velocities=speeds)
    assert not scene.update('b', ['far'], Shapes.boxes(of([[30.0, 0.0]]), of([1.0, 1.0])))
    assert not scene.update('c', ['tin'], Shapes.cylinders(of([8.0, 0.0]), 0.5, 1.0))
    assert len(scene) == 4
    return scene


QUESTIONS: dict[str, Callable[[Scene, Places], Any]] = {
    'raycast': lambda s, of: s.raycast(of(HERE[0]), of(THERE[0])),
    'a ball': lambda s, of: s.raycast(of(HERE[0]), of(THERE[0]), 0.3, at=0.0, until=2.0),
    'raycast_all': lambda s, of: s.raycast_all(of(HERE[0]), of(THERE[0])),
    'raycast_many': lambda s, of: s.raycast_many(of(HERE[0]), of(THERE), 1.0),
    'sweep_many': lambda s, of: s.sweep_many(of(THERE), of(HERE[0]), 0.2, at=1.0, until=2.0),
    'overlap': lambda s, of: s.overlap(of([1.0, -1.0]), of([6.0, 0.5])),
    'overlap at': lambda s, of: s.overlap(of([1.0, -1.0]), of([6.0, 0.5]), at=1.0),
    'overlap_many': lambda s, of: s.overlap_many(of(THERE), of([1.0, 2.0]), YAWS, want='hits'),
    'overlap_shape': lambda s, of: s.overlap_shape(Shapes.boxes(of([2.0, 0.5]), of([1.0, 1.0]))),
    'overlap_shape_many': lambda s, of: s.overlap_shape_many(
        Shapes.boxes(of(HERE), of([0.8, 0.5])), of(THERE), YAWS, want='hits'
    ),
    'nearest': lambda s, of: s.nearest(of(HERE[0]), 3),
    'nearest_many': lambda s, of: s.nearest_many(of(THERE), 2),
    'clearance_many': lambda s, of: s.clearance_many(Shapes.boxes(of(THERE), of([0.8, 0.5]))),
    'sweep_shape': lambda s, of: s.sweep_shape(
        Shapes.boxes(of(HERE), of([0.8, 0.5])), of(THERE[0]), YAWS[1]
    ),
    'sweep_shape_many': lambda s, of: s.sweep_shape_many(
        Shapes.boxes(of(HERE), of([0.8, 0.5])), of(HERE[0]), None, of(THERE), YAWS
    ),
}


def in_full(answer: Any) -> Any:
    """Arrays as lists, and NaN equal to itself."""
    if isinstance(answer, np.ndarray):
        return str(answer.tolist())
    return [in_full(part) for part in answer] if isinstance(answer, (list, tuple)) else answer


@pytest.mark.parametrize('question', QUESTIONS)
def test_two_coordinates_ask_what_three_ask(question: str) -> None:
    ask = QUESTIONS[question]
    found = ask(some_scene(as_they_are), as_they_are)
    assert found  # else it says nothing
    assert in_full(found) == in_full(ask(some_scene(with_height), with_height))


def test_one_row_is_the_same_as_many_equal_rows() -> None:
    scene, foot = some_scene(as_they_are), Shapes.boxes(HERE, [0.8, 0.5])
    every = np.repeat(HERE, 3, axis=0)
    for answer, same in (
        (scene.raycast_many(HERE[0], THERE), scene.raycast_many(every, THERE)),
        (scene.sweep_many(THERE, HERE[0]), scene.sweep_many(THERE, every)),
        (
            scene.sweep_shape_many(foot, HERE[0], None, THERE),
            scene.sweep_shape_many(foot, every, None, THERE),
        ),
        (
            scene.sweep_shape_many(foot, THERE, None, HERE[0]),
            scene.sweep_shape_many(foot, THERE, None, every),
        ),
    ):
        assert not isinstance(answer, np.ndarray)
        assert not isinstance(same, np.ndarray)
        for column, other in zip(answer, same, strict=True):
            np.testing.assert_array_equal(column, other)
    for sizes in (1.5, [1.5, 1.5]):
        found = scene.overlap_many(THERE, sizes, want='count')
        assert (
            found.tolist()
            == scene.overlap_many(THERE, [[1.5, 1.5, 0.0]] * 3, want='count').tolist()
        )


def test_a_scene_with_heights_refuses_two_coordinates() -> None:
    scene, flat = Scene(), Shapes.boxes(HERE, [1.0, 1.0])
    with pytest.raises(ValueError, match=r'need a planar scene'):
        scene.update('a', ['a'], flat)
    with pytest.raises(ValueError, match=r'need a planar scene'):
        scene.overlap_shape(flat)
    with pytest.raises(ValueError, match=r'start must have shape \(3,\)'):
        scene.raycast([0.0, 0.0], [1.0, 0.0, 0.0])
    with pytest.raises(ValueError, match=r'origins must have shape'):
        scene.raycast_many([[0.0, 0.0]], [[1.0, 0.0]])
    with pytest.raises(ValueError, match=r'2 or 3 coordinates, not shape \(4,\)'):
        Scene(planar=True).raycast([0.0, 0.0, 0.0, 0.0], [1.0, 0.0])
