# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which kernels answer a batch of rays and swept balls."""

from typing import Any

import numpy as np

from ..tree.access import CLOSEST, checks
from ..tree.access import Rays as ThinRays
from .cast import batch, boxes, query
from .cast.arguments import Found, Rays, refuse_infinite, row_by_row, ways_of
from .geometry.shapes import Floats, along_axes
from .moments import Moments
from .results import CastHits
from .store.obstacles import Obstacles

# So many rays go one by one, whatever they are: of lists a second kernel tells points and normals.
FEW = 200


class RayBatches:
    """Answers batches of input that is good but for rows that are not finite."""

    def __init__(self, held: Obstacles, moments: Moments) -> None:
        self._held = held
        self._moments = moments

    def first(
        self, rays: Rays, radii: Floats, skip: bool, times: tuple[Any, Any], threads: int
    ) -> CastHits:
        """First hits of rays, or of balls that go along them; times = (at, until)."""
        count = len(rays.origins)
        if (times[0] is not None or times[1] is not None) and self._moments.meant(*times, count):
            return self._moments.first_of_many(rays, radii, skip, times, threads)
        if radii is checks.NOTHING:
            return self._thin(rays, skip, threads)
        thick = int(radii.item() > 0.0) if len(radii) == 1 else np.count_nonzero(radii)
        if not thick:
            return self._thin(rays, skip, threads)
        if thick == len(radii):
            return self._balls(rays, radii, skip, threads)
        refuse_endless(rays, radii)  # by their rows here
        each, both = row_by_row(rays), (np.flatnonzero(radii == 0.0), np.flatnonzero(radii))
        thin, rows = (Rays(*(column[which] for column in each)) for which in both)
        found = self._balls(rows, radii[both[1]], skip, threads)
        others = self._thin(thin, skip, threads)
        columns: Any = zip(others, found, strict=True)
        order = np.argsort(np.concatenate(both))
        return CastHits(*(np.concatenate(column)[order] for column in columns))

    def now(
        self, rays: tuple[Any, ...], radii: Floats, asked: tuple[bool, bool], threads: int
    ) -> CastHits | None:
        """`first` with as little Python as can be, asked = (whether what is called directions are
        goals, skip_inside): of balls alone, or by one thread of thin rays, among boxes those that
        are few. Else None, as where one is not finite.
        """
        held, columns = self._held, self._held.columns
        if radii is not checks.NOTHING:
            if not (radii.item() > 0.0 if len(radii) == 1 else radii.all()):
                return None
            return batch.first_hits_of_balls(held.tree, columns, (*rays, radii), asked, threads)
        if threads != 1:
            return None
        if columns.shaped:
            return batch.first_hits_of_rays(held.tree, columns, rays, asked, 1)
        # As Rays(...), which would take one more call of a function of Python's.
        thin = tuple.__new__(ThinRays, (*rays, asked[1], CLOSEST, True))
        if len(thin.origins) > FEW and not held.tree.few_rays(thin):
            return None
        return boxes.few_first(held.tree, columns.node_handle, thin, asked[0])

    def _balls(self, rays: Rays, radii: Floats, skip: bool, threads: int) -> CastHits:
        """First hits of balls that go along rays."""
        held, balls, asked = self._held, (*rays, radii), (False, skip)
        found = batch.first_hits_of_balls(held.tree, held.columns, balls, asked, threads)
        if found is None:
            refuse_endless(rays, radii)
        assert found is not None
        return found

    def _thin(self, rays: Rays, skip: bool, threads: int) -> CastHits:
        """First hits of thin rays."""
        held = self._held
        if not held.columns.shaped:
            handles = held.columns.node_handle
            if held.planar:
                refuse_infinite(rays)  # else the tree's kernel looks
            return boxes.first_of_many(held.tree, handles, rays, skip, threads)
        found = batch.first_hits_of_rays(
            held.tree, held.columns, tuple(rays), (False, skip), threads
        )
        if found is None:
            refuse_infinite(rays)
        assert found is not None
        return found

    def cast(self, rays: Rays, skip: bool, every: bool) -> Found:
        """Thin rays against the true shapes."""
        held = self._held
        origins, directions = (along_axes(rows, held.tree.ndim) for rows in rays[:2])
        flat = Rays(origins, directions, rays.t_max, rays.masks)
        return query.cast_all(held.tree, held.columns, flat, skip, every)


def refuse_endless(rays: Rays, radii: Floats) -> None:
    """ValueError if a ray, or the way of a ball, is not finite."""
    refuse_infinite(rays)
    ways_of(rays, radii)
