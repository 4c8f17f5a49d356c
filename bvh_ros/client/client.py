# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`BvhClient`: the services and batches of one bvh node, or of several."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from nav_msgs.srv import GetPlan
from numpy.typing import ArrayLike, NDArray
from rclpy.node import Node
from rclpy.task import Future

from bvh_ros.client import messages
from bvh_ros.client.messages import Batch, Clearances, Hit, Sweeps, length, place, request
from bvh_ros.client.node import OneNode
from bvh_ros.client.waiting import Waiting
from bvh_ros.ros.conversions.query_clouds import (
    EVERYTHING,
    FREE,
    UNANSWERED,
    Hits,
    Near,
    PathHits,
    Touched,
)
from bvh_ros.ros.conversions.rotations import IDENTITY as UPRIGHT
from bvh_ros.scene import Shapes
from bvh_ros.tree.access import checks


class BvhClient:
    """Calls the services of one bvh node, or of several that share a world.

    The plain calls wait for the answer, whether the node is being spun in another thread, now and
    then, or not at all, and in callbacks, too; there they hold up everything else, so the
    `_async` forms are better. Any thread may call, and a node may have several clients.

    Several nodes with a region each (their parameter) are queried as if they were one:

    - A query goes to the nodes whose region it meets. Their answers are merged: nearest
      first, equal distances by name, an obstacle of several regions once.
    - If one of these nodes does not answer, or the query leaves all regions, that is an error, in
      a batch an UNANSWERED row: what no node knows is not free.
    - Places are in the nodes' frame: there is no `frame_id`, no `stamp` and no `_async` form.
    - In batches `obstacles` are int64: a node's handle, and above its 32 bits the number of the
      node in the order of the names. So an obstacle of two regions has two numbers; `names` has
      both. `counts` are UNANSWERED where two nodes know some of the obstacles.
    - `nearest` without `max_distance` needs regions that reach to infinity, or as many obstacles
      as the nodes' `nearest_limit`.

    Parameters
    ----------
    node : rclpy.node.Node
        Your node.
    name : str, or sequence of str
        Name of the bvh node, with its namespace if that is not your own: `/robot1/bvh`; or the
        names of several.
    timeout : float
        Seconds that a plain call waits for its answer unless the call says otherwise.
    """

    def __init__(
        self, node: Node, name: str | Sequence[str] = 'bvh', *, timeout: float = 5.0
    ) -> None:
        self.node = node
        self.name: Any = name
        self.timeout = timeout
        self._waiting = Waiting(node)
        self._one = OneNode(node, name, self._waiting) if isinstance(name, str) else None
        if self._one is None:
            from bvh_ros.client.regions import SeveralNodes

            self._nodes: Any = SeveralNodes(node, name, self._waiting)
        else:
            self._nodes = self._one

    def wait_until_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node offers its services, and has compiled what they need.

        Raises
        ------
        BvhTimeoutError
            If it does not in time; the first start on a machine compiles for 20 to 40 s.
        """
        self._nodes.wait_until_ready(self._seconds(timeout))

    def wait_until_batches_are_ready(self, timeout: float = 60.0) -> None:
        """Wait until the node hears our rays and we hear its hits, or raise BvhTimeoutError."""
        self._nodes.wait_until_batches_are_ready(self._seconds(timeout))

    def regions(self) -> list[tuple[NDArray[np.float64], NDArray[np.float64]]]:
        """Return lower and upper corner of the region of each of several nodes, m."""
        if self._one is not None:
            raise ValueError('only several nodes have regions: give a sequence of names')
        coverage = self._nodes.coverage(self.timeout)
        return list(zip(coverage.lo, coverage.hi, strict=True))

    def names(self, obstacles: Iterable[int], *, timeout: float | None = None) -> dict[int, str]:
        """Return the names of node handles, as `raycast_many` returns them.

        Handles that stand for no obstacle are left out. The node sends names at most once a
        second; those of obstacles that have vanished since are missing after `timeout` seconds.

        Raises
        ------
        BvhTimeoutError
            If no names come at all.
        """
        handles = set(np.unique(messages.handles(obstacles)).tolist()) - {FREE, UNANSWERED}
        names: dict[int, str] = self._nodes.names(handles, self._seconds(timeout))
        return names

    # ---- one question

    def raycast(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: float | None = None,
        until: float | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Hit | None:
        """Return the first obstacle between `start` and `end`, or None: the segment is free.

        Parameters
        ----------
        start, end : sequence of 2 or 3 floats
            Metres; z is 0 if left out.
        radius : float
            Of a ball swept along the segment; 0 is a thin ray.
        at, until : time, optional
            An int in ns, or a float in s: the ball leaves `start` at `at` and reaches `end` at
            `until`, while those obstacles move whose source predicts; without `until` the world is
            as it is at `at`. None: as last reported.
        frame_id : str
            Frame of the coordinates, by default the node's.
        timeout : float, optional
            Seconds to wait for the answer.

        Raises
        ------
        BvhError
            If the node cannot answer, with its reason; BvhTimeoutError if it does not.
        ValueError
            If an argument has the wrong form.
        """
        segment = _segment(start, end, radius, at, until, frame_id)
        hits = self._hits('raycast', segment, timeout)
        return hits[0] if hits else None

    def raycast_all(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: float | None = None,
        until: float | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return every obstacle on the segment, nearest first; otherwise like `raycast`."""
        segment = _segment(start, end, radius, at, until, frame_id)
        return self._hits('raycast_all', segment, timeout)

    def overlap(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = UPRIGHT,
        tolerance: float = 0.0,
        *,
        at: float | None = None,
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
            As for `raycast`, which says what is raised, too.
        """
        box = _box(corner, opposite, orientation, tolerance, at, frame_id)
        return self._hits('overlap', box, timeout)

    def nearest(
        self,
        point: Sequence[float],
        max_distance: float = 0.0,
        *,
        at: float | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> list[Hit]:
        """Return the obstacles nearest to a point, nearest first: at most as many as the node's
        parameter `nearest_limit` says, and no farther than `max_distance` (m; 0: however far).

        Otherwise like `raycast`. The first question of all makes the node compile, and is
        answered by an error that begins with ``compiling``.
        """
        where, reach = place('point', point), length('max_distance', max_distance)
        return self._hits('nearest', request(where, where, reach, frame_id, at=at), timeout)

    def raycast_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: float | None = None,
        until: float | None = None,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast` does; return a future of its result, for use inside callbacks."""
        segment = _segment(start, end, radius, at, until, frame_id)
        return self._future('raycast', segment, messages.first_hit)

    def raycast_all_async(
        self,
        start: Sequence[float],
        end: Sequence[float],
        radius: float = 0.0,
        *,
        at: float | None = None,
        until: float | None = None,
        frame_id: str = '',
    ) -> Future:
        """Ask as `raycast_all` does; return a future of its result."""
        return self._future('raycast_all', _segment(start, end, radius, at, until, frame_id))

    def overlap_async(
        self,
        corner: Sequence[float],
        opposite: Sequence[float],
        orientation: Sequence[float] = UPRIGHT,
        tolerance: float = 0.0,
        *,
        at: float | None = None,
        frame_id: str = '',
    ) -> Future:
        """Ask as `overlap` does; return a future of its result."""
        box = _box(corner, opposite, orientation, tolerance, at, frame_id)
        return self._future('overlap', box)

    # ---- batches: a row a question, a row an answer

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
        origins, directions : array_like, shape (n, 3), or (n, 2) with z 0
            The rays ``origin + t * direction``, ``0 <= t <= t_max``. One of them may be one row:
            the same for all rays. A zero direction asks for the point. Where both arrays are
            float32, rays and hits travel so, in half the bytes.
        t_max : float or (n,) array_like
            In units of the directions: metres if these are unit vectors.
        mask : int or (n,) array_like
            Only obstacles whose own mask has a bit in common are hit.
        radius : float or (n,) array_like, optional
            Of balls that go along the rays, m; where it is above 0, t_max must be finite.
        at, until : int or (n,) array_like, optional
            An int in ns, or a float in s: when t is 0 and 1, see `raycast`. Where `until` is
            later, t_max must be finite.
        frame_id : str
            Frame of rays and hits, by default the node's.
        stamp : int, optional
            Time (ns) to transform another frame at, by default now. It also tells the answer from
            others, so it must not be used twice.
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
            If the node answers no row, with its reason if that holds for all questions (it starts
            and compiles, the frame is not known); BvhTimeoutError if it does not reply.
        ValueError
            If an argument has the wrong form, or the arrays do not fit together.
        """
        rays = messages.rays(origins, directions, t_max, mask, radius, at, until)
        hits: Hits = self._answers(rays, frame_id, timeout, stamp)
        return hits

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
        points : array_like, shape (n, 3), or (n, 2) with z 0
            m.
        max_distance, mask : one for all points, or (n,) array_like
            Obstacles that are farther away (m), or have no bit in common, are left out.
        at : int, float or (n,) array_like, optional
            ints in ns or floats in s: the world as it is then, see `raycast`.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.

        Returns
        -------
        Near
            `points` (n, 3) on the obstacles, `distances` (n,), `normals` (n, 3), `obstacles` (n,).
        """
        batch = messages.points(points, max_distance, mask, at)
        near: Near = self._answers(batch, frame_id, timeout)
        return near

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
        centers : array_like, shape (n, 3), or (n, 2) with z 0
            m.
        sizes : array_like, shape (n, 3), or one row for all, or a number
            Edge lengths, m; a third one that is left out is 0. One number is that of cubes.
        orientations : array_like, shape (n, 4), or (4,) for all, optional
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
        batch = messages.boxes(centers, sizes, orientations, tolerance, mask, at)
        touched: Touched = self._answers(batch, frame_id, timeout)
        return touched

    def check_path(
        self,
        positions: ArrayLike,
        orientations: ArrayLike | None = None,
        *,
        at: ArrayLike | None = None,
        frame_id: str = '',
        timeout: float | None = None,
        between: bool = False,
    ) -> Near | PathHits:
        """Return how far the node's `footprint` is from the nearest obstacle at n poses, by the
        topics `paths` and `path_hits`.

        Parameters
        ----------
        positions : array_like, shape (n, 3), or (n, 2) with z 0
            m.
        orientations : array_like, shape (n, 4), or (4,) for all, optional
            Quaternions x, y, z, w.
        at : int, float or (n,) array_like, optional
            ints in ns or floats in s: when the footprint is there; 0 is now, as is None.
        frame_id, timeout
            As of `raycast_many`, which says what is raised, too.
        between : bool
            Check the motion between the poses, too: for a node whose `path_between` is on. The
            footprint goes along straight lines and turns at constant rate; see
            `Scene.sweep_shape`. One node only.

        Returns
        -------
        Near
            As of `nearest_many`; where the footprint touches the obstacle, a distance is minus the
            depth, and the normal the shortest way out.
        PathHits, with `between`
            The same with `t` (n,), where the first contact is on the way from the pose before (0)
            to the pose (1): inf if both are free, 1 if the pose alone touches. Where a pose is
            free and the way to it is not, the obstacle is that of the way, at distance 0.

        Raises
        ------
        BvhError
            Also with `between`, if `path_between` of the node is off.
        """
        between = checks.flag('between', between)
        batch = messages.poses(positions, orientations, at, between=between)
        if between:
            self._only()
        answers: Near | PathHits = self._answers(batch, frame_id, timeout)
        return answers

    # ---- what only the typed services answer, see docs/typed_services.md; of one node

    def clearance_many(
        self,
        shapes: Shapes,
        max_distance: ArrayLike = np.inf,
        mask: ArrayLike = EVERYTHING,
        *,
        signed: bool = False,
        at: ArrayLike | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Clearances:
        """Return how far n shapes are from the nearest obstacle, by the service `query/clearance`.

        Parameters
        ----------
        shapes : bvh_ros.scene.Shapes
            Boxes, spheres, cylinders and capsules, n rows.
        max_distance, mask : one for all shapes, or (n,) array_like
            Obstacles that are farther away (m), or have no bit in common, are left out.
        signed : bool
            Where a shape and an obstacle overlap the distance is minus the depth, not 0.
        at : int, float or (n,) array_like, optional
            ints in ns or floats in s: the world as it is then, see `raycast`.
        frame_id : str
            Frame of all coordinates, by default the node's; transformed at the earliest time.
        timeout : float, optional
            Seconds to wait for the answer.

        Returns
        -------
        Clearances
            `obstacles` (n,), `distances` (n,), `shape_points` and `obstacle_points` (n, 3).

        Raises
        ------
        BvhError
            If the package bvh_msgs is not installed, or no row is answered, with the node's
            reason; BvhTimeoutError if the node does not answer, or does not offer the service.
        ValueError
            If an argument has the wrong form, or the client has several nodes.
        """
        node = self._only()
        question = messages.clearances(shapes, max_distance, mask, signed, at, frame_id)
        clearances: Clearances = node.typed_answers(question, self._seconds(timeout))
        return clearances

    def sweep_shape_many(
        self,
        shapes: Shapes,
        goal_positions: ArrayLike,
        goal_orientations: ArrayLike | None = None,
        tolerance: ArrayLike = 0.0,
        mask: ArrayLike = EVERYTHING,
        *,
        resolution: float = 1e-4,
        at: ArrayLike | None = None,
        until: ArrayLike | None = None,
        frame_id: str = '',
        timeout: float | None = None,
    ) -> Sweeps:
        """Return the first obstacles that n shapes touch from their poses to others, by the
        service `query/sweep`. The centre goes along a line, and the shape turns at constant rate.

        Parameters
        ----------
        shapes : bvh_ros.scene.Shapes
            Boxes, spheres, cylinders and capsules where they start, n rows.
        goal_positions : array_like, shape (n, 3), or (3,) for all
            m.
        goal_orientations : array_like, shape (n, 4), or (4,) for all, optional
            Quaternions x, y, z, w; None: those of the start.
        tolerance, mask : one for all shapes, or (n,) array_like
            The shapes are grown by `tolerance` all round, m.
        resolution : float
            m, above 0: what is not certainly farther away counts as contact.
        at, until : int, float or (n,) array_like, optional
            ints in ns or floats in s: when the shapes leave and arrive, see `raycast`.
        frame_id, timeout
            As of `clearance_many`, which says what is raised, too.

        Returns
        -------
        Sweeps
            `obstacles`, `t` and `free_until` (n,), `points` and `normals` (n, 3).
        """
        node = self._only()
        question = messages.sweeps(
            *(shapes, goal_positions, goal_orientations, tolerance, mask, resolution),
            *(at, until, frame_id),
        )
        sweeps: Sweeps = node.typed_answers(question, self._seconds(timeout))
        return sweeps

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
        rays = messages.rays(origins, directions, t_max, mask, radius, at, until)
        question = self._only().batch_question(
            rays, frame_id, messages.stamp(stamp), executor=self.node.executor
        )
        return self._waiting.keep_asking(question, self._seconds(None))

    # ---- what all calls share

    def _seconds(self, timeout: float | None) -> float:
        return checks.limit('timeout', self.timeout if timeout is None else timeout)

    def _hits(self, query: str, request: GetPlan.Request, timeout: float | None) -> list[Hit]:
        hits: list[Hit] = self._nodes.hits(query, request, self._seconds(timeout))
        return hits

    def _answers(
        self, batch: Batch, frame_id: str, timeout: float | None, stamp: int | None = None
    ) -> Any:
        return self._nodes.answers(
            batch, self._seconds(timeout), messages.frame(frame_id), messages.stamp(stamp)
        )

    def _future(self, query: str, request: GetPlan.Request, read: Any = messages.hits) -> Future:
        question = self._only().question(query, request, read, self.node.executor)
        return self._waiting.keep_asking(question, self._seconds(None))

    def _only(self) -> OneNode:
        if self._one is None:
            raise ValueError(
                'several nodes have no _async calls, no paths `between` poses, no clearances and '
                'no sweeps'
            )
        return self._one


def _segment(
    start: Sequence[float],
    end: Sequence[float],
    radius: float,
    at: float | None,
    until: float | None,
    frame_id: str,
) -> GetPlan.Request:
    ends = place('start', start), place('end', end)
    return request(*ends, length('radius', radius), frame_id, at=at, until=until)


def _box(
    corner: Sequence[float],
    opposite: Sequence[float],
    orientation: Sequence[float],
    tolerance: float,
    at: float | None,
    frame_id: str,
) -> GetPlan.Request:
    corners = place('corner', corner), place('opposite', opposite)
    return request(*corners, length('tolerance', tolerance), frame_id, orientation, at=at)
