# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The libraries that the report compares, each in the form that serves it best."""

from collections.abc import Callable, Iterable
from importlib import import_module
from importlib.util import find_spec
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.spatial import cKDTree

from .. import DynamicBVH
from ..tree.access import CORNERS, SIDES
from .scenes import Boxes, Floats, Rays

Rows = NDArray[np.int64]
Move = Callable[[Rows | None, Boxes], object]  # these rows, or all


class Library(NamedTuple):
    """A library under test, by what it does; None is what it cannot do.

    `note` says how it is used, so that a reader can judge whether that is fair. `prepare` and
    `rays` make its own form of boxes and rays; they are not timed. `build` makes a scene of boxes
    in that form, and `size` counts them.
    """

    name: str
    module: str
    note: str
    prepare: Callable[[Boxes], Any]
    build: Callable[[Any], Any]
    size: Any = None
    rays: Callable[[Rays], Any] = lambda rays: rays
    cast: Any = None  # (scene, rays): for each ray what it hits first, negative where nothing
    mover: Any = None  # (scene): a `Move`
    overlap: Any = None  # (scene, boxes): the number of overlaps
    pairs: Any = None  # (scene): the number of pairs of boxes that overlap
    nearest: Any = None  # (scene, points): distance of each from the nearest box

    def installed(self) -> bool:
        """Whether it is on this machine."""
        return find_spec(self.module) is not None


# ---- This package


def tree_mover(tree: DynamicBVH) -> Move:
    """Move rows of a tree that was built at once."""
    ids = tree.ids()
    return lambda rows, boxes: tree.move_many(ids if rows is None else ids[rows], *boxes)


OURS = Library(
    'bvh_ros',
    'bvh_ros',
    'batch calls, float64, exact decisions; a cast returns id, distance and normal',
    prepare=lambda boxes: boxes,
    build=lambda boxes: DynamicBVH.from_boxes(*boxes),
    size=len,
    cast=lambda tree, rays: tree.raycast_many(*rays).ids,
    mover=tree_mover,
    overlap=lambda tree, boxes: len(tree.overlap_many(*boxes)[1]),
    pairs=lambda tree: len(tree.overlap_pairs()),
    nearest=lambda tree, points: tree.nearest_many(points)[1],
)

# ---- Embree 4 by embreex: a box is twelve triangles


FACES = SIDES[:, (0, 1, 2, 0, 2, 3)].reshape(12, 3).astype(np.int32)
ONE_RAY = np.zeros((1, 3), np.float32), np.ones((1, 3), np.float32)


def triangles(boxes: Boxes) -> tuple[NDArray[np.float32], NDArray[np.int32]]:
    """Corners (8 n, 3) and the twelve triangles of every box (12 n, 3)."""
    corners = np.where(CORNERS, boxes.hi[:, None], boxes.lo[:, None]).astype(np.float32)
    faces = FACES + 8 * np.arange(len(boxes.lo), dtype=np.int32)[:, None, None]
    return corners.reshape(-1, 3), faces.reshape(-1, 3)


def embree_scene(mesh: tuple[NDArray[np.float32], NDArray[np.int32]]) -> Any:
    """A static scene; Embree builds when the first ray comes."""
    from embreex.mesh_construction import TriangleMesh
    from embreex.rtcore_scene import EmbreeScene

    scene = EmbreeScene()
    TriangleMesh(scene, *mesh)
    scene.run(*ONE_RAY)
    return scene


EMBREE = Library(
    'Embree 4',
    'embreex',
    'through embreex, 12 indexed triangles a box, float32, the query that returns the '
    'triangle alone; not the robust mode, which is slower; what moves is built anew, as embreex '
    'has no update',
    prepare=triangles,
    build=embree_scene,
    rays=lambda rays: [np.ascontiguousarray(part, np.float32) for part in rays],
    cast=lambda scene, rays: scene.run(*rays),
)

# ---- The dynamic AABB trees of FCL (python-fcl) and Coal (formerly hpp-fcl)


def collision_objects(
    module: str, forms: Iterable[Any], turns: Iterable[Floats], centers: Iterable[Floats]
) -> list[Any]:
    """Objects of python-fcl or coal; turns are rotation matrices."""
    library, coal = import_module(module), module == 'coal'
    pose = library.Transform3s if coal else library.Transform
    objects = [
        library.CollisionObject(form, pose(turn, center))
        for form, turn, center in zip(forms, turns, centers, strict=True)
    ]
    for item in objects if coal else ():
        item.computeAABB()
    return objects


class BroadPhase:
    """A manager of python-fcl or coal and its objects."""

    def __init__(self, module: str, objects: list[Any]) -> None:
        self.objects, self._library = objects, import_module(module)
        self._coal = module == 'coal'
        self.manager = self._library.DynamicAABBTreeCollisionManager()
        if self._coal:
            for item in objects:
                self.manager.registerObject(item)
        else:
            self.manager.registerObjects(objects)
        self.manager.setup()

    def move(self, rows: Rows | None, boxes: Boxes) -> None:
        """Move all objects, or some, from Python, then update."""
        moved = self.objects if rows is None else [self.objects[row] for row in rows.tolist()]
        for item, center in zip(moved, boxes.centers, strict=True):
            item.setTranslation(center)
            if self._coal:
                item.computeAABB()
        if rows is None or self._coal:  # coal's update(item) takes 40 us and more, each
            self.manager.update()
        else:
            self.manager.update(moved)

    def overlaps(self, queries: Iterable[Any]) -> int:
        """Count the pairs of an object with one of the queries, without a narrow phase."""
        return self._collide([(item,) for item in queries], len(self.objects))

    def pairs(self) -> int:
        """Count the pairs of objects."""
        return self._collide([()], 50 * len(self.objects))

    def _collide(self, queries: Iterable[tuple[Any, ...]], most: int) -> int:
        if self._coal:
            total, collect = 0, self._library.CollisionCallBackCollect(most)
            for query in queries:
                self.manager.collide(*query, collect)
                total += collect.numCollisionPairs()
            return total
        found = [0]
        for query in queries:
            self.manager.collide(*query, found, _count)
        return found[0]


def _count(_first: Any, _second: Any, found: list[int]) -> bool:
    found[0] += 1
    return False


def boxes_of(module: str, boxes: Boxes) -> list[Any]:
    """Objects of axis-aligned boxes."""
    forms = [import_module(module).Box(*edges) for edges in boxes.edges]
    return collision_objects(module, forms, [np.eye(3)] * len(forms), boxes.centers)


def _with_manager(name: str, module: str, note: str) -> Library:
    managed = (
        'DynamicAABBTreeCollisionManager, objects moved one by one from Python, then update()'
    )
    return Library(
        name,
        module,
        f'{managed}; {note}',
        prepare=lambda boxes: boxes_of(module, boxes),
        build=lambda objects: BroadPhase(module, objects),
        size=lambda scene: int(scene.manager.size()),
        mover=lambda scene: scene.move,
        overlap=BroadPhase.overlaps,
        pairs=BroadPhase.pairs,
    )


COAL = _with_manager('coal', 'coal', 'pairs are collected in C++ without a narrow phase')
FCL = _with_manager(
    'python-fcl',
    'fcl',
    'pairs go to a callback in Python that only counts them, without a narrow phase',
)


class CoalMesh:
    """A mesh of coal, in its tightest boxes; each query is a call from Python."""

    def __init__(self, vertices: Floats, faces: Rows) -> None:
        self._coal = coal = import_module('coal')
        model = coal.BVHModelOBBRSS()
        model.beginModel(len(faces), len(vertices))
        model.addVertices(vertices)
        model.addTriangles(faces)
        model.endModel()
        self.mesh = coal.CollisionObject(model)

    def distances(self, objects: Iterable[Any]) -> list[float]:
        """Distance of each object from the mesh."""
        coal = self._coal
        wanted, found = coal.DistanceRequest(), coal.DistanceResult
        return [coal.distance(self.mesh, item, wanted, found()) for item in objects]

    def touches(self, objects: Iterable[Any]) -> list[bool]:
        """Whether each object touches the mesh."""
        coal = self._coal
        wanted, found = coal.CollisionRequest(), coal.CollisionResult
        return [coal.collide(self.mesh, item, wanted, found()) > 0 for item in objects]


# ---- Open3D: the closest points of a mesh, by Embree. It is large, so no extra brings it


def closest_points_job(vertices: Floats, faces: Rows, points: Floats) -> Callable[[], object]:
    """Finds the closest points of a mesh on one core."""
    library = import_module('open3d')
    given = vertices.astype(np.float32), faces.astype(np.uint32), points.astype(np.float32)
    corners, rows, places = map(library.core.Tensor, given)
    scene = library.t.geometry.RaycastingScene(nthreads=1)
    scene.add_triangles(corners, rows)
    return lambda: scene.compute_closest_points(places, nthreads=1)


# ---- cKDTree of scipy, which most Python users would take for nearest points


SCIPY = Library(
    'scipy cKDTree',
    'scipy',
    'points only, one thread',
    prepare=lambda boxes: boxes.centers,
    build=cKDTree,
    size=lambda tree: int(tree.n),
    nearest=lambda tree, points: tree.query(points)[0],
)

LIBRARIES = OURS, EMBREE, COAL, FCL, SCIPY
