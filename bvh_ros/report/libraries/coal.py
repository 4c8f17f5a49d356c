# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Coal (formerly hpp-fcl): its dynamic AABB tree."""

from typing import Any

import numpy as np

from ..scenes import Boxes, Floats
from ..timing import Job
from .base import Library, Work


class Coal(Library):
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
        return [
            coal.CollisionObject(coal.Box(*edges), still, center)
            for edges, center in zip(boxes.hi - boxes.lo, centers(boxes), strict=True)
        ]

    def _manager(self, objects: list[Any]) -> Any:
        import coal

        manager = coal.DynamicAABBTreeCollisionManager()
        for item in objects:
            manager.registerObject(item)
        manager.setup()
        return manager

    def move_all(self, work: Work) -> Job:
        """Move every box a little."""
        objects = self._objects(work.boxes)
        manager, states = self._manager(objects), work.moving()

        def run():
            for item, center in zip(objects, centers(next(states)), strict=True):
                item.setTranslation(center)
                item.computeAABB()
            manager.update()

        return Job(run, len(objects))

    def move_some(self, work: Work) -> Job:
        """Move few boxes far."""
        objects = self._objects(work.boxes)
        manager, jumps = self._manager(objects), work.jumping()

        def run():
            rows, boxes = next(jumps)
            for row, center in zip(rows.tolist(), centers(boxes), strict=True):
                item = objects[row]
                item.setTranslation(center)
                item.computeAABB()
            manager.update()  # all at once: update(item) takes 40 us and more, each

        return Job(run, len(work.jumps[0].rows))

    def build(self, work: Work) -> Job:
        """Register objects that exist, and set up."""
        objects = self._objects(work.boxes)
        return Job(lambda: self._manager(objects), len(objects), lambda manager: manager.size())

    def overlap(self, work: Work) -> Job:
        """Boxes that meet small boxes."""
        import coal

        objects = self._objects(work.boxes)
        manager, asked = self._manager(objects), self._objects(work.small)
        for item in asked:
            item.computeAABB()

        def run():
            found = 0
            collect = coal.CollisionCallBackCollect(len(objects))
            for item in asked:
                manager.collide(item, collect)
                found += collect.numCollisionPairs()
            return found

        return Job(run, len(asked), int)

    def pairs(self, work: Work) -> Job:
        """All pairs of boxes that meet."""
        import coal

        objects = self._objects(work.boxes)
        manager = self._manager(objects)

        def run():
            collect = coal.CollisionCallBackCollect(50 * len(objects))
            manager.collide(collect)
            return collect.numCollisionPairs()

        return Job(run, len(objects), int)


def centers(boxes: Boxes) -> Floats:
    """Centres of the boxes, shape (n, 3)."""
    return (boxes.lo + boxes.hi) / 2
