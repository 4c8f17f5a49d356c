# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Distances below 0: no shorter way parts the shapes, and the way told does."""

import itertools
import math
from fractions import Fraction

import numpy as np
import pytest
from scene.distance.contacts import rotation
from scene.reference import (
    bulging,
    changed,
    geometry_arrays,
    hull_of,
    random_shapes,
    random_turns,
    refilled,
    scene_of,
)

from bvh_ros.scene import Mesh, Scene, Shapes

BOX, SPHERE, CYLINDER, CAPSULE = range(4)
ASIDE = [0, 0, math.sin(math.pi / 8), math.cos(math.pi / 8)]


def shape(kind, size, place=(0, 0, 0), turn=(0, 0, 0, 1)):
    return Shapes([kind], [place], [turn], size)


def depth(one, other, planar=False):
    """(distance, point, other point) of a shape and an obstacle."""
    told = refilled(other, planar).clearance_many(one, signed=True)
    return told[1].item(), told[2][0], told[3][0]


class Body:
    """A shape by how far it reaches; of a mesh `triangles` are in its frame."""

    def __init__(self, rows, triangles=None):
        self.solid = geometry_arrays(rows)[0]
        self.triangles = triangles

    def reach(self, normals):
        if self.triangles is None:
            along = self.solid.reach(normals)
        else:
            local = normals @ self.solid.matrix
            along = (local @ self.triangles.reshape(-1, 3).T).max(axis=1)
        return normals @ self.solid.position + along

    def edges(self):
        if self.triangles is None:
            return self.solid.matrix.T[: 0 if self.solid.kind == SPHERE else 3]
        sides = np.roll(self.triangles, -1, axis=1) - self.triangles
        return sides.reshape(-1, 3) @ self.solid.matrix.T

    def faces(self):
        if self.triangles is None:
            return self.solid.matrix.T
        one, other = self.triangles[:, 1:].swapaxes(0, 1) - self.triangles[:, 0]
        return np.cross(one, other) @ self.solid.matrix.T


def apart(one, other, normals):
    """How far the one has to move along each normal to leave the other."""
    return other.reach(normals) + one.reach(-normals)


def least_way(one, other):
    """Of all faces of the set of differences, and of many ways besides, ever closer."""
    numbers = np.arange(2000) + 0.5
    polar, turn = np.arccos(1 - numbers / 1000), math.pi * (1 + math.sqrt(5)) * numbers
    ways = [np.stack((np.cos(turn) * np.sin(polar), np.sin(turn) * np.sin(polar), np.cos(polar)))]
    across = np.cross(one.edges()[:, None], other.edges()[None]).reshape(-1, 3)
    ways = np.concatenate((ways[0].T, one.faces(), other.faces(), across))
    sizes = np.linalg.norm(ways, axis=1)
    ways = ways[sizes > 1e-9] / sizes[sizes > 1e-9, None]
    ways = np.concatenate((ways, -ways))
    grid = np.stack(np.meshgrid(*[np.linspace(-1, 1, 9)] * 2), -1).reshape(-1, 2)
    best, step = ways[np.argsort(apart(one, other, ways))[:4]], 0.1
    for _ in range(40):
        side = np.cross(best, np.eye(3)[np.argmin(np.abs(best), axis=1)])
        side /= np.linalg.norm(side, axis=1)[:, None]
        frame = np.stack((side, np.cross(best, side)), 1)
        trial = best[:, None] + step * np.einsum('gk,nki->ngi', grid, frame)
        trial /= np.linalg.norm(trial, axis=2)[:, :, None]
        values = apart(one, other, trial.reshape(-1, 3)).reshape(trial.shape[:2])
        best = np.take_along_axis(trial, np.argmin(values, axis=1)[:, None, None], 1)[:, 0]
        step *= 0.6
    return float(apart(one, other, best).min())


def assert_is_depth(one, other, found):
    """Of bodies of about 1 m."""
    distance, point, other_point = found
    assert distance <= 0.0
    assert np.linalg.norm(other_point - point) == pytest.approx(-distance, abs=1e-14)
    assert -distance <= least_way(one, other) + 1e-13
    if distance < -1e-9:
        way = (other_point - point) / np.linalg.norm(other_point - point)
        assert apart(one, other, way[None])[0] == pytest.approx(-distance, abs=1e-7)
        heights = np.array([one.reach(-way[None])[0], other.reach(way[None])[0]])
        assert heights == pytest.approx([-way @ point, way @ other_point], abs=1e-7)


def with_meshes(rng, rows):
    """One row as it is, or a mesh in its place; and its triangles."""
    if rng.random() < 0.7:
        return rows, None
    triangles = bulging(rng, int(rng.choice([6, 20, 40])))
    placed = Shapes.of_meshes([Mesh(triangles)], rows.position, random_turns(rng, 1))
    return placed, triangles


@pytest.mark.slow
def test_every_pair_of_kinds_as_brute_force():
    rng, seen = np.random.default_rng(11), set()
    for _ in range(200):
        rows = random_shapes(rng, 2, rng.choice([0.1, 0.6, 1.0]))
        (one, triangles), (other, more) = (with_meshes(rng, rows.take([i])) for i in (0, 1))
        found = depth(one, other)
        if found[0] <= 0.0:
            assert_is_depth(Body(one, triangles), Body(other, more), found)
            seen.add(tuple(sorted((one.kind.item(), other.kind.item()))))
    assert len(seen) == 15


NEARLY = [0.0, 1e-15, 1e-12, 1e-8, 1e-3]


@pytest.mark.slow
def test_shapes_that_lie_along_each_other():
    """Needles, plates and equal shapes, one in the other, turned by next to nothing."""
    rng, sizes = np.random.default_rng(12), [1e-12, 1e-6, 0.01, 0.5, 1.0, 2.0]
    touching = 0
    for kind, other_kind in itertools.product(range(5), repeat=2):
        for nearly in NEARLY:
            (turn,) = random_turns(rng, 1)
            pair = []
            for number in (kind, other_kind):
                a, b, c = rng.choice(sizes, 3)
                size = [[a, b, c], [a, a, a], [a, a, c], [a, a, a + c], [1, 1, 1]][number]
                place = rng.integers(-1, 2, 3) * 0.25 + rng.normal(size=3) * nearly
                facing = turn + rng.normal(size=4) * nearly
                facing /= np.linalg.norm(facing)
                if number == 4:
                    triangles = hull_of(rng.integers(-2, 3, (30, 3)) * 0.25)
                    rows = Shapes.of_meshes([Mesh(triangles)], [place], [facing])
                    pair.append((rows, triangles))
                else:
                    pair.append((shape(number, size, place, facing), None))
            found = depth(pair[0][0], pair[1][0])
            if found[0] <= 0.0:
                touching += 1
                assert_is_depth(Body(*pair[0]), Body(*pair[1]), found)
            for rows, triangles in pair:  # within itself
                body = Body(rows, triangles)
                assert_is_depth(body, body, depth(rows, rows))
    assert touching > 60


@pytest.mark.slow
def test_seen_from_above_as_brute_force():
    rng, touching = np.random.default_rng(13), 0
    for _ in range(150):
        rows = random_shapes(rng, 2, 1.0)
        distance, point, other_point = depth(rows.take([0]), rows.take([1]), planar=True)
        if distance > 0.0:
            continue
        one, other = geometry_arrays(rows)
        middle, reach = 0.0, math.pi
        for _ in range(4):  # ever closer
            angles = middle + np.linspace(-reach, reach, 2001)
            ways = np.stack((np.cos(angles), np.sin(angles)), 1)
            widths = one.reach(-ways) + other.reach(ways)
            widths += ways @ (other.position - one.position)[:2]
            middle, reach = angles[np.argmin(widths)], reach * 0.01
        assert widths.min() == pytest.approx(-distance, abs=1e-8)
        assert widths.min() >= -distance - 1e-13
        assert np.linalg.norm(other_point - point) == pytest.approx(-distance, abs=1e-14)
        assert point[2] == other_point[2] == rows.position[0, 2]
        touching += 1
    assert touching > 60


def fractions(numbers):
    return np.array([Fraction(number) for number in numbers])


def exact_square(boxes):
    """The square of the depth of two turned boxes: over the faces of all their differences."""
    (half, place, turn), (other_half, other_place, other_turn) = boxes
    axes, other_axes = (rotation(*fractions(each)).T for each in (turn, other_turn))
    lines = [*axes, *other_axes, *np.cross(axes[:, None], other_axes).reshape(-1, 3)]
    offset = fractions(place) - fractions(other_place)
    squares = []
    for line in filter(any, lines):
        reach = fractions(half) @ np.abs(axes @ line)
        reach += fractions(other_half) @ np.abs(other_axes @ line)
        over = reach - abs(line @ offset)
        squares.append((over * over / (line @ line)) * (1 if over >= 0 else -1))
    return min(squares)


@pytest.mark.slow
def test_turned_boxes_as_rationals():
    rng, touching = np.random.default_rng(14), 0
    for _ in range(200):
        boxes = [
            (
                rng.choice([0.0, 0.25, 0.5, 1.0], 3).tolist(),
                (rng.integers(-8, 9, 3) * 0.125).tolist(),
                [*rng.integers(-3, 4, 3).tolist(), int(rng.integers(1, 4))],
            )
            for _ in range(2)
        ]
        square = exact_square(boxes)
        if square < 0:
            continue
        one, other = (
            shape(BOX, 2 * np.array(half), place, turn / np.linalg.norm(turn))
            for half, place, turn in boxes
        )
        assert depth(one, other)[0] == pytest.approx(-math.sqrt(square), abs=4e-15)
        touching += 1
    assert touching > 50


@pytest.mark.slow
def test_boxes_along_the_axes_exactly():
    inner = shape(BOX, [2, 2, 2], [0.5, 0.25, 3])
    distance, point, other_point = depth(inner, shape(BOX, [4, 6, 8]))
    assert (distance, point.tolist(), other_point.tolist()) == (-2, [0.5, 0.25, 2], [0.5, 0.25, 4])
    for size in ([2, 2, 2], [2, 2, 0], [0, 0, 0]):  # the same box: up along the lowest axis
        one = shape(BOX, size, [1, 1, 1])
        assert depth(one, one)[0] == -min(size)
    assert depth(shape(BOX, [1, 1, 1]), shape(BOX, [1, 1, 1], [1, 0, 0]))[0] == 0.0
    tiny = shape(BOX, [1e-300] * 3, [1.0, 0, 0])
    assert depth(tiny, shape(BOX, [2, 2, 2]))[0] == 0.0


CASES = [
    (SPHERE, [2, 2, 2], [0, 0, 0], -1.0),
    (SPHERE, [2, 2, 2], [0, 0, 0.75], -0.25),
    (CYLINDER, [2, 2, 4], [0, 0, 0], -1.0),
    (CYLINDER, [2, 2, 4], [0.25, 0, 1.5], -0.5),
    (CAPSULE, [2, 2, 4], [0, 0, 1], -1.0),
    (CAPSULE, [2, 2, 4], [0, 0.5, 1.5], -(1 - math.sqrt(0.5))),
    (BOX, [2, 4, 6], [0.5, 0, 0], -0.5),
    (BOX, [2, 4, 6], [0, 0, 3], 0.0),
    (BOX, [2, 4, 0], [0, 0, 0], 0.0),
]


@pytest.mark.parametrize('planar', [False, True])
def test_points_in_shapes(planar):
    """In closed form, at any scale and turned; the nearest point of the surface, the way out."""
    turns = [[0, 0, 0, 1], ASIDE] if planar else [[0, 0, 0, 1], ASIDE, [0.2, 0.4, 0.5, 0.74]]
    for (kind, size, place, expected), turn in itertools.product(CASES, turns):
        if planar and (place[2] or size[2] == 0):
            continue
        matrix = geometry_arrays(shape(kind, size, turn=turn))[0].matrix
        for scale in (1.0, 2.0**-900, 2.0**900, 1e-150, 1e150):
            rows = shape(kind, np.multiply(size, scale), turn=turn)
            where = matrix @ place * scale
            hit = refilled(rows, planar).nearest(where, signed=True)[0]
            assert hit.t == pytest.approx(expected * scale, abs=1e-14 * scale)
            assert np.linalg.norm(hit.normal) == pytest.approx(1.0)
            assert hit.point == pytest.approx(where - hit.t * hit.normal, abs=1e-10 * scale)


def test_the_deepest_comes_first():
    scene = scene_of(
        Shapes.boxes([[0, 0, 0], [0.5, 0, 0], [4, 0, 0]], [[2] * 3, [4] * 3, [2] * 3])
    )
    hits = scene.nearest([0.25, 0, 0], 5, signed=True)
    assert [(hit.name, hit.t) for hit in hits] == [('1', -1.75), ('0', -0.75), ('2', 2.75)]
    assert [hit.normal.tolist() for hit in hits] == [[-1, 0, 0], [1, 0, 0], [-1, 0, 0]]
    assert [hit.name for hit in scene.nearest([0.25, 0, 0], 1, 0.0, signed=True)] == ['1']
    assert [hit.t for hit in scene.nearest([0.25, 0, 0], 2)] == [0.0, 0.0]
    found = scene.clearance('0', signed=True)
    assert (found.name, found.distance) == ('1', -2.5)
    apart = scene.clearance('2', signed=True)
    assert (apart.distance, apart.point.tolist()) == (0.5, [3, 0, 0])


def test_the_same_from_either_side_and_at_any_scale():
    """Scales are powers of two, so that they round nothing; far from the origin, too."""
    rng = np.random.default_rng(15)
    for _ in range(60):
        rows = random_shapes(rng, 2, 0.5)
        place = np.round(rows.position * 2.0**30) * 2.0**-30
        rows = changed(rows, position=place)
        one, other = rows.take([0]), rows.take([1])
        distance, point, other_point = depth(one, other)
        back = depth(other, one)
        assert back[0] == distance
        np.testing.assert_array_equal([back[2], back[1]], [point, other_point])
        for scale in (2.0**-700, 2.0**700):
            larger = changed(rows, position=place * scale, size=rows.size * scale)
            assert depth(larger.take([0]), larger.take([1]))[0] == distance * scale
        far = changed(rows, position=place + 4096.0)
        assert depth(far.take([0]), far.take([1]))[0] == pytest.approx(distance, abs=1e-12)


def test_nothing_changes_where_nothing_touches():
    rng = np.random.default_rng(17)
    scene, asked = scene_of(random_shapes(rng, 40)), random_shapes(rng, 80)
    told, signed = scene.clearance_many(asked), scene.clearance_many(asked, signed=True)
    free = told[1] > 0.0
    assert free.any()
    assert not free.all()
    for column, other in zip(told, signed, strict=True):
        np.testing.assert_array_equal(column[free], other[free])
    assert (signed[1][~free] <= 0.0).all()
    points = rng.uniform(-6, 6, (300, 3))
    told, signed = scene.nearest_many(points, 2), scene.nearest_many(points, 2, signed=True)
    free = told[1][:, 0] > 0.0
    for column, other in zip(told, signed, strict=True):
        np.testing.assert_array_equal(column[free], other[free])
    assert Scene().nearest([0, 0, 0], signed=True) == []
