# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many thin rays at meshes go together: each is answered as it is alone, to the last bit."""

import numpy as np
import pytest
from scene.meshes import ring as torus
from scene.reference import icosphere

from bvh_ros.scene import NO_NODE, Mesh, Scene, Shapes

COUNT = 1_500  # more than go together
RING = torus(24, 10, 1000) / 1000.0


@pytest.fixture(scope='module')
def shapes():
    """Meshes that share triangles and lie in each other, among other shapes."""
    rng = np.random.default_rng(5)
    solid, shell, convex = Mesh(RING), Mesh(RING, solid=False), Mesh(icosphere(3))
    few = Mesh([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]], [[0, 1, 2], [0, 1, 3]])
    meshes = [solid, solid, shell, convex, few, solid]
    turns = rng.normal(size=(len(meshes), 4))
    places = rng.uniform(-1.5, 1.5, (len(meshes), 3))
    turns[0], places[0], places[5], turns[5] = (0, 0, 0, 1), 0.0, places[1], turns[1]
    turns /= np.linalg.norm(turns, axis=1, keepdims=True)
    return [
        Shapes.of_meshes(meshes, places, turns),
        Shapes.spheres(rng.uniform(-2, 2, (3, 3)), 0.3),
        Shapes.boxes(rng.uniform(-2, 2, (4, 3)), 0.4),
    ]


def scene_of(parts):
    scene = Scene()
    for number, part in enumerate(parts):
        names = [f'{number} {row}' for row in range(len(part.position))]
        assert scene.update('test', names, part, stamp=1) == []
    return scene


def rays():
    """Origins and directions: past and from within the meshes, along their edges, from far away,
    without a length, and with endless ones.
    """
    rng = np.random.default_rng(6)
    vertices = RING.reshape(-1, 3)
    origins = rng.normal(size=(COUNT, 3)) * 2.0
    goals = rng.uniform(-1.5, 1.5, (COUNT, 3))
    goals[:300] = vertices[rng.integers(0, len(vertices), 300)]
    origins[200:400] = goals[200:400] + rng.normal(size=(200, 3)) * 1e6
    origins[400:500] = vertices[rng.integers(0, len(vertices), 100)]
    directions = goals - origins
    directions[500:510] = 0.0
    directions[510:520] *= 1e-160
    origins[520:530] *= 1e30
    return origins, directions


@pytest.mark.parametrize('skip_inside', [False, True])
@pytest.mark.parametrize('t_max', [np.inf, 1.0])
def test_rays_together_are_answered_as_alone(shapes, skip_inside, t_max):
    scene = scene_of(shapes)
    origins, directions = rays()
    masks = np.where(np.arange(COUNT) % 7 == 0, 0, 1).astype(np.uint32)
    options = {'t_max': t_max, 'skip_inside': skip_inside}
    together = scene.raycast_many(origins, directions, mask=masks, **options)
    alone = [
        scene.raycast_many(origins[k : k + 1], directions[k : k + 1], mask=masks[k], **options)
        for k in range(COUNT)
    ]
    met = np.isfinite(together.t)
    assert 400 < met.sum() < 1_400
    assert len(np.unique(together.handles)) > 10
    for column, rows in zip(together, zip(*alone, strict=True), strict=True):
        np.testing.assert_array_equal(column, np.concatenate(rows))


def test_a_snapshot_that_was_patched_decides_the_same(shapes):
    scene = scene_of(shapes)
    origins, directions = rays()
    scene.raycast_many(origins, directions)  # makes the snapshot of the scene
    moved = Shapes.spheres([[0.0, 0.0, 1.0]], 0.5)
    scene.update('test', ['new'], moved, stamp=1)
    together = scene.raycast_many(origins, directions)
    fresh = scene_of(shapes)
    fresh.update('test', ['new'], moved, stamp=1)
    for column, other in zip(together, fresh.raycast_many(origins, directions), strict=True):
        np.testing.assert_array_equal(column, other)


def test_threads_and_rays_that_are_not_finite(shapes):
    scene = scene_of(shapes)
    origins, directions = rays()
    one = scene.raycast_many(origins, directions)
    for column, other in zip(one, scene.raycast_many(origins, directions, threads=2), strict=True):
        np.testing.assert_array_equal(column, other)
    directions[COUNT - 1, 1] = np.nan
    with pytest.raises(ValueError, match='row 1499'):
        scene.raycast_many(origins, directions)


@pytest.mark.parametrize('count', [1, 80])
def test_a_hit_beyond_all_doubles_is_one(count):
    ball = Mesh(icosphere(2), solid=False)
    scene = scene_of([Shapes.of_meshes(ball, np.zeros((1, 3)))])
    starts = np.tile([16.0, 0.01, 0.02], (count, 1))
    hits = scene.raycast_many(starts, np.tile([-(2.0**-1022), 0.0, 0.0], (count, 1)))
    assert (hits.t == np.finfo(float).max).all()  # 15 * 2**1022 is more
    assert (hits.handles != NO_NODE).all()
