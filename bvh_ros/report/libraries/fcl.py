# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""FCL through python-fcl: its dynamic AABB tree."""

from typing import Any

from ..scenes import Boxes
from ..timing import Job
from .base import Library, Work
from .coal import centers


def _count(first: Any, second: Any, found: list[int]) -> bool:
    found[0] += 1
    return False


class Fcl(Library):
    """The broad phase alone; python-fcl's callbacks are Python functions."""

    name = 'python-fcl'
    module = 'fcl'
    note = (
        'DynamicAABBTreeCollisionManager, objects moved one by one from Python, then update(); '
        'pairs go to a callback that only counts them, without a narrow phase'
    )

    def _objects(self, boxes: Boxes) -> list[Any]:
        import fcl

        return [
            fcl.CollisionObject(fcl.Box(*edges), fcl.Transform(center))
            for edges, center in zip(boxes.hi - boxes.lo, centers(boxes), strict=True)
        ]

    def _manager(self, objects: list[Any]) -> Any:
        import fcl

        manager = fcl.DynamicAABBTreeCollisionManager()
        manager.registerObjects(objects)
        manager.setup()
        return manager

    def move_all(self, work: Work) -> Job:
        """Move every box a little."""
        objects = self._objects(work.boxes)
        manager, states = self._manager(objects), work.moving()

        def run():
            for item, center in zip(objects, centers(next(states)), strict=True):
                item.setTranslation(center)
            manager.update()

        return Job(run, len(objects))

    def move_some(self, work: Work) -> Job:
        """Move few boxes far."""
        objects = self._objects(work.boxes)
        manager, jumps = self._manager(objects), work.jumping()

        def run():
            rows, boxes = next(jumps)
            jumping = [objects[row] for row in rows.tolist()]
            for item, center in zip(jumping, centers(boxes), strict=True):
                item.setTranslation(center)
            manager.update(jumping)

        return Job(run, len(work.jumps[0].rows))

    def build(self, work: Work) -> Job:
        """Register objects that exist, and set up."""
        objects = self._objects(work.boxes)
        return Job(lambda: self._manager(objects), len(objects), lambda manager: manager.size())

    def overlap(self, work: Work) -> Job:
        """Boxes that meet small boxes."""
        objects = self._objects(work.boxes)
        manager, asked = self._manager(objects), self._objects(work.small)

        def run():
            found = [0]
            for item in asked:
                manager.collide(item, found, _count)
            return found[0]

        return Job(run, len(asked), int)

    def pairs(self, work: Work) -> Job:
        """All pairs of boxes that meet."""
        objects = self._objects(work.boxes)
        manager = self._manager(objects)

        def run():
            found = [0]
            manager.collide(found, _count)
            return found[0]

        return Job(run, len(objects), int)


class FclWithNarrowPhase(Library):
    """The same with the callback that python-fcl brings, which also decides every pair."""

    name = 'python-fcl, its callback'
    module = 'fcl'
    note = 'the same with defaultCollisionCallback, which runs the narrow phase on every pair'

    def pairs(self, work: Work) -> Job:
        """All pairs of boxes that meet."""
        import fcl

        broad = Fcl()
        manager = broad._manager(broad._objects(work.boxes))
        request = fcl.CollisionRequest(num_max_contacts=1 << 30)

        def run():
            manager.collide(fcl.CollisionData(request), fcl.defaultCollisionCallback)

        return Job(run, len(work.boxes.lo))
