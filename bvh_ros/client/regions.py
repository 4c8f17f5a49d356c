# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`BvhClient` for a world that several nodes share, a region each."""

from __future__ import annotations

import itertools
import math
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters
from rclpy.node import Node

from bvh_ros.client import client
from bvh_ros.client.errors import BvhError, BvhTimeoutError
from bvh_ros.client.plans import Hit

Box = tuple[NDArray[np.float64], NDArray[np.float64]]
SAME = 1e-9  # of the radius: what a ball touches where it starts


class RegionClient:
    """Calls the services of several bvh nodes as if they were one.

    Asks the nodes whose region (their parameter) the query meets, and merges what they say:
    nearest first, equal distances by name, an obstacle of several regions once. If one of them
    does not answer, or the query leaves all regions, that is an error: what nobody knows is not
    free.

    Made by ``BvhClient(node, names)``.
    """

    def __init__(self, node: Node, names: Sequence[str], timeout: float) -> None:
        if not names:
            raise ValueError('there must be a name of a bvh node at least')
        self.node = node
        self.timeout = timeout
        self._clients = [client.BvhClient(node, name, timeout=timeout) for name in names]
        self._regions: list[Box] | None = None

    def wait_until_ready(self, timeout: float = 60.0) -> None:
        """Wait until all nodes are ready; see `BvhClient.wait_until_ready`."""
        for one in self._clients:
            one.wait_until_ready(timeout)

    def regions(self) -> list[Box]:
        """Lower and upper corner of each node's region, m; asked for once."""
        if self._regions is None:
            self._regions = [self._region(one) for one in self._clients]
        return self._regions

    def raycast(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        timeout: float | None = None,
    ) -> Hit | None:
        """As `BvhClient.raycast`."""
        hits = self._along('raycast', start, end, radius, timeout)
        return hits[0] if hits else None

    def raycast_all(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        timeout: float | None = None,
    ) -> list[Hit]:
        """As `BvhClient.raycast_all`."""
        return self._along('raycast_all', start, end, radius, timeout)

    def overlap(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        timeout: float | None = None,
    ) -> list[Hit]:
        """As `BvhClient.overlap`."""
        a, b = _place(corner), _place(opposite)
        center = a * 0.5 + b * 0.5
        reach = abs(b - a) * 0.5
        if tuple(orientation) != (0.0, 0.0, 0.0, 1.0):  # whatever way it is turned
            reach = np.full(3, float(np.linalg.norm(reach)))
        reach = reach + tolerance
        replies = self._ask(
            (center - reach, center + reach),
            lambda one: one.overlap_async(corner, opposite, orientation, tolerance),
            timeout,
        )
        return _merged(replies, lambda hit: math.dist(hit.point, center))

    def _along(
        self,
        query: str,
        start: Sequence[float],
        end: Sequence[float],
        radius: float,
        timeout: float | None,
    ) -> list[Hit]:
        a, b = _place(start), _place(end)
        replies = self._ask(
            (np.minimum(a, b) - radius, np.maximum(a, b) + radius),
            lambda one: getattr(one, f'{query}_async')(start, end, radius),
            timeout,
        )
        return _merged(replies, lambda hit: _share(hit, a, b - a, radius))

    def _ask(self, box: Box, ask: Callable[[Any], Any], timeout: float | None) -> list[list[Hit]]:
        """Ask all nodes whose region touches a box at once; their hits."""
        timeout = self.timeout if timeout is None else timeout
        met = [
            one
            for one, (lo, hi) in zip(self._clients, self.regions(), strict=True)
            if (lo <= box[1]).all() and (hi >= box[0]).all()
        ]
        if not _covers(self.regions(), box):
            raise BvhError('the query leaves the regions of all nodes')
        answers = [(one, ask(one)) for one in met]
        hits = []
        for one, answer in answers:
            if not one.wait_for(answer, timeout):
                raise BvhTimeoutError(f"'{one.name}' did not answer within {timeout:g} s")
            found = answer.result()
            hits.append(found if isinstance(found, list) else [found] if found else [])
        return hits

    def _region(self, one: Any) -> Box:
        service = f'{one.name}/get_parameters'
        reply = one.call(GetParameters, service, GetParameters.Request(names=['region', 'planar']))
        region, planar = reply.values
        corners = np.array(region.double_array_value)
        if corners.shape != (6,):
            raise BvhError(f"'{one.name}' has no parameter 'region'")
        lo, hi = corners[:3], corners[3:]
        if planar.bool_value:  # who does not look at z knows all of it
            lo[2], hi[2] = -math.inf, math.inf
        return lo, hi


def _place(place: Sequence[float]) -> NDArray[np.float64]:
    if len(place) not in (2, 3):
        raise ValueError('a place has 2 or 3 coordinates')
    return np.array((*place, 0.0)[:3], np.float64)


def _share(hit: Hit, start: Any, way: Any, radius: float) -> float:
    """How much of the way is behind a ball where it meets an obstacle."""
    length = float(np.linalg.norm(way))
    if length == 0.0 or math.dist(hit.point, start) <= radius * (1.0 + SAME):
        return 0.0
    center = np.array(hit.point) + radius * np.array(hit.normal)
    return float((center - start) @ (way / length)) / length


def _merged(replies: list[list[Hit]], distance: Callable[[Hit], float]) -> list[Hit]:
    known = {hit.name: hit for hits in replies for hit in hits}
    return sorted(known.values(), key=lambda hit: (distance(hit), hit.name))


def _covers(regions: list[Box], box: Box) -> bool:
    """Whether every point of a box lies in a region: regions' faces cut it into cells, each in one
    or in none.
    """
    lo, hi = box
    cuts = [
        sorted({lo[axis], hi[axis], *_between(regions, axis, lo[axis], hi[axis])})
        for axis in range(3)
    ]
    spans = ([*itertools.pairwise(each)] or [(each[0], each[0])] for each in cuts)
    return all(
        any(
            all(low[i] <= cell[i][0] and cell[i][1] <= high[i] for i in range(3))
            for low, high in regions
        )
        for cell in itertools.product(*spans)
    )


def _between(regions: list[Box], axis: int, lo: float, hi: float) -> Iterator[float]:
    for corner in itertools.chain.from_iterable(regions):
        if lo < corner[axis] < hi:
            yield float(corner[axis])
