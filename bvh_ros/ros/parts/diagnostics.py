# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`/diagnostics`: how the world, its sources and the answers are doing, once a second."""

from __future__ import annotations

import math
from collections.abc import Callable, Mapping, Sequence
from typing import TYPE_CHECKING, Protocol

from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue

from bvh_ros.ros.parts.part import NodePart
from bvh_ros.ros.world.survey import SceneStatistics, resident_bytes

if TYPE_CHECKING:
    import numpy as np
    from numpy.typing import NDArray
    from rclpy.node import Node

    from bvh_ros.ros.parts.refusals import Refused
    from bvh_ros.ros.parts.services import QueryServices
    from bvh_ros.ros.parts.timings import Timings
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.world.world import World

PERIOD = 1.0  # seconds
LOWEST, HIGHEST = 'lowest corner [m]', 'highest corner [m]'

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STOPPED = '/clock stands still: no lifetime ends, and no source grows older'


class Answerer(Protocol):
    """What answers rays by the thousand."""

    what: str
    refused: Refused
    answered: int  # rays
    timings: Timings


class Diagnostics(NodePart):
    """Publishes a status for the world, for the queries of each view and for each source.

    Parameters
    ----------
    queries : sequence of QueryServices
        One a view.
    answerers : sequence of Answerer
        Whatever else answers.
    features : callable
        Tells which parts are on and which are off.
    """

    def __init__(
        self,
        node: Node,
        world: World,
        queries: Sequence[QueryServices],
        answerers: Sequence[Answerer],
        features: Callable[[], Mapping[str, bool]],
    ) -> None:
        super().__init__(node)
        self._name = node.get_fully_qualified_name().lstrip('/')
        self._clock = node.get_clock()
        self._world = world
        self._survey = SceneStatistics(world)
        self._queries = queries
        self._answerers = answerers
        self._features = features
        self._refused_before: dict[str, int] = {}
        self._published_at = -1  # ns on the node's clock
        self._publisher = self.publisher(DiagnosticArray, '/diagnostics', 1)
        self.every(PERIOD, self.publish)

    def publish(self) -> None:
        """Publish the state as it is now."""
        now = self._clock.now()
        figures, seen = self._survey.look()
        problem = self._world.problem(now.nanoseconds)
        message = DiagnosticArray()
        message.header.stamp = now.to_msg()
        message.status = [
            self._world_status(figures, now.nanoseconds, problem),
            *(self._query_status(queries, seen, problem) for queries in self._queries),
            *(self._answerer_status(answerer, problem) for answerer in self._answerers),
            *(self._source_status(source, now.nanoseconds) for source in self._world.sources),
        ]
        self._published_at = now.nanoseconds
        self._publisher.publish(message)
        for queries in self._queries:
            queries.refused.log()
        for answerer in self._answerers:
            answerer.refused.log()
        for source in self._world.sources:
            source.refused.log()

    def _world_status(
        self, figures: Mapping[str, object], now: int, problem: str
    ) -> DiagnosticStatus:
        scene, features = self._world.scene, self._features()
        level, text = OK, f'{len(scene)} obstacles'
        if problem:
            level, text = ERROR, problem
        elif self._clock.ros_time_is_active and now == self._published_at:
            level, text = WARN, STOPPED
        values = {
            'obstacles': len(scene),
            **figures,
            **({} if scene.interrupted else _corners(*scene.tree_levels(0, 0, 1)[:2])),
            'expired': scene.expired,
            'bytes of the process': resident_bytes(),
            'on': ', '.join(name for name in features if features[name]),
            'off': ', '.join(name for name in features if not features[name]),
        }
        return self._status('world', level, text, values)

    def _query_status(
        self, queries: QueryServices, seen: Mapping[str, int], problem: str
    ) -> DiagnosticStatus:
        refused, view = queries.refused, queries.view.name
        name = f'queries of {view}' if view else 'queries'
        level, text = self._refused_since(name, refused.count, refused.last)
        if problem:
            level, text = ERROR, f'nothing is answered: {problem}'
        count = seen[view]
        nothing = f'no obstacle matches the view {view}' if view and not count else 'answering'
        values = {
            'obstacles seen': count,
            **_in_words(queries.timings, 'answers'),
            'refused': refused.count,
            'last reason': refused.last,
        }
        return self._status(name, level, text or nothing, values)

    def _answerer_status(self, answerer: Answerer, problem: str) -> DiagnosticStatus:
        refused = answerer.refused
        level, text = self._refused_since(answerer.what, refused.count, refused.last)
        if problem:
            level, text = ERROR, f'nothing is answered: {problem}'
        values = {
            **_in_words(answerer.timings, 'answers'),
            'rays answered': answerer.answered,
            'rays refused': refused.count,
            'last reason': refused.last,
        }
        return self._status(answerer.what, level, text or 'answering', values)

    def _source_status(self, source: Source, now: int) -> DiagnosticStatus:
        refused, subscription = source.refused, source.subscription
        level, text = self._refused_since(source.name, refused.count, refused.last)
        values: dict[str, object] = {
            'messages': source.messages,
            **_in_words(source.timings, 'updates'),
            'longest slice of an update [ms]': f'{1e3 * source.longest_slice:.3f}',
            'refused': refused.count,
            'last reason': refused.last,
            **refused.rows(),
            'points skipped': source.skipped,
        }
        if subscription is not None:
            publishers = subscription.publishers()
            values['topic'] = subscription.topic
            values['publishers'] = publishers
            values |= subscription.figures()
            if subscription.lost and source.completeness.missing():
                level, text = WARN, f'obstacles may be unknown: {source.completeness.missing()}'
            if source.has_spoken and not publishers:
                level, text = WARN, 'its publishers are gone; what they said is kept'
            if subscription.incompatible:
                level, text = WARN, subscription.incompatible
        if problem := source.problem(now):
            level, text = ERROR, problem
        listening = 'receiving' if source.has_spoken else 'has not spoken yet'
        return self._status(f'source {source.name}', level, text or listening, values)

    def _refused_since(self, who: str, count: int, last: str) -> tuple[bytes, str]:
        """Warn while something is being refused, not for ever after."""
        before = self._refused_before.get(who, 0)
        self._refused_before[who] = count
        return (WARN, f'refused {count - before}: {last}') if count > before else (OK, '')

    def _status(
        self, what: str, level: bytes, text: str, values: Mapping[str, object]
    ) -> DiagnosticStatus:
        return DiagnosticStatus(
            name=f'{self._name}: {what}',
            hardware_id='',
            level=level,
            message=text,
            values=[KeyValue(key=key, value=str(value)) for key, value in values.items()],
        )


def _corners(lo: NDArray[np.float64], hi: NDArray[np.float64]) -> dict[str, str]:
    """The root's corners: where the obstacles are, with the margin around them. Nothing where
    there is none.
    """
    return {
        key: ', '.join(f'{coordinate:.3f}' for coordinate in corner)
        for key, corners in ((LOWEST, lo), (HIGHEST, hi))
        for corner in corners
    }


def _in_words(timings: Timings, what: str) -> dict[str, str]:
    """Rate and, if anything happened, durations since the last look."""
    summary = timings.look()
    durations = {
        'p50 [ms]': summary.median,
        'p99 [ms]': summary.p99,
        'longest [ms]': summary.longest,
    }
    return {
        f'{what} a second': f'{summary.rate:.1f}',
        **{name: f'{took:.3f}' for name, took in durations.items() if not math.isnan(took)},
    }
