# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How callers make shapes: what they are, and what is refused at once."""

import numpy as np
import pytest
from scene.reference import box_of_triangles

from bvh_ros import Mesh, Scene, ShapeKind, Shapes

TWO, UNTURNED = [[0.0, 0, 0], [3, 0, 0]], [0.0, 0, 0, 1]
CUBE = Mesh(box_of_triangles((1, 1, 1)))
MADE = {
    'one box size for all': (Shapes.boxes(TWO, [1, 2, 3]), 'BOX', [[1, 2, 3]] * 2),
    'a cube each': (Shapes.boxes(TWO, 2), 'BOX', [[2, 2, 2]] * 2),
    'balls': (Shapes.spheres(TWO, [1, 2]), 'SPHERE', [[2, 2, 2], [4, 4, 4]]),
    'drums': (Shapes.cylinders(TWO, 0.5, [1, 2]), 'CYLINDER', [[1, 1, 1], [1, 1, 2]]),
    'arms': (Shapes.capsules(TWO, [0.5, 0.25], 2), 'CAPSULE', [[1, 1, 2], [0.5, 0.5, 2]]),
    'one mesh for all': (Shapes.of_meshes(CUBE, TWO), 'MESH', [[1, 1, 1]] * 2),
}


@pytest.mark.parametrize(('shapes', 'kind', 'size'), MADE.values(), ids=MADE.keys())
def test_what_is_made(shapes: Shapes, kind: str, size: list[list[float]]) -> None:
    assert shapes.kind.tolist() == [ShapeKind[kind]] * 2
    assert shapes.position.tolist() == TWO
    assert shapes.orientation.tolist() == [UNTURNED] * 2
    assert shapes.size.tolist() == size
    scene = Scene()
    assert not scene.update('s', ['a', 'b'], shapes)
    assert scene.get('b').size.tolist() == size[1]


def test_rows_of_several_kinds() -> None:
    shapes = Shapes([0, 1, 4], [[0, 0, 0]] * 3, UNTURNED, [1, 1, 1], [None, None, CUBE])
    assert not Scene().update('s', ['a', 'b', 'c'], shapes)


TURNED = [0, 0, 0.6, 0.8]
REFUSED = {
    'size before orientation': (lambda: Shapes([0, 0], TWO, TWO, [TURNED] * 2), 'orientation'),
    'position before kind': (lambda: Shapes(TWO, [0, 0], TURNED, TWO), 'kind must'),
    'no kind': (lambda: Shapes([0, 7], TWO, TURNED, 1), 'kind .* row 1 is 7'),
    'no ball': (lambda: Shapes(1, TWO, TURNED, [[1, 1, 1], [1, 1, 2]]), 'row 1 .* sizes'),
    'a hole': (lambda: Shapes.boxes(TWO, [[1, 1, 1], [1, 1, -1]]), 'row 1 .* size is negative'),
    'no place': (lambda: Shapes.boxes([[0, 0, 0], [0, 0, np.nan]], 1), 'row 1 .* position'),
    'no radius': (lambda: Shapes.spheres(TWO, [1, 0]), 'radius .* row 1 is 0'),
    'too large': (lambda: Shapes.spheres(TWO, 1e308), 'radius .* row 0'),
    'no height': (lambda: Shapes.cylinders(TWO, 1, [1, -1]), 'height .* row 1 is -1'),
    'too short': (lambda: Shapes.capsules(TWO, 1, [2, 1.9]), 'length .* row 1 has length 1.9'),
    'three for two': (lambda: Shapes.spheres(TWO, [1, 1, 1]), 'radius must .* not'),
    'no mesh': (lambda: Shapes(4, TWO, TURNED, 1, [CUBE, None]), 'mesh .* row 1 has none'),
    'another size': (lambda: Shapes(4, TWO, TURNED, 2, [CUBE, CUBE]), 'size .* row 0'),
}  # fmt: skip


@pytest.mark.parametrize(('make', 'says'), REFUSED.values(), ids=REFUSED.keys())
def test_what_is_refused_when_it_is_made(make, says: str) -> None:
    with pytest.raises(ValueError, match=says):
        make()


def test_a_stamp_may_be_left_out_where_nothing_moves() -> None:
    scene = Scene()
    scene.update('s', ['a', 'b'], Shapes.boxes(TWO, 1))
    scene.replace('s', '', ['a'], Shapes.boxes(TWO[:1], 1))
    assert (scene.newest, scene.get('a').stamp, len(scene)) == (0, 0, 1)
    for change in (
        scene.update,
        lambda *rest, **more: scene.replace(rest[0], '', *rest[1:], **more),
    ):
        with pytest.raises(ValueError, match='stamp must be given'):
            change('s', ['c'], Shapes.boxes(TWO[1:], 1), velocities=[[1, 0, 0]])
    assert len(scene) == 1
