# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Contacts of two shapes whose gap is known, feature against feature.

A feature is a point of a shape, an outward unit normal there, and the ways in which the point may
be moved within the shape across the normal: none at a corner, one on an edge, two on a face. Two
features are put opposite each other. That moves positions to the next doubles, so the gap is
measured afterwards in 50 digits, for the very doubles: what is left of the way between the points
without the ways in which they move. A plane across it proves that no point is nearer.
"""

from decimal import Decimal, localcontext
from typing import NamedTuple

import numpy as np
from scene.reference import refilled
from scipy.spatial import ConvexHull
from scipy.spatial.transform import Rotation

from bvh_ros.scene import Mesh, ShapeKind, Shapes

BOX, SPHERE, CYLINDER, CAPSULE, MESH = ShapeKind
FEATURES = {
    BOX: ('corner', 'edge', 'face'),
    SPHERE: ('corner',),
    CYLINDER: ('rim', 'side', 'end'),
    CAPSULE: ('corner', 'side'),
    MESH: ('corner', 'edge', 'face'),
}
DIGITS = 50
PARALLEL = Decimal(10) ** -12  # ways closer together than this are one
SLIDING = 1e-3  # of the size: that far apart the ends of edges may be what is closest
BENDING = 1e-10  # of the size: farther along its tangent a rim is somewhere else


class Solid(NamedTuple):
    kind: ShapeKind
    half: np.ndarray
    points: np.ndarray | None = None
    """Of a mesh."""
    mesh: Mesh | None = None


class Feature(NamedTuple):
    """In the frame of its solid; of a ball or capsule on the centre or axis."""

    point: np.ndarray
    normal: np.ndarray
    free: list[np.ndarray]
    radius: float


class Contact(NamedTuple):
    geometry_arrays: tuple[Solid, Solid]
    positions: np.ndarray
    turns: np.ndarray
    gap: float
    """Negative: so deep."""
    size: float
    """Of the pair around."""


def prism(rng):
    """A mesh of a regular base, from a wedge to a drum of 40 sides."""
    corners, height = int(rng.choice([3, 4, 6, 40])), 10.0 ** rng.uniform(-2, 1)
    angles = np.arange(corners) * (2 * np.pi / corners)
    rim = np.column_stack((np.cos(angles), np.sin(angles), np.full(corners, -height)))
    points = np.vstack((rim, rim * [1, 1, -1]))
    return points, Mesh(points[ConvexHull(points).simplices])


def solid(kind, meshes, rng):
    half = 10.0 ** rng.uniform(*((-2, 2) if rng.random() < 0.3 else (-0.7, 0)), 3)
    if kind == MESH:
        points, mesh = meshes[rng.integers(len(meshes))]
        return Solid(kind, mesh.size / 2, points, mesh)
    if kind != BOX:
        half[1] = half[0]
    if kind in (SPHERE, CAPSULE):
        half[2] = half[0] * (1 if kind == SPHERE else 1 + half[2])
    return Solid(kind, half)


def feature_of(body, name, flat, rng):
    """A feature with a normal across z if `flat`."""
    if body.kind == MESH:
        return mesh_feature(body.points, body.mesh.normals, name, flat, rng)
    normal = rng.uniform(0.3, 1.0, 3) * rng.choice([-1.0, 1.0], 3)
    if flat:
        normal[2] = 0.0
    kept = rng.integers(2 if flat else 3)
    if name == 'face':
        normal[np.arange(3) != kept] = 0.0
    elif name == 'edge':
        normal[2 if flat else kept] = 0.0
    elif name == 'side' or name == 'end':
        normal[2 if name == 'side' else slice(2)] = 0.0
    normal /= np.linalg.norm(normal)
    within = rng.uniform(-0.9, 0.9, 3)
    axes = np.eye(3)
    if body.kind == CYLINDER:
        tangent = np.array([-normal[1], normal[0], 0.0])
        if name == 'end':
            return Feature(
                np.array([*within[:2] * 0.7, np.sign(normal[2])]) * body.half,
                *(normal, [axes[0], axes[1]], 0.0),
            )
        out = np.array([*normal[:2], 0.0]) / np.linalg.norm(normal[:2]) * body.half[0]
        level = within[2] if name == 'side' else np.sign(normal[2])
        free = [tangent, axes[2]] if name == 'side' else [tangent]
        return Feature(out + axes[2] * level * body.half[2], normal, free, 0.0)
    radius = 0.0 if body.kind == BOX else body.half[0]
    place = np.where(normal == 0.0, within, np.sign(normal)) * (body.half - radius)
    free = [axis for axis in axes if normal @ axis == 0.0 and (body.half - radius) @ axis > 0.0]
    return Feature(place, normal, free, radius)


def mesh_feature(vertices, normals, name, flat, rng):
    """Of a corner, an edge or a face of a mesh (upright ones, if the normal is across z)."""
    way = rng.normal(size=3)
    if name == 'face' or flat:
        able = normals[np.abs(normals[:, 2]) < 0.5] if flat else normals
        way = able[rng.integers(len(able))].copy()
        if flat and name != 'face':
            way += rng.uniform(0.3, 1.5) * able[np.argsort(-(able @ way))[2]]
    way /= np.linalg.norm(way)
    heights = vertices @ way
    top = np.flatnonzero(heights > heights.max() - 1e-9)
    point = rng.dirichlet(np.full(len(top), 2.0)) @ vertices[top]
    here = normals @ point > (normals @ vertices.T).max(axis=1) - 1e-9
    if (normals[here] @ way).min() < -1e-9:  # it leads into no inside
        return mesh_feature(vertices, normals, name, flat, rng)
    steps = np.linalg.svd(vertices[top] - vertices[top[0]])
    return Feature(point, way, list(steps[2][: int((steps[1] > 1e-9).sum())]), 0.0)


def turns_of(features, manner, rng):
    """Two rotations that make the normals opposite."""
    one, other = (feature.normal for feature in features)
    if manner == 'upright':
        turn = Rotation.from_euler('z', rng.uniform(-3, 3))
        yaws = [np.arctan2(normal[1], normal[0]) for normal in (turn.apply(one), -other)]
        return turn, Rotation.from_euler('z', yaws[0] - yaws[1])
    turn = Rotation.identity() if rng.random() < 0.2 else Rotation.random(random_state=rng)
    ways = [f.free[0] if f.free else np.roll(f.normal, 1) for f in features]
    frames = []
    for normal, way in zip((one, -other), ways, strict=True):
        across = np.cross(normal, way)
        across /= np.linalg.norm(across)
        frames.append(np.column_stack((normal, across, np.cross(normal, across))))
    angle = {'parallel': 0.0, 'nearly': 10.0 ** rng.uniform(-10, -2)}.get(
        manner, rng.uniform(0, 3)
    )
    spin = Rotation.from_euler('x', angle).as_matrix()
    return turn, turn * Rotation.from_matrix(frames[0] @ spin @ frames[1].T)


def decimals(numbers):
    return np.array([Decimal(float(number)) for number in np.ravel(numbers)])


def matrix(turn):
    return rotation(*decimals(turn))


def rotation(x, y, z, w):
    """The exact rotation of a quaternion of any length, in whatever numbers it is given."""
    square = x * x + y * y + z * z + w * w
    rows = [
        [w * w + x * x - y * y - z * z, 2 * (x * y - z * w), 2 * (x * z + y * w)],
        [2 * (x * y + z * w), w * w - x * x + y * y - z * z, 2 * (y * z - x * w)],
        [2 * (x * z - y * w), 2 * (y * z + x * w), w * w - x * x - y * y + z * z],
    ]
    return np.array(rows) / square


def length(vector):
    return (vector @ vector).sqrt()


def reach(body, turn, way):
    """How far a solid reaches along a vector from its position, times the vector's length."""
    local = way @ turn
    if body.kind == MESH:
        return max(decimals(body.points).reshape(-1, 3) @ local)
    a, b, c = decimals(body.half)
    x, y, z = np.abs(local)
    if body.kind == BOX:
        return a * x + b * y + c * z
    if body.kind == CYLINDER:
        return a * (x * x + y * y).sqrt() + c * z
    return a * length(local) + (c - a) * z


def measured(bodies, features, positions, turns, normal):
    """The gap, m; None if the doubles do not tell, because the features slid off each other."""
    with localcontext() as context:
        context.prec = DIGITS
        frames = [matrix(turn) for turn in turns]
        places = [decimals(position) for position in positions]
        ends = [
            place + frame @ decimals(feature.point)
            for place, frame, feature in zip(places, frames, features, strict=True)
        ]
        size, basis = max(float(body.half.max()) for body in bodies), []
        for body, frame, feature in zip(bodies, frames, features, strict=True):
            most = (BENDING if body.kind == CYLINDER else SLIDING) * size
            for way in feature.free:
                step = across(frame @ decimals(way), basis)
                if length(step) > PARALLEL:
                    basis.append(step / length(step))
                    moved = (ends[1] - ends[0]) @ basis[-1] / length(step)
                    if abs(moved) > most:
                        return None
        apart = across(ends[1] - ends[0], basis)
        along = apart @ decimals(normal)
        radius = sum(Decimal(float(feature.radius)) for feature in features)
        gap = length(apart).copy_sign(along) - radius
        if along <= 0:
            aside = apart - along * decimals(normal)
            return float(gap) if length(aside) <= -along / 8 else None
        plane = apart @ (places[1] - places[0])
        plane -= reach(bodies[0], frames[0], apart) + reach(bodies[1], frames[1], -apart)
        sure = abs(float(gap - plane / length(apart))) <= 1e-15 * size
        return float(gap) if sure else None


def across(way, basis):
    """What is left of a vector without what is along some unit vectors."""
    for unit in basis:
        way = way - (way @ unit) * unit
    return way


def contact(bodies, names, gap, offset, manner, rng):
    """Two features `gap` apart, in sizes of the larger solid; None if that failed."""
    flat = manner == 'upright'
    features = [feature_of(*pair, flat, rng) for pair in zip(bodies, names, strict=True)]
    turns = turns_of(features, manner, rng)
    size = 2 * max(body.half.max() for body in bodies)
    normal = turns[0].apply(features[0].normal)
    place = rng.uniform(-1, 1, 3) * offset * size
    meet = place + turns[0].apply(features[0].point)
    reach_over = gap * size + features[0].radius + features[1].radius
    other = meet + reach_over * normal - turns[1].apply(features[1].point)
    quaternions = np.array([turn.as_quat() for turn in turns])
    positions = np.array([place, other])
    exact = measured(bodies, features, positions, quaternions, normal)
    return exact and Contact(tuple(bodies), positions, quaternions, exact, float(size))


def contacts(count, rng, manners, gaps, offsets, kinds=tuple(FEATURES)):
    """So many contacts, of everything with everything."""
    meshes, made = [prism(rng) for _ in range(12)], []
    while len(made) < count:
        bodies = [solid(kinds[rng.integers(len(kinds))], meshes, rng) for _ in range(2)]
        names = [rng.choice(FEATURES[body.kind]) for body in bodies]
        manner = rng.choice(manners)
        if manner == 'upright' and any(
            body.kind in (CYLINDER, CAPSULE) and name != 'side'
            for body, name in zip(bodies, names, strict=True)
        ):
            continue
        gap = rng.choice([-1.0, 1.0]) * rng.choice(gaps)
        halves = np.concatenate([body.half for body in bodies])
        if -gap * halves.max() > 0.2 * halves.min():  # that deep it would come out behind
            continue
        one = contact(bodies, names, gap, rng.choice(offsets), manner, rng)
        if one:
            made.append(one)
    return made


def shapes_of(one):
    bodies, held = one.geometry_arrays, np.empty(2, object)
    held[:] = [body.mesh for body in bodies]
    sizes = [body.mesh.size if body.mesh else 2 * body.half for body in bodies]
    kinds = np.array([body.kind for body in bodies], np.uint8)
    return Shapes(kinds, one.positions, one.turns, np.array(sizes), held)


def answers(one, planar=False):
    """Whether the pair of a contact touches, and its clearance as seen from either side."""
    scene = refilled(shapes_of(one), planar)
    return bool(scene.overlap_pairs()), scene.clearance('0'), scene.clearance('1')


def touches_within(one, tolerance):
    """Whether the first solid of a contact touches the second one, grown by the tolerance."""
    shapes = shapes_of(one)
    scene = refilled(shapes.take([1]))
    return bool(scene.overlap_shape(shapes.take([0]), tolerance=tolerance))


def farthest_outside(one, found, planar=False):
    """How far the points of a clearance are outside their solids, at most."""
    points = found.point, found.other_point
    places = zip(one.geometry_arrays, one.positions, one.turns, points, strict=True)
    return max(outside(*place, planar) for place in places)


def outside(body, position, turn, point, planar=False):
    """How far a point is outside a solid, at most; seen from above if `planar`."""
    local = Rotation.from_quat(turn).inv().apply(point - position)
    if body.kind == MESH:
        planes = ConvexHull(body.points).equations
        steep = np.abs(planes[:, 2]) < 0.5 if planar else slice(None)
        return max((planes[steep] @ [*local, 1.0]).max(), 0.0)
    if planar:
        local[2] = 0.0
    if body.kind == BOX:
        return np.linalg.norm(np.maximum(np.abs(local) - body.half, 0.0))
    level = max(abs(local[2]) - body.half[2], 0.0)
    if body.kind == CYLINDER:
        return max(np.hypot(*local[:2]) - body.half[0], level, 0.0)
    rest = max(abs(local[2]) - (body.half[2] - body.half[0]), 0.0)
    return max(np.linalg.norm([*local[:2], rest]) - body.half[0], 0.0)
