# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which kernels answer a batch of rays and swept balls."""

from typing import Any

import numpy as np

from ..tree import checks
from ..tree.rays.raycasting import CLOSEST
from ..tree.rays.raycasting import Rays as ThinRays
from .casting import box_casting, casting, sweeping, wide_rays
from .casting.arguments import WHOLE_WAY, Found, Rays, row_by_row, ways_of
from .casting.sweeping import Balls
from .geometry.shapes import Floats, along_axes
from .moments import Moments
from .results import NO_NODE, CastHits
from .store.obstacles import Obstacles

# So many rays go one by one, whatever they are: of lists a second kernel tells points and normals.
FEW = 200


class RayBatches:
    """Answers batches of good input."""

    def __init__(self, held: Obstacles, moments: Moments) -> None:
        self._held = held
        self._moments = moments

    def first(
        self, rays: Rays, radii: Floats | None, skip: bool, times: tuple[Any, Any], threads: int
    ) -> CastHits:
        """First hits of rays, or of balls that go along them; times = (at, until)."""
        count = len(rays.origins)
        if (times[0] is not None or times[1] is not None) and self._moments.meant(*times, count):
            radii = checks.NOTHING if radii is None else radii
            return self._moments.first_of_many(rays, radii, skip, times, threads)
        if radii is None or radii is checks.NOTHING:
            return self._thin(rays, skip, threads)
        thick = int(radii.item() > 0.0) if len(radii) == 1 else np.count_nonzero(radii)
        if not thick:
            return self._thin(rays, skip, threads)
        ways = rays.directions if rays.t_max is WHOLE_WAY else ways_of(rays, radii)
        balls = tuple.__new__(Balls, (rays.origins, ways, radii, rays.masks))
        if thick == len(radii):
            return self._balls(balls, rays.t_max, skip, threads)
        each, both = row_by_row(rays), (np.flatnonzero(radii == 0.0), np.flatnonzero(radii))
        thin, rows = both
        some = Balls(*(column[rows] for column in balls._replace(masks=each.masks)))
        found = self._balls(some, each.t_max[rows], skip, threads)
        others = self._thin(Rays(*(column[thin] for column in each)), skip, threads)
        columns: Any = zip(others, found, strict=True)
        order = np.argsort(np.concatenate(both))
        return CastHits(*(np.concatenate(column)[order] for column in columns))

    def few(self, rays: tuple[Any, ...], skip: bool, to_goals: bool) -> CastHits | None:
        """`first` of thin rays with as little Python as can be: among solid boxes alone of those
        that are few, else None, as where one is not finite. `to_goals`: what is called directions
        are the goals of the ways.
        """
        held = self._held
        if held.columns.shaped:
            some, asked = tuple.__new__(Rays, rays), (to_goals, skip)
            return wide_rays.first_of_many(held.tree, held.columns, some, asked, 1)
        if held.planar:
            return None
        # As Rays(...), which would take one more call of a function of Python's.
        thin = tuple.__new__(ThinRays, (*rays, skip, CLOSEST, True))
        if len(thin.origins) > FEW and not held.tree.few_rays(thin):
            return None
        return box_casting.few_first(held.tree, held.columns.node_handle, thin, to_goals)

    def _balls(self, balls: Balls, t_max: Floats, skip: bool, threads: int) -> CastHits:
        """First hits of balls, at t from 0 to `t_max`."""
        held = self._held
        found = sweeping.first_of_many(held.tree, held.columns, balls, (False, skip), threads)
        assert found is not None
        if t_max is not WHOLE_WAY:
            np.multiply(found.t, t_max, out=found.t, where=found.handles != NO_NODE)
        return found

    def _thin(self, rays: Rays, skip: bool, threads: int) -> CastHits:
        """First hits of thin rays."""
        held = self._held
        if not held.columns.shaped:
            handles = held.columns.node_handle
            return box_casting.first_of_many(held.tree, handles, rays, skip, threads)
        found = wide_rays.first_of_many(held.tree, held.columns, rays, (False, skip), threads)
        assert found is not None
        return found

    def cast(self, rays: Rays, skip: bool, every: bool) -> Found:
        """Thin rays against the true shapes."""
        held = self._held
        origins, directions = (along_axes(rows, held.tree.ndim) for rows in rays[:2])
        flat = Rays(origins, directions, rays.t_max, rays.masks)
        return casting.cast_all(held.tree, held.columns, flat, skip, every)
