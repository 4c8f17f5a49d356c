# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`BvhClient` for a world that several nodes share, a region each."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Iterable, Sequence
from typing import Any, TypeVar

import numpy as np
from numpy.typing import NDArray
from rclpy.node import Node

from bvh_ros.client import client, plans
from bvh_ros.client.batch import handles_of
from bvh_ros.client.coverage import Box, grown
from bvh_ros.client.errors import BvhError
from bvh_ros.client.layout import LEAVES, Layout, read_layout
from bvh_ros.client.merging import HANDLE_BITS
from bvh_ros.client.plans import Hit
from bvh_ros.client.region_batches import RegionBatches
from bvh_ros.client.waiting import left, results

SAME = 1e-9  # of the radius: what a ball touches where it starts
Answer = TypeVar('Answer')


class RegionClient(RegionBatches):
    """Asks several bvh nodes as if they were one.

    Asks the nodes whose region (their parameter) a query meets, one alone if that holds all of
    it, and merges what they say: nearest first, equal distances by name, an obstacle of several
    regions once. If one of them does not answer, or the query leaves all regions, that is an
    error, in a batch an UNANSWERED row: what nobody knows is not free. A node that was started
    again is asked for its region anew.

    In batches `obstacles` are int64: a node's handle, and above its 32 bits the number of the
    node in the order of the names. So an obstacle of two regions has two numbers; `names` tells.
    `counts` of what touches a box are UNANSWERED where two nodes know some of them each.

    Places are in the nodes' frame. Made by ``BvhClient(node, names)``.
    """

    def __init__(self, node: Node, names: Sequence[str], timeout: float) -> None:
        if not names:
            raise ValueError('there must be a name of a bvh node at least')
        self.node = node
        self.timeout = timeout
        self.clients = [client.BvhClient(node, name, timeout=timeout) for name in names]
        self.silent = {}
        self._layout: Layout | None = None

    def wait_until_ready(self, timeout: float = 60.0) -> None:
        """Wait until all nodes are ready; see `BvhClient.wait_until_ready`."""
        deadline = time.monotonic() + timeout
        for one in self.clients:
            one.wait_until_ready(left(deadline))

    def wait_until_batches_are_ready(self, timeout: float = 60.0) -> None:
        """See `BvhClient.wait_until_batches_are_ready`."""
        deadline = time.monotonic() + timeout
        for one in self.clients:
            one.wait_until_batches_are_ready(left(deadline))

    def regions(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Lower and upper corner of each node's region, m."""
        coverage = self.ask(lambda layout, _: layout.coverage, None)
        return list(zip(coverage.lo, coverage.hi, strict=True))

    def raycast(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: int | None = None,
        until: int | None = None,
        timeout: float | None = None,
    ) -> Hit | None:
        """As `BvhClient.raycast`."""
        hits = self._along('raycast', start, end, radius, (at, until), timeout)
        return hits[0] if hits else None

    def raycast_all(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: int | None = None,
        until: int | None = None,
        timeout: float | None = None,
    ) -> list[Hit]:
        """As `BvhClient.raycast_all`."""
        return self._along('raycast_all', start, end, radius, (at, until), timeout)

    def overlap(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        at: int | None = None,
        timeout: float | None = None,
    ) -> list[Hit]:
        """As `BvhClient.overlap`."""
        request = plans.request(corner, opposite, tolerance, '', orientation, (at, None))
        a, b = _place(corner), _place(opposite)
        center, box = a * 0.5 + b * 0.5, _box(a, b, 0.0)
        if any(orientation[:3]):  # whatever way it is turned
            box = _box(center, center, math.nextafter(math.dist(a, b) * 0.5, math.inf))
        replies = self._hits('overlap', request, grown(box, [_float32(tolerance)]), timeout)
        return _merged(replies, lambda hit: math.dist(hit.point, center))

    def nearest(
        self,
        point: Sequence[float],
        max_distance: float = 0.0,
        *,
        at: int | None = None,
        timeout: float | None = None,
    ) -> list[Hit]:
        """As `BvhClient.nearest`; without `max_distance`, regions must reach to infinity where
        fewer obstacles are known than the nodes' `nearest_limit`.
        """
        request = plans.request(point, point, max_distance, '', times=(at, None))
        place = _place(point)

        def far(hit: Hit) -> float:
            return math.dist(hit.point, place)

        def work(layout: Layout, deadline: float) -> list[Hit]:
            reach = _float32(max_distance) or math.inf
            met = layout.coverage.asked(_box(place, place, reach))[0]
            hits = _merged(self._replies('nearest', request, met, deadline), far)
            if len(hits) >= layout.nearest_limit:
                hits = hits[: layout.nearest_limit]
                reach = far(hits[-1])
            if not layout.coverage.covers(_box(place, place, reach))[0]:
                raise BvhError(LEAVES)
            return hits

        return self.ask(work, timeout)

    def names(self, obstacles: Iterable[int], *, timeout: float | None = None) -> dict[int, str]:
        """Names of the numbers that batches return; see `BvhClient.names`."""
        deadline = time.monotonic() + (self.timeout if timeout is None else timeout)
        numbers, names = handles_of(obstacles), dict[int, str]()
        for region, one in enumerate(self.clients):
            above = region << HANDLE_BITS
            handles = [n - above for n in numbers if n >> HANDLE_BITS == region]
            if handles:
                found = one.names(handles, timeout=left(deadline))
                names |= {above + handle: name for handle, name in found.items()}
        return names

    def _along(
        self,
        query: str,
        start: Sequence[float],
        end: Sequence[float],
        radius: float,
        times: tuple[int | None, int | None],
        timeout: float | None,
    ) -> list[Hit]:
        request = plans.request(start, end, radius, '', times=times)
        a, b = _place(start), _place(end)
        replies = self._hits(query, request, _box(a, b, _float32(radius)), timeout)
        return _merged(replies, lambda hit: _share(hit, a, b - a, radius))

    def _hits(self, query: str, request: Any, box: Box, timeout: float | None) -> list[list[Hit]]:
        """What the nodes say that know all that touches a box."""

        def work(layout: Layout, deadline: float) -> list[list[Hit]]:
            if not layout.coverage.covers(box)[0]:
                raise BvhError(LEAVES)
            return self._replies(query, request, layout.coverage.asked(box)[0], deadline)

        return self.ask(work, timeout)

    def _replies(
        self, query: str, request: Any, asked: NDArray[np.bool_], deadline: float
    ) -> list[list[Hit]]:
        asking = [self.clients[region].services for region in np.flatnonzero(asked)]
        pending = [each.begin(getattr(each, query), request) for each in asking]
        return [plans.all_hits(reply) for reply in results(pending, deadline)]

    def ask(self, work: Callable[[Layout, float], Answer], timeout: float | None) -> Answer:
        """Do what asks the nodes; again, if one of them was started again meanwhile: its region
        may be another one.
        """
        deadline = time.monotonic() + (self.timeout if timeout is None else timeout)
        while True:
            layout = self._layout = read_layout(self.clients, self._layout, deadline)
            try:
                answer = work(layout, deadline)
            except BvhError:
                if layout.is_current(self.clients):
                    raise
            else:
                if layout.is_current(self.clients):
                    return answer


def _place(place: Sequence[float]) -> NDArray[np.float64]:
    return np.array((*place, 0.0)[:3], np.float64)


def _box(a: NDArray[np.float64], b: NDArray[np.float64], reach: float) -> Box:
    """One row: the box with these corners, grown."""
    return grown((np.minimum(a, b)[None], np.maximum(a, b)[None]), [reach])


def _float32(length: float) -> float:
    """The larger of a length and what becomes of it in a request."""
    with np.errstate(over='ignore'):
        return max(float(length), float(np.float32(length)))


def _share(hit: Hit, start: Any, way: Any, radius: float) -> float:
    """How much of the way is behind a ball where it meets an obstacle."""
    length = float(np.linalg.norm(way))
    if length == 0.0 or math.dist(hit.point, start) <= radius * (1.0 + SAME):
        return 0.0
    center = np.array(hit.point) + radius * np.array(hit.normal)
    return float((center - start) @ (way / length)) / length


def _merged(replies: list[list[Hit]], distance: Callable[[Hit], float]) -> list[Hit]:
    """All obstacles once; those of one node stay in its order."""
    known: dict[str, Hit] = {}
    for hit in heapq.merge(*replies, key=lambda hit: (distance(hit), hit.name)):
        known.setdefault(hit.name, hit)
    return list(known.values())
