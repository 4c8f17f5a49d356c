# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the node says about itself and its obstacles, and what it does now and then."""

from __future__ import annotations

import math
import resource
import struct
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus, KeyValue
from rclpy.serialization import serialize_message

from bvh_ros.ros.parts.part import QOS_PERIOD, Answerer, NodePart, OnDemandPublisher

if TYPE_CHECKING:
    from numpy.typing import NDArray
    from rclpy.node import Node

    from bvh_ros.ros.parts.services import QueryServices
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.texts import Timings
    from bvh_ros.ros.world.world import World

SHARE = 0.01  # of the time may go into surveys
TURN = 0.01  # seconds after which the rest is left for the next look
DONE = object()


class SceneStatistics:
    """Looks at the whole world, so seldom that it takes at most a hundredth of the time, and with
    many views bit by bit.

    The cost of a tree is among the figures of up to 100,000 obstacles: that of 10^6 takes 55 ms.
    `~/rebuild` and `~/validate` reply it.
    """

    def __init__(self, world: World) -> None:
        self._world = world
        self._work: Iterator[None] | None = None
        self._spent = 0.0  # s on the look that is being taken
        self._figures: dict[str, Any] = {}
        self._visible = dict.fromkeys((view.name for view in world.views), 0)
        self._taken = -float('inf')
        self._due = -float('inf')

    def look(self) -> tuple[dict[str, Any], dict[str, int]]:
        """Return the figures of the scene, and how many obstacles each view shows."""
        began = time.monotonic()
        if self._work is None and began >= self._due:
            self._work, self._spent = self._take(), 0.0
        while self._work is not None:
            if next(self._work, DONE) is DONE:
                self._work, self._taken = None, time.monotonic()
                spent = self._spent + self._taken - began
                self._due = self._taken + spent / SHARE
            elif self._figures and time.monotonic() - began > TURN:
                break
        now = time.monotonic()
        self._spent += now - began
        return {
            **self._figures,
            'age of these figures': f'{now - self._taken:.1f} s',
        }, self._visible

    def _take(self) -> Iterator[None]:
        if self._world.scene.interrupted:
            return  # its content is unknown
        visible = {}
        for view in self._world.views:
            visible[view.name] = self._world.scene.count(view.mask)
            yield
        self._figures, self._visible = self._take_figures(), visible

    def _take_figures(self) -> dict[str, Any]:
        scene = self._world.scene
        stats = scene.figures()
        tree = stats['tree']
        return {
            **{f'obstacles of {name}': count for name, count in stats['sources'].items()},
            'height': stats['height'],
            **_costs(stats['cost'], tree['cost_when_built']),
            'turned or round obstacles': stats['shaped'],
            'different meshes': stats['meshes'],
            'obstacles with a lifetime': stats['mortal'],
            'bytes of the tree': tree['bytes'] + tree['snapshot_bytes'],
            'bytes of the scene': stats['bytes'],
            'pairs of true shapes compared': stats['pairs_compared'],
            'of these with more digits': stats['pairs_in_more_digits'],
            'node handles left': stats['node_handles_left'],
        }


def resident_bytes() -> int | None:
    """Return how much memory this process occupies; None where the system does not say."""
    try:
        pages = int(Path('/proc/self/statm').read_text().split()[1])
    except OSError:
        return None
    return pages * resource.getpagesize()


def _costs(cost: float, when_built: float) -> dict[str, str]:
    if math.isnan(cost):
        return {'cost': 'of so many obstacles ~/validate replies it'}
    ratio = f'{cost / when_built:.3f}' if when_built > 0.0 else 'never built at once'
    return {'cost': f'{cost:.4g}', 'cost over that of the last build': ratio}


# What has to be done again and again.

# Queries expire obstacles exactly. This frees their memory where there are no queries.
EXPIRY_PERIOD = 0.1  # seconds


class Maintenance(NodePart):
    """Removes obstacles whose time is over, and follows what publishers offer."""

    def __init__(self, node: Node, world: World) -> None:
        super().__init__(node)
        self._world = world
        self._turn = node.create_guard_condition(self._expire)
        self._close.append(lambda: node.destroy_guard_condition(self._turn))
        self.every(EXPIRY_PERIOD, self._expire)
        self.every(QOS_PERIOD, self._check_qos)

    def _expire(self) -> None:
        if self._world.expire(self.node.get_clock().now().nanoseconds):
            self._turn.trigger()

    def _check_qos(self) -> None:
        for source in self._world.sources:
            if source.subscription is not None:
                source.subscription.check()


# `/diagnostics`: how the world, its sources and the answers are doing, once a second.

PERIOD = 1.0  # seconds
LOWEST, HIGHEST = 'lowest corner [m]', 'highest corner [m]'

OK, WARN, ERROR = DiagnosticStatus.OK, DiagnosticStatus.WARN, DiagnosticStatus.ERROR
STOPPED = '/clock stands still: no lifetime ends, and no source grows older'


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
        figures, visible = self._survey.look()
        problem = self._world.problem(now.nanoseconds)
        message = DiagnosticArray()
        message.header.stamp = now.to_msg()
        message.status = [
            self._world_status(figures, now.nanoseconds, problem),
            *(self._query_status(queries, visible, problem) for queries in self._queries),
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
        self, queries: QueryServices, visible: Mapping[str, int], problem: str
    ) -> DiagnosticStatus:
        refused, view = queries.refused, queries.view.name
        level, text = self._refused_since(queries.what, refused.count, refused.last)
        if problem:
            what = 'only thin rays are' if problem == self._world.compiling else 'nothing is'
            level, text = ERROR, f'{what} answered: {problem}'
        count = visible[view]
        nothing = f'no obstacle matches the view {view}' if view and not count else 'answering'
        values = {
            'obstacles seen': count,
            **_in_words(queries.timings, 'answers'),
            'refused': refused.count,
            'last reason': refused.last,
        }
        return self._status(queries.what, level, text or nothing, values)

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

    def _refused_since(self, part: str, count: int, last: str) -> tuple[bytes, str]:
        """Warn while something is being refused, not for ever after."""
        before = self._refused_before.get(part, 0)
        self._refused_before[part] = count
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


# `~/names`: which obstacle a node handle means.

NAMES_AT_A_TIME = 1024


class NamesPublisher(OnDemandPublisher):
    """Publishes the handle and name of every obstacle after some came or went.

    The message is put together from bytes that are kept for each obstacle: thousands of KeyValue
    objects a second would stop the queries for tens of milliseconds.
    """

    def __init__(self, node: Node, world: World) -> None:
        super().__init__(node, DiagnosticStatus, '~/names')
        self._world = world
        self._status = f'{node.get_fully_qualified_name().lstrip("/")}: names'
        self._population: tuple[int, int] | None = None
        self._pairs: dict[int, bytes] = {}  # by handle, ascending
        self._work: Iterator[None] | None = None  # a message that is being put together
        self._turn = node.create_guard_condition(self._go_on)
        self._close.append(lambda: node.destroy_guard_condition(self._turn))

    def message(self) -> None:
        """Begin to put together a DiagnosticStatus, unless no obstacle came or went."""
        if self._work is None and self._world.scene.population != self._population:
            self._population = self._world.scene.population
            self._work = self._tell()
            self._go_on()

    def _go_on(self) -> None:
        """Put together some of the message, and the rest after others had their turn."""
        end = time.perf_counter() + TURN
        while self._work is not None and time.perf_counter() < end:
            if next(self._work, DONE) is DONE:
                self._work = None
        if self._work is not None:
            self._turn.trigger()

    def _tell(self) -> Iterator[None]:
        handles, slots = self._world.scene.newcomers(next(reversed(self._pairs), 0))
        for begin in range(0, len(handles), NAMES_AT_A_TIME):
            some = slice(begin, begin + NAMES_AT_A_TIME)
            for handle, name in self._world.scene.names_still_there(handles[some], slots[some]):
                self._pairs[handle] = pair(handle, name)
            yield
        known = np.fromiter(self._pairs, np.int64, len(self._pairs))
        for handle in known[~np.isin(known, self._world.scene.handles())].tolist():
            del self._pairs[handle]
        yield
        head = DiagnosticStatus(name=self._status, message=f'{len(self._pairs)} obstacles')
        # What is serialised ends with the number of values: none so far.
        before = serialize_message(head)[:-4]
        count = struct.pack('=I', len(self._pairs))
        self.send(b''.join((before, count, *self._pairs.values())))


def pair(handle: int, name: str) -> bytes:
    """Return a KeyValue as CDR, filled up to a multiple of four bytes as the next one needs."""
    return _string(str(handle)) + _string(name)


def _string(text: str) -> bytes:
    characters = text.encode() + b'\0'
    return struct.pack('=I', len(characters)) + characters + bytes(-len(characters) % 4)
