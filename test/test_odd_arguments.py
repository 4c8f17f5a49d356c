# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every odd value for every argument of the public methods of a scene, of shapes and of a forest:
an answer, or a ValueError of one line that names the argument, and nothing is changed.

`test/tree/test_any_argument.py` does the same for a tree.
"""

import inspect
from typing import Any

import numpy as np
import pytest
from odd_values import ONE, VALUES
from scene.reference import box_of_triangles

from bvh_ros.forest import Forest
from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes

ORIGIN, ROWS, ENDS = [0.0] * 3, np.zeros((5, 3)), np.ones((5, 3))
BALL = Shapes(np.array([ShapeKind.SPHERE]), np.zeros((1, 3)), np.zeros((1, 4)), np.ones((1, 3)))
FIVE = Shapes.boxes(ROWS, ENDS)
CUBE = Mesh(box_of_triangles((1, 1, 1)))
# For each method good arguments, of which one at a time is replaced.
SCENE: dict[str, dict[str, Any]] = {
    'clearance': {'name': 'a', 'signed': True, 'at': 0},
    'clearance_many': {'shapes': FIVE, 'max_distance': 9.0, 'mask': 1, 'signed': False,
                       'threads': 1, 'at': 0},
    'count': {'mask': 1},
    'expire': {'now': 10, 'most': 1},
    'find': {'source': 's', 'names': ['a'], 'namespaces': ()},
    'get': {'name': 'a'},
    'handles_of': {'source': 's', 'most': 1},
    'has_expired': {'now': 1},
    'name_of': {'handle': 1},
    'names': {'after': 0},
    'nearest': {'point': ORIGIN, 'k': 1, 'max_distance': 9.0, 'mask': 1, 'signed': True, 'at': 0},
    'nearest_many': {'points': ROWS, 'k': 1, 'max_distance': 9.0, 'mask': 1, 'signed': False,
                     'threads': 1, 'at': 0},
    'newcomers': {'after': 0},
    'prepare_batch': {'count': 5},
    'overlap': {'start': ORIGIN, 'goal': ONE, 'orientation': [0, 0, 0, 1], 'tolerance': 0.1,
                'mask': 1, 'most': 9, 'at': 0},
    'overlap_many': {'centers': ROWS, 'sizes': ENDS, 'orientations': None, 'tolerance': 0.1,
                     'mask': 1, 'want': 'ids', 'threads': 1, 'at': 0},
    'overlap_pairs': {'mask': 1},
    'overlap_shape': {'shape': BALL, 'tolerance': 0.1, 'mask': 1, 'at': 0},
    'overlap_shape_many': {'shape': BALL, 'positions': ROWS, 'orientations': None,
                           'tolerance': 0.1, 'mask': 1, 'want': 'any', 'threads': 1, 'at': 0},
    'raycast': {'start': ORIGIN, 'goal': ONE, 'radius': 0.1, 'mask': 1, 'skip_inside': False,
                'at': 0, 'until': 1},
    'raycast_all': {'start': ORIGIN, 'goal': ONE, 'radius': 0.1, 'mask': 1, 'skip_inside': False,
                    'most': 9, 'at': 0, 'until': 1},
    'raycast_many': {'origins': ROWS, 'directions': ENDS, 't_max': 9.0, 'mask': 1,
                     'skip_inside': False, 'threads': 1, 'radius': 0.1, 'at': 0, 'until': 1},
    'remove': {'source': 's', 'names': ['a']},
    'remove_group': {'source': 's', 'group': ''},
    'remove_namespace': {'source': 's', 'namespace': 'a'},
    'replace': {'source': 's', 'group': '', 'names': ['a'], 'shapes': BALL, 'stamp': 8,
                'expires': 9, 'categories': 1, 'velocities': [ONE]},
    'shapes_of': {'source': 's', 'most': 1},
    'shift_expiries': {'by': 1},
    'sweep_many': {'starts': ROWS, 'goals': ENDS, 'radius': 0.1, 'mask': 1, 'skip_inside': False,
                   'threads': 1, 'at': 0, 'until': 1},
    'tree_levels': {'first': 0, 'last': 1, 'most': 9},
    'update': {'source': 's', 'names': ['a'], 'shapes': BALL, 'stamp': 8, 'expires': 9,
               'categories': 1, 'velocities': [ONE]},
}  # fmt: skip
# The node hands them what the scene gave it; `test/scene/test_slicing.py`, `test_plotting.py`.
LEFT_OUT = {'discard', 'discard_in_slices', 'names_of', 'in_slices', 'is_long', 'plot'}
UNKNOWN_NAMES = {'name', 'handle'}  # of what there is none: KeyError
# As many rows as memory can take: views of one number are left out.
MANY = {
    'origins',
    'points',
    'centers',
    'positions',
    'starts',
    'lo',
    'position',
    'size',
    'orientation',
}

FOREST: dict[str, dict[str, Any]] = {
    'raycast_many': {'origins': ROWS, 'directions': ENDS, 't_max': 9.0, 'mask': 1,
                     'skip_inside': False, 'threads': 1, 'executor': None},
    'occluded_many': {'origins': ROWS, 'directions': ENDS, 't_max': 9.0, 'mask': 1,
                      'skip_inside': False, 'threads': 1, 'executor': None},
    'overlap_many': {'lo': ROWS, 'hi': ENDS, 'mask': 1, 'threads': 1, 'executor': None},
    'nearest_many': {'points': ROWS, 'k': 1, 'max_distance': 9.0, 'mask': 1, 'executor': None},
    'open': {'folder': 'world', 'verify': True},
    'build': {'folder': 'other', 'chunks': [(ROWS, ENDS)], 'max_boxes': 3},
}  # fmt: skip
SHAPES: dict[str, dict[str, Any]] = {
    'boxes': {'position': ROWS, 'size': ENDS, 'orientation': None},
    'of_meshes': {'meshes': [CUBE] * 5, 'position': ROWS, 'orientation': None},
}


def parameters(cls: type, inherited: type = object) -> dict[str, set[str]]:
    """The names of the arguments of each public method that takes any."""
    named = {}
    for name in dir(cls):
        function = getattr(cls, name)
        if name.startswith('_') or not callable(function) or hasattr(inherited, name):
            continue
        if taken := {*inspect.signature(function).parameters} - {'self'}:
            named[name] = taken
    return named


def complaints(call: Any, name: str, state: Any = lambda: None) -> list[str]:
    """What is wrong about `call` with each odd value."""
    wrong = []
    for place, value in enumerate(VALUES):
        before = state()
        shown = f'{name}: value {place}, a {type(value).__name__}'
        if isinstance(value, np.ndarray) and value.size > 2**40 and name in MANY:
            continue
        try:
            call(value)
            continue
        except (KeyError, OSError) as error:
            if name not in UNKNOWN_NAMES and not isinstance(error, OSError):
                wrong.append(f'{shown}: {error!r}')
        except ValueError as error:
            if '\n' in str(error) or len(str(error)) > 500:
                wrong.append(f'{shown}: {error}')
        except Exception as error:
            wrong.append(f'{shown}: {error!r:.300}')
        if state() != before:
            wrong.append(f'{shown} has changed something')
    return wrong


def some_scene(moving: bool) -> Scene:
    scene = Scene()
    shapes = Shapes.boxes([[0, 0, 0], [3, 0, 0]], [1, 1, 1], [[0, 0, 0.6, 0.8]] * 2)
    speeds = [[1.0, 0, 0], [0, 0, 0]] if moving else None
    scene.update('s', ['a', 'b'], shapes, stamp=0, expires=100, velocities=speeds)
    return scene


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('moving', [False, True])
@pytest.mark.parametrize('method', SCENE)
def test_a_scene(method: str, moving: bool) -> None:
    wrong = []
    for name in SCENE[method]:
        kept = [some_scene(moving)]

        def call(value: Any, name: str = name, kept: list[Scene] = kept) -> None:
            getattr(kept[0], method)(**{**SCENE[method], name: value})
            kept[0] = some_scene(moving)

        def state(kept: list[Scene] = kept) -> Any:
            return (
                kept[0].names(),
                kept[0].newest,
                [str(kept[0].get(n)) for _, n in kept[0].names()],
            )

        wrong += complaints(call, name, state)
    assert not wrong, '\n'.join(wrong)


@pytest.mark.filterwarnings('ignore')
def test_a_forest(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    forest, wrong = Forest.build('world', [(ROWS, ENDS)], 3), []
    for method, good in FOREST.items():
        for name in good:
            call = lambda x, m=method, g=good, n=name: getattr(forest, m)(**{**g, n: x})  # noqa: E731
            wrong += [f'{method} {one}' for one in complaints(call, name)]
    assert not wrong, '\n'.join(wrong)


@pytest.mark.filterwarnings('ignore')
def test_shapes() -> None:
    wrong = []
    for method, good in SHAPES.items():
        for name in good:
            call = lambda x, m=method, g=good, n=name: getattr(Shapes, m)(**{**g, n: x})  # noqa: E731
            wrong += [f'{method} {one}' for one in complaints(call, name)]
    assert not wrong, '\n'.join(wrong)


def test_no_argument_is_left_out() -> None:
    named = {name: taken for name, taken in parameters(Scene).items() if name not in LEFT_OUT}
    assert {name: {*good} for name, good in SCENE.items()} == named
    assert {name: {*good} for name, good in FOREST.items()} == parameters(Forest)
