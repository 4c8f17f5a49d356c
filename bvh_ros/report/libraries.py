# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The libraries that the report compares, each in the form that serves it best."""

from collections.abc import Iterator
from importlib.util import find_spec
from itertools import cycle
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import DynamicBVH, RayHits
from .scenes import Boxes, Floats, Rays, incoherent_rays, moved, query_edge, spread, uniform_boxes
from .timing import Job

# ---- What is asked of every library.


SOME = 32  # one box in so many jumps in the task `move_some`


class Jump(NamedTuple):
    """Some of the boxes, and where they are now."""

    rows: NDArray[np.int64]
    boxes: Boxes


class Work(NamedTuple):
    """One scene and what is asked about it; the same for every library."""

    boxes: Boxes
    rays: Rays
    small: Boxes
    """Boxes to ask overlaps for; each meets half a box on average."""
    points: Floats
    """Points to ask the nearest box centre for, shape (m, 3)."""
    states: tuple[Boxes, Boxes]
    """All boxes, at home and up to one edge away."""
    jumps: tuple[Jump, ...]
    """One box in 32, each time others, somewhere else in the cube."""

    def moving(self) -> Iterator[Boxes]:
        """All boxes, away and home again, for ever."""
        return cycle((self.states[1], self.states[0]))

    def jumping(self) -> Iterator[Jump]:
        """One jump after the other, for ever."""
        return cycle(self.jumps)


def make_work(count: int, asked: int) -> Work:
    """Make a scene of `count` boxes, and `asked` rays, small boxes and points."""
    rng = np.random.default_rng(0)
    boxes = uniform_boxes(count, rng)
    edges = boxes.hi - boxes.lo
    corner = spread(asked, rng)
    return Work(
        boxes,
        incoherent_rays(asked, rng),
        Boxes(corner, corner + query_edge(boxes, 0.5)),
        spread(asked, rng),
        (boxes, moved(boxes, rng.uniform(-1, 1, edges.shape) * edges)),
        tuple(_jump(boxes, rng) for _ in range(8)),
    )


def _jump(boxes: Boxes, rng: np.random.Generator) -> Jump:
    count = len(boxes.lo)
    rows = np.sort(rng.choice(count, max(1, count // SOME), replace=False))
    half = (boxes.hi[rows] - boxes.lo[rows]) / 2
    centers = spread(len(rows), rng)
    return Jump(rows, Boxes(centers - half, centers + half))


class Library:
    """A library under test: a method named as a task returns the job; what it can't do is missing.

    Attributes
    ----------
    name : str
        As it stands in the tables.
    module : str
        What must be importable.
    note : str
        How it is used, so that a reader can judge whether that is fair.
    """

    name: str
    module: str
    note: str

    def installed(self) -> bool:
        """Whether it is on this machine."""
        return find_spec(self.module) is not None


# ---- This package.


def _boxes_hit(result: RayHits) -> int:
    return int(np.count_nonzero(result.ids >= 0))


class Ours(Library):
    """DynamicBVH, float64, exact decisions."""

    name = 'bvh_ros'
    module = 'bvh_ros'
    note = 'batch calls, float64, exact decisions; a cast returns id, distance and normal'

    def cast(self, work: Work) -> Job:
        """First hits."""
        tree = DynamicBVH.from_boxes(*work.boxes)
        return Job(lambda: tree.raycast_many(*work.rays), len(work.rays.origins), _boxes_hit)

    def frame(self, work: Work) -> Job:
        """Move all, then cast."""
        tree, states = DynamicBVH.from_boxes(*work.boxes), work.moving()
        ids = tree.ids()

        def run():
            tree.move_many(ids, *next(states))
            return tree.raycast_many(*work.rays)

        return Job(run, 1, _boxes_hit)

    def move_all(self, work: Work) -> Job:
        """Move every box a little."""
        tree, states = DynamicBVH.from_boxes(*work.boxes), work.moving()
        ids = tree.ids()
        return Job(lambda: tree.move_many(ids, *next(states)), len(ids))

    def move_some(self, work: Work) -> Job:
        """Move few boxes far."""
        tree, jumps = DynamicBVH.from_boxes(*work.boxes), work.jumping()
        ids = tree.ids()

        def run():
            jump = next(jumps)
            tree.move_many(ids[jump.rows], *jump.boxes)

        return Job(run, len(work.jumps[0].rows))

    def build(self, work: Work) -> Job:
        """Build from nothing."""
        return Job(lambda: DynamicBVH.from_boxes(*work.boxes), len(work.boxes.lo), len)

    def overlap(self, work: Work) -> Job:
        """Boxes that meet small boxes."""
        tree = DynamicBVH.from_boxes(*work.boxes)
        return Job(lambda: tree.overlap_many(*work.small), len(work.small.lo), lambda r: len(r[1]))

    def pairs(self, work: Work) -> Job:
        """All pairs of boxes that meet."""
        tree = DynamicBVH.from_boxes(*work.boxes)
        return Job(tree.overlap_pairs, len(tree), len)

    def nearest(self, work: Work) -> Job:
        """The nearest of many points; a point is a box without extent."""
        centers = (work.boxes.lo + work.boxes.hi) / 2
        tree = DynamicBVH.from_boxes(centers, centers)
        points = work.points
        return Job(lambda: tree.nearest_many(points), len(points), lambda r: rounded(r[1]))


def rounded(distances: Floats) -> int:
    """Sum of the distances in mm: equal only if the same points were found."""
    return round(float(np.sum(distances)) * 1e3)


# ---- Embree 4, through embreex: a very fast ray caster. It knows triangles, so a box is twelve.


# Corner k of a box takes x, y, z from its upper end where bit 0, 1, 2 of k is set.
UPPER = np.array([[k & 1, k >> 1 & 1, k >> 2 & 1] for k in range(8)], bool)
SIDES = ((0, 1, 3, 2), (4, 5, 7, 6), (0, 1, 5, 4), (2, 3, 7, 6), (0, 2, 6, 4), (1, 3, 7, 5))
FACES = np.array([t for a, b, c, d in SIDES for t in ((a, b, c), (a, c, d))], np.int32)


Mesh = tuple[NDArray[np.float32], NDArray[np.int32]]


def triangles(boxes: Boxes) -> Mesh:
    """Corners (8 n, 3) and the twelve triangles of every box (12 n, 3)."""
    corners = np.where(UPPER, boxes.hi[:, None], boxes.lo[:, None]).astype(np.float32)
    faces = FACES + 8 * np.arange(len(boxes.lo), dtype=np.int32)[:, None, None]
    return corners.reshape(-1, 3), faces.reshape(-1, 3)


class Embree(Library):
    """Embree's static scene; what moves is built anew, for embreex gives no update."""

    name = 'Embree 4'
    module = 'embreex'
    note = (
        'through embreex, 12 indexed triangles a box, float32, the query that returns the '
        'triangle alone; not the robust mode, which is slower'
    )

    def scene(self, mesh: Mesh) -> Any:
        """A static scene of these triangles."""
        from embreex.mesh_construction import TriangleMesh
        from embreex.rtcore_scene import EmbreeScene

        scene = EmbreeScene()
        TriangleMesh(scene, *mesh)
        return scene

    def cast(self, work: Work) -> Job:
        """First hits."""
        scene = self.scene(triangles(work.boxes))
        rays = [np.ascontiguousarray(part, np.float32) for part in work.rays]
        return Job(lambda: scene.run(*rays), len(rays[0]), _hits)

    def frame(self, work: Work) -> Job:
        """Build with all boxes moved, then cast. Making the triangles is not counted."""
        meshes = [triangles(state) for state in work.states]
        rays = [np.ascontiguousarray(part, np.float32) for part in work.rays]
        turn = iter(range(1 << 62))
        return Job(lambda: self.scene(meshes[1 - next(turn) % 2]).run(*rays), 1, _hits)

    def build(self, work: Work) -> Job:
        """Build; Embree does when the first ray comes. Making the triangles is not counted."""
        mesh = triangles(work.boxes)
        ray = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)
        return Job(lambda: self.scene(mesh).run(*ray), len(work.boxes.lo))


def _hits(triangle: NDArray[np.int32]) -> int:
    return int(np.count_nonzero(triangle >= 0))


# ---- FCL through python-fcl, and Coal (formerly hpp-fcl): their dynamic AABB trees.


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


# ---- scipy's cKDTree: points only.


class KdTree(Library):
    """The static k-d tree that most Python users would take for nearest points."""

    name = 'scipy cKDTree'
    module = 'scipy'
    note = 'points only, one thread'

    def build(self, work: Work) -> Job:
        """Build over the centres."""
        from scipy.spatial import cKDTree

        centers = (work.boxes.lo + work.boxes.hi) / 2
        return Job(lambda: cKDTree(centers), len(centers), lambda tree: tree.n)

    def nearest(self, work: Work) -> Job:
        """The nearest of many points."""
        from scipy.spatial import cKDTree

        tree = cKDTree((work.boxes.lo + work.boxes.hi) / 2)
        return Job(lambda: tree.query(work.points), len(work.points), lambda r: rounded(r[0]))


LIBRARIES: list[Library] = [Ours(), Embree(), Coal(), Fcl(), KdTree()]
