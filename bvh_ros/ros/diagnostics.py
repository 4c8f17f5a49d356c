# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`/diagnostics`: how the world and its sources are doing, once a second."""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from bvh_ros.ros.part import Part

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.services import QueryServices
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.world import World

PERIOD = 1.0  # seconds

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR


class Diagnostics(Part):
    """Publishes one status for the world, one for the queries and one for each source."""

    def __init__(self, node: Node, world: World, queries: QueryServices) -> None:
        super().__init__(node)
        self._name = node.get_fully_qualified_name()
        self._clock = node.get_clock()
        self._scene = world.scene
        self._queries = queries
        self._sources = world.sources
        self._refused_before: dict[str, int] = {}
        self._publisher = self.publisher(DiagnosticArray, '/diagnostics', 1)
        self.every(PERIOD, self.publish)

    def publish(self) -> None:
        """Publish the state as it is now."""
        now = self._clock.now()
        message = DiagnosticArray()
        message.header.stamp = now.to_msg()
        message.status = [
            self._world(),
            self._query_status(),
            *(self._source(source, now.nanoseconds) for source in self._sources),
        ]
        self._publisher.publish(message)

    def _world(self) -> DiagnosticStatus:
        return self._status('world', OK, f'{len(self._scene)} obstacles', self._scene.stats())

    def _query_status(self) -> DiagnosticStatus:
        refused = self._queries.refused
        level, text = self._refused_since('queries', refused.count, refused.last)
        values = {
            'answered': self._queries.answered,
            'refused': refused.count,
            'last reason': refused.last,
        }
        return self._status('queries', level, text or 'answering', values)

    def _source(self, source: Source, now: int) -> DiagnosticStatus:
        refused, subscription = source.refused, source.subscription
        level, text = self._refused_since(source.name, refused.count, refused.last)
        problem = source.problem(now)
        values: dict[str, object] = {
            'messages': source.messages,
            'refused': refused.count,
            'last reason': refused.last,
            'points skipped': source.skipped,
        }
        if subscription is not None:
            values['topic'] = subscription.topic
            values['publishers'] = subscription.publishers()
            values['reliability'] = subscription.qos.reliability.name.lower()
            if subscription.incompatible:
                level = WARN
                text = f'a publisher with incompatible {subscription.incompatible} is not heard'
        if problem:
            level, text = ERROR, problem
        return self._status(f'source {source.name}', level, text or 'receiving', values)

    def _refused_since(self, who: str, count: int, last: str) -> tuple[bytes, str]:
        """Warn while something is being refused, not for ever after."""
        before = self._refused_before.get(who, 0)
        self._refused_before[who] = count
        return (WARN, f'refused {count - before}: {last}') if count > before else (OK, '')

    def _status(
        self, what: str, level: bytes, text: str, values: Mapping[str, object]
    ) -> DiagnosticStatus:
        return DiagnosticStatus(
            name=f'{self._name.lstrip("/")}: {what}',
            hardware_id='',
            level=level,
            message=text,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )
