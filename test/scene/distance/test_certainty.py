# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""No shape that a ray or a ball touches looks free, and none that it passes looks touched.

Sure beyond 1e-12 of L, the largest length in play (coordinates, sizes, radius). What is true is
known from how a segment is made: through a point that is within the shape by so much, or in the
tangent plane at a point of the surface, lifted or lowered by so much. 10^6 with
BVH_ROS_LONG_TESTS=1.
"""

import itertools
import math

import numpy as np
import pytest
from scene.reference import bulging, geometry_arrays, hull_distances, hull_of, refilled
from tree.reference import effort, exact_hits

from bvh_ros.scene import NO_NODE, Mesh, ShapeKind, Shapes

SURE = 1e-12  # of L
BOX, SPHERE, CYLINDER, CAPSULE, MESH = ShapeKind
X = np.array([1.0, 0.0, 0.0])
# It does not hold the origin: a mesh may lie anywhere in its frame.
CORNER = hull_of([[0, 0, 0], [1, 0, 0], [0, 1, 0], [0, 0, 1]]) - 0.4


class Body:
    """An obstacle alone in a scene. A ball of radius `inner` about `middle`, a point seen from the
    position, is within it.
    """

    def __init__(self, rng, kind, planar):
        scale = 10.0 ** rng.integers(-6, 7)
        size = rng.uniform(0.2, 2.0, 3) * scale
        if rng.random() < 0.3:
            size[rng.integers(3)] *= 10.0 ** rng.uniform(-4 if kind == MESH else -9, 0)
        if kind == MESH:
            self.mesh = mesh = Mesh((CORNER if rng.random() < 0.1 else bulging(rng)) * size)
        elif kind != BOX:
            size[1] = size[0]
            size[2] = size[0] if kind == SPHERE else size[2] + size[0] * (kind == CAPSULE)
        self.turn = turn = leaning(rng)
        self.position = rng.normal(size=3) * scale * rng.choice([0.0, 1.0, 1e3])
        self.kind, self.planar = kind, planar
        if kind == MESH:
            shapes = Shapes.of_meshes([mesh], self.position[None], turn[None])
            self.solid = geometry_arrays(shapes)[0]
            self.corners = mesh.vertices @ self.solid.matrix.T
            self.position = self.position + self.solid.matrix @ mesh.centre
            size = mesh.size
        else:
            shapes = Shapes(np.array([kind]), self.position[None], turn[None], size[None])
            self.solid = geometry_arrays(shapes)[0]
        self.size, self.inner = float(size.max()), float(size.min()) / 2
        self.middle = np.zeros(3)
        if kind == MESH:
            middle = mesh.vertices.mean(axis=0)
            self.middle = self.solid.matrix @ middle
            faces = mesh.vertices[mesh.corners[:, 0]] - middle
            self.inner = float(np.einsum('ni,ni->n', mesh.normals, faces).min())
        self.scene = refilled(shapes, planar)

    def farthest(self, normals):
        """Points (n, 3), from the position, of the shape farthest along vectors (n, 3)."""
        if self.kind == MESH:
            return self.corners[np.argmax(normals @ self.corners.T, axis=1)]
        local, half = normals @ self.solid.matrix, self.solid.half
        if self.kind == BOX:
            return np.copysign(half, local) @ self.solid.matrix.T
        radial = local.copy()
        radial[:, 2] *= self.kind != CYLINDER
        radial *= half[0] / np.linalg.norm(radial, axis=1)[:, None]
        if self.kind == CYLINDER:
            radial[:, 2] = np.copysign(half[2], local[:, 2])
        elif self.kind == CAPSULE:
            radial[:, 2] += np.copysign(half[2] - half[0], local[:, 2])
        return radial @ self.solid.matrix.T

    def gaps(self, places):
        """Distances of points (n, 3), from the position, 0 inside."""
        if self.planar and self.kind == CYLINDER:
            return oval_gaps(self.solid, places[:, :2])
        if self.planar:
            return self.gaps_from_above(places[:, :2])
        if self.kind == MESH:
            return hull_distances(places, self.corners[self.mesh.corners])
        return self.solid.distances(places + self.position)

    def gaps_from_above(self, places):
        """Of the shadow of all but cylinders: the widest gap that a line leaves is along the
        normal of an edge, or the way to a corner.
        """
        matrix, half = self.solid.matrix[:2], self.solid.half
        if self.kind == MESH:
            corners = self.corners[:, :2]
            seen = corners[self.mesh.corners]
            edges = (seen - np.roll(seen, -1, axis=1)).reshape(-1, 2)
            edges = np.concatenate((edges, -edges))
        elif self.kind == BOX:
            corners = np.array(list(itertools.product((-1, 1), repeat=3))) * half @ matrix.T
            edges = np.concatenate((matrix.T, -matrix.T))
        else:
            edges = np.array([matrix[:, 2], -matrix[:, 2]])
            corners = edges * (half[2] - half[0])
        across = np.broadcast_to(edges[:, ::-1] * [1, -1], (len(places), *edges.shape))
        ways = np.concatenate((places[:, None] - corners, across), axis=1)
        sizes = np.linalg.norm(ways, axis=2, keepdims=True)
        ways = np.divide(ways, sizes, out=np.zeros_like(ways), where=sizes > 0.0)
        gaps = np.einsum('nki,ni->nk', ways, places) - self.reach(ways)
        return np.where((sizes[:, :, 0] > 0.0), gaps, 0.0).max(axis=1, initial=0.0)

    def reach(self, normals):
        if self.kind != MESH:
            return self.solid.reach(normals)
        return (normals @ self.corners[:, :2].T).max(axis=-1)


def oval_gaps(solid, places):
    """Distances of points (n, 2), from its position, from the shadow of a cylinder: the widest gap
    that a line leaves. The shadow is the same in all four quarters; normals are searched for among
    those that are even in angle, and those that are even along the rim, which may be flat.
    """
    axis, radius = solid.matrix[:, 2], solid.half[0]
    slope = np.hypot(*axis[:2])
    along = axis[:2] / slope if slope > 0.0 else X[:2]
    straight, a = solid.half[2] * slope, radius * abs(axis[2])
    u, v = np.abs(places @ along)[:, None], np.abs(places @ [-along[1], along[0]])[:, None]
    quarter = np.linspace(0.0, math.pi / 2, 64)
    angles = np.sort(np.append(quarter, np.arctan2(a * np.sin(quarter), radius * np.cos(quarter))))
    angles = np.broadcast_to(angles, (len(places), 128))
    best = np.zeros(len(places))
    for _ in range(27):
        x, y = np.cos(angles), np.sin(angles)
        gaps = (u - straight) * x + v * y - np.hypot(a * x, radius * y)
        best = np.maximum(best, gaps.max(axis=1))
        row, at = np.arange(len(places)), gaps.argmax(axis=1)
        ends = angles[row, np.maximum(at - 2, 0)], angles[row, np.minimum(at + 2, len(x[0]) - 1)]
        angles = np.linspace(*ends, 17, axis=1)
    return best


def leaning(rng):
    """About any axis, by 1e-15 to 180 degrees; or upside down, or lying, and then so much more."""
    angle = math.radians(180 * 10.0 ** rng.uniform(-17, 0))
    axis = rng.normal(size=3)
    axis /= np.linalg.norm(axis)
    small = np.array([*(axis * math.sin(angle / 2)), math.cos(angle / 2)])
    x, y, z, w = small
    if rng.random() < 0.3:  # after half a quarter, or a quarter turn about x
        s = math.sqrt(0.5)
        small = np.array([s * (x + w), s * (y + z), s * (z - y), s * (w - x)])
    turn = rng.normal(size=4)
    return turn / np.linalg.norm(turn) if rng.random() < 0.2 else small


def units(rng, count, planar):
    ways = rng.normal(size=(count, 3))
    ways[:, 2] *= not planar
    ways[rng.random(count) < 0.1] = X
    return ways / np.linalg.norm(ways, axis=1)[:, None]


def across(rng, normals, planar):
    """Unit vectors at right angles."""
    if planar:
        return np.column_stack([-normals[:, 1], normals[:, 0], 0 * normals[:, 0]])
    ways = np.cross(normals, units(rng, len(normals), False))
    bad = np.linalg.norm(ways, axis=1) < 0.1
    ways[bad] = np.cross(normals[bad], np.roll(normals[bad], 1, axis=1) + 0.3 * X)
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    ways -= normals * np.einsum('ni,ni->n', normals, ways)[:, None]
    return ways / np.linalg.norm(ways, axis=1)[:, None]


def segments(rng, body, count, radius):
    """Starts, goals (from the position), by how much each touches (negative: by how much not)."""
    planar = body.planar
    normals = units(rng, count, planar)
    ways = across(rng, normals, planar)
    lift = 10.0 ** rng.uniform(-14, 0, count) * np.where(rng.random(count) < 0.5, 1, -1)
    lift *= body.size
    lift = np.maximum(lift, -0.9 * radius)
    points = body.farthest(normals) + (radius + lift)[:, None] * normals
    touch = -lift
    inner = rng.random(count) < (0.5 if radius.max() > 0 else 0.6)
    share = 10.0 ** rng.uniform(-12, 0, count)
    within = body.middle + (body.farthest(normals) - body.middle) * (1 - share)[:, None]
    tilted = units(rng, count, planar) * 10.0 ** rng.uniform(-9, 0, count)[:, None]
    ways = np.where(inner[:, None], ways + tilted, ways)
    points = np.where(inner[:, None], within, points)
    touch = np.where(inner, radius + share * body.inner, touch)
    before, after = 10.0 ** rng.uniform(-6, 3, (2, count)) * body.size
    before[rng.random(count) < 0.1] = 0.0
    after[rng.random(count) < 0.1] = 0.0
    starts, goals = points - before[:, None] * ways, points + after[:, None] * ways
    if planar:
        starts[:, 2], goals[:, 2] = rng.normal(size=(2, count)) * body.size
    return starts, goals, touch


def lengths(body, starts, goals, radius):
    """L: coordinates and sizes, a row each."""
    ends = np.abs([starts, goals, starts + body.position, goals + body.position])
    own = max(float(np.abs(body.position).max()), body.size)
    return np.maximum(np.maximum(ends.max(axis=(0, 2)), radius), own)


def check(body, starts, goals, touch, radius, t):
    """Check what is met, and that where it is the ball just touches, and did not before; return
    which are met.
    """
    large, hit = lengths(body, starts, goals, radius), np.isfinite(t)
    wrong = np.where(hit, touch < -SURE * large, touch > SURE * large)
    assert not wrong.any(), (hit[wrong], radius[wrong], touch[wrong], large[wrong])
    if hit.any():
        starts, ways, t, large = starts[hit], (goals - starts)[hit], t[hit], large[hit]
        for share in (1.0, 0.99, 0.5):
            gaps = body.gaps(starts + (share * t)[:, None] * ways) - radius[hit]
            assert (gaps >= -SURE * large)[t > 0].all(), share
            if share == 1.0:
                assert (gaps <= SURE * large).all()
    return hit


KINDS = [(kind, planar) for kind in ShapeKind for planar in (False, True)]


@pytest.mark.parametrize(('kind', 'planar'), KINDS)
def test_thin_rays(kind, planar):
    rng = np.random.default_rng([int(kind), planar, 1])
    none, passed, met = np.zeros(400), 0, 0
    for _ in range(effort(20, 500)):
        body = Body(rng, kind, planar)
        starts, goals, touch = segments(rng, body, 400, none)
        begin, end = starts + body.position, goals + body.position
        handles, t, _, normals = body.scene.raycast_many(begin, end - begin, 1.0)
        hit = check(body, starts, goals, touch, none, t)
        assert ((handles != NO_NODE) == hit).all()
        lengths_of = np.linalg.norm(normals[hit], axis=1)
        assert (np.abs(lengths_of - 1) < 1e-9)[t[hit] > 0].all()
        for row in rng.integers(0, 400, effort(10, 40)):
            every = body.scene.raycast_all(begin[row], end[row])
            one = body.scene.raycast(begin[row], end[row])
            assert (
                [one.t] == [t[row]] == [at.t for at in every] if hit[row] else not (one or every)
            )
        passed, met = passed + (~hit).sum(), met + hit.sum()
    assert min(passed, met) > effort(1000, 1000)


@pytest.mark.parametrize(('kind', 'planar'), KINDS)
def test_balls(kind, planar):
    rng = np.random.default_rng([int(kind), planar, 2])
    passed, met, count = 0, 0, 60
    for _ in range(effort(20, 500)):
        body = Body(rng, kind, planar)
        radius = 10.0 ** rng.uniform(-9, 1, count) * body.size
        starts, goals, touch = segments(rng, body, count, radius)
        begin, end = starts + body.position, goals + body.position
        asked = list(zip(begin, end, radius.tolist(), strict=True))
        found = [body.scene.raycast(*row) for row in asked]
        t = np.array([one.t if one else np.inf for one in found])
        hit = check(body, starts, goals, touch, radius, t)
        for row in range(0, count, 8):
            every = body.scene.raycast_all(*asked[row])
            assert [one.t for one in every] == ([t[row]] if hit[row] else [])
        passed, met = passed + (~hit).sum(), met + hit.sum()
    assert min(passed, met) > effort(200, 200)


def is_met(body, start, end):
    """Whether a thin ray must meet what one of its ends touches. Of an axis-aligned box that is
    decided exactly, for the direction as it is rounded: it may end just short of the face.
    """
    if body.scene.any_shaped:
        return True
    (lo, hi), ndim = body.scene.bounds, 2 if body.planar else 3
    rays = start[None, :ndim], (end - start)[None, :ndim]
    return any(hit.t <= 1 for hit in exact_hits(lo[None], hi[None], *rays)[0])


@pytest.mark.parametrize(('kind', 'planar'), KINDS)
def test_what_overlaps_at_an_end_is_met(kind, planar):
    """Also where it is only by rounding that an end touches."""
    rng = np.random.default_rng([int(kind), planar, 3])
    touching = 0
    for _ in range(effort(20, 300)):
        body = Body(rng, kind, planar)
        normals = units(rng, 20, planar)
        ends = body.farthest(normals) + body.position
        starts = ends + units(rng, 20, planar) * 10.0 ** rng.uniform(-3, 2, (20, 1)) * body.size
        for start, end in zip(starts, ends, strict=True):
            if body.scene.overlap(end, end):
                touching += 1
                if kind != MESH or planar:  # a thin ray meets triangles, which are rounded
                    for way in ((start, end), (end, start)):
                        assert (body.scene.raycast(*way) is not None) == is_met(body, *way)
                radius = 1e-3 * body.size
                assert body.scene.raycast(start, end, radius) is not None
                assert body.scene.raycast(end, start, radius).t == 0.0
    assert touching > effort(100, 100)


@pytest.mark.parametrize(('kind', 'planar'), KINDS)
def test_the_normal_of_a_ball_at_the_start_is_none_or_outwards(kind, planar):
    """From within the surface's rounding: zero; a little above it: outwards."""
    rng = np.random.default_rng([int(kind), planar, 4])
    for _ in range(effort(20, 300)):
        body = Body(rng, kind, planar)
        normals = units(rng, 20, planar)
        places = body.farthest(normals)
        large = max(float(np.abs(body.position).max()), body.size)
        for normal, place in zip(normals, places, strict=True):
            for lift in (0.0, 1e-16, 1e-10, 1e-3):
                start = body.position + place + lift * large * normal
                hit = body.scene.raycast(start, start + normal * body.size, 0.1 * large)
                assert hit.t == 0.0
                if lift >= 1e-10:
                    assert hit.normal @ normal > 0.999
                elif hit.normal.any():
                    raise AssertionError((hit.normal, normal))
