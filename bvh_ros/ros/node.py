# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The node: reads its parameters, joins sources, scene and services, and ends quietly."""

from __future__ import annotations

import sys
from typing import TYPE_CHECKING

import rclpy
from rclpy.clock import Clock, ClockType
from rclpy.exceptions import InvalidTopicNameException, ParameterException
from rclpy.executors import ExternalShutdownException, SingleThreadedExecutor
from rclpy.impl.implementation_singleton import rclpy_implementation
from rclpy.node import Node

from bvh_ros.ros.diagnostics import Diagnostics
from bvh_ros.ros.frames import Frames, tf2_lookup
from bvh_ros.ros.interrupts import Interrupts
from bvh_ros.ros.parameters import ConfigurationError, read_settings
from bvh_ros.ros.services import QueryServices, TriggerServices
from bvh_ros.ros.sources import SOURCE_TYPES, create_source
from bvh_ros.ros.warm_up import warm_up
from bvh_ros.scene import Scene
from bvh_ros.tree import compiling

if TYPE_CHECKING:
    from bvh_ros.ros.parameters import SourceSettings
    from bvh_ros.ros.sources.source import Source

EXPIRY_PERIOD = 0.1  # seconds; queries expire obstacles exactly, this frees what nobody asks about
QOS_PERIOD = 1.0  # seconds
WRONG_CONFIGURATION = 2  # exit code
RCLError = rclpy_implementation.RCLError  # what rcl says about arguments that it cannot read


class BvhNode(Node):
    """Keeps moving obstacles in a dynamic bounding volume hierarchy and answers queries.

    Raises
    ------
    ConfigurationError
        If a parameter cannot be used.
    """

    def __init__(self) -> None:
        super().__init__('bvh')
        settings = read_settings(self, {name: t.options for name, t in SOURCE_TYPES.items()})
        self.settings = settings
        if not compiling.is_warm():
            self.get_logger().info(
                'first start on this machine: compiling, about a minute; later starts take seconds'
            )
        self.scene = Scene(
            planar=settings.planar, margin=settings.margin, max_obstacles=settings.max_obstacles
        )
        lookup = tf2_lookup(self) if settings.use_tf else None
        self.frames = Frames(settings.frame_id, lookup)
        self.sources = [self._create_source(source) for source in settings.sources]

    def compile(self) -> None:
        """Compile the kernels that this configuration needs."""
        kinds = {kind for s in self.settings.sources for kind in SOURCE_TYPES[s.type].kinds}
        warm_up(
            planar=self.settings.planar,
            margin=self.settings.margin,
            kinds=kinds,
            log=self.get_logger().info,
        )

    def serve(self) -> None:
        """Listen to the sources and offer the services; every kernel is compiled by now."""
        for source in self.sources:
            self._subscribe(source)
        self.queries = QueryServices(self, self.scene, self.frames, self.sources)
        TriggerServices(self, self.scene, self.sources)
        Diagnostics(self, self.scene, self.queries, self.sources)
        # Real time: with simulated time these have to go on while nobody publishes /clock.
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(EXPIRY_PERIOD, self._expire, clock=steady)
        self.create_timer(QOS_PERIOD, self._check_qos, clock=steady)
        self.get_logger().info(self.in_words())

    def in_words(self) -> str:
        """Say what is served and which parts this scene uses."""
        settings = self.settings
        heard = ', '.join(
            f'{source.name} ({source.settings.type} on {source.subscription.topic})'
            for source in self.sources
            if source.subscription is not None
        )
        parts = {
            '2D tree of footprints' if settings.planar else '3D tree': True,
            f'margin of {settings.margin:g} m' if settings.margin else 'margin': settings.margin
            > 0.0,
            'tf2': self.frames.lookup is not None,
            'python-fcl until a turned or round shape is asked about': False,
        }
        on, off = (
            ', '.join(part for part in parts if parts[part] is used) for used in (True, False)
        )
        return (
            f"ready in frame '{settings.frame_id}'; sources: {heard or 'none'}; "
            f'on: {on}; off: {off}'
        )

    def _create_source(self, settings: SourceSettings) -> Source:
        try:
            self.resolve_topic_name(settings.topic)  # a wrong one is better known before compiling
        except (RuntimeError, InvalidTopicNameException) as error:
            raise ConfigurationError(f"source '{settings.name}': {error}") from error
        return create_source(self, settings, self.scene, self.frames)

    @staticmethod
    def _subscribe(source: Source) -> None:
        try:
            source.subscribe()
        except (RuntimeError, ParameterException) as error:  # QoS overrides that make no sense
            raise ConfigurationError(f"source '{source.name}': {error}") from error

    def _expire(self) -> None:
        self.scene.expire(self.get_clock().now().nanoseconds)

    def _check_qos(self) -> None:
        for source in self.sources:
            if source.subscription is not None:
                source.subscription.check()


def main(args: list[str] | None = None) -> int:
    """Run the node until Ctrl-C or SIGTERM; return the exit code."""
    interrupts = Interrupts()
    try:
        with interrupts.while_starting():
            rclpy.init(args=args)
            node = BvhNode()
            node.compile()
            node.serve()
            executor = SingleThreadedExecutor()
        rclpy.spin(node, executor)
    except ExternalShutdownException:
        pass
    except (ConfigurationError, RCLError) as error:
        # Where a signal has shut ROS down below us, an error is only its echo.
        if not interrupts.received:
            print(f'bvh_node: {error}', file=sys.stderr)
            return WRONG_CONFIGURATION
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == '__main__':
    sys.exit(main())
