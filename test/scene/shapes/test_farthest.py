# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The farthest vertex against all of them, above all on fine flat faces rounded to float32."""

import numpy as np
from scene.meshes import cut_cube
from scene.reference import scene_of
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, Shapes


def as_published(triangles, offset, seed):
    """Turned, far from the origin, and in float32."""
    turn = Rotation.random(random_state=seed)
    places = turn.apply(triangles.reshape(-1, 3)) + np.array([1.0, 0.7, 0.0]) * offset
    return places.astype(np.float32).astype(float).reshape(-1, 3, 3)


def test_a_vertex_in_a_box_is_never_free():
    """Boxes that a face of a fine mesh enters with one vertex, along every face's normal."""
    mesh = Mesh(as_published(cut_cube(32), 1000.0, 5))
    scene = scene_of(Shapes.of_meshes([mesh], [[0, 0, 0]]))
    places = mesh.vertices + mesh.centre
    rng = np.random.default_rng(6)
    for way in mesh.normals[rng.integers(len(mesh.normals), size=30)]:
        deepest = places[np.argmax(places @ way)]
        turn = Rotation.align_vectors([way], [[1, 0, 0]])[0]
        for depth, touches in ((1e-9, True), (-1e-9, False)):
            centre = deepest + way * (0.5 - depth)
            box = Shapes.boxes([centre], [1, 4, 4], [turn.as_quat()])
            assert bool(scene.overlap_shape(box)) == touches
            assert bool(scene.overlap(centre, centre, tolerance=0.5)) == touches
