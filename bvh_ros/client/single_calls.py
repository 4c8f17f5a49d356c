# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Single questions, by the services of a bvh node."""

from __future__ import annotations

from collections.abc import Sequence

from nav_msgs.srv import GetPlan
from rclpy.client import Client
from rclpy.task import Future

from bvh_ros.client import plans
from bvh_ros.client.plans import Hit
from bvh_ros.client.services import Services


class SingleCalls:
    """`raycast`, `raycast_all`, `overlap` and `nearest`, each for one question."""

    timeout: float
    services: Services

    def raycast(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: int | None = None,
        until: int | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Hit | None:
        """Return the first obstacle on the way from `start` to `end`, or None: the way is free.

        Parameters
        ----------
        start, end : sequence of 2 or 3 floats
            Metres; z is 0 if left out.
        radius : float
            Of a ball swept along the way; 0 is a thin ray.
        at, until : int, optional
            ns: `start` is left at `at`, and `end` reached at `until`, while obstacles move whose
            source predicts; without `until` the world is asked for as it is at that time. None: as
            last told.
        frame_id : str
            Frame of the coordinates, by default the node's.
        timeout : float, optional
            Seconds to wait for the answer.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        """
        request = plans.request(start, end, radius, frame_id, times=(at, until))
        return plans.first_hit(self._call(self.services.raycast, request, timeout))

    def raycast_all(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: int | None = None,
        until: int | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return every obstacle on the way, nearest first; otherwise like `raycast`."""
        request = plans.request(start, end, radius, frame_id, times=(at, until))
        return plans.all_hits(self._call(self.services.raycast_all, request, timeout))

    def overlap(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        at: int | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return every obstacle that touches a box, nearest to the box's centre first.

        Parameters
        ----------
        corner, opposite : sequence of 2 or 3 floats
            Opposite corners of the box; the same twice for a ball.
        orientation : sequence of 4 floats
            Directions of the box's axes as a quaternion x, y, z, w.
        tolerance : float
            Metres by which the box is grown all round, its corners rounded.
        at, frame_id, timeout
            As for `raycast`.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        """
        request = plans.request(*(corner, opposite, tolerance, frame_id, orientation), (at, None))
        return plans.all_hits(self._call(self.services.overlap, request, timeout))

    def nearest(
        self,
        point: Sequence[float],
        max_distance: float = 0.0,
        *,
        at: int | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return the obstacles nearest to a point, nearest first: at most as many as the node's
        parameter `nearest_limit` says, and no farther than `max_distance` (m; 0: however far).

        Otherwise like `raycast`. The first question of all makes the node compile, and is
        answered by an error that begins with ``compiling``.
        """
        request = plans.request(point, point, max_distance, frame_id, times=(at, None))
        return plans.all_hits(self._call(self.services.nearest, request, timeout))

    def raycast_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: int | None = None,
        until: int | None = None,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast` does; return a future of its result, for use inside callbacks."""
        request = plans.request(start, end, radius, frame_id, times=(at, until))
        return self.services.ask(self.services.raycast, request, plans.first_hit, self.timeout)

    def raycast_all_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: int | None = None,
        until: int | None = None,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast_all` does; return a future of its result."""
        request = plans.request(start, end, radius, frame_id, times=(at, until))
        return self.services.ask(self.services.raycast_all, request, plans.all_hits, self.timeout)

    def overlap_async(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        at: int | None = None,
        frame_id: str = '',
    ) -> Future:
        """Ask as `overlap` does; return a future of its result."""
        request = plans.request(*(corner, opposite, tolerance, frame_id, orientation), (at, None))
        return self.services.ask(self.services.overlap, request, plans.all_hits, self.timeout)

    def _call(
        self, client: Client, request: GetPlan.Request, timeout: float | None
    ) -> GetPlan.Response:
        return self.services.call(client, request, self.timeout if timeout is None else timeout)
