# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""FCL through python-fcl, and Coal (formerly hpp-fcl): their dynamic AABB trees."""

from typing import Any

import numpy as np

from ..scenes import Boxes, Floats
from ..timing import Job
from .base import Library, Work


def centers(boxes: Boxes) -> Floats:
    """Centres of the boxes, shape (n, 3)."""
    return (boxes.lo + boxes.hi) / 2


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

    def _put(self, item: Any, center: Floats) -> None:
        item.setTranslation(center)

    def _update(self, manager: Any, moved: list[Any]) -> None:
        manager.update(moved)

    def _collide(self, manager: Any, asked: list[Any] | None, most: int) -> int:
        """Count pairs of the manager's objects with the asked ones, or with each other."""

        def count(_first: Any, _second: Any, found: list[int]) -> bool:
            found[0] += 1
            return False

        found = [0]
        for item in asked or ():
            manager.collide(item, found, count)
        if asked is None:
            manager.collide(found, count)
        return found[0]

    def move_all(self, work: Work) -> Job:
        """Move every box a little."""
        objects = self._objects(work.boxes)
        manager, states = self._manager(objects), work.moving()

        def run():
            for item, center in zip(objects, centers(next(states)), strict=True):
                self._put(item, center)
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
                self._put(item, center)
            self._update(manager, jumping)

        return Job(run, len(work.jumps[0].rows))

    def build(self, work: Work) -> Job:
        """Register objects that exist, and set up."""
        objects = self._objects(work.boxes)
        return Job(lambda: self._manager(objects), len(objects), lambda manager: manager.size())

    def overlap(self, work: Work) -> Job:
        """Boxes that meet small boxes."""
        objects = self._objects(work.boxes)
        manager, asked = self._manager(objects), self._objects(work.small)
        return Job(lambda: self._collide(manager, asked, len(objects)), len(asked), int)

    def pairs(self, work: Work) -> Job:
        """All pairs of boxes that meet."""
        objects = self._objects(work.boxes)
        manager = self._manager(objects)
        return Job(lambda: self._collide(manager, None, 50 * len(objects)), len(objects), int)


class Coal(Fcl):
    """The broad phase alone, with callbacks in C++."""

    name = 'coal'
    module = 'coal'
    note = (
        'DynamicAABBTreeCollisionManager, objects moved one by one from Python, then update(); '
        'pairs are collected in C++ without a narrow phase'
    )

    def _objects(self, boxes: Boxes) -> list[Any]:
        import coal

        still = np.eye(3)
        objects = [
            coal.CollisionObject(coal.Box(*edges), still, center)
            for edges, center in zip(boxes.hi - boxes.lo, centers(boxes), strict=True)
        ]
        for item in objects:
            item.computeAABB()
        return objects

    def _manager(self, objects: list[Any]) -> Any:
        import coal

        manager = coal.DynamicAABBTreeCollisionManager()
        for item in objects:
            manager.registerObject(item)
        manager.setup()
        return manager

    def _put(self, item: Any, center: Floats) -> None:
        item.setTranslation(center)
        item.computeAABB()

    def _update(self, manager: Any, moved: list[Any]) -> None:
        manager.update()  # all at once: update(item) takes 40 us and more, each

    def _collide(self, manager: Any, asked: list[Any] | None, most: int) -> int:
        import coal

        found, collect = 0, coal.CollisionCallBackCollect(most)
        for item in asked or ():
            manager.collide(item, collect)
            found += collect.numCollisionPairs()
        if asked is None:
            manager.collide(collect)
            found = collect.numCollisionPairs()
        return found
