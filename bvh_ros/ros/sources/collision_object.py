# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a CollisionObject topic."""

from __future__ import annotations

from collections.abc import Generator
from typing import Any

import numpy as np
from moveit_msgs.msg import CollisionObject

from bvh_ros.ros.conversions import collision_objects as objects
from bvh_ros.ros.conversions.collision_objects import Body, CollisionObjects
from bvh_ros.ros.conversions.placing import numbered
from bvh_ros.ros.sources.columns import ColumnsSource
from bvh_ros.ros.sources.source import Applying, is_costly
from bvh_ros.scene import Part, Refusal

OCTOMAP = '<octomap>'  # what MoveIt calls the octomap, as if it were an object
AT_A_TIME = 32  # objects between two pauses


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
    """

    def __init__(self, known: dict[str, Body]) -> None:
        self.known = known
        self.bodies = dict(known)
        self.touched: dict[str, None] = {}
        self.whole = False
        self.refusals: list[Refusal] = []

    def start_over(self) -> None:
        """Let all bodies go."""
        self.bodies, self.whole = {}, True

    def put(self, name: str, body: Body) -> None:
        """Let a body come, or take the place of the one before."""
        self.bodies[name] = body
        self.touched[name] = None

    def remove(self, name: str) -> None:
        """Let a body go, if there is one."""
        self.bodies.pop(name, None)
        self.touched[name] = None

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
            try:
                if operation == objects.REMOVE:
                    changes.remove(name) if name else changes.start_over()
                    continue
                if name in ('', OCTOMAP):
                    raise ValueError(f"'{name}' is no id of an object")
                if row in nowhere:
                    raise ValueError(nowhere[row])
                before, stamp = changes.bodies.get(name), int(given.stamps[row]) or now
                if operation == objects.MOVE:
                    if before is None:
                        raise ValueError('there is no such object to move')
                    body = given.moved(row, before, places[row], stamp)
                elif operation in (objects.ADD, objects.APPEND):
                    parts = yield from given.parts(
                        row, planar=self.scene.planar, form=self.settings.options['meshes']
                    )
                    body = Body(parts, places[row], stamp)
                    if before is not None and operation == objects.APPEND:
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
        part = Part(names, objects.placed([*rows.values()]), stamps)
        replaced = changes.touched.keys() & known.keys()
        self._bodies = bodies
        self.is_whole = changes.whole
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
    fields = objects.FIELDS

    def apply(self, message: Any, now: int) -> Applying:
        """Add, extend, move or remove an object."""
        changes = Changes(self._bodies)
        given = CollisionObjects(self._columns(message))
        yield from self._read_objects(given, changes, now)
        return (yield from self._apply_changes(changes))
