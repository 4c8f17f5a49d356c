# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Trees of boxes that move, and whether their answers are those of exact arithmetic."""

import math
from collections.abc import Sequence
from typing import Any

import numpy as np
from tree.motion.exact import Course, Floats, World
from tree.reference import INSIDE, ExactHit, is_within_2_ulp, seen

from bvh_ros import DynamicBVH, RayHit, RayHits
from bvh_ros.tree.access import OpenTree
from bvh_ros.tree.motion.queries import MotionQueries


class StoppingTree(OpenTree):
    """Boxes that go on for some seconds, and then stand."""

    def stop_after(self, left: float) -> None:
        self._motion = MotionQueries(self.ndim, self._tree_of_boxes, left=left)


def tree_of(world: World, margin: float = 0.0, left: float = math.inf) -> StoppingTree:
    tree = StoppingTree.from_boxes(world.lo, world.hi, margin=margin)
    tree.stop_after(left)
    moving = world.velocities.any(axis=1)
    ids = tree.ids()[moving]
    tree.set_velocities(ids, world.velocities[moving], world.references[moving])
    return tree


def normal_of(face: int, ndim: int) -> list[float]:
    normal = [0.0] * ndim
    if face != INSIDE:
        normal[face >> 1] = 1.0 if face & 1 else -1.0
    return normal


def check_hit(tree: DynamicBVH, hit: RayHit | None, right: list[ExactHit]) -> None:
    """It is the first one of these."""
    assert (hit is None) == (not right)
    if hit is not None:
        assert hit.id == tree.ids()[right[0].row]
        assert is_within_2_ulp(hit.t, right[0].t), (hit.t, float(right[0].t))
        assert hit.normal.tolist() == normal_of(right[0].axis, tree.ndim)


def check_rows(
    tree: DynamicBVH, hits: RayHits, occluded: Any, every: Sequence[list[ExactHit]]
) -> None:
    """Each row of a batch is the first one of its hits."""
    assert occluded.tolist() == [bool(right) for right in every]
    for row, right in enumerate(every):
        one = RayHit(int(hits.ids[row]), float(hits.t[row]), hits.normals[row], hits.normals[row])
        check_hit(tree, one if hits.ids[row] >= 0 else None, right)


def check_course(tree: DynamicBVH, every: list[ExactHit], course: Course, limit: float) -> int:
    """Check what a ray meets of these boxes; return how many boxes that decided."""
    times, ids = {'at': course.at, 'pace': course.pace}, tree.ids()
    ray = course.low, course.direction
    for skip in (False, True):
        right = seen(every, ids, limit, skip)
        hit = tree.raycast(*ray, limit, skip_inside=skip, **times)
        check_hit(tree, hit, right)
        assert tree.occluded(*ray, limit, skip_inside=skip, **times) == bool(right)
        _, found, ts = tree.raycast_all_many([ray[0]], [ray[1]], limit, skip_inside=skip, **times)
        assert found.tolist() == [ids[exact.row] for exact in right]
        assert all(is_within_2_ulp(t, e.t) for t, e in zip(ts.tolist(), right, strict=True))
        assert (np.diff(ts[np.isfinite(ts)]) >= 0).all()
        many = tree.raycast_many([ray[0]] * 2, [ray[1]] * 2, limit, skip_inside=skip, **times)
        assert many.ids.tolist() == [ids[right[0].row] if right else -1] * 2
        if hit is not None:
            assert many.t[1] == hit.t
            assert many.normals[1].tolist() == hit.normal.tolist()
    return 2 * len(tree)


def one_by_one(tree: DynamicBVH, origins: Floats, ways: Floats, times: Any) -> list[Any]:
    """(id, t) of each ray alone."""
    hits = [tree.raycast(*ray, 1.0, **times) for ray in zip(origins, ways, strict=True)]
    return [(-1, math.inf) if hit is None else (hit.id, hit.t) for hit in hits]
