# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`BvhClient`: the services and batches of one bvh node."""

from __future__ import annotations

import time
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from nav_msgs.srv import GetPlan
from numpy.typing import ArrayLike
from rclpy.callback_groups import ReentrantCallbackGroup
from rclpy.client import Client
from rclpy.node import Node
from rclpy.task import Future

from bvh_ros.client import plans, volumes
from bvh_ros.client.batch import as_rays, handles_of
from bvh_ros.client.channels import Channels
from bvh_ros.client.errors import BvhError, BvhTimeoutError
from bvh_ros.client.plans import Hit
from bvh_ros.client.services import Services
from bvh_ros.client.waiting import Waiting
from bvh_ros.ros.conversions import ray_clouds
from bvh_ros.ros.conversions.query_clouds import Near, Touched
from bvh_ros.ros.conversions.ray_clouds import EVERYTHING, Hits

LOOK = 0.2  # seconds between two looks whether the node still compiles


class BvhClient:
    """Calls the services of one bvh node.

    The plain calls wait for the answer, whether the node is being spun in another thread, now and
    then, or not at all, and in callbacks, too; there they hold up everything else, so the
    `_async` forms are better. Any thread may call, and a node may have several clients.

    Parameters
    ----------
    node : rclpy.node.Node
        Your node.
    name : str, or sequence of str
        Name of the bvh node, with its namespace if that is not your own: `/robot1/bvh`. Of
        several nodes with a region each: a client of all of them, see `RegionClient`.
    timeout : float
        Seconds that a plain call waits for its answer unless it is told otherwise.
    """

    def __new__(
        cls, node: Node, name: str | Sequence[str] = 'bvh', *, timeout: float = 5.0
    ) -> Any:
        """Return a client of one node, or of several."""
        if isinstance(name, str):
            return super().__new__(cls)
        from bvh_ros.client.regions import RegionClient

        return RegionClient(node, name, timeout)

    def __init__(self, node: Node, name: str = 'bvh', *, timeout: float = 5.0) -> None:
        self.node = node
        self.name = name
        self.timeout = timeout
        # A group of their own: a callback that awaits an answer keeps the group it is in busy.
        group = ReentrantCallbackGroup()
        self._waiting = Waiting(node)
        self._services = Services(node, name, group, self._waiting)
        self._channels = Channels(node, name, group, self._waiting)

    def wait_until_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node offers its services, and has compiled what they need.

        Raises
        ------
        BvhTimeoutError
            If it does not in time; the first start on a machine compiles for half a minute.
        """
        deadline = time.monotonic() + timeout
        if not self._waiting.until(self._services.are_offered, timeout):
            raise BvhTimeoutError(f"no services of '{self.name}' after {timeout:g} s")
        while compiling := self._compiling(deadline - time.monotonic()):
            if time.monotonic() > deadline:
                raise BvhTimeoutError(f"'{self.name}' is still {compiling}")
            time.sleep(LOOK)

    def _compiling(self, timeout: float) -> str:
        """Ask a question that is answered once all are; say how far compiling has come."""
        try:
            self.raycast_all((0.0, 0.0), (0.0, 0.0), timeout=min(max(timeout, 0.0), LOOK))
        except BvhTimeoutError:
            return 'compiling, or busy'
        except BvhError as error:
            return str(error) if str(error).startswith(plans.COMPILING) else ''
        return ''

    def raycast(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
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
        frame_id : str
            Frame of the coordinates, by default the node's.
        timeout : float, optional
            Seconds to wait for the answer.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        """
        request = plans.request(start, end, radius, frame_id)
        return plans.first_hit(self._call(self._services.raycast, request, timeout))

    def raycast_all(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return every obstacle on the way, nearest first; otherwise like `raycast`."""
        request = plans.request(start, end, radius, frame_id)
        return plans.all_hits(self._call(self._services.raycast_all, request, timeout))

    def overlap(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
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
        frame_id, timeout
            As for `raycast`.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        """
        request = plans.request(corner, opposite, tolerance, frame_id, orientation)
        return plans.all_hits(self._call(self._services.overlap, request, timeout))

    def nearest(
        self,
        point: Sequence[float],
        max_distance: float = 0.0,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return the obstacles nearest to a point, nearest first: at most as many as the node's
        parameter `nearest_limit` says, and no farther than `max_distance` (m; 0: however far).

        Otherwise like `raycast`. The first question of all makes the node compile, and is
        answered by an error that begins with ``compiling``.
        """
        request = plans.request(point, point, max_distance, frame_id)
        return plans.all_hits(self._call(self._services.nearest, request, timeout))

    def raycast_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast` does; return a future of its result, for use inside callbacks."""
        request = plans.request(start, end, radius, frame_id)
        return self._services.ask(self._services.raycast, request, plans.first_hit)

    def raycast_all_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast_all` does; return a future of its result."""
        request = plans.request(start, end, radius, frame_id)
        return self._services.ask(self._services.raycast_all, request, plans.all_hits)

    def overlap_async(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = (0.0, 0.0, 0.0, 1.0),
        tolerance: float = 0.0,
        *,
        frame_id: str = '',
    ) -> Future:
        """Ask as `overlap` does; return a future of its result."""
        request = plans.request(corner, opposite, tolerance, frame_id, orientation)
        return self._services.ask(self._services.overlap, request, plans.all_hits)

    def raycast_many(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        radius: ArrayLike | None = None,
        frame_id: str = '',
        stamp: int | None = None,
        timeout: float | None = None,
    ) -> Hits:
        """Return the first obstacles on n rays, by the node's topics `rays` and `ray_hits`.

        Parameters
        ----------
        origins, directions : array_like, shape (n, 3)
            The rays ``origin + t * direction``, ``0 <= t <= t_max``. A zero direction asks for the
            point. Where both arrays are float32, rays and hits travel so, in half the bytes.
        t_max : float or (n,) array_like
            In units of the directions: metres if these are unit vectors.
        mask : int or (n,) array_like
            Only obstacles whose own mask has a bit in common are seen.
        radius : float or (n,) array_like, optional
            Of balls that go along the rays, m; where it is above 0, t_max ends the way.
        frame_id : str
            Frame of rays and hits, by default the node's.
        stamp : int, optional
            Time (ns) to transform another frame at, by default now; also what tells the answer
            from others, so it must not be used twice.
        timeout : float, optional
            Seconds to wait for the answer.

        Returns
        -------
        Hits
            `obstacles` (n,): node handles (see `names`), FREE or, for a row that cannot be
            answered (NaN), UNANSWERED; `t` (n,); `points` and `normals` (n, 3).

        Raises
        ------
        BvhError
            If the node answers no row; BvhTimeoutError if it does not reply.
        ValueError
            If the arrays do not fit together.
        """
        cloud = ray_clouds.rays_cloud(as_rays(origins, directions, t_max, mask, radius))
        timeout = self.timeout if timeout is None else timeout
        return self._channels.ask(self._channels.rays(), cloud, frame_id, stamp, timeout)

    def nearest_many(
        self,
        points: ArrayLike,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Near:
        """Return the obstacles nearest to n points, by the topics `points` and `nearest_hits`.

        Parameters
        ----------
        points : array_like, shape (n, 3)
            m.
        max_distance, mask : one for all points, or (n,) array_like
            Obstacles that are farther away (m), or are not seen, are left out.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.

        Returns
        -------
        Near
            `points` (n, 3) on the obstacles, `distances` (n,), `normals` (n, 3), `obstacles` (n,).
        """
        asked = volumes.points(points, max_distance, mask)
        return self._ask_volumes('points', 'nearest_hits', asked, frame_id, timeout)

    def overlap_many(
        self,
        centers: ArrayLike,
        sizes: ArrayLike,
        orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = EVERYTHING,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Touched:
        """Return what touches n turned boxes, by the topics `boxes` and `box_hits`.

        Parameters
        ----------
        centers : array_like, shape (n, 3)
            m.
        sizes : array_like, shape (n, 3), or (3,) for all
            Edge lengths, m.
        orientations : array_like, shape (n, 4), optional
            Quaternions x, y, z, w.
        tolerance, mask : one for all boxes, or (n,) array_like
            The boxes are grown by `tolerance` all round, m.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.

        Returns
        -------
        Touched
            Of the obstacle nearest to each centre `points` (n, 3), `distances` (n,) and
            `obstacles` (n,); and `counts` (n,), how many touch the box.
        """
        asked = volumes.boxes(centers, sizes, orientations, tolerance, mask)
        return self._ask_volumes('boxes', 'box_hits', asked, frame_id, timeout)

    def check_path(
        self,
        positions: ArrayLike,
        orientations: ArrayLike | None = None,
        *,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Near:
        """Return how far the node's `footprint` is from the nearest obstacle at n poses, by the
        topics `paths` and `path_hits`.

        Parameters
        ----------
        positions : array_like, shape (n, 3)
            m.
        orientations : array_like, shape (n, 4), optional
            Quaternions x, y, z, w.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.

        Returns
        -------
        Near
            As of `nearest_many`; a distance is 0 where the footprint touches the obstacle.
        """
        asked = volumes.path(positions, orientations)
        return self._ask_volumes('paths', 'path_hits', asked, frame_id, timeout)

    def raycast_many_async(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        frame_id: str = '',
        stamp: int | None = None,
    ) -> Future:
        """Ask as `raycast_many` does; return a future of its result.

        `wait_until_batches_are_ready` first: what is asked before the node listens is lost.
        """
        cloud = ray_clouds.rays_cloud(as_rays(origins, directions, t_max, mask))
        return self._channels.rays().ask(cloud, cloud.width, frame_id, stamp, self.node.executor)

    def wait_until_batches_are_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node hears our rays and we hear its hits, or raise BvhTimeoutError."""
        self._channels.until_answered(self._channels.rays(), timeout)

    def names(self, obstacles: Iterable[int], *, timeout: float | None = None) -> dict[int, str]:
        """Return the names of node handles, as `raycast_many` returns them.

        Handles that stand for no obstacle are left out. The node tells names at most once a
        second; those of obstacles that have vanished since are missing after `timeout` seconds.

        Raises
        ------
        BvhTimeoutError
            If no names are told at all.
        """
        timeout = self.timeout if timeout is None else timeout
        return self._channels.find_names(handles_of(obstacles), timeout)

    def wait_for(self, answer: Future, timeout: float) -> bool:
        """Wait for what an `_async` call returned; whether it is there."""
        self._waiting.check()
        return self._waiting.until_done(answer, timeout)

    def call(self, kind: Any, service: str, request: Any) -> Any:
        """Call any other service of the node once; BvhTimeoutError without an answer."""
        return self._services.once(kind, service, request, self.timeout)

    def _ask_volumes(
        self, asked: str, told: str, message: Any, frame_id: str, timeout: float | None
    ) -> Any:
        """Ask by other topics than those of rays."""
        timeout = self.timeout if timeout is None else timeout
        channel = self._channels.open(asked, told, volumes.readers[told], type(message))
        return self._channels.ask(channel, message, frame_id, None, timeout)

    def _call(
        self, client: Client, request: GetPlan.Request, timeout: float | None
    ) -> GetPlan.Response:
        return self._services.call(client, request, self.timeout if timeout is None else timeout)
