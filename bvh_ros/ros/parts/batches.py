# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many queries in one message, answered row for row."""

from __future__ import annotations

import time
from collections import deque
from collections.abc import Callable, Generator, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr import point_cloud2 as decoder
from bvh_ros.ros.cdr.point_cloud2 import PointCloud
from bvh_ros.ros.compile_jobs import BALLS, BOXES_ASKED, NEAREST_THEN, PATHS_THEN, POINTS
from bvh_ros.ros.conversions import paths, query_clouds, ray_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Near, Points, QueryCloud, Touched
from bvh_ros.ros.conversions.ray_clouds import Floats, Hits, RayCloud, Rays
from bvh_ros.ros.parts.part import NodePart, Timings
from bvh_ros.ros.qos import DEPTH, Delivery
from bvh_ros.ros.sources.subscribing import FollowingSubscription
from bvh_ros.ros.texts import Refused, explain
from bvh_ros.scene import NO_NODE

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.parts.drawing import QueryDrawing
    from bvh_ros.ros.parts.readiness import OnDemand
    from bvh_ros.ros.world.frames import Transform
    from bvh_ros.ros.world.known_times import KnownTimes
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import Scene

Times = NDArray[np.int64]
LONGEST = 2.0**60  # ns, as sums of these and of a stamp are no more than 64 bits


class Spans(NamedTuple):
    """When n rows begin and end, ns, and what was known when they begin."""

    at: Times
    until: Times
    which: Times
    states: list[Scene]

    def take(self, rows: NDArray[np.bool_]) -> Spans:
        """Some of the rows."""
        return Spans(self.at[rows], self.until[rows], self.which[rows], self.states)


class KnownSpans(NamedTuple):
    """When n rows begin and end."""

    spans: Spans
    unknown: NDArray[np.bool_]
    """(n,) which of the rows cannot be answered."""


def spans_of(
    since: Floats, durations: Floats | None, stamp: int, known: KnownTimes, now: int
) -> KnownSpans:
    """When rows begin, so long (s) after the stamp of their cloud, and end, and which of them
    cannot be answered.
    """
    begin = since * 1e9
    length = 0.0 * begin if durations is None else durations * 1e9
    sane = (np.abs(begin) < LONGEST) & (length < LONGEST) & (length >= 0.0)
    at, more = (np.rint(np.where(sane, c, 0.0)).astype(np.int64) for c in (begin, length))
    at += stamp
    spans, unknown = spans_between(at, at + more, known, now)
    return KnownSpans(spans, unknown | ~sane)


def spans_between(at: Times, until: Times, known: KnownTimes, now: int) -> KnownSpans:
    """Rows that begin and end at these times, ns, and which of them cannot be answered."""
    states, which = known.states(at, now)
    good = (which >= 0) & known.within(at, until, now)
    return KnownSpans(Spans(at, until, which, states), np.logical_not(good))


def by_state(known: KnownSpans) -> Iterator[tuple[Scene, Times, Times]]:
    """Each state of the world that is asked about, and when its rows begin and end."""
    spans = known.spans.take(~known.unknown)
    for number in np.unique(spans.which).tolist():
        rows = spans.which == number
        yield spans.states[number], spans.at[rows], spans.until[rows]


def fill(answers: Any, spans: Spans, ask: Callable[[Scene, Any, Times], Any]) -> Any:
    """Fill in what ask(scene, rows, at) answers, each state's rows at once; return it."""
    for number in np.unique(spans.which).tolist():
        rows = np.flatnonzero(spans.which == number)
        found = ask(spans.states[number], rows, spans.at[rows])
        for column, part in zip(answers, found, strict=True):
            column[rows] = part
    return answers


def cast(rays: Rays, masks: NDArray[np.uint32], skip: bool, threads: int, spans: Spans) -> Hits:
    """First hits of rays; a ray that takes time reaches its t_max at the end of that time."""
    hits = Hits.unanswered(len(masks))
    for number in np.unique(spans.which).tolist():
        rows = spans.which == number
        some = rays.take(rows), masks[rows], skip, threads, spans.take(rows)
        hits = hits.put(rows, _cast(spans.states[number], *some))
    return hits


def _cast(
    scene: Scene, rays: Rays, masks: NDArray[np.uint32], skip: bool, threads: int, spans: Spans
) -> Hits:
    takes_time = spans.until > spans.at
    whole = np.where(takes_time, rays.t_max, 1.0)  # the scene's rays end at t = 1 then
    limits = np.where(takes_time, 1.0, rays.t_max)
    hits = Hits(
        *scene.raycast_many(
            *(rays.origins, rays.directions * whole[:, None], limits, masks, skip),
            threads=threads,
            radius=rays.radii,
            at=spans.at,
            until=spans.until,
        )
    )
    return hits._replace(t=np.where(np.isfinite(hits.t), hits.t * whole, hits.t))


# Many questions in one message, answered row for row: `~/rays` to `~/ray_hits`.

QOS_PERIOD = 1.0  # seconds
SMALLEST_PIECE, LARGEST_PIECE = 32, 8192  # rows
PIECE_TIME = 0.005  # seconds
GROWTH = 8.0  # at most, from a piece to the next: rows may take 100 times as long as others
# What a batch of so many rows needs of so many obstacles takes longer than a turn.
MANY_ROWS, MANY_OBSTACLES = 1024, 30_000
TURN = 0.01  # seconds after which others get a turn
DONE = object()
UNKNOWN_TIME = 'its time is not known, see history and max_prediction'


class Batch(NodePart):
    """Answers each message of questions by a cloud of answers, in the request's frame.

    A row that cannot be answered (NaN, infinite, negative), and each row of a message that cannot
    be answered (wrong fields, unknown frame, a required source missing), has the obstacle
    0xFFFFFFFE and NaN. A cloud whose size cannot be believed gets one such row.

    A cloud of very many rows is answered piece by piece, and others have their turns in between:
    each row meets the world as it is then. The replies come in the order of the requests.

    Parameters
    ----------
    world : World
        Asked before each answer whether it is complete.
    view : View
        What is seen, of that what each row's mask asks for, and the name of the topics.
    kernels : OnDemand
        What is compiled when somebody asks.
    """

    question_topic, answer_topic = 'rays', 'ray_hits'
    message: type = PointCloud2

    def __init__(self, node: Node, world: World, view: View, kernels: OnDemand) -> None:
        super().__init__(node)
        self.view = view
        self.refused = Refused(node.get_logger(), view.topic(self.question_topic))
        self.what = f'{self.question_topic} of {view.name}' if view.name else self.question_topic
        self.answered = 0  # rows
        self.timings = Timings()
        self._world = world
        self._kernels = kernels
        # Questions that wait, the first begun: their bytes, and what answers them.
        self._work: deque[tuple[bytes, Iterator[None]]] = deque()
        self._turn = node.create_guard_condition(self._go_on)
        self._close += [partial(node.destroy_guard_condition, self._turn), self._work.clear]
        self._publisher = self.publisher(PointCloud2, view.topic(self.answer_topic), DEPTH)
        delivery = Delivery(ordered=False, raw=True)
        subscription = FollowingSubscription(
            node, self.message, view.topic(self.question_topic), self.receive, delivery
        )
        self._close.append(subscription.destroy)
        self.every(QOS_PERIOD, subscription.check)

    def receive(self, messages: Sequence[bytes]) -> None:
        """Begin to answer one cloud, unless it repeats a question that still waits."""
        (serialised,) = messages
        if any(serialised == waiting for waiting, _ in self._work):
            return
        try:
            request = self._read(serialised)
        except ValueError as error:  # from whom, and what was asked, is not known
            self.refused.add(str(error))
            return
        self._work.append((serialised, self._answering(request)))
        while len(self._work) > DEPTH:
            for _ in self._work.popleft()[1]:
                pass
        self._go_on()

    def _go_on(self) -> None:
        """Answer for a while, and go on after others had their turn."""
        began = time.perf_counter()
        try:
            while self._work and time.perf_counter() - began < TURN:
                if next(self._work[0][1], DONE) is DONE:
                    self._work.popleft()
        finally:
            if self._work:
                self._turn.trigger()

    def finish(self) -> None:
        """Answer until nothing reads the scene in the helper thread any more."""
        while self._work and self._world.changes.owner is self:
            next(self._work[0][1])

    def _answering(self, request: PointCloud) -> Iterator[None]:
        """Answer one cloud, with pauses."""
        began = time.perf_counter_ns()
        try:
            reply = yield from self._reply(request)
            self._publish(reply, request)
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

    def _read(self, serialised: bytes) -> Any:
        """Read a message; ValueError if it is none."""
        return decoder.read(serialised)

    def _reply(self, request: Any) -> Generator[None, None, PointCloud2]:
        """Make the cloud of answers, with pauses; ValueError if there can be none."""
        raise NotImplementedError

    def _refusal(self, request: Any, reason: str) -> PointCloud2:
        """Make the cloud that says that nothing is answered."""
        raise NotImplementedError

    def _prepare(self, count: int, spans: Callable[[], KnownSpans] | None) -> Iterator[None]:
        """Prepare in the helper thread what would take longer than a turn; pause until it is done.

        Parameters
        ----------
        count : int
            Rows that are rays.
        spans : callable, optional
            When the rows begin and end, as things are when it is called; None: now.
        """
        changes = self._world.changes
        if len(changes.visible) < MANY_OBSTACLES:
            return

        def prepare() -> None:
            if spans is None:
                changes.visible.prepare_rays(count)
                return
            for state, at, until in by_state(spans()):
                state.prepare_times(min(count, len(at)), at, until)

        if count >= MANY_ROWS or (
            spans is not None
            and not all(state.is_prepared(at, until) for state, at, until in by_state(spans()))
        ):
            yield from changes.read(self, prepare)

    def _in_pieces(self, count: int, answer: Callable[[slice], None]) -> Iterator[None]:
        """Answer `count` rows, piece by piece with pauses; a piece takes about PIECE_TIME."""
        begin, rows = 0, SMALLEST_PIECE
        while begin < count:
            if begin:
                yield
            began = time.perf_counter()
            end = min(begin + rows, count)
            answer(slice(begin, end))
            took = max(time.perf_counter() - began, 1e-6)
            rows = int((end - begin) * min(PIECE_TIME / took, GROWTH))
            rows = min(max(rows, SMALLEST_PIECE), LARGEST_PIECE)
            begin = end

    def _now(self) -> Scene:
        return self._world.at(self.node.get_clock().now().nanoseconds)

    def _stamp_of(self, request: Any) -> int:
        """When a cloud was stamped, ns; now, if it was not."""
        return request.stamp or self.node.get_clock().now().nanoseconds

    def _spans(
        self, since: NDArray[np.float64], durations: NDArray[np.float64] | None, stamp: int
    ) -> KnownSpans:
        """When rows begin and end, and which of them cannot be answered."""
        if self._world.times is None:
            raise ValueError(
                't0 and duration have no meaning: no source predicts, and there is no history'
            )
        now = self.node.get_clock().now().nanoseconds
        return spans_of(since, durations, stamp, self._world.times, now)

    def _masks(self, masks: NDArray[np.uint32]) -> NDArray[np.uint32]:
        """What of these masks this view shows."""
        return masks & np.uint32(self.view.mask)

    def _count(self, bad: NDArray[np.bool_], reason: str) -> NDArray[np.bool_]:
        """Count rows that are answered, and not; return which are."""
        refused = int(np.count_nonzero(bad))
        self.answered += len(bad) - refused
        if refused:
            self.refused.add(reason, refused)
        return ~bad


class RayBatch(Batch):
    """Answers rays by hits.

    Parameters
    ----------
    node, world, view, kernels
        As of a `Batch`.
    drawing : QueryDrawing
        Is told of rays and hits while somebody looks.
    """

    def __init__(
        self, node: Node, world: World, view: View, kernels: OnDemand, drawing: QueryDrawing
    ) -> None:
        super().__init__(node, world, view, kernels)
        self._drawing = drawing

    def _reply(self, request: PointCloud) -> Generator[None, None, PointCloud2]:
        self._now()
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        cloud = RayCloud(request)
        if cloud.has_radii and not cloud.has_times:
            self._kernels.require(BALLS)
        stamp = self._stamp_of(request)
        table = ray_clouds.hits_table(len(cloud), cloud.real)

        def answer(piece: slice) -> None:
            rays = cloud.rows(piece.start, piece.stop)
            hits = self._answer(rays, piece.start, transform, stamp)
            ray_clouds.write_hits(table[piece], hits)

        spans = partial(self._spans, *cloud.times(), stamp) if cloud.has_times else None
        yield from self._prepare(len(cloud), spans)
        yield from self._in_pieces(len(cloud), answer)
        return ray_clouds.table_cloud(table, request.height, request.width, table['t'])

    def _answer(self, rays: Rays, number: int, transform: Transform | None, stamp: int) -> Hits:
        """Hits of some rays, the first of which has this number; `stamp` is their cloud's, ns."""
        scene = self._now()
        if transform is not None:
            rays = moved(transform, rays)
        bad, reason = rays.fault(number)
        if rays.since is None:
            spans = None
        else:
            spans, unknown = self._spans(rays.since, rays.durations, stamp)
            reason = reason or UNKNOWN_TIME
            bad = bad | unknown
        good = self._count(bad, reason)
        if good.all():
            hits = self._cast(scene, rays, spans)
        else:
            some = None if spans is None else spans.take(good)
            hits = self._cast(scene, rays.take(good), some)
            hits = Hits.unanswered(len(good)).put(good, hits)
        if self._drawing.is_watched:
            self._drawing.add_rays(rays, hits)
        return hits if transform is None else moved_back(transform, hits)

    def _cast(self, scene: Scene, rays: Rays, spans: Spans | None) -> Hits:
        masks = self._masks(rays.masks)
        if spans is not None:
            threads = self._world.settings.threads_for(len(masks))
            return cast(rays, masks, self.view.skip_inside, threads, spans)
        return Hits(
            *scene.raycast_many(
                *(rays.origins, rays.directions, rays.t_max, masks, self.view.skip_inside),
                radius=rays.radii,
                threads=self._world.settings.threads_for(len(masks)),
            )
        )

    def _refusal(self, request: PointCloud, reason: str) -> PointCloud2:
        height, width = ray_clouds.rows_of(request, ray_clouds.LEAST_RAY)
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


def moved_back(transform: Transform, answers: Any) -> Any:
    """Return answers in the frame that the questions came from."""
    back = transform.inverse()
    with np.errstate(over='ignore', invalid='ignore'):
        answers = answers._replace(points=back.points(answers.points))
        if 'normals' in answers._fields:
            answers = answers._replace(normals=back.vectors(answers.normals))
    return answers


# `~/boxes` to `~/box_hits`, `~/points` to `~/nearest_hits`, `~/paths` to `~/path_hits`.

Answers = Near | Touched
LEAST_FIELD = 4  # bytes


class VolumeBatch(Batch):
    """What batches of points and boxes share."""

    question: type = Points
    answer: Any = Near
    needed, needed_then = POINTS, NEAREST_THEN
    least = 3 * LEAST_FIELD  # bytes of a row

    def _reply(self, request: PointCloud) -> Generator[None, None, PointCloud2]:
        self._now()
        self._kernels.require(self.needed)
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        cloud, stamp = QueryCloud(request, self.question), self._stamp_of(request)
        if cloud.has_times:
            self._kernels.require(self.needed_then)
        answers = query_clouds.unanswered(self.answer, len(cloud))

        def answer(piece: slice) -> None:
            rows = cloud.rows(piece.start, piece.stop)
            put(answers, piece, *self._answer(rows, piece.start, transform, stamp))

        spans = partial(self._spans, cloud.times(), None, stamp) if cloud.has_times else None
        yield from self._prepare(0, spans)
        yield from self._in_pieces(len(cloud), answer)
        return query_clouds.answers_cloud(answers, request.height, request.width, cloud.real)

    def _answer(
        self, questions: Any, number: int, transform: Transform | None, stamp: int
    ) -> tuple[NDArray[np.bool_], Answers]:
        """Which of some rows are good, and the answers to these; `number` is that of the first
        row, and `stamp` that of the cloud, ns.
        """
        scene, spans = self._now(), None
        if transform is not None:
            with np.errstate(over='ignore', invalid='ignore'):  # what leaves the doubles is bad
                questions = questions.moved(transform)
        bad, reason = query_clouds.fault(questions, number)
        if questions.since is not None:
            spans, unknown = self._spans(questions.since, None, stamp)
            bad, reason = bad | unknown, reason or UNKNOWN_TIME
        good = self._count(bad, reason)
        some = query_clouds.take(questions, good)
        if spans is None:
            found = self._ask(scene, some)
        else:
            found = self._elsewhen(some, spans.take(good))
        return good, found if transform is None else moved_back(transform, found)

    def _elsewhen(self, questions: Any, spans: Spans) -> Answers:
        """Ask about other times."""
        answers = query_clouds.unanswered(self.answer, len(spans.at))
        return fill(
            *(answers, spans),
            lambda scene, rows, at: self._ask(scene, query_clouds.take(questions, rows), at),
        )

    def _ask(self, scene: Scene, questions: Any, at: NDArray[np.int64] | None = None) -> Answers:
        """Ask the scene, about now or (n,) times in ns."""
        raise NotImplementedError

    def _refusal(self, request: PointCloud, reason: str) -> PointCloud2:
        height, width = ray_clouds.rows_of(request, self.least)
        self.refused.add(reason, height * width)
        answers = query_clouds.unanswered(self.answer, height * width)
        return query_clouds.answers_cloud(answers, height, width, np.dtype(np.float32))


class PointBatch(VolumeBatch):
    """Answers points by the obstacles nearest to them."""

    question_topic, answer_topic = 'points', 'nearest_hits'

    def _ask(self, scene: Scene, questions: Points, at: NDArray[np.int64] | None = None) -> Near:
        masks = self._masks(questions.masks)
        handles, distances, points = scene.nearest_many(
            *(questions.places, 1, questions.reaches, masks),
            threads=self._world.settings.threads_for(len(masks)),
            at=at,
        )
        return near(questions.places, points[:, 0], distances[:, 0], handles[:, 0])


class BoxBatch(VolumeBatch):
    """Answers boxes by what touches them."""

    question_topic, answer_topic = 'boxes', 'box_hits'
    question, answer, needed, needed_then = Boxes, Touched, BOXES_ASKED, BOXES_ASKED
    least = 6 * LEAST_FIELD

    def _ask(self, scene: Scene, questions: Boxes, at: NDArray[np.int64] | None = None) -> Touched:
        hits = scene.overlap_many(
            *(questions.places, questions.sizes, questions.turns, questions.tolerances),
            *(
                self._masks(questions.masks),
                'hits',
                self._world.settings.threads_for(len(questions.masks)),
            ),
            at=at,
        )
        return Touched(hits.points, hits.distances, hits.handles, hits.counts.astype(np.uint32))


class PathBatch(Batch):
    """Answers the poses of paths by how far the footprint is from the nearest obstacle there:
    where they touch, minus the depth, and the normal is the shortest way out.

    Parameters
    ----------
    node, world, view, kernels
        As of a `Batch`.
    footprint : sequence of float
        Edge lengths of a box, or the radius of a ball, m; centred on each pose.
    """

    question_topic, answer_topic = 'paths', 'path_hits'
    message = Path

    def __init__(
        self, node: Node, world: World, view: View, kernels: OnDemand, footprint: Sequence[float]
    ) -> None:
        self._footprint = footprint
        super().__init__(node, world, view, kernels)

    def _read(self, serialised: bytes) -> paths.Poses:
        return paths.read(serialised)

    def _reply(self, request: paths.Poses) -> Generator[None, None, PointCloud2]:
        self._now()
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        answers = query_clouds.unanswered(Near, len(request.places))

        def answer(piece: slice) -> None:
            rows = request.rows(piece)
            if transform is not None:
                rows = rows.moved(transform)
            good, found = self._answer(rows, piece.start)
            if transform is not None:
                found = moved_back(transform, found)
            put(answers, piece, good, found)

        times, at = self._world.times, request.stamps[request.stamps != 0]
        if times is not None and len(at):
            now = self.node.get_clock().now().nanoseconds
            yield from self._prepare(0, partial(spans_between, at, at, times, now))
        yield from self._in_pieces(len(request.places), answer)
        return query_clouds.answers_cloud(answers, 1, len(request.places), np.dtype(np.float64))

    def _answer(self, rows: paths.Poses, number: int) -> tuple[NDArray[np.bool_], Near]:
        """Which of some poses are good, and the answers to these."""
        times, scene = self._world.times, self._now()
        if times is None or not rows.stamps.any():  # as ever, stamps say nothing
            good = self._count(*rows.fault(number))
            return good, self._ask(scene, rows.rows(good))
        self._kernels.require(PATHS_THEN)
        now = self.node.get_clock().now().nanoseconds
        spans, unknown = spans_between(rows.stamps, rows.stamps, times, now)
        timed, (bad, reason) = rows.stamps != 0, rows.fault(number)
        good = self._count(bad | (unknown & timed), reason or UNKNOWN_TIME)
        some, timed = rows.rows(good), timed[good]
        answers, later = query_clouds.unanswered(Near, len(timed)), some.rows(timed)
        put(answers, slice(None), ~timed, self._ask(scene, some.rows(~timed)))

        def ask(state: Scene, places: Any, at: NDArray[np.int64]) -> Near:
            return self._ask(state, later.rows(places), at)

        found = query_clouds.unanswered(Near, len(later.stamps))
        put(answers, slice(None), timed, fill(found, spans.take(good).take(timed), ask))
        return good, answers

    def _ask(self, scene: Scene, rows: paths.Poses, at: NDArray[np.int64] | None = None) -> Near:
        shapes = paths.shapes(rows, self._footprint)
        handles, distances, places, points = scene.clearance_many(
            *(shapes, np.inf, self.view.mask, True),
            self._world.settings.threads_for(len(rows.places)),
            at=at,
        )
        return near(places, points, distances, handles)

    def _refusal(self, request: paths.Poses, reason: str) -> PointCloud2:
        count = max(len(request.places), 1)
        self.refused.add(reason, count)
        answers = query_clouds.unanswered(Near, count)
        return query_clouds.answers_cloud(answers, 1, count, np.dtype(np.float64))


def put(answers: Any, piece: slice, good: NDArray[np.bool_], found: Any) -> None:
    """Write the answers to the good rows of a piece."""
    for column, rows in zip(answers, found, strict=True):
        column[piece][good] = rows


def near(
    places: NDArray[np.float64],
    points: NDArray[np.float64],
    distances: NDArray[np.float64],
    handles: NDArray[np.uint32],
) -> Near:
    """Return obstacles' points with the directions from there to the places, or out of the
    obstacles where distances are negative.
    """
    normals = np.zeros((len(places), 3))
    apart = (handles != NO_NODE) & (distances != 0.0)
    normals[apart] = (places[apart] - points[apart]) / distances[apart, None]
    return Near(points, distances, normals, handles)
