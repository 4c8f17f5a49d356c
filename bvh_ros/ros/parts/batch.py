# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`~/rays` to `~/ray_hits`: many rays in one message, answered row for row."""

from __future__ import annotations

import time
from typing import TYPE_CHECKING

import numpy as np
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr import point_cloud2 as decoder
from bvh_ros.ros.cdr.point_cloud2 import PointCloud
from bvh_ros.ros.conversions import ray_clouds
from bvh_ros.ros.conversions.ray_clouds import Hits, Rays
from bvh_ros.ros.parts.part import Part
from bvh_ros.ros.parts.refusals import Refused, explain
from bvh_ros.ros.parts.timings import Timings
from bvh_ros.ros.qos import DEPTH
from bvh_ros.ros.sources.subscribing import FollowingSubscription

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.parts.query_drawing import QueryDrawing
    from bvh_ros.ros.world.frames import Transform
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import Scene

QOS_PERIOD = 1.0  # seconds


class RayBatch(Part):
    """Answers each cloud of rays by a cloud of hits, in the request's frame and of its shape.

    A row that cannot be answered (NaN, infinite, negative t_max), and each row of a cloud that
    cannot be answered (wrong fields, unknown frame, a required source missing), has the obstacle
    0xFFFFFFFE and t = NaN. A cloud whose size cannot be believed gets one such row.

    Parameters
    ----------
    node : rclpy.node.Node
    world : World
        Asked before each answer whether it is complete.
    view : View
        What these rays see, of that what each row's mask asks for, and the name of the topics.
    drawing : QueryDrawing
        Is told of rays and hits while somebody looks.
    """

    def __init__(self, node: Node, world: World, view: View, drawing: QueryDrawing) -> None:
        super().__init__(node)
        self.view = view
        self.refused = Refused(node.get_logger(), view.topic('rays'))
        self.what = f'rays of {view.name}' if view.name else 'rays'
        self.answered = 0  # rays
        self.timings = Timings()
        self._world = world
        self._drawing = drawing
        self._publisher = self.publisher(PointCloud2, view.topic('ray_hits'), DEPTH)
        subscription = FollowingSubscription(
            node, PointCloud2, view.topic('rays'), self.receive, ordered=False, raw=True
        )
        self._close.append(subscription.destroy)
        self.every(QOS_PERIOD, subscription.check)

    def receive(self, serialised: bytes) -> None:
        """Answer one cloud."""
        began = time.perf_counter_ns()
        try:
            request = decoder.read(serialised)
        except ValueError as error:  # from whom, and what was asked, is not known
            self.refused.add(str(error))
            return
        try:
            self._publish(self._reply(request), request)
            self.timings.add(began)
            return
        except ValueError as error:
            reason = str(error)
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = explain(error)
        # Not earlier: an error holds in memory whatever its function was working on.
        self._publish(self._refusal(request, reason), request)
        self.timings.add(began)

    def _publish(self, reply: PointCloud2, request: PointCloud) -> None:
        seconds, rest = divmod(request.stamp, 1_000_000_000)
        reply.header.stamp.sec, reply.header.stamp.nanosec = seconds, rest
        reply.header.frame_id = request.frame_id
        self._publisher.publish(reply)

    def _reply(self, request: PointCloud) -> PointCloud2:
        scene = self._world.at(self.node.get_clock().now().nanoseconds)
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        rays = ray_clouds.rays(request)
        if transform is not None:
            rays = moved(transform, rays)
        hits = self._answer(scene, rays)
        if self._drawing.is_watched:
            self._drawing.add_rays(rays, hits)
        if transform is not None:
            hits = moved_back(transform, hits)
        return ray_clouds.hits_cloud(hits, request.height, request.width, rays.real)

    def _answer(self, scene: Scene, rays: Rays) -> Hits:
        bad, reason = rays.fault()
        refused = int(np.count_nonzero(bad))
        self.answered += len(bad) - refused
        if not refused:
            return self._cast(scene, rays)
        self.refused.add(reason, refused)
        hits = Hits.unanswered(len(bad))
        return hits.put(~bad, self._cast(scene, rays.take(~bad)))

    def _cast(self, scene: Scene, rays: Rays) -> Hits:
        view = self.view
        masks = rays.masks & np.uint32(view.mask)
        return Hits(
            *scene.raycast_many(rays.origins, rays.directions, rays.t_max, masks, view.skip_inside)
        )

    def _refusal(self, request: PointCloud, reason: str) -> PointCloud2:
        height, width = ray_clouds.rows_of(request)
        self.refused.add(reason, height * width)
        return ray_clouds.hits_cloud(
            Hits.unanswered(height * width), height, width, np.dtype(np.float32)
        )


def moved(transform: Transform, rays: Rays) -> Rays:
    """Return rays in the node's frame; lengths, and with them t, are the same there."""
    with np.errstate(over='ignore', invalid='ignore'):  # rows that leave the doubles are refused
        return rays._replace(
            origins=transform.points(rays.origins), directions=transform.vectors(rays.directions)
        )


def moved_back(transform: Transform, hits: Hits) -> Hits:
    """Return hits in the frame that the rays came from."""
    back = transform.inverse()
    with np.errstate(over='ignore', invalid='ignore'):
        return hits._replace(points=back.points(hits.points), normals=back.vectors(hits.normals))
