# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and swept balls against mixed scenes, by brute force over distances."""

import math

import numpy as np
import pytest
from scene.reference import first_contact, geometry_arrays, random_shapes

from bvh_ros.scene import Scene, Shapes

T = 1e-9  # of the segment; the reference itself bisects to 1e-12 or so
GRAZING = 1e-7  # a contact this shallow (m) may be seen or not


def filled(rng, count, planar=False, margin=0.0):
    shapes = random_shapes(rng, count)
    scene = Scene(planar=planar, margin=margin)
    assert scene.update('test', [f'o/{i}' for i in range(count)], shapes, stamp=1) == []
    return scene, geometry_arrays(shapes)


def segment(rng, world):
    """From anywhere to somewhere near an obstacle, some no longer than a point."""
    target = world[rng.integers(len(world))].position
    start, goal = rng.uniform(-6, 6, 3), target + rng.normal(size=3) * rng.choice([0.1, 0.5, 2.0])
    return start, start if rng.random() < 0.05 else goal


@pytest.mark.parametrize('radius', [0.0, 1e-3, 0.3, 2.0])
@pytest.mark.parametrize('planar', [False, pytest.param(True, marks=pytest.mark.slow)])
def test_all_hits_equal_brute_force(radius, planar):
    rng = np.random.default_rng(int(radius * 1000) + planar)
    met = 0
    for _ in range(3 if planar else 4):
        scene, world = filled(rng, 12, planar, margin=rng.choice([0.0, 0.2]))
        for _ in range(10 if planar else 25):
            start, goal = segment(rng, world)
            hits = scene.raycast_all(start, goal, radius)
            assert hits == sorted(hits, key=lambda hit: (hit.t, hit.handle))
            by_name = {hit.name: hit for hit in hits}
            for i, solid in enumerate(world):
                t, depth = first_contact(solid, start, goal, radius, planar)
                hit = by_name.pop(f'o/{i}', None)
                if (hit is None) != math.isinf(t):
                    assert abs(depth) < GRAZING, (solid, start, goal)
                elif hit is not None:
                    met += 1
                    assert hit.t == pytest.approx(t, abs=T) or depth < GRAZING
                    assert_contact(solid, hit, start, goal, radius, planar)
            assert by_name == {}
    assert met > 25


def assert_contact(solid, hit, start, goal, radius, planar):
    def distance(point):
        return (solid.distances_from_above if planar else solid.distances)(point[None])[0]

    centre = start + hit.t * (goal - start)
    if planar:
        assert hit.point[2] == start[2]
        assert hit.normal[2] == 0.0
        centre[2] = start[2]
    assert distance(hit.point) < 1e-9
    if hit.t > 0.0:
        assert np.linalg.norm(hit.normal) == pytest.approx(1.0)
        assert centre == pytest.approx(hit.point + radius * hit.normal, abs=1e-9)
        # Outwards: a little way along the normal leaves the obstacle by as much.
        assert distance(hit.point + 1e-4 * hit.normal) == pytest.approx(1e-4, rel=1e-3)
    elif distance(start) > 1e-12:
        away = centre - hit.point
        assert np.linalg.norm(away) == pytest.approx(distance(start))
        assert hit.normal == pytest.approx(away / np.linalg.norm(away), abs=1e-9)
    else:
        assert hit.normal.tolist() == [0.0, 0.0, 0.0]
        assert hit.point.tolist() == start.tolist()


def test_thin_rays_among_boxes_stay_exact_beside_other_shapes():
    """A ray along the common edge of boxes, decided as the tree alone decides it."""
    boxes = Shapes.boxes([[0.1 * i, 0.1, 0.1] for i in range(30)], [0.1, 0.1, 0.1])
    scene = Scene()
    scene.update('test', [f'b{i}' for i in range(30)], boxes, stamp=1)
    rays = [
        ([-1, y, z], [4, y, z]) for y in (0.05, 0.15, 0.1) for z in (0.05, 0.15000000000000002)
    ]
    rays += [([-1, -1 / 3, 0.1], [4, 4 / 3, 0.1]), ([0.05, 0.05, -1], [0.05, 0.05, 1])]
    alone = [
        [(h.name, h.t, h.point.tolist(), h.normal.tolist()) for h in scene.raycast_all(*ray)]
        for ray in rays
    ]
    first = [scene.raycast(*ray) for ray in rays]
    scene.update(
        'test',
        ['ball'],
        Shapes(np.array([1]), np.array([[0, 9.0, 9]]), np.zeros((1, 4)), np.ones((1, 3))),
        stamp=1,
    )
    beside = [
        [(h.name, h.t, h.point.tolist(), h.normal.tolist()) for h in scene.raycast_all(*ray)]
        for ray in rays
    ]
    assert sum(map(len, alone)) > 60
    for ray, one, other, hit in zip(rays, alone, beside, first, strict=True):
        assert one == other
        again = scene.raycast(*ray)
        assert (hit is None) == (again is None)
        assert hit is None or (hit.name, hit.t) == (again.name, again.t)
