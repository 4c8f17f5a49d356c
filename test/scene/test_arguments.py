# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whatever a public argument of the scene is given: a ValueError in one line (KeyError for unknown
names), or an answer; and a scene that is as it was.
"""

import fractions

import numpy as np
import pytest
from scene.reference import box_of_triangles, changed, scene_of

from bvh_ros.scene import Families, Mesh, NodeScene, Numbered, Part, ShapeKind, Shapes

CUBE = Mesh(box_of_triangles((1, 1, 1)))
BOX = Shapes.boxes([[0, 0, 0]], [1, 1, 1])


MASKED = np.ma.masked_array([[0.0, 0.0, 0.0]], [[True, False, False]])
NOT_ONE = [None, 'x', b'x', 1.5, float('nan'), float('inf'), True, 10**400, -(10**400), 2**63, 1j]
NOT_ONE += [[1, 2], [[1]], [1.5], ['a'], {}, object(), np.ma.masked_array([1], [True])]
NOT_TIMES = [bad for bad in NOT_ONE if bad not in (1.5, [1.5])]
NOT_POINTS = [None, 'x', 1.0, [1, 2], [[1, 2]], [[1, 2, 3, 4]], [[1, 2], [3]], ['a', 'b', 'c']]
NOT_POINTS += [[10**400, 0, 0], [1j, 0, 0], [[[1, 2, 3]]], MASKED, object(), {}]
NOT_FINITE = [[np.nan, 0, 0], [np.inf, 0, 0]]
NOT_NAMES = [None, 'a', 5, [5], [None], [b'a'], b'a', Numbered('a', np.array([1.5]))]
NOT_NAMES += [Numbered(5, np.array([1])), Numbered('a', np.array([[1]])), Numbered('a', 3)]
NOT_NAMES += [Numbered('a', np.array([2**64 - 1], np.uint64)), Numbered('a', np.array(['x']))]
NOT_NAMES += [Numbered('a', np.ma.masked_array([1], [True])), ['a', 'b']]
NOT_NAMES += [Families(['a'], np.array(f), np.array([1])) for f in ([1], [-1], [0.5], [0, 0], 0)]
NOT_NAMES += [Families([None], np.array([0]), np.array([1]))]
NOT_KINDS = [[0.0], [True], ['BOX'], 0, [[0]], [0, 0], [None], np.ma.masked_array([0], [True])]
NOT_SHAPES = [
    None,
    5,
    tuple(BOX),
    [BOX],
    changed(BOX, mesh=3),
    changed(BOX, mesh=np.empty(2, object)),
]
NOT_SHAPES += [changed(BOX, kind=kind) for kind in NOT_KINDS]
NOT_SHAPES += [changed(BOX, **{name: bad}) for name in ('position', 'size') for bad in NOT_POINTS]
NOT_SHAPES += [changed(BOX, orientation=bad) for bad in (*NOT_POINTS[:5], [[0, 0, 0]], 0)]
BAD_ROWS = [
    (changed(BOX, kind=np.array([kind])), 'none of BOX, SPHERE, CYLINDER, CAPSULE and MESH')
    for kind in (-1, 5, 255, 256, 2**40, np.uint64(2**64 - 1))
]
BAD_ROWS += [
    (changed(BOX, **{name: np.array([[bad] + [0.5] * more])}), f'{name} is not finite')
    for name, more in (('position', 2), ('orientation', 3), ('size', 2))
    for bad in (np.nan, np.inf, -np.inf)
]
BAD_ROWS += [(changed(BOX, size=np.full((1, 3), 1e309)), 'size is not finite')]
BAD_ROWS += [(changed(BOX, size=np.array([[-1e-9, 1, 1]])), 'size is negative')]
BAD_ROWS += [
    (
        changed(BOX, position=np.full((1, 3), 1.7e308), size=np.full((1, 3), 1.7e308)),
        'largest double',
    )
]
BAD_ROWS += [
    (changed(BOX, kind=np.array([kind]), size=np.array([size], float)), words)
    for kind, size, words in (
        (ShapeKind.SPHERE, (1, 1, 2), 'sphere must be equal'),
        (ShapeKind.CYLINDER, (1, 2, 1), 'cylinder or capsule along x and y must be equal'),
        (ShapeKind.CAPSULE, (2, 2, 1), 'at least as long'),
        (ShapeKind.SPHERE, (1, 1, 0), 'sphere must be equal'),
        (ShapeKind.CYLINDER, (1, 1, 0), 'above zero'),
        (ShapeKind.CAPSULE, (1, 1, 0), 'above zero'),
    )
]
BAD_ROWS += [
    (changed(BOX, kind=np.array([kind]), size=np.array([size], float)), words)
    for kind in (ShapeKind.SPHERE, ShapeKind.CYLINDER, ShapeKind.CAPSULE)
    for size, words in (((0, 0, 0), 'above zero'), ((-1, -1, -1), 'size is negative'))
]
BAD_ROWS += [
    (changed(BOX, kind=np.array([ShapeKind.MESH]), mesh=mesh), 'needs its Mesh')
    for mesh in (None, *(np.array([x, 0], object)[:1] for x in (None, 'x', 7)))
]
OF_MESH = Shapes.of_meshes([CUBE], [[0, 0, 0]])
BAD_ROWS += [(changed(OF_MESH, size=np.full((1, 3), 2.0)), 'size of it')]


@pytest.fixture
def scene():
    scene = NodeScene()
    scene.update('s', ['a', 'ball'], Shapes(
        np.array([0, 1]), np.array([[0.0, 0, 0], [3, 0, 0]]), [0, 0, 0, 1], np.ones((2, 3))
    ), stamp=7, expires=100, categories=3)  # fmt: skip
    return scene


def state(scene):
    scene.validate()
    found = [scene.get(name) for _, name in scene.names()]
    return [[str(x) for x in one] for one in found], scene.newest, len(scene)


def refused(scene, call, *given, only=ValueError, **named):
    before = state(scene)
    with pytest.raises(only) as error:
        call(*given, **named)
    assert '\n' not in str(error.value)
    assert len(str(error.value)) < 500
    assert state(scene) == before


def in_slices(scene):
    def change(source, names, shapes, **rest):
        list(scene.in_slices(source, '', 1, Part(names, shapes, **rest).cut, whole=True))

    return change


def test_changes(scene):
    def replace(source, names, shapes, **rest):
        scene.replace(source, '', names, shapes, **rest)

    for change in (scene.update, replace, in_slices(scene)):
        for names in (*NOT_NAMES, {'a'}, frozenset('a')):
            refused(scene, change, 's', names, BOX, stamp=8)
        for shapes in NOT_SHAPES:
            refused(scene, change, 's', ['a'], shapes, stamp=8)
        for bad in NOT_TIMES:
            if bad is not None:
                refused(scene, change, 's', ['a'], BOX, stamp=bad)
            refused(scene, change, 's', ['a'], BOX, stamp=8, expires=bad)
        for bad in NOT_ONE:
            if bad is not None:
                refused(scene, change, 's', ['a'], BOX, stamp=8, categories=bad)
        for bad in (-1, 2**32, 2**40):
            refused(scene, change, 's', ['a'], BOX, stamp=8, categories=bad)
        refused(scene, change, 's', ['a'], BOX, stamp=8, expires=-1)
        for source in (None, 5, b's', ['s'], {}):
            refused(scene, change, source, ['a'], BOX, stamp=8)
    refused(scene, scene.replace, 's', 5, ['a'], BOX, stamp=8)
    for names in NOT_NAMES[:-8]:
        refused(scene, scene.remove, 's', names)
    for bad in (None, 5, b's', ['s']):
        refused(scene, scene.remove, bad, ['a'])
        refused(scene, scene.remove_group, bad, '')
        refused(scene, scene.remove_group, 's', bad)
        refused(scene, scene.remove_namespace, bad)
        if bad is not None:
            refused(scene, scene.remove_namespace, 's', bad)
    for bad in NOT_TIMES:
        if bad != ['a']:
            refused(scene, scene.expire, bad)
            refused(scene, scene.has_expired, bad)
            refused(scene, scene.shift_expiries, bad)


def test_rows_that_are_no_shape_are_refused_one_by_one(scene):
    before = state(scene)
    for rows, words in BAD_ROWS:
        (refusal,) = scene.update('s', ['a'], rows, stamp=8)
        assert (refusal.row, refusal.name) == (0, 'a')
        assert words in refusal.reason
        assert state(scene) == before
        refused(scene, scene.overlap_shape, rows)
        other = scene_of(BOX, names=['a'], source='s', of=NodeScene)
        (refusal,) = other.replace('s', '', ['a'], rows, stamp=3)
        assert (other.get('a').stamp, other.newest, words in refusal.reason) == (1, 3, True)


def test_constructors(scene):
    # Two coordinates are those of a planar scene.
    legal = 'None', '1.0', '[1, 2]', '[[1, 2]]'
    for bad in [bad for bad in NOT_POINTS if str(bad) not in legal]:
        refused(scene, Shapes.boxes, bad, [1, 1, 1])
        refused(scene, Shapes.of_meshes, [CUBE], bad)
    for bad in ('x', MASKED[:, :2], [1j, 1, 1], {}):
        refused(scene, Shapes.boxes, [[0, 0, 0]], bad)
    for bad in (5, 'x', [1, 2], [[1, 2, 3]], [[0, 0, 0, 1]] * 3):
        refused(scene, Shapes.boxes, [[0, 0, 0]], [1, 1, 1], bad)
    for bad in ([None], ['x'], [5], [], [CUBE, CUBE]):
        refused(scene, Shapes.of_meshes, bad, [[0, 0, 0]])
    for bad in (*NOT_POINTS, [[[np.nan] * 3] * 3], []):
        refused(scene, Mesh, bad)
    for bad in (0, -1, 1.5, None, 'x', float('nan'), True):
        refused(scene, NodeScene, max_obstacles=bad)
    for bad in (-1.0, float('nan'), float('inf'), None, 'x', [1], 10**400):
        refused(scene, NodeScene, margin=bad)


def test_queries(scene):
    spot = (0.0, 0.0, 5.0)
    for bad in [*NOT_POINTS, *NOT_FINITE]:
        for ask in (scene.raycast, scene.raycast_all, scene.overlap):
            refused(scene, ask, bad, spot)
            refused(scene, ask, spot, bad)
        refused(scene, scene.nearest, bad)
    for bad in (None, 'x', np.nan, -1.0, -np.inf, [1, 2], 10**400, 1j):
        for ask in (scene.raycast, scene.raycast_all):
            refused(scene, ask, spot, spot, bad)
        refused(scene, scene.overlap, spot, spot, tolerance=bad)
        refused(scene, scene.overlap_shape, BOX, bad)
        refused(scene, scene.nearest, spot, 1, bad)
    for bad in (None, 'x', 1.5, np.nan, np.inf, -1, 2**32, 10**400, [1, 2]):
        for ask in (scene.raycast, scene.raycast_all, scene.overlap):
            refused(scene, ask, spot, spot, mask=bad)
        refused(scene, scene.overlap_shape, BOX, mask=bad)
        refused(scene, scene.nearest, spot, mask=bad)
        refused(scene, scene.overlap_pairs, bad)
        refused(scene, scene.count, bad)
    for bad in (0, -1, 1.5, np.nan, None, 'x', True, [1]):
        refused(scene, scene.nearest, spot, bad)
    for k in (10**400, 2**63, 2**31):
        assert len(scene.nearest(spot, k)) == 2
    for bad in ('x', [1, 2], [1, 2, 3], [np.nan, 0, 0, 1], 5, [0, 0, 0, 0]):
        refused(scene, scene.overlap, spot, spot, bad)
    for bad in NOT_SHAPES:
        refused(scene, scene.overlap_shape, bad)
    for bad in (None, 5, b'a', 'none', '', ['a']):
        refused(scene, scene.clearance, bad, only=KeyError)
        refused(scene, scene.get, bad, only=KeyError)
    for bad in (None, 'x', 1.5, -1, True):
        refused(scene, scene.name_of, bad)
        for ask in (scene.names, scene.newcomers):
            refused(scene, ask, bad)
        for ask in (scene.handles_of, scene.shapes_of):
            refused(scene, ask, 's', bad)
    for bad in (None, 5, b's', ['s']):
        for ask in (scene.handles_of, scene.shapes_of):
            refused(scene, ask, bad, 1)
    refused(scene, scene.name_of, 10**400, only=KeyError)
    for bad in ('x', 1.5, None, [True], [[1], [1, 2]]):
        refused(scene, scene.names_of, bad)
    for bad in (0, -1, 5000, [1, 5000]):
        refused(scene, scene.names_of, bad, only=KeyError)
    third = fractions.Fraction(1, 3)
    assert scene.raycast((third, 0, 0), (third, 0, 9)).name == 'a'


@pytest.mark.parametrize('kind', ['i1', 'u1', '>i2', 'u8', '>i8'])
def test_stamps_are_integers_of_any_type(scene, kind):
    for stamps in ([9], [9, 3]):
        names = ['a', 'b'][: len(stamps)]
        shapes = BOX.take([0] * len(stamps))
        assert not scene.replace('s', '', names, shapes, stamp=np.array(stamps, kind))
        assert scene.newest == 9
        assert [scene.get(name).stamp for name in names] == stamps


def test_many_rays(scene):
    rays = np.zeros((2, 3)), np.ones((2, 3))
    for bad in (None, 'x', 1.0, [[1, 2]], [[1, 2, 3]], [[np.nan, 0, 0]] * 2, [[1j, 0, 0]] * 2):
        if np.shape(bad) != (1, 3):
            refused(scene, scene.raycast_many, bad, rays[1])
        refused(scene, scene.raycast_many, rays[0], bad)
    for bad in (None, 'x', [1], -1.0, np.nan, [1, np.nan], [1, -1], 10**400):
        refused(scene, scene.raycast_many, *rays, bad)
    for bad in (None, 'x', [1], -1, 1.5, [1, 2**32], [1.5, 1], 10**400):
        refused(scene, scene.raycast_many, *rays, mask=bad)
    none = np.zeros((0, 3))
    assert len(scene.raycast_many(none, none, 1.0, mask=[], at=[], until=[]).t) == 0


def test_a_shifted_clock_saturates(scene):
    for by in (2**63 - 1, -(2**63), 2**62, 2**62, 2**62):
        scene.shift_expiries(by)
        assert all(scene.get(name).expires > 0 for name in ('a', 'ball'))
