# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions in batches, by the topics of a bvh node."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike
from rclpy.node import Node
from rclpy.task import Future

from bvh_ros.client import volumes
from bvh_ros.client.batch import as_rays, earliest, since, with_times
from bvh_ros.client.channels import Channels
from bvh_ros.client.waiting import Waiting
from bvh_ros.ros.conversions import ray_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Near, Points, Touched
from bvh_ros.ros.conversions.ray_clouds import EVERYTHING, Hits, Rays


class BatchCalls:
    """`raycast_many` and its kin: a row a question, a row an answer."""

    node: Node
    timeout: float
    channels: Channels
    waiting: Waiting

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
        at, until : int or (n,) array_like, optional
            ns: when t is 0 and 1, see `raycast`. Where `until` is after `at`, t_max ends the ray.
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
        rays, stamp = self._timed(
            as_rays(origins, directions, t_max, mask, radius), at, until, frame_id, stamp
        )
        return self._ask('rays', ray_clouds.rays_cloud(rays), frame_id, stamp, timeout)

    def nearest_many(
        self,
        points: ArrayLike,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        at: ArrayLike | None = None,
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
        at : int or (n,) array_like, optional
            ns: the world as it is then, see `raycast`.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.

        Returns
        -------
        Near
            `points` (n, 3) on the obstacles, `distances` (n,), `normals` (n, 3), `obstacles` (n,).
        """
        asked = volumes.points(points, max_distance, mask)
        return self._ask('points', *self._at('points', asked, at, frame_id), timeout)

    def overlap_many(
        self,
        centers: ArrayLike,
        sizes: ArrayLike,
        orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = EVERYTHING,
        *,
        at: ArrayLike | None = None,
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
        at, frame_id, timeout
            As of `nearest_many`.

        Returns
        -------
        Touched
            Of the obstacle nearest to each centre `points` (n, 3), `distances` (n,) and
            `obstacles` (n,); and `counts` (n,), how many touch the box.
        """
        asked = volumes.boxes(centers, sizes, orientations, tolerance, mask)
        return self._ask('boxes', *self._at('boxes', asked, at, frame_id), timeout)

    def check_path(
        self,
        positions: ArrayLike,
        orientations: ArrayLike | None = None,
        *,
        at: ArrayLike | None = None,
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
        at : int or (n,) array_like, optional
            ns: when somebody is there; 0 is now, as is None.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.

        Returns
        -------
        Near
            As of `nearest_many`; where the footprint touches the obstacle, a distance is minus the
            depth, and the normal the shortest way out.
        """
        asked = volumes.path(*volumes.poses(positions, orientations), at)
        return self._ask('paths', asked, frame_id, None, timeout)

    def raycast_many_async(
        self,
        origins: ArrayLike,
        directions: ArrayLike,
        t_max: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        radius: ArrayLike | None = None,
        at: ArrayLike | None = None,
        until: ArrayLike | None = None,
        frame_id: str = '',
        stamp: int | None = None,
    ) -> Future:
        """Ask as `raycast_many` does; return a future of its result.

        While no answer comes, the rays are published again for the client's `timeout`.
        """
        rays, stamp = self._timed(
            as_rays(origins, directions, t_max, mask, radius), at, until, frame_id, stamp
        )
        cloud = ray_clouds.rays_cloud(rays)
        answer, question = self.channels.open('rays').ask(
            cloud, frame_id, stamp, self.node.executor
        )
        self.waiting.ask_again(answer, question, self.timeout)
        return answer

    def _timed(
        self,
        rays: Rays,
        at: ArrayLike | None,
        until: ArrayLike | None,
        frame_id: str,
        stamp: int | None,
    ) -> tuple[Rays, int | None]:
        """Rays with their times, and the stamp of their cloud, which these count from."""
        if at is None and until is None:
            return rays, stamp
        stamp = self._stamp('rays', at, len(rays.t_max), frame_id) if stamp is None else stamp
        return with_times(rays, at, until, stamp), stamp

    def _stamp(self, what: str, at: ArrayLike | None, count: int, frame_id: str) -> int:
        """The stamp of rows with times: near these, to keep their nanoseconds, but near the clock
        in another frame, which is transformed at the stamp.
        """
        return self.channels.open(what).stamp(None if frame_id else earliest(at, count))

    def _at(
        self, what: str, asked: Points | Boxes, at: ArrayLike | None, frame_id: str
    ) -> tuple[Any, str, int | None]:
        """The cloud of what is asked about times in ns, its frame, and its stamp, which these
        count from.
        """
        if at is None:
            return volumes.cloud(asked), frame_id, None
        stamp = self._stamp(what, at, len(asked.places), frame_id)
        given = asked._replace(since=since(at, stamp, len(asked.places)))
        return volumes.cloud(given), frame_id, stamp

    def wait_until_batches_are_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node hears our rays and we hear its hits, or raise BvhTimeoutError."""
        self.channels.until_answered(self.channels.open('rays'), timeout)

    def _ask(
        self, what: str, message: Any, frame_id: str, stamp: int | None, timeout: float | None
    ) -> Any:
        timeout = self.timeout if timeout is None else timeout
        return self.channels.begin(what, message, timeout, frame_id, stamp).result(timeout)
