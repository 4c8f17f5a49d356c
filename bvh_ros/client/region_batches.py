# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of questions to several nodes, a region each."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bvh_ros.client import region_rows, volumes
from bvh_ros.client.batch import as_rays
from bvh_ros.client.errors import BvhError, BvhTimeoutError
from bvh_ros.client.layout import LEAVES, Layout
from bvh_ros.client.merging import Nearest
from bvh_ros.client.region_rows import Rows
from bvh_ros.client.waiting import Pending, left
from bvh_ros.ros.conversions.query_clouds import Near, Touched
from bvh_ros.ros.conversions.ray_clouds import EVERYTHING, Hits

if TYPE_CHECKING:
    from bvh_ros.client.client import BvhClient

NAMES_PATIENCE = 2.0  # seconds; names are told once a second
SLICE = 0.05  # seconds that one node is waited for while others may answer
SILENT = 5.0  # seconds for which a node that did not answer is remembered, ...
PROBE = 0.3  # ... and meanwhile has this many seconds to answer


class RegionBatches:
    """`raycast_many` and its kin, asked of several nodes."""

    clients: list[BvhClient]
    silent: dict[int, float]
    """By number of a node that did not answer: until when that is remembered."""
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
            nearest = Nearest(rows.answer, rows.bad, coverage)
            count = len(rows.bad)
            answered = np.zeros((count, len(self.clients)), np.bool_)
            waiting = answered.copy()
            questions: list[_Question] = []
            failure: BvhError | None = None
            nearest.unknown |= ~coverage.covers(rows.around(np.zeros(count)))
            while True:
                # At first the place where a row begins, then all that is as near as its answer.
                found = np.clip(nearest.distances, 0.0, rows.most)  # a depth reaches no farther
                reach = np.where(answered.any(axis=1), found, 0.0)
                asked = coverage.asked(rows.around(reach)) & ~answered
                asked[nearest.unknown | waiting.any(axis=1)] = False
                waiting |= asked
                for region in np.flatnonzero(asked.any(axis=0)).tolist():
                    end = min(deadline, self._end_of_probe(region))
                    some = np.flatnonzero(asked[:, region])
                    questions.append(_Question(self.clients[region], region, rows, some, end))
                if not questions:
                    break
                for question in [*questions]:
                    if not question.is_over():
                        continue
                    questions.remove(question)
                    waiting[question.some, question.region] = False
                    answered[question.some, question.region] = True
                    if question.failure is None:
                        self.silent.pop(question.region, None)
                        nearest.add(question.some, question.region, question.answer)
                        continue
                    nearest.unknown[question.some] = True
                    failure = failure or question.failure
                    if isinstance(question.failure, BvhTimeoutError):
                        self.silent[question.region] = time.monotonic() + SILENT
            nearest.unknown |= ~coverage.covers(rows.around(reach))
            if count and nearest.unknown.all():
                raise failure or BvhError(f'no row can be answered: NaN, or {LEAVES}')
            if tied := nearest.tied():
                nearest.settle(self.names(tied, timeout=min(left(deadline), NAMES_PATIENCE)))
            return nearest.answer()

        return self.ask(work, timeout)

    def _end_of_probe(self, region: int) -> float:
        """Until when a node is waited for: not long if it did not answer a moment ago."""
        now = time.monotonic()
        return now + PROBE if self.silent.get(region, 0.0) > now else np.inf


class _Question:
    """Some rows that one node is asked, once it is found, until a time of `time.monotonic`."""

    def __init__(
        self, client: BvhClient, region: int, rows: Rows, some: NDArray[np.int64], end: float
    ) -> None:
        self.region, self.some = region, some
        self.answer: Any = None
        self.failure: BvhError | None = None
        self._channels, self._rows, self._end = client.channels, rows, end
        self._pending: Pending | None = None

    def is_over(self) -> bool:
        """Whether there is an answer, or a failure, after waiting for a moment."""
        rest = left(self._end)
        try:
            if self._pending is None:
                channel = self._channels.open(self._rows.topic)
                self._channels.until_answered(channel, min(rest, SLICE))
                stamp = channel.stamp(self._rows.begin)
                message = self._rows.message(self.some, stamp)
                self._pending = self._channels.begin(self._rows.topic, message, rest, '', stamp)
            if not self._pending.is_done(min(left(self._end), SLICE)):
                raise BvhTimeoutError(f'no answer from {self._pending.whom}')
            self.answer = self._pending.result(0.0)
        except BvhTimeoutError as error:
            if rest > 0.0:
                return False
            if self._pending is not None:
                self._pending.forget()
                self._channels.open(self._rows.topic).forget_contact()
            self.failure = error
        except BvhError as error:
            self.failure = error
        return True
