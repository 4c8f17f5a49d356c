# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The truth that the report measures against, and how it counts."""

import math
from fractions import Fraction

import numpy as np
import pytest
from tree.reference import effort, exact_hits

from bvh_ros.report.error.meshes import CELL, boxes_of, surface_of, watertight
from bvh_ros.report.error.methods import (
    APART,
    COLOURS,
    LETTERS,
    WRONG,
    Point,
    box_methods,
    front,
    tradeoff,
)
from bvh_ros.report.error.truth import NOTHING, Answer, Score, boxes_truth, score, shapes_truth
from bvh_ros.report.error.worlds import corner_rays, rays_round, shapes_by_scene, true_shapes
from bvh_ros.report.scenes import Boxes, Rays, incoherent_rays, uniform_boxes
from bvh_ros.scene import Mesh, Scene, ShapeKind, Shapes, unchecked_shapes


@pytest.mark.parametrize('adversarial', [False, True])
def test_truth_of_boxes_is_that_of_brute_force(adversarial):
    rng = np.random.default_rng(1)
    boxes, rays = uniform_boxes(200, rng), incoherent_rays(100, rng)
    if adversarial:
        boxes, rays = corner_rays(200, 100, rng)
    truth = boxes_truth(boxes, rays)
    for ray, hits in enumerate(exact_hits(*boxes, *rays)):
        first = min((hit.t, hit.row) for hit in hits) if hits else (None, NOTHING)
        assert (truth.ts[ray], truth.rows[ray]) == first
        for hit in hits:
            assert truth.entry(hit.row, ray) == hit.t


def test_cells_are_a_mesh_and_boxes():
    """Rays that touch no corner: exact, rounded and as boxes they meet the same."""
    rng = np.random.default_rng(3)
    filled = rng.random((6, 6, 6)) < 0.1
    rays = incoherent_rays(60, rng)
    towards = Rays(rays.directions * -3.0, rays.directions + rng.uniform(0.0, 0.2, (60, 3)))
    boxes, triangles = boxes_of(np.argwhere(filled)), surface_of(filled) * CELL
    truth, found = boxes_truth(boxes, towards), watertight(triangles, towards)
    mesh = Mesh(triangles)
    scene = Scene()
    scene.update('report', ['mesh'], Shapes.of_meshes([mesh], [[0.0, 0.0, 0.0]]))
    ours = scene.raycast_many(*towards)
    exact = np.array([np.inf if t is None else float(t) for t in truth.ts])
    assert 5 < np.isfinite(exact).sum() < 55
    assert np.allclose(found.ts, exact, rtol=1e-12)
    assert np.allclose(ours.t, exact, rtol=1e-12)


HALF_TURN = (0.0, 0.0, 1.0, 1.0)  # a quarter turn about z, not of unit length
EIGHTH = (0.0, 0.0, math.sin(math.pi / 8), math.cos(math.pi / 8))
ROOT = Fraction(math.isqrt(2 << 200), 1 << 100)
# kind, size, quaternion, origin, direction, exact t or None; all shapes stand at (10, 0, 0)
SHAPES = {
    'box': ('BOX', (2, 4, 6), (0, 0, 0, 1), (0, 0, 0), (1, 0, 0), 9),
    'box, quarter turn': ('BOX', (2, 4, 6), HALF_TURN, (0, 0, 0), (1, 0, 0), 8),
    'box, edge first': ('BOX', (2, 2, 2), EIGHTH, (0, 0, 0), (1, 0, 0), 10 - ROOT),
    'sphere': ('SPHERE', (10, 10, 10), (0, 0, 0, 1), (0, 3, 0), (1, 0, 0), 6),
    'sphere, slow ray': ('SPHERE', (10, 10, 10), (0, 0, 0, 1), (0, 3, 0), (0.5, 0, 0), 12),
    'sphere, touched': ('SPHERE', (10, 10, 10), (0, 0, 0, 1), (0, 5, 0), (1, 0, 0), 10),
    'sphere missed': ('SPHERE', (10, 10, 10), (0, 0, 0, 1), (0, 5 + 1e-15, 0), (1, 0, 0), None),
    'sphere, behind': ('SPHERE', (10, 10, 10), (0, 0, 0, 1), (20, 3, 0), (1, 0, 0), None),
    'sphere, inside': ('SPHERE', (10, 10, 10), (0, 0, 0, 1), (12, 3, 0), (1, 0, 0), 0),
    'cylinder, side': ('CYLINDER', (10, 10, 2), (0, 0, 0, 1), (0, 4, 0), (1, 0, 0), 7),
    'cylinder, cap': ('CYLINDER', (10, 10, 2), (0, 0, 0, 1), (12, 1, 9), (0, 0, -2), 4),
    'cylinder, rim': ('CYLINDER', (10, 10, 2), (0, 0, 0, 1), (0, 0, 1), (1, 0, 0), 5),
    'above': ('CYLINDER', (10, 10, 2), (0, 0, 0, 1), (0, 0, 1 + 2e-16), (1, 0, 0), None),
    'cylinder, lying': ('CYLINDER', (10, 10, 2), (0, 1, 0, 1), (0, 0, 3), (1, 0, 0), 9),
}  # fmt: skip


@pytest.mark.parametrize('name', SHAPES)
def test_truth_of_shapes(name):
    kind, size, turn, origin, direction, expected = SHAPES[name]
    shapes = unchecked_shapes(
        np.array([ShapeKind[kind]], np.uint8),
        np.array([[10.0, 0, 0]]),
        np.array([turn], float),
        np.array([size], float),
    )
    truth = shapes_truth(shapes, Rays(np.array([origin], float), np.array([direction], float)))
    (t,) = truth.ts
    if expected is None:
        assert t is None
    else:
        assert abs(t - expected) < 1e-15
    assert truth.rows[0] == (NOTHING if expected is None else 0)


def test_score_counts_what_is_wrong():
    boxes = Boxes(np.array([[1.0, 0, 0], [3, 0, 0]]), np.array([[2.0, 1, 1], [4, 1, 1]]))
    origins = np.array([[0.0, 0.5, 0.5]] * 5 + [[0, 5, 5]])
    truth = boxes_truth(boxes, Rays(origins, np.tile([1.0, 0, 0], (6, 1))))
    assert truth.rows.tolist() == [0, 0, 0, 0, 0, NOTHING]
    one_ulp = math.nextafter(1.0, 2.0)
    answer = Answer(np.array([0, 0, 1, NOTHING, 0, 1]), np.array([1, one_ulp, 3, math.inf, 1, 3]))
    found = score([answer], [truth])
    assert (found.wrong_hits, found.wrong_misses, found.wrong_first) == (1, 1, 1)
    assert found.wrong_by == 2.0
    assert found.wrong == 0.5
    assert found.ulps == 1.0
    assert found.relative == 2.0**-52
    assert found.distances.tolist() == [0, 2.0**-52, 2, 0]


def test_objects_entered_at_the_same_distance_are_both_first():
    boxes = Boxes(np.zeros((2, 3)), np.ones((2, 3)))
    truth = boxes_truth(boxes, Rays(np.array([[-1.0, 0.5, 0.5]]), np.array([[1.0, 0, 0]])))
    assert truth.rows.tolist() == [0]
    answer = Answer(np.array([1]), np.array([1.0]))
    assert score([answer], [truth]).wrong == 0


@pytest.mark.slow
def test_only_rounded_decisions_are_wrong_where_it_is_close():
    boxes, rays = corner_rays(300, 2000, np.random.default_rng(1))
    truth = boxes_truth(boxes, rays)
    for name, (run, answer) in box_methods(boxes, rays).items():
        if 'brute force' not in name:
            found = score([answer(run())], [truth])
            assert found.wrong == 0 if name.startswith('bvh_ros') else found.wrong > 0.01
            assert not name.startswith('bvh_ros') or found.ulps <= 2


@pytest.mark.parametrize(
    ('points', 'expected'),
    [
        ([(1, 1), (2, 0.5), (3, 0.7), (4, 0.1)], [0, 1, 3]),
        ([(4, 0.1), (1, 1), (1, 0.5)], [2, 0]),
        ([(1, 1), (2, 0.95)], [0]),
        ([(1, 0), (2, 0)], [0]),
    ],
)
def test_front(points, expected):
    assert front(points) == expected


def point(name, time, wrong):
    return Point(name, time, Score(100, wrong, 0, 0, 0.0, np.zeros(1), 0.0, 0.0))


def test_letters_do_not_overlap_and_an_exact_answer_is_at_zero():
    pytest.importorskip('matplotlib', reason='matplotlib is not installed')
    assert len(set(LETTERS.values())) == len(LETTERS) == len(COLOURS)
    names = [*COLOURS][:6]
    points = [point(name, 1.0, 0 if k < 4 else 7) for k, name in enumerate(names)]
    axes, *_ = tradeoff(points, [WRONG], 'any').axes
    pixel = 72.0 / axes.figure.dpi
    middles = []
    for letter in axes.texts:
        at = np.array(letter.xyann) + pixel * axes.transData.transform(letter.xy)
        assert all(np.hypot(*(at - other)) >= APART for other in middles)
        middles.append(at)
    assert [letter.get_text() for letter in axes.texts] == [LETTERS[name] for name in names]
    assert [letter.xy[1] for letter in axes.texts] == [0.0] * 4 + [0.07] * 2
    assert '0' in [text.get_text() for text in axes.get_yticklabels()]
    assert axes.get_ylim()[0] < 0.0


def test_first_hits_among_recorded_shapes_are_those_of_exact_arithmetic(shared_data):
    """Tables and shelves; distances to rounding over the slope of the surface that is entered."""
    scenes = shapes_by_scene(shared_data / 'manipulation_scenes' / 'scenes.csv')
    assert len(scenes) == 17
    met, rays = 0, effort(200, 10_000)
    for number, shapes in enumerate(scenes.values()):
        some = rays_round(shapes, rays, np.random.default_rng(number))
        truth = shapes_truth(shapes, some)
        method = true_shapes(shapes, some)
        found = score([method.answer(method.run())], [truth])
        assert (found.wrong_hits, found.wrong_misses) == (0, 0)
        assert found.wrong_by < 1e-14  # flush boards: decided in float64
        assert found.distances.max(initial=0.0) < 1e-11
        met += int(np.count_nonzero(truth.rows != NOTHING))
    assert 0.3 < met / (rays * len(scenes)) < 0.99
