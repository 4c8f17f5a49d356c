# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a PlanningScene topic."""

from __future__ import annotations

from collections.abc import Generator, Iterable
from typing import Any

from moveit_msgs.msg import PlanningScene

from bvh_ros.ros.cdr.any_message import Columns, plan_of
from bvh_ros.ros.compile_jobs import Job
from bvh_ros.ros.conversions import octomap
from bvh_ros.ros.sources.collision_object import (
    FIELDS,
    OCTOMAP,
    REMOVE,
    BodiesSource,
    Body,
    Changes,
    CollisionObjects,
    place_of,
)
from bvh_ros.ros.sources.octomap import to_compile
from bvh_ros.ros.sources.source import Applying

OBJECTS, ATTACHED = 'world.collision_objects', 'robot_state.attached_collision_objects.object'
OCTREE = 'world.octomap.octomap.'


class PlanningSceneSource(BodiesSource):
    """Keeps the objects and the octomap of a scene, which messages tell as a whole or change.

    What is attached to the robot is part of it, and leaves the world.
    """

    message_type = PlanningScene
    fields = (
        *(f'{OBJECTS}.{field}' for field in FIELDS),
        *(f'{ATTACHED}.id', f'{ATTACHED}.operation'),
        *('world.octomap.header', 'world.octomap.origin'),
        *(f'{OCTREE}{field}' for field in octomap.FIELDS if field != 'header'),
        'is_diff',
    )

    @staticmethod
    def says_everything(serialised: bytes) -> bool:
        """Whether a scene replaces the one before."""
        try:
            columns = Columns(serialised, plan_of(PlanningScene, ('is_diff',)))
        except ValueError:
            return False
        return not columns.numbers('is_diff').item()

    def to_compile(self) -> Iterable[Job]:
        """Return the readers of the message and of the octree."""
        return [*super().to_compile(), to_compile()]

    def apply(self, message: Any, now: int) -> Applying:
        """Replace or change the world."""
        columns, changes = self._columns(message), Changes(self._bodies)
        if columns.numbers('is_diff').item():
            self._take_attached(columns, changes, now)
        else:
            changes.start_over(now)
        given = CollisionObjects(columns, OBJECTS)
        yield from self._read_objects(given, changes, now)
        yield from self._read_octomap(columns, changes, now)
        return (yield from self._apply_changes(changes))

    @staticmethod
    def _take_attached(columns: Columns, changes: Changes, now: int) -> None:
        """Remove what is attached to the robot. What leaves the robot comes with the world."""
        in_world = set(columns.texts(f'{OBJECTS}.id'))
        operations = columns.numbers(f'{ATTACHED}.operation')[:, 0].tolist()
        for row, name in enumerate(columns.texts(f'{ATTACHED}.id')):
            if operations[row] != REMOVE:
                changes.remove(name, now)
            elif name not in in_world:
                reason = 'it leaves the robot, and the scene does not say where it is then'
                changes.refuse(row, name, reason)

    def _read_octomap(
        self, columns: Columns, changes: Changes, now: int
    ) -> Generator[None, None, None]:
        """Replace the octomap, if there is one: its leaves are the parts of a body."""
        tree = octomap.Octree.read(columns, OCTREE)
        if not len(tree.data):
            if tree.kind:  # 'cleared', as MoveIt says it
                changes.remove(OCTOMAP, now)
            return
        (frame_id,) = columns.texts('world.octomap.header.frame_id')
        stamp = columns.stamps('world.octomap.header.stamp').item()
        try:
            place = place_of(columns.numbers('world.octomap.origin')[0])
            frame = self.frames.into_node(frame_id, stamp)
            parts = yield from octomap.boxes(
                tree,
                occupied_at=self.settings.options['occupied_at'],
                most=self.scene.max_obstacles,
            )
        except ValueError as error:
            changes.refuse(0, OCTOMAP, str(error))
            return
        place = place if frame is None else frame.after(place)
        changes.put(OCTOMAP, Body(parts, place, stamp or now))
