# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays visit the parts that they meet, nearest first, until none can hold a nearer box.

Which parts a ray meets, and in which order, the tree over the parts decides exactly. Distances are
told within 2 ulp: hits of two parts that are as near to each other are compared in a tree of their
two boxes, exactly.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import DynamicBVH, RayHits
from ..tree.access import NONE, checks
from .asking import Asking, parts_of, pieces

# Of two distances, each within 2 ulp of the exact one, and half an ulp for the sum.
DOUBT = 16 * 2.0**-53
LEAST_DOUBT = 64 * 5e-324


class Rays(NamedTuple):
    """Rays, checked: a value a row."""

    origins: NDArray[np.float64]
    directions: NDArray[np.float64]
    t_max: NDArray[np.float64]
    masks: NDArray[np.uint32]
    skip_inside: bool
    threads: int

    def some(self, rows: slice) -> 'Rays':
        """Rays of these rows."""
        ends = self.t_max[rows], self.masks[rows], self.skip_inside, self.threads
        return Rays(self.origins[rows], self.directions[rows], *ends)


class Best(NamedTuple):
    """The nearest hit so far of each ray, and where its box is."""

    ids: NDArray[np.int64]
    t: NDArray[np.float64]
    normals: NDArray[np.float64]
    parts: NDArray[np.int64]
    handles: NDArray[np.int64]

    def put(self, rows: Any, found: Any, which: Any, part: int) -> None:
        for mine, theirs in zip(self, (*found[:3], None, found.handles), strict=True):
            mine[rows] = part if theirs is None else theirs[which]


def check(
    ndim: int,
    origins: ArrayLike,
    directions: ArrayLike,
    t_max: ArrayLike,
    mask: ArrayLike,
    skip_inside: bool,
    threads: int,
) -> Rays:
    """ValueError as `DynamicBVH.raycast_many`."""
    starts = checks.points('origins', origins, ndim)
    count = len(starts)
    return Rays(
        starts,
        checks.points('directions', directions, ndim, count),
        checks.limits('t_max', t_max, count),
        checks.masks(mask, count),
        checks.flag('skip_inside', skip_inside),
        checks.whole('threads', threads, 1),
    )


def first_hits(top: DynamicBVH, asking: Asking, rays: Rays) -> RayHits:
    """The nearest hit of each ray."""
    count, ndim = rays.origins.shape
    nowhere = np.full((2, count), NONE, np.int64)
    best = Best(
        np.full(count, NONE, np.int64), np.full(count, np.inf), np.zeros((count, ndim)), *nowhere
    )
    for piece in pieces(count):
        some = Best._make(column[piece] for column in best)
        _cast(top, asking, rays.some(piece), some)
    return RayHits(best.ids, best.t, best.normals)


def any_hits(top: DynamicBVH, asking: Asking, rays: Rays) -> NDArray[np.bool_]:
    """Whether each ray hits."""
    blocked = np.zeros(len(rays.origins), np.bool_)
    for piece in pieces(len(rays.origins)):
        asked = rays.some(piece)[:4]
        ends, parts, _ = _parts_met(top, asked)
        at, found = ends[:-1].copy(), blocked[piece]
        while len(rows := np.flatnonzero((at < ends[1:]) & ~found)):
            here = parts[at[rows]]
            for some, _, hit in asking.each('occluded', rows, here, asked, *rays[4:]):
                found[some] = hit
            at[rows] += 1
    return blocked


def _parts_met(
    top: DynamicBVH, asked: Any
) -> tuple[NDArray[np.int64], NDArray[np.int64], NDArray[np.float64]]:
    """Where the parts of each ray begin and end, their numbers, nearest first, and how far."""
    ends, handles, ts = top.raycast_all_many(*asked)
    return ends, parts_of(top, handles), ts


def _cast(top: DynamicBVH, asking: Asking, rays: Rays, best: Best) -> None:
    asked = rays[:4]
    ends, parts, ts = _parts_met(top, asked)
    at = ends[:-1].copy()
    rows = np.flatnonzero(at < ends[1:])
    while len(rows):
        here = parts[at[rows]]
        # Nothing farther than what was found is looked for.
        reach = np.minimum(rays.t_max, _beyond(best.t))
        nearer = (*asked[:2], reach, asked[3])
        for some, part, found in asking.each('raycast', rows, here, nearer, *rays[4:]):
            _merge(asking, rays, best, some, part, found)
        at[rows] += 1
        rows = rows[at[rows] < ends[rows + 1]]
        rows = rows[ts[at[rows]] <= _beyond(best.t[rows])]


def _beyond(t: NDArray[np.float64]) -> NDArray[np.float64]:
    """A distance that is larger than what is told as t, whatever was rounded."""
    with np.errstate(over='ignore'):
        return t * (1.0 + DOUBT) + LEAST_DOUBT


def _merge(
    asking: Asking, rays: Rays, best: Best, rows: NDArray[np.int64], part: int, found: Any
) -> None:
    hit = np.flatnonzero(found.ids != NONE)
    row, t = rows[hit], found.t[hit]
    known = best.ids[row] != NONE
    nearer = ~known | (_beyond(t) < best.t[row])
    doubtful = ~nearer & (t <= _beyond(best.t[row]))
    inside = doubtful & ~(best.normals[row].any(axis=1) | found.normals[hit].any(axis=1))
    nearer |= inside & (found.ids[hit] < best.ids[row])
    doubtful &= ~inside
    if doubtful.any():
        some = np.flatnonzero(doubtful)
        nearer[some] = _is_nearer(asking, rays, best, row[some], part, found, hit[some])
    best.put(row[nearer], found, hit[nearer], part)


def _is_nearer(
    asking: Asking,
    rays: Rays,
    best: Best,
    rows: NDArray[np.int64],
    part: int,
    found: Any,
    hit: NDArray[np.int64],
) -> NDArray[np.bool_]:
    """Whether what a part found comes before the best so far, exactly."""
    count, ndim = len(rows), rays.origins.shape[1]
    boxes = np.empty((2, 2, count, ndim))  # of the best, of the found; lo, hi
    numbers = np.arange(count)
    for side, parts, handles in (
        (0, best.parts[rows], best.handles[rows]),
        (1, np.full(count, part), found.handles[hit]),
    ):
        for some, _, its in asking.each('boxes', numbers, parts, (handles,)):
            boxes[side][:, some] = its
    first = np.empty(count, np.bool_)
    for i, row in enumerate(rows):
        order = (0, 1) if best.ids[row] < found.ids[hit[i]] else (1, 0)
        pair = DynamicBVH(ndim, capacity=2)
        handles = [pair.insert(*boxes[side, :, i]) for side in order]
        ray = rays.origins[row], rays.directions[row]
        nearest = pair.raycast_all(*ray, skip_inside=rays.skip_inside)[0]
        first[i] = order[handles.index(nearest.id)] == 1
    return first
