# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of questions to several nodes, a region each."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bvh_ros.client import region_rows, volumes
from bvh_ros.client.batch import as_rays
from bvh_ros.client.errors import BvhError
from bvh_ros.client.layout import LEAVES, Layout
from bvh_ros.client.merging import Nearest
from bvh_ros.client.region_rows import Rows
from bvh_ros.client.waiting import left, results
from bvh_ros.ros.conversions.query_clouds import Near, Touched
from bvh_ros.ros.conversions.ray_clouds import EVERYTHING, Hits

if TYPE_CHECKING:
    from bvh_ros.client.client import BvhClient

NAMES_PATIENCE = 2.0  # seconds; names are told once a second


class RegionBatches:
    """`raycast_many` and its kin, asked of several nodes."""

    clients: list[BvhClient]
    names: Callable[..., dict[int, str]]
    ask: Callable[..., Any]

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        radius: ArrayLike | None = None,
        at: ArrayLike | None = None,
        until: ArrayLike | None = None,
        timeout: float | None = None,
    ) -> Hits:
        """As `BvhClient.raycast_many`; a row is UNANSWERED where it leaves the regions before it
        hits.
        """
        rays = as_rays(origins, directions, t_max, mask, radius)
        return self._nearest_of(lambda _: region_rows.of_rays(rays, at, until), timeout)

    def nearest_many(
        self,
        points: ArrayLike,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        at: ArrayLike | None = None,
        timeout: float | None = None,
    ) -> Near:
        """As `BvhClient.nearest_many`; a row is UNANSWERED where something nearer could lie
        beyond the regions.
        """
        asked = volumes.points(points, max_distance, mask)
        return self._nearest_of(lambda _: region_rows.of_points(asked, at), timeout)

    def overlap_many(
        self,
        centers: ArrayLike,
        sizes: ArrayLike,
        orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = EVERYTHING,
        *,
        at: ArrayLike | None = None,
        timeout: float | None = None,
    ) -> Touched:
        """As `BvhClient.overlap_many`, but for `counts`, see `RegionClient`."""
        asked = volumes.boxes(centers, sizes, orientations, tolerance, mask)
        return self._nearest_of(lambda _: region_rows.of_boxes(asked, at), timeout)

    def check_path(
        self,
        positions: ArrayLike,
        orientations: ArrayLike | None = None,
        *,
        at: ArrayLike | None = None,
        timeout: float | None = None,
    ) -> Near:
        """As `BvhClient.check_path`; all nodes must have the same `footprint`."""
        asked = volumes.poses(positions, orientations)
        return self._nearest_of(
            lambda layout: region_rows.of_poses(*asked, layout.footprint(), at), timeout
        )

    def _nearest_of(self, ask: Callable[[Layout], Rows], timeout: float | None) -> Any:
        """The nearest obstacle of each row: of what lies where the row begins at first, then of
        all that may be nearer.
        """

        def work(layout: Layout, deadline: float) -> Any:
            rows, coverage = ask(layout), layout.coverage
            told = Nearest(rows.answer, rows.bad, coverage)
            count = len(rows.bad)
            done = np.zeros((count, len(self.clients)), np.bool_)
            reach = np.zeros(count)
            for _ in range(2):
                told.unknown |= ~coverage.covers(rows.around(np.zeros(count)))
                asked = coverage.asked(rows.around(reach)) & ~done
                asked[told.unknown] = False
                self._add(told, rows, asked, deadline)
                done |= asked
                reach = np.clip(told.distances, 0.0, rows.most)  # a depth reaches no farther
            told.unknown |= ~coverage.covers(rows.around(reach))
            if count and told.unknown.all():
                raise BvhError(f'no row can be answered: NaN, or {LEAVES}')
            if tied := told.tied():
                told.settle(self.names(tied, timeout=min(left(deadline), NAMES_PATIENCE)))
            return told.answer()

        return self.ask(work, timeout)

    def _add(self, told: Nearest, rows: Rows, asked: NDArray[np.bool_], deadline: float) -> None:
        """Ask regions about rows, (n, regions), all at once."""
        regions = np.flatnonzero(asked.any(axis=0)).tolist()
        some = [np.flatnonzero(asked[:, region]) for region in regions]
        pending = []
        for region, which in zip(regions, some, strict=True):
            channels = self.clients[region].channels
            stamp = channels.open(rows.topic).stamp()
            message = rows.message(which, stamp)
            pending.append(channels.begin(rows.topic, message, left(deadline), '', stamp))
        answers = results(pending, deadline)
        for region, which, answer in zip(regions, some, answers, strict=True):
            told.add(which, region, answer)
