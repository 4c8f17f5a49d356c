# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a CollisionObject topic: the objects of a message, and the parts of each."""

from __future__ import annotations

import math
from collections.abc import Generator, Sequence
from typing import Any, NamedTuple

import numpy as np
from moveit_msgs.msg import CollisionObject
from numpy.typing import NDArray

from bvh_ros.ros.cdr.any_message import Columns
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.placing import (
    IntoNode,
    Placing,
    alike,
    examined,
    joined,
    moved,
    numbered,
)
from bvh_ros.ros.sources.source import Applying, ColumnsSource, is_costly
from bvh_ros.ros.world.frames import Transform
from bvh_ros.scene import AS_CONVEX, Part, Refusal, ShapeKind, Shapes, unchecked_shapes
from bvh_ros.scene.shapes.shape import FINE, REASONS, as_shapes, canonicalise

Integers = NDArray[np.int64]
Floats = NDArray[np.float64]

FIELDS = (
    *('header', 'pose', 'id', 'primitives', 'primitive_poses', 'meshes', 'mesh_poses', 'planes'),
    'operation',
)
# moveit_msgs/msg/CollisionObject
ADD, REMOVE, APPEND, MOVE = range(4)
# shape_msgs/msg/SolidPrimitive: types, what they are in a scene, and how many dimensions they have
BOX, SPHERE, CYLINDER, CONE, PRISM = range(1, 6)
KINDS = {
    BOX: ShapeKind.BOX,
    SPHERE: ShapeKind.SPHERE,
    CYLINDER: ShapeKind.CYLINDER,
    CONE: ShapeKind.MESH,
}
DIMENSIONS = {BOX: 3, SPHERE: 1, CYLINDER: 2, CONE: 2}
SIDES = 32  # of the pyramid around a cone
UNMOVED = np.array((0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0))  # as a pose: place and quaternion
NO_POSE = 'its pose is not finite, or the length of its orientation is neither 1 nor 0'
OCTOMAP = '<octomap>'  # what MoveIt calls the octomap, as if it were an object
AT_A_TIME = 32  # objects between two pauses


# ---- The sources.


class Changes:
    """What a message makes of the bodies that a source knows.

    Attributes
    ----------
    bodies : dict of str to Body
        By the ids of the objects, as they are in the end.
    touched : dict
        Its keys are the ids of the bodies that came, changed or went, in order.
    whole : bool
        Whether nothing is left of the bodies before, but for what is among `bodies`.
    refusals : list of Refusal
        The objects that cannot be used; the bodies of these stay.
    removed_at : int
        The latest stamp at which any go, ns; 0 if none do.
    """

    def __init__(self, known: dict[str, Body]) -> None:
        self.known = known
        self.bodies = dict(known)
        self.touched: dict[str, None] = {}
        self.whole = False
        self.refusals: list[Refusal] = []
        self.removed_at = 0

    def start_over(self, stamp: int) -> None:
        """Let all bodies go."""
        self.bodies, self.whole = {}, True
        self.removed_at = max(self.removed_at, stamp)

    def put(self, name: str, body: Body) -> None:
        """Let a body come, or take the place of the one before."""
        self.bodies[name] = body
        self.touched[name] = None

    def remove(self, name: str, stamp: int) -> None:
        """Let a body go, if there is one."""
        self.bodies.pop(name, None)
        self.touched[name] = None
        self.removed_at = max(self.removed_at, stamp)

    def refuse(self, row: int, name: str, reason: str) -> None:
        """Keep the body as it was before the message."""
        self.refusals.append(Refusal(row, name, reason))
        if name in self.known and name not in self.bodies:
            self.bodies[name] = self.known[name]


class BodiesSource(ColumnsSource):
    """Keeps bodies of several parts, which are obstacles of their own."""

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._bodies: dict[str, Body] = {}

    def forget(self) -> None:
        """Start over."""
        super().forget()
        self._bodies.clear()

    def _read_objects(
        self, given: CollisionObjects, changes: Changes, now: int
    ) -> Generator[None, None, None]:
        """Follow objects in their order; pause now and then."""
        places, nowhere = yield from given.places(self.frames.into_node)
        for row, (name, operation) in enumerate(zip(given.ids, given.operations, strict=True)):
            if row % AT_A_TIME == AT_A_TIME - 1:
                yield
            stamp = int(given.stamps[row]) or now
            try:
                if operation == REMOVE:
                    changes.remove(name, stamp) if name else changes.start_over(stamp)
                    continue
                if name in ('', OCTOMAP):
                    raise ValueError(f"'{name}' is no id of an object")
                if row in nowhere:
                    raise ValueError(nowhere[row])
                before = changes.bodies.get(name)
                if operation == MOVE:
                    if before is None:
                        raise ValueError('there is no such object to move')
                    body = given.moved(row, before, places[row], stamp)
                elif operation in (ADD, APPEND):
                    parts = yield from given.parts(
                        row, planar=self.scene.planar, form=self.settings.options['meshes']
                    )
                    body = Body(parts, places[row], stamp)
                    if before is not None and operation == APPEND:
                        body = before.with_parts(body)
                else:
                    raise ValueError(f'unknown operation {operation}')
                changes.put(name, body)
            except ValueError as error:
                changes.refuse(row, name, str(error))

    def _apply_changes(self, changes: Changes) -> Applying:
        """Bring bodies into the scene as they are after a message."""
        bodies, known, prefix = changes.bodies, changes.known, self.settings.prefix
        rows = bodies if changes.whole else {n: bodies[n] for n in changes.touched if n in bodies}
        sizes = {name: len(body.parts.kind) for name, body in rows.items()}
        names = numbered({f'{prefix}{name}/': range(size) for name, size in sizes.items()})
        stamps = np.repeat(
            np.array([body.stamp for body in rows.values()], np.int64), list(sizes.values())
        )
        part = Part(names, placed([*rows.values()]), stamps)
        replaced = changes.touched.keys() & known.keys()
        self._bodies = bodies
        self.is_whole, self.removed_at = changes.whole, changes.removed_at
        if changes.whole:
            costly = is_costly(part)
            given = '', len(names), part.cut
            refused = yield from self._in_slices(*given, whole=True, costly=costly)
        else:
            left = {
                f'{prefix}{name}/': range(sizes.get(name, 0), len(known[name].parts.kind))
                for name in replaced
            }
            leaving = self.scene.find(self.name, numbered(left))
            refused = yield from self._change(part, leaving)
        removed = len(replaced - bodies.keys())
        own = [each._replace(name=f'{prefix}{each.name}') for each in changes.refusals]
        return len(names) + removed + len(own), [*own, *refused]


class CollisionObjectSource(BodiesSource):
    """Keeps collision objects: one a message."""

    message_type = CollisionObject
    fields = FIELDS

    def apply(self, message: Any, now: int) -> Applying:
        """Add, extend, move or remove an object."""
        changes = Changes(self._bodies)
        given = CollisionObjects(self._columns(message))
        yield from self._read_objects(given, changes, now)
        return (yield from self._apply_changes(changes))


# ---- Bodies: objects of the world, as they were added and moved.


class Body(NamedTuple):
    """An object of the world."""

    parts: Shapes  # in its own frame
    place: Transform  # of that in the node's frame
    stamp: int  # ns

    def with_parts(self, other: Body) -> Body:
        """The same with the parts of another body, where these are."""
        parts = moved(other.parts, self.place.inverse().after(other.place))
        return Body(joined((self.parts, parts)), self.place, other.stamp)


def placed(bodies: Sequence[Body]) -> Shapes:
    """The parts of all bodies in the node's frame."""
    if not bodies:
        nothing = np.empty((0, 3)), np.empty((0, 4)), np.empty((0, 3)), np.empty(0, object)
        return unchecked_shapes(np.empty(0, np.uint8), *nothing)
    parts = joined([body.parts for body in bodies])
    of = np.repeat(np.arange(len(bodies)), [len(body.parts.kind) for body in bodies])
    place = Transform(
        np.array([body.place.translation for body in bodies])[of],
        np.array([body.place.rotation for body in bodies])[of],
    )
    return moved(parts, place)


# ---- What a message says of objects.


class Each(NamedTuple):
    """Elements of a sequence that each of n objects has."""

    counts: Integers  # (n,) how many
    first: Integers  # (n,) where they begin
    rows: NDArray[Any]  # of all objects

    @classmethod
    def of(cls, counts: Integers, rows: NDArray[Any]) -> Each:
        """The elements, which follow each other."""
        return cls(counts, np.cumsum(counts) - counts, rows)

    @classmethod
    def read(cls, columns: Columns, path: str) -> Each:
        """A field that is a sequence of numbers."""
        return cls.of(columns.counts(path), columns.numbers(path))

    def span(self, row: int) -> slice:
        """Where the elements of an object are."""
        return slice(self.first[row], self.first[row] + self.counts[row])


class CollisionObjects:
    """n objects, one a row.

    Parameters
    ----------
    path : str
        Of the objects in the message; '' where the message is one.
    """

    def __init__(self, columns: Columns, path: str = '') -> None:
        prefix = f'{path}.' if path else ''
        self.ids = columns.texts(f'{prefix}id')
        self.operations = columns.numbers(f'{prefix}operation')[:, 0].tolist()
        self.stamps = columns.stamps(f'{prefix}header.stamp')
        self._frame_ids = columns.texts(f'{prefix}header.frame_id')
        self._own_poses = columns.numbers(f'{prefix}pose')
        self._planes = columns.counts(f'{prefix}planes')
        solids, surfaces = _solids(columns, prefix), _surfaces(columns, prefix)
        self._solids = Each.of(columns.counts(f'{prefix}primitives'), solids)
        self._meshes = Each.of(columns.counts(f'{prefix}meshes'), surfaces)
        names = 'primitive_poses', 'mesh_poses'
        self._part_poses = [Each.read(columns, f'{prefix}{name}') for name in names]
        self._take_poses_of_single_parts()
        for each in self._part_poses:
            each.rows[:, 3:] = rotations.normalised_if_near(each.rows[:, 3:])
        solids['pose'] = _poses_of(self._solids, self._part_poses[0])
        surfaces['pose'] = _poses_of(self._meshes, self._part_poses[1])
        solids['fault'] = _faults(solids)
        self._are_plain = self._meshes.counts == 0  # objects of boxes, spheres and cylinders
        of = np.repeat(np.arange(len(self.ids)), self._solids.counts)
        self._are_plain[of[(solids['fault'] != FINE) | (solids['kind'] == ShapeKind.MESH)]] = False

    def _take_poses_of_single_parts(self) -> None:
        """Where only the pose of the only part is given, it is the object's, as for MoveIt: a
        later move replaces it.
        """
        counts = np.array((self._solids.counts, self._meshes.counts))
        unset = (self._own_poses == UNMOVED).all(axis=1) | ~self._own_poses.any(axis=1)
        for row in np.flatnonzero(unset & (counts.sum(axis=0) == 1)).tolist():
            poses = self._part_poses[int(counts[1, row])]
            if poses.counts[row] == 1:
                self._own_poses[row] = poses.rows[poses.first[row]]
                poses.rows[poses.first[row]] = UNMOVED

    def places(
        self, into_node: IntoNode
    ) -> Generator[None, None, tuple[list[Transform], dict[int, str]]]:
        """Where the objects are in the node's frame, and why some are nowhere."""
        numbers = {name: number for number, name in enumerate(dict.fromkeys(self._frame_ids))}
        frame = np.array([numbers[name] for name in self._frame_ids], np.int64)
        placing = Placing(list(numbers), frame, self.stamps, into_node)
        at, turns = self._own_poses[:, :3].copy(), self._own_poses[:, 3:]
        bad = ~np.isfinite(self._own_poses).all(axis=1) | rotations.are_off(turns)
        # A pose gets there as a shape does.
        frames = np.arange(len(frame))
        poses = unchecked_shapes(frames, at, rotations.normalised(turns), at)
        reasons = yield from placing.find(frames)
        yield from placing.move(poses, frames)
        reasons |= dict.fromkeys(np.flatnonzero(bad).tolist(), NO_POSE)
        return [*map(Transform, at, rotations.normalised(poses.orientation))], reasons

    def parts(self, row: int, *, planar: bool, form: str) -> Generator[None, None, Shapes]:
        """Make the parts of an object, in its own frame; pause where there are meshes.

        Raises
        ------
        ValueError
            If one cannot be used: without it the object would have a hole.
        """
        if self._planes[row]:
            raise ValueError('it has a plane, which goes on for ever')
        solids = self._solids.rows[self._solids.span(row)]
        meshes = self._meshes.rows[self._meshes.span(row)]
        for poses, parts in zip(self._part_poses, (solids, meshes), strict=True):
            if poses.counts[row] > len(parts):
                raise ValueError(f'it has {poses.counts[row]} poses for {len(parts)} parts')
        if not len(solids) + len(meshes):
            raise ValueError('it has no parts')
        pose = solids['pose']
        shapes = unchecked_shapes(solids['kind'], pose[:, :3], pose[:, 3:], solids['size'])
        if self._are_plain[row]:
            return shapes
        for part in np.flatnonzero(solids['fault'] != FINE).tolist():
            raise ValueError(f'part {part}: {_reason(solids[part])}')
        return (yield from _with_meshes(shapes, meshes, planar, form))

    def moved(self, row: int, body: Body, place: Transform, stamp: int) -> Body:
        """Return a body at another place; its parts stay where they are in it, if they are given
        no other poses.

        Raises
        ------
        ValueError
            If not every part has a pose, or one is none.
        """
        given = np.concatenate([each.rows[each.span(row)] for each in self._part_poses])
        parts, turns = body.parts, rotations.normalised(given[:, 3:])
        if len(given) not in (0, len(parts.kind)):
            raise ValueError(f'it has {len(given)} poses for {len(parts.kind)} parts')
        if not np.isfinite(given).all() or rotations.are_off(given[:, 3:]).any():
            raise ValueError(f'a part: {NO_POSE}')
        if len(given):
            parts = parts._replace(position=given[:, :3], orientation=turns)
        return Body(parts, place, stamp)


def place_of(pose: Floats) -> Transform:
    """A pose (7,) as the way from its frame; ValueError if it is none."""
    if not np.isfinite(pose).all() or rotations.are_off(pose[3:]).any():
        raise ValueError(NO_POSE)
    return Transform(pose[:3], rotations.normalised(pose[3:]))


def _poses_of(parts: Each, poses: Each) -> Floats:
    """A pose (p, 7) for each part; where none is given, it is the object's."""
    found = np.tile(UNMOVED, (len(parts.rows), 1))
    row = np.repeat(np.arange(len(parts.counts)), parts.counts)
    number = np.arange(len(row)) - parts.first[row]
    given = number < poses.counts[row]
    found[given] = poses.rows[poses.first[row[given]] + number[given]]
    return found


# ---- Primitives.

SOLID = np.dtype(
    [
        *(('type', 'u1'), ('dimensions', 'i8'), ('kind', 'u1'), ('size', 'f8', (3,))),
        *(('pose', 'f8', (7,)), ('fault', 'u1')),
    ]
)
BAD_TYPE, BAD_DIMENSIONS = 254, 255  # faults besides those of shapes


def _solids(columns: Columns, prefix: str) -> NDArray[np.void]:
    """All primitives, of whatever type, with as many dimensions as each has."""
    types = columns.numbers(f'{prefix}primitives.type')[:, 0]
    given = Each.read(columns, f'{prefix}primitives.dimensions')
    solids = np.zeros(len(types), SOLID)
    solids['type'], solids['dimensions'] = types, given.counts
    one, two, three = np.zeros((3, len(solids)))
    for number, dimension in enumerate((one, two, three)):
        has = given.counts > number
        dimension[has] = given.rows[given.first[has] + number, 0]
    with np.errstate(over='ignore'):  # infinite: refused
        across, wide = 2.0 * one, 2.0 * two
    upright = wide, wide, one  # a cylinder or cone has its height first
    sizes = {BOX: (one, two, three), SPHERE: (across,) * 3, CYLINDER: upright, CONE: upright}
    for kind, size in sizes.items():
        rows = solids['type'] == kind
        solids['kind'][rows] = KINDS[kind]
        solids['size'][rows] = np.column_stack(size)[rows]
    return solids


def _faults(solids: NDArray[np.void]) -> NDArray[np.uint8]:
    """Why primitives cannot be used."""
    kinds = np.where(solids['type'] == CONE, ShapeKind.CYLINDER, solids['kind'])
    at, turn = solids['pose'][:, :3], solids['pose'][:, 3:]
    shapes = unchecked_shapes(kinds.astype(np.uint8), at, turn, solids['size'])
    faults = canonicalise(as_shapes(shapes)).faults
    wanted = np.array([DIMENSIONS.get(kind, 0) for kind in range(256)])[solids['type']]
    faults[wanted != solids['dimensions']] = BAD_DIMENSIONS
    faults[wanted == 0] = BAD_TYPE
    return faults


def _reason(solid: Any) -> str:
    """Say why a primitive cannot be used."""
    kind, fault = int(solid['type']), int(solid['fault'])
    if fault == BAD_TYPE:
        what = 'a PRISM' if kind == PRISM else f'of type {kind}'
        return f'it is {what}, not a BOX, SPHERE, CYLINDER or CONE'
    if fault == BAD_DIMENSIONS:
        return f'it has {solid["dimensions"]} dimensions, not {DIMENSIONS[kind]}'
    return REASONS[fault]


# ---- Meshes.

SURFACE = np.dtype([('corners', 'O'), ('vertices', 'O'), ('pose', 'f8', (7,))])
Surface = tuple[NDArray[np.uint32], Floats]  # corners (m, 3) of triangles by number; vertices


def _cone(size: Floats) -> Surface:
    """The pyramid around a cone: 0.5 % wider, at its edges."""
    angles = np.arange(SIDES) * (2.0 * math.pi / SIDES)
    reach, half = 0.5 * size[0] / math.cos(math.pi / SIDES), 0.5 * size[2]
    base = np.column_stack((reach * np.cos(angles), reach * np.sin(angles), np.full(SIDES, -half)))
    first = np.arange(SIDES)
    sides = np.column_stack((first, (first + 1) % SIDES, np.full(SIDES, SIDES)))
    floor = np.column_stack((np.zeros(SIDES - 2), first[2:], first[1:-1]))
    return np.vstack((sides, floor)).astype(np.uint32), np.vstack((base, (0.0, 0.0, half)))


def _surfaces(columns: Columns, prefix: str) -> NDArray[np.void]:
    """The surfaces of all meshes."""
    names = 'triangles', 'vertices'
    corners, vertices = (Each.read(columns, f'{prefix}meshes.{name}') for name in names)
    surfaces = np.zeros(len(corners.counts), SURFACE)
    for row in range(len(surfaces)):
        surfaces['corners'][row] = corners.rows[corners.span(row)]
        surfaces['vertices'][row] = vertices.rows[vertices.span(row)]
    return surfaces


def _with_meshes(
    solids: Shapes, surfaces: NDArray[np.void], planar: bool, form: str
) -> Generator[None, None, Shapes]:
    """Examine surfaces, and cones among the solids; ValueError if one cannot be used."""
    pose, count = surfaces['pose'], len(surfaces)
    more = alike(ShapeKind.MESH, pose[:, :3], pose[:, 3:], np.zeros((count, 3)))
    shapes = joined((solids, more))
    mesh = np.empty(len(shapes.kind), object)
    for part in np.flatnonzero(shapes.kind == ShapeKind.MESH).tolist():
        number = part - len(solids.kind)
        surface = _cone(shapes.size[part]) if number < 0 else surfaces[number]
        becomes = AS_CONVEX if number < 0 else form
        try:
            mesh[part] = yield from examined(_triangles(surface[0], surface[1]), planar, becomes)
        except ValueError as error:
            raise ValueError(f'part {part}: {error}') from None
        shapes.size[part] = mesh[part].size
    shapes = shapes._replace(mesh=mesh)
    faults = canonicalise(as_shapes(shapes), 2 if planar else 3).faults
    for part in np.flatnonzero(faults != FINE).tolist():
        raise ValueError(f'part {part}: {REASONS[faults[part]]}')
    return shapes


def _triangles(corners: NDArray[np.uint32], vertices: Floats) -> Floats:
    """Triangles (m, 3, 3) of a surface; ValueError if one has a vertex that there is not."""
    if not len(corners):
        raise ValueError('the mesh has no triangles')
    if (beyond := (corners >= len(vertices)).any(axis=1)).any():
        row = int(np.argmax(beyond))
        raise ValueError(f'triangle {row} has vertex {corners[row].max()} of {len(vertices)}')
    return vertices[corners]
