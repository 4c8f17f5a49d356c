# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Every odd value for every argument of every public method: an answer, or a ValueError of one
line that names the argument, and nothing is changed.
"""

import inspect
from collections.abc import Callable, Iterator
from typing import Any

import numpy as np
import pytest
from odd_values import ONE, VALUES
from scene.reference import box_of_triangles
from tree.arguments import TREE, moving, some_tree
from tree.reference import snapshot

from bvh_ros import DynamicBVH
from bvh_ros.forest import Forest
from bvh_ros.scene import Mesh, NodeScene, Scene, ShapeKind, Shapes, TooManyHitsError

ORIGIN, ROWS, ENDS = [0.0] * 3, np.zeros((5, 3)), np.ones((5, 3))
BALL = Shapes(np.array([ShapeKind.SPHERE]), np.zeros((1, 3)), [0, 0, 0, 1], np.ones((1, 3)))
FIVE = Shapes.boxes(ROWS, ENDS)
CUBE = Mesh(box_of_triangles((1, 1, 1)))
# For each method good arguments, of which one at a time is replaced.
SCENE: dict[str, dict[str, Any]] = {
    '__init__': {'planar': False, 'margin': 0.0, 'max_obstacles': 9, 'categorise': str.__len__,
                 'meshes': False, 'any_mesh': False, 'region': None, 'max_prediction': 9.0,
                 'uncertainty': 0.0},
    '__contains__': {'name': 'a'},
    'clearance': {'name': 'a', 'signed': True, 'at': 0},
    'clearance_many': {'shapes': FIVE, 'max_distance': 9.0, 'mask': 1, 'signed': False,
                       'threads': 1, 'at': 0},
    'collisions_many': {'shapes': FIVE, 'mask': 1, 'threads': 1, 'at': 1},
    'count': {'mask': 1},
    'expire': {'now': 10, 'most': 1},
    'find': {'source': 's', 'names': ['a'], 'namespaces': ()},
    'get': {'name': 'a'},
    'handles_of': {'source': 's', 'most': 1},
    'has_expired': {'now': 1},
    'name_of': {'handle': 1},
    'names': {'after': 0},
    'names_of': {'handles': [1, 0xFFFFFFFF]},
    'nearest': {'point': ORIGIN, 'k': 1, 'max_distance': 9.0, 'mask': 1, 'signed': True, 'at': 0},
    'nearest_many': {'points': ROWS, 'k': 1, 'max_distance': 9.0, 'mask': 1, 'signed': False,
                     'threads': 1, 'at': 0},
    'newcomers': {'after': 0},
    'prepare_rays': {'count': 5},
    'overlap': {'start': ORIGIN, 'goal': ONE, 'orientation': [0, 0, 0, 1], 'tolerance': 0.1,
                'mask': 1, 'most': 9, 'at': 0},
    'overlap_many': {'centers': ROWS, 'sizes': ENDS, 'orientations': None, 'tolerance': 0.1,
                     'mask': 1, 'want': 'hits', 'threads': 1, 'at': 0},
    'overlap_pairs': {'mask': 1},
    'overlap_shape': {'shape': BALL, 'tolerance': 0.1, 'mask': 1, 'at': 0},
    'sweep_shape': {'shape': BALL, 'goal_position': ONE, 'goal_orientation': None,
                    'tolerance': 0.1, 'mask': 1, 'resolution': 1e-3, 'at': 0, 'until': 1},
    'sweep_shape_many': {'shape': BALL, 'positions': ROWS, 'orientations': None,
                         'goal_positions': ENDS, 'goal_orientations': None, 'tolerance': 0.1,
                         'mask': 1, 'resolution': 1e-3, 'at': 0, 'until': 1, 'want': 'any',
                         'threads': 1},
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
    '__new__': {'kind': 0, 'position': ROWS, 'orientation': [0, 0, 0, 1], 'size': ENDS,
                'mesh': None},
    'boxes': {'position': ROWS, 'size': ENDS, 'orientation': None},
    'spheres': {'position': ROWS, 'radius': 1.0},
    'cylinders': {'position': ROWS, 'radius': 1.0, 'height': 2.0, 'orientation': None},
    'capsules': {'position': ROWS, 'radius': 1.0, 'length': 2.0, 'orientation': None},
    'take': {'rows': [0, 1]},
    'of_meshes': {'meshes': [CUBE] * 5, 'position': ROWS, 'orientation': None},
}  # fmt: skip


MESH: dict[str, dict[str, Any]] = {
    '__init__': {'triangles': np.eye(3), 'faces': [[0, 1, 2]], 'solid': None},
    'from_file': {'path': 'tetrahedron.obj', 'scale': 1.0, 'solid': None, 'max_triangles': 9,
                  'max_bytes': 99},
}  # fmt: skip

# What other rooms call, with what the tree or the scene gave them.
INSIDE = {
    NodeScene: {'is_prepared', 'prepare_times', 'discard', 'discard_in_slices', 'in_slices',
                'is_long', 'names_still_there', 'own_box', 'triangles_met'},
    Forest: {'__init__'},  # of `open` and `build`
}  # fmt: skip
DRAWN = {'plot'}  # `test_plotting` of the tree and of the scene
MAKERS = '__init__', '__new__'
ABSENT = {'handle', 'handles', 'ids', 'name'}  # of what there is none: KeyError
FILES = {'path', 'folder'}  # where there is nothing to read, or to write: OSError
# As many rows as memory can take: views of one number are left out.
MANY = {'origins', 'points', 'centers', 'positions', 'starts', 'lo', 'position', 'size',
        'orientation', 'rows', 'scale'}  # fmt: skip
# What an error calls an argument by.
SAYS = {'handles': 'handle', 'ids': 'id', 'chunks': 'chunk', 'triangles': 'triangle',
        'max_triangles': 'triangles', 'max_bytes': 'bytes'}  # fmt: skip


def parameters(cls: type) -> dict[str, set[str]]:
    """The names of the arguments of each public method that takes any."""
    named = {}
    for name, function in inspect.getmembers(cls, callable):
        if name.startswith('_') and name not in (*MAKERS, '__contains__'):
            continue
        if function is getattr(tuple if issubclass(cls, tuple) else object, name, None):
            continue
        if taken := {*inspect.signature(function).parameters} - {'self', 'cls'}:
            named[name] = taken
    return named


def odd_values(name: str) -> Iterator[tuple[str, Any]]:
    for place, value in enumerate(VALUES):
        if not (isinstance(value, np.ndarray) and value.size > 2**40 and name in MANY):
            yield f'{name}: value {place}, a {type(value).__name__}', value


def complaint(error: Exception, name: str) -> str:
    """What is wrong about an error for a value of this argument; empty if nothing is."""
    if isinstance(error, KeyError) and name in ABSENT:
        return ''
    if isinstance(error, OSError) and name in FILES:
        return ''
    text = str(error)
    # Where there are no rows, it is the other arguments that have too many.
    named = SAYS.get(name, name) in text or 'shape (0, ' in text
    good = isinstance(error, ValueError) and named and '\n' not in text and len(text) <= 500
    return '' if good else f'{error!r:.300}'


def complaints(
    method: str,
    good: dict[str, Any],
    make: Callable[[], Any],
    state: Callable[[Any], Any] = lambda _: None,
    answers: type[Exception] = TooManyHitsError,
) -> list[str]:
    """What is wrong about a method of what `make` returns with each odd value."""
    wrong = []
    for name in good:
        subject = make()
        before = state(subject)
        for shown, value in odd_values(name):
            call = subject if method in MAKERS else getattr(subject, method)
            try:
                call(**{**good, name: value})
                subject = make()
                continue
            except answers:
                continue
            except Exception as error:
                if said := complaint(error, name):
                    wrong.append(f'{method} {shown}: {said}')
            if state(subject) != before:
                wrong.append(f'{method} {shown} has changed something')
                subject = make()
    return wrong


# ---- the classes


def cases(table: dict[str, dict[str, Any]]) -> list[tuple[str, bool]]:
    """All methods; those that take times also where something moves."""
    return [(method, False) for method in table] + [
        (method, True) for method, good in table.items() if 'at' in good
    ]


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize(('method', 'with_velocities'), cases(TREE))
def test_a_tree(
    method: str, with_velocities: bool, tmp_path: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    some_tree().save('saved', mapped=True)
    make: Callable[[], Any] = some_tree if not with_velocities else lambda: moving(some_tree())
    if method == '__init__':
        wrong = complaints(method, TREE[method], lambda: DynamicBVH)
    else:
        wrong = complaints(method, TREE[method], make, snapshot)
    assert not wrong, '\n'.join(wrong)


def some_scene(moving: bool, planar: bool = False) -> NodeScene:
    scene = NodeScene(planar=planar)
    shapes = Shapes.boxes([[0, 0, 0], [3, 0, 0]], [1, 1, 1], [[0, 0, 0.6, 0.8]] * 2)
    speeds = [[1.0, 0, 0], [0, 0, 0]] if moving else None
    scene.update('s', ['a', 'b'], shapes, stamp=0, expires=100, velocities=speeds)
    return scene


def contents(scene: Any) -> Any:
    named = scene.names()
    return named, scene.newest, [str(tuple(scene.get(name))) for _, name in named]


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize(('method', 'with_velocities'), cases(SCENE))
def test_a_scene(method: str, with_velocities: bool) -> None:
    if method == '__init__':
        wrong = complaints(method, SCENE[method], lambda: Scene)
    else:
        wrong = complaints(method, SCENE[method], lambda: some_scene(with_velocities), contents)
    assert not wrong, '\n'.join(wrong)


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method', sorted(set(SCENE) - {'__init__'}))
def test_a_planar_scene(method: str) -> None:
    wrong = complaints(method, SCENE[method], lambda: some_scene(True, planar=True), contents)
    assert not wrong, '\n'.join(wrong)


@pytest.mark.filterwarnings('ignore')
def test_a_forest(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    forest = Forest.build('world', [(ROWS, ENDS)], 3)
    wrong = [complaints(method, good, lambda: forest) for method, good in FOREST.items()]
    assert not any(wrong), '\n'.join(map(str, wrong))


@pytest.mark.filterwarnings('ignore')
def test_shapes_and_meshes(tmp_path: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.chdir(tmp_path)
    corners, faces = ('0 0 0', '1 0 0', '0 1 0', '0 0 1'), ('1 2 3', '1 2 4', '1 3 4', '2 3 4')
    lines = [f'v {one}' for one in corners] + [f'f {one}' for one in faces]
    (tmp_path / 'tetrahedron.obj').write_text('\n'.join(lines))
    wrong = [
        complaints(method, good, lambda method=method: Shapes if method in MAKERS else FIVE)
        for method, good in SHAPES.items()
    ]
    wrong += [complaints(method, good, lambda: Mesh) for method, good in MESH.items()]
    assert not any(wrong), '\n'.join(map(str, wrong))


TABLES = {DynamicBVH: TREE, NodeScene: SCENE, Forest: FOREST, Shapes: SHAPES, Mesh: MESH}


@pytest.mark.parametrize('cls', TABLES, ids=lambda cls: cls.__name__)
def test_no_argument_is_left_out(cls: type) -> None:
    left = INSIDE.get(cls, set()) | DRAWN
    named = {method: taken for method, taken in parameters(cls).items() if method not in left}
    assert {method: {*good} for method, good in TABLES[cls].items()} == named


# What `help` shows besides these methods: no argument, or none that could be odd.
PLAIN = {
    DynamicBVH: {'bounds', 'clear', 'cost', 'height', 'ids', 'margin', 'ndim', 'optimize', 'plot',
                 'rebuild', 'sibling_search', 'stats', 'validate'},
    Scene: {'bounds', 'clear', 'copy', 'expired', 'handles', 'interrupted', 'max_obstacles',
            'max_prediction', 'newest', 'planar', 'plot', 'rebuild', 'sources', 'stats',
            'validate'},
}  # fmt: skip
ASKED_BY_NODES = {'collisions_many', 'find', 'handles_of', 'has_expired', 'newcomers',
                  'prepare_rays', 'shapes_of', 'tree_levels'}  # fmt: skip


@pytest.mark.parametrize(('cls', 'table'), [(DynamicBVH, TREE), (Scene, SCENE)])
def test_help_shows_what_callers_use(cls: type, table: dict[str, dict[str, Any]]) -> None:
    shown = {name for name in dir(cls) if not name.startswith('_')}
    called = {name for name in table if not name.startswith('_')} - ASKED_BY_NODES
    assert shown == called | PLAIN[cls]


# ---- the client: without a node, what is not refused times out

QUESTION: dict[str, Any] = {'start': ORIGIN, 'end': ONE, 'radius': 0.1, 'at': 1, 'until': 2,
                            'frame_id': ''}  # fmt: skip
VOLUME: dict[str, Any] = {'corner': ORIGIN, 'opposite': ONE, 'orientation': [0, 0, 0, 1],
                          'tolerance': 0.1, 'at': 1, 'frame_id': ''}  # fmt: skip
BATCH: dict[str, Any] = {'origins': ROWS, 'directions': ENDS, 't_max': 9.0, 'mask': 1,
                         'radius': 0.1, 'at': 1, 'until': 2, 'frame_id': '',
                         'stamp': 1}  # fmt: skip
TIMEOUT: dict[str, Any] = {'timeout': 0.01}
CLIENT: dict[str, dict[str, Any]] = {
    'check_path': {'positions': ROWS, 'orientations': None, 'at': 1, 'frame_id': '',
                   'between': False, **TIMEOUT},
    'clearance_many': {'shapes': FIVE, 'max_distance': 9.0, 'mask': 1, 'signed': False, 'at': 1,
                       'frame_id': '', **TIMEOUT},
    'names': {'obstacles': [1], **TIMEOUT},
    'nearest': {'point': ORIGIN, 'max_distance': 9.0, 'at': 1, 'frame_id': '', **TIMEOUT},
    'nearest_many': {'points': ROWS, 'max_distance': 9.0, 'mask': 1, 'at': 1, 'frame_id': '',
                     **TIMEOUT},
    'overlap': VOLUME | TIMEOUT,
    'overlap_async': VOLUME,
    'overlap_many': {'centers': ROWS, 'sizes': ENDS, 'orientations': None, 'tolerance': 0.1,
                     'mask': 1, 'at': 1, 'frame_id': '', **TIMEOUT},
    'raycast': QUESTION | TIMEOUT,
    'raycast_all': QUESTION | TIMEOUT,
    'raycast_all_async': QUESTION,
    'raycast_async': QUESTION,
    'raycast_many': BATCH | TIMEOUT,
    'raycast_many_async': BATCH,
    'sweep_shape_many': {'shapes': FIVE, 'goal_positions': ENDS, 'goal_orientations': None,
                         'tolerance': 0.1, 'mask': 1, 'resolution': 1e-3, 'at': 1, 'until': 2,
                         'frame_id': '', **TIMEOUT},
    'wait_until_batches_are_ready': TIMEOUT,
    'wait_until_ready': TIMEOUT,
}  # fmt: skip


@pytest.fixture
def client(monkeypatch: pytest.MonkeyPatch) -> Iterator[Any]:
    """A client whose questions are never answered, which it notices at once."""
    rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    from bvh_ros.client import BvhClient

    context = rclpy.Context()
    rclpy.init(args=[], context=context)
    monkeypatch.setattr('bvh_ros.client.waiting.Waiting.until', lambda *_: False)
    yield BvhClient(rclpy.create_node('odd', context=context), timeout=0.01)
    rclpy.try_shutdown(context=context)


@pytest.mark.filterwarnings('ignore')
@pytest.mark.parametrize('method', CLIENT)
def test_a_client(client: Any, method: str) -> None:
    from bvh_ros.client import BvhClient, BvhError

    assert {*CLIENT[method]} == parameters(BvhClient)[method]
    # An error of no answer in time, or of a package that is not there.
    wrong = complaints(method, CLIENT[method], lambda: client, answers=BvhError)
    assert not wrong, '\n'.join(wrong)
