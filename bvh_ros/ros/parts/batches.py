# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Many queries in one message, answered row for row."""

from __future__ import annotations

import math
import time
from collections import deque
from collections.abc import Callable, Generator, Hashable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from nav_msgs.msg import Path
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr import point_cloud2 as decoder
from bvh_ros.ros.cdr.point_cloud2 import PointCloud
from bvh_ros.ros.compile_jobs import BOXES_ASKED, NEAREST_THEN, PATHS_THEN, POINTS
from bvh_ros.ros.conversions import paths, rotations
from bvh_ros.ros.conversions.paths import PathPoses, Poses
from bvh_ros.ros.conversions.query_clouds import (
    AnswerTable,
    Boxes,
    Floats,
    Hits,
    Masks,
    Near,
    PathHits,
    Points,
    QueryCloud,
    Rays,
    Touched,
    answers_cloud,
    fault,
    moved,
    put,
    size_of_reply,
    take,
    unanswered,
)
from bvh_ros.ros.parts.part import Answerer
from bvh_ros.ros.qos import DEPTH, Delivery
from bvh_ros.ros.texts import why
from bvh_ros.scene import NO_NODE
from bvh_ros.scene.store import WAITS

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.parts.drawing import QueryDrawing
    from bvh_ros.ros.parts.readiness import OnDemand
    from bvh_ros.ros.world.frames import Transform
    from bvh_ros.ros.world.known_times import KnownTimes
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import NodeScene, Shapes

Times = NDArray[np.int64]
At = Times | None  # (n,) ns; None: now
LONGEST = 2.0**60  # ns, as sums of these and of a stamp are no more than 64 bits
NOW = -2  # instead of a state: rows about now


class Spans(NamedTuple):
    """When n rows begin and end, and what was known when they begin."""

    at: Times  # (n,) ns
    until: Times  # (n,) ns
    which: Times  # (n,) which of the states; NOW
    states: list[NodeScene]
    unknown: NDArray[np.bool_]  # (n,) rows that cannot be answered

    def take(self, rows: Any) -> Spans:
        """Some of the rows."""
        at, until, which = (column[rows] for column in self[:3])
        return Spans(at, until, which, self.states, self.unknown[rows])

    def groups(self) -> Iterator[NDArray[np.int64]]:
        """The rows of one state after the other."""
        for number in np.unique(self.which).tolist():
            yield np.flatnonzero(self.which == number)


def spans_after(
    since: Floats, durations: Floats | None, stamp: int, known: KnownTimes, now: int
) -> Spans:
    """Rows that begin so long (s) after the stamp of their cloud, and take so long."""
    begin = since * 1e9
    length = 0.0 * begin if durations is None else durations * 1e9
    sane = (np.abs(begin) < LONGEST) & (length < LONGEST) & (length >= 0.0)
    at, more = (np.rint(np.where(sane, c, 0.0)).astype(np.int64) for c in (begin, length))
    at += stamp
    spans = spans_between(at, at + more, known, now)
    return spans._replace(unknown=spans.unknown | ~sane)


def spans_between(at: Times, until: Times, known: KnownTimes, now: int) -> Spans:
    """Rows that begin and end at these times, ns."""
    states, which = known.states(at, now)
    unknown = (which < 0) | ~known.within(at, until, now)
    return Spans(at, until, which, states, unknown)


UNKNOWN_TIME = 'its time is not known, see history and max_prediction'


class Checked(NamedTuple):
    """Some rows in the node's frame, and which of them can be answered."""

    rows: Any
    good: NDArray[np.bool_]  # (n,)
    reason: str  # why the first that is not good cannot be answered
    spans: Spans | None  # None: all are about now

    def by_state(self, now: NodeScene) -> Iterator[tuple[NodeScene, Any, At, At]]:
        """The good rows, state by state: the scene, which rows, and when they begin and end (ns).
        `now` is the scene of rows about now. Where it is that of all rows, none is copied.
        """
        which = slice(None) if self.good.all() else np.flatnonzero(self.good)
        if self.spans is None:
            if self.good.any() or self.good.all():
                yield now, which, None, None
            return
        rows = np.arange(len(self.good))[which]
        for group in self.spans.take(rows).groups():
            these = rows[group]
            at, until, number = (column[these] for column in self.spans[:3])
            if number[0] == NOW:
                yield now, these, None, None
            else:
                yield self.spans.states[number[0]], these, at, until


def checked(
    rows: Any, number: int, transform: Transform | None, spans_of: Callable[[Any], Spans | None]
) -> Checked:
    """Bring rows, the first of which has this number, into the node's frame, and check them."""
    if transform is not None:
        with np.errstate(over='ignore', invalid='ignore'):  # what leaves the doubles is bad
            rows = moved(rows, transform)
    bad, reason = fault(rows, number)
    spans = spans_of(rows)
    if spans is not None:
        bad, reason = bad | spans.unknown, reason or UNKNOWN_TIME
    return Checked(rows, ~bad, reason, spans)


# Many questions in one message, answered row for row: `~/rays` to `~/ray_hits`.

SMALLEST_PIECE, LARGEST_PIECE = 1, 8192  # rows
PIECE_TIME = 0.005  # seconds
RECENT = 1.0  # seconds: rows of the last batch of a kind took as long as those of the next
GROWTH = 8.0  # at most, from a piece to the next: rows may take 100 times as long as others
# A question that came again while its answer took longer than a repetition waits in the
# middleware, and comes within so many seconds after the answer.
LATE_REPEATS, LONG_ANSWER = 0.1, 0.02
# What a batch of so many rows needs of so many obstacles takes longer than a turn.
MANY_ROWS, MANY_OBSTACLES = 1024, 30_000
TURN = 0.01  # seconds after which others get a turn
DONE = object()


def prepare(
    owner: Any, world: World, rays: int, spans_of: Callable[[], Spans | None]
) -> Iterator[None]:
    """Prepare in the helper thread what would take longer than a turn; pause until it is done.

    Parameters
    ----------
    owner : object
        The part of the node that answers.
    rays : int
        How many there are; 0 for other questions.
    spans_of : callable
        When all rows begin and end; None: now.
    """
    changes = world.changes
    if len(changes.visible) < MANY_OBSTACLES:
        return
    timed = spans_of() is not None

    def states() -> Iterator[tuple[NodeScene, Times, Times]]:
        spans = spans_of() if timed else None
        if spans is not None:
            spans = spans.take(~spans.unknown & (spans.which != NOW))
            for rows in spans.groups():
                yield spans.states[spans.which[rows[0]]], spans.at[rows], spans.until[rows]

    def prepare_all() -> None:
        if not timed:
            changes.visible.prepare_rays(rays)
        for scene, at, until in states():
            scene.prepare_times(min(rays, len(at)), at, until)

    if rays >= MANY_ROWS or not all(scene.is_prepared(at, until) for scene, at, until in states()):
        yield from changes.read(owner, prepare_all)


class Pace:
    """Answers questions in pieces that take about PIECE_TIME, whatever a row takes.

    The first piece of a question has as many rows as the last one of its kind, if that was a
    moment ago.
    """

    def __init__(self) -> None:
        self._pieces: dict[Hashable, tuple[int, float]] = {}  # rows, and when that was found, s

    def answer(
        self, kind: Hashable, count: int, answer: Callable[[slice], None]
    ) -> Generator[None, None, None]:
        """Answer `count` rows of one kind, piece by piece with pauses."""
        rows, when = self._pieces.get(kind, (SMALLEST_PIECE, -math.inf))
        if time.monotonic() - when >= RECENT:
            rows = SMALLEST_PIECE
        begin = 0
        while begin < count:
            if begin:
                yield
            began = time.perf_counter()
            end = min(begin + rows, count)
            answer(slice(begin, end))
            took = max(time.perf_counter() - began, 1e-6)
            more = int((end - begin) * min(PIECE_TIME / took, GROWTH))
            if more < rows or end - begin == rows:
                rows = min(max(more, SMALLEST_PIECE), LARGEST_PIECE)
            begin = end
        self._pieces[kind] = rows, time.monotonic()


class Batch(Answerer):
    """Answers each message of questions by a cloud of answers, in the request's frame.

    A row that cannot be answered (NaN, infinite, negative), and each row of a message that cannot
    be answered (wrong fields, unknown frame, a required source missing), has the obstacle
    0xFFFFFFFE and NaN. A cloud whose size cannot be believed gets one such row.

    A cloud of very many rows is answered piece by piece, and others have their turns in between:
    each row meets the world as it is then. The replies come in the order of the requests.

    Parameters
    ----------
    world : World
        Checked for completeness before each answer.
    view : View
        Its mask limits that of each row; its name begins the topics.
    kernels : OnDemand
        Kernels that are compiled on first use.
    """

    question_topic, answer_topic = 'rays', 'ray_hits'
    question: type = Rays
    answer: type = Hits
    needed = needed_then = ''  # kernels, see `OnDemand`; the second ones at other times than now
    message: type = PointCloud2

    def __init__(self, node: Node, world: World, view: View, kernels: OnDemand) -> None:
        super().__init__(node, world, view, self.question_topic, view.topic(self.question_topic))
        self._kernels = kernels
        self._pace = Pace()
        # Questions that wait, the first begun: their bytes, and what answers them.
        self._work: deque[tuple[bytes, Iterator[None]]] = deque()
        self._answered: deque[tuple[bytes, float]] = deque(maxlen=DEPTH)
        """Questions whose answers took long, and until when repetitions of them are not new."""
        self._turn = node.create_guard_condition(self._go_on)
        self._close += [partial(node.destroy_guard_condition, self._turn), self._work.clear]
        self._publisher = self.publisher(PointCloud2, view.topic(self.answer_topic), DEPTH)
        topic = view.topic(self.question_topic)
        self.listen(self.message, topic, self.receive, Delivery(ordered=False, raw=True))

    def receive(self, messages: Sequence[bytes]) -> None:
        """Begin to answer one cloud, unless it repeats a question that still waits, or waited
        when this one was sent.
        """
        (serialised,) = messages
        now = time.monotonic()
        if any(serialised == waiting for waiting, _ in self._work):
            return
        if any(serialised == done and now < until for done, until in self._answered):
            return
        try:
            request = self._read(serialised)
        except ValueError as error:  # the sender and the question are not known
            self.refused.add(str(error))
            return
        self._work.append((serialised, self._answering(request, serialised)))
        while len(self._work) > DEPTH:
            for _ in self._work.popleft()[1]:
                pass
        self._go_on()

    def _go_on(self) -> None:
        """Answer for a while, and go on after others had their turn."""
        began = time.perf_counter()
        try:
            while self._work and time.perf_counter() - began < TURN:
                step = next(self._work[0][1], DONE)
                if step is DONE:
                    self._work.popleft()
                elif step is WAITS:
                    break
        finally:
            if self._work:
                self._turn.trigger()

    def finish(self) -> None:
        """Answer until nothing reads the scene in the helper thread any more."""
        while self._work and self._world.changes.owner is self:
            next(self._work[0][1])

    def _answering(self, request: PointCloud, serialised: bytes) -> Iterator[None]:
        """Answer one cloud, with pauses."""
        began = time.perf_counter_ns()
        try:
            reply = yield from self._reply(request)
            self._finish(reply, request, serialised, began)
            return
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = why(error)
        # Not earlier: an error holds in memory whatever its function was working on.
        self._finish(self._refusal(request, reason), request, serialised, began)

    def _finish(
        self, reply: PointCloud2, request: PointCloud, serialised: bytes, began: int
    ) -> None:
        """Publish the answer to a question, whose work began at a time (ns)."""
        self._publish(reply, request)
        self.timings.add(began)
        if time.perf_counter_ns() - began > LONG_ANSWER * 1e9:
            self._answered.append((serialised, time.monotonic() + LATE_REPEATS))

    def _publish(self, reply: PointCloud2, request: PointCloud) -> None:
        seconds, rest = divmod(request.stamp, 1_000_000_000)
        reply.header.stamp.sec, reply.header.stamp.nanosec = seconds, rest
        reply.header.frame_id = request.frame_id
        self._publisher.publish(reply)

    # What paths have otherwise than clouds.

    def _read(self, serialised: bytes) -> Any:
        """Read a message; ValueError if it is none."""
        return decoder.read(serialised)

    def _questions(self, request: Any) -> QueryCloud | PathPoses:
        """Return the rows of a message; ValueError if it cannot be read."""
        return QueryCloud(request, self.question)

    def _spans(self, moments: Any, stamp: int) -> Spans | None:
        """When rows begin and end; None: now."""
        if moments.since is None:
            return None
        if self._world.times is None:
            raise ValueError(
                't0 and duration have no meaning: no source predicts, and there is no history'
            )
        given = moments.since, getattr(moments, 'durations', None), stamp
        return spans_after(*given, self._world.times, self.now())

    def _refusal(self, request: Any, reason: str) -> PointCloud2:
        """Make the cloud that says that nothing is answered."""
        height, width = size_of_reply(request, self.question)
        self.refused.add(reason, height * width)
        return answers_cloud(unanswered(self.answer, height * width), height, width, np.float32)

    # A reply.

    def _reply(self, request: Any) -> Generator[None, None, PointCloud2]:
        """Make the cloud of answers, with pauses; ValueError if there can be none."""
        self._world.at(self.now())
        transform = self._world.frames.into_node(request.frame_id, request.stamp)
        questions = self._questions(request)
        yield from self._load(questions)
        stamp = request.stamp or self.now()
        table = AnswerTable(self.answer, request.height, request.width, questions.real)

        def answer(piece: slice) -> None:
            rows = questions.rows(piece.start, piece.stop)
            table.write(piece, self._answer(rows, piece.start, transform, stamp))

        rays = len(questions) if self.question is Rays else 0
        spans = partial(self._spans, questions.moments(), stamp)
        yield from prepare(self, self._world, rays, spans)
        kind = questions.has_times, questions.has_radii
        yield from self._pace.answer(kind, len(questions), answer)
        return table.cloud()

    def _load(self, questions: Any) -> Iterator[None]:
        """Pause while kernels are loaded; IncompleteWorldError while they are compiled."""
        yield from self._kernels.load(self.needed)
        if questions.has_times:
            yield from self._kernels.load(self.needed_then)

    def _answer(self, questions: Any, number: int, transform: Transform | None, stamp: int) -> Any:
        """Answers to some rows, the first of which has this number; `stamp` is that of the
        message, ns.
        """
        scene = self._world.at(self.now())
        rows, good, reason, _ = given = checked(
            questions, number, transform, lambda rows: self._spans(rows, stamp)
        )
        refused = int(np.count_nonzero(~good))
        self.answered += len(good) - refused
        if refused:
            self.refused.add(reason, refused)
        answers: Any = None
        if refused or given.spans is not None:
            answers = unanswered(self.answer, len(good))
        for state, these, at, until in given.by_state(scene):
            found = self._ask(state, take(rows, these), at, until)
            if answers is None:  # all rows at once: none is copied
                answers = found
            else:
                put(answers, these, found)
        self._draw(rows, answers)
        return answers if transform is None else moved_back(transform, answers)

    def _ask(self, scene: NodeScene, questions: Any, at: At, until: At) -> Any:
        """Ask the scene, about now or (n,) times in ns."""
        raise NotImplementedError

    def _draw(self, questions: Any, answers: Any) -> None:
        """Show questions and answers to viewers."""

    def _masks(self, masks: Masks) -> Masks:
        """What of these masks this view shows."""
        return masks & np.uint32(self.view.mask)

    def _threads(self, rows: int) -> int:
        return self._world.settings.threads_for(rows)


class RayBatch(Batch):
    """Answers rays by hits.

    Parameters
    ----------
    node, world, view, kernels
        As of a `Batch`.
    drawing : QueryDrawing
        Shows rays and hits to viewers.
    """

    def __init__(
        self, node: Node, world: World, view: View, kernels: OnDemand, drawing: QueryDrawing
    ) -> None:
        super().__init__(node, world, view, kernels)
        self._drawing = drawing

    def _draw(self, questions: Rays, answers: Hits) -> None:
        if self._drawing.is_watched:
            self._drawing.add_rays(questions, answers)

    def _ask(self, scene: NodeScene, questions: Rays, at: At, until: At) -> Hits:
        """First hits; a ray that takes time reaches its t_max at the end of that time."""
        directions, limits, whole = questions.directions, questions.t_max, np.ones(1)
        if at is not None and until is not None:
            takes_time = until > at
            whole = np.where(takes_time, limits, 1.0)  # the scene's rays end at t = 1 then
            limits = np.where(takes_time, 1.0, limits)
            directions = directions * whole[:, None]
        masks = self._masks(questions.masks)
        hits = Hits(
            *scene.raycast_many(
                *(questions.origins, directions, limits, masks, self.view.skip_inside),
                threads=self._threads(len(masks)),
                radius=questions.radii,
                at=at,
                until=until,
            )
        )
        if at is None:
            return hits
        return hits._replace(t=np.where(np.isfinite(hits.t), hits.t * whole, hits.t))


class PointBatch(Batch):
    """Answers points by the obstacles nearest to them: `~/points` to `~/nearest_hits`."""

    question_topic, answer_topic = 'points', 'nearest_hits'
    question, answer, needed, needed_then = Points, Near, POINTS, NEAREST_THEN

    def _ask(self, scene: NodeScene, questions: Points, at: At, until: At) -> Near:
        masks = self._masks(questions.masks)
        handles, distances, points = scene.nearest_many(
            *(questions.places, 1, questions.reaches, masks),
            threads=self._threads(len(masks)),
            at=at,
        )
        return near(questions.places, points[:, 0], distances[:, 0], handles[:, 0])


class BoxBatch(Batch):
    """Answers boxes by what touches them: `~/boxes` to `~/box_hits`."""

    question_topic, answer_topic = 'boxes', 'box_hits'
    question, answer, needed, needed_then = Boxes, Touched, BOXES_ASKED, BOXES_ASKED

    def _ask(self, scene: NodeScene, questions: Boxes, at: At, until: At) -> Touched:
        masks = self._masks(questions.masks)
        hits = scene.overlap_many(
            *(questions.places, questions.sizes, rotations.set_ones(questions.turns)),
            tolerance=questions.tolerances,
            mask=masks,
            want='hits',
            threads=self._threads(len(masks)),
            at=at,
        )
        return Touched(hits.points, hits.distances, hits.handles, hits.counts.astype(np.uint32))


class PathBatch(Batch):
    """Answers the poses of paths by how far the footprint is from the nearest obstacle there:
    where they touch, minus the depth, and the normal is the shortest way out; 0, and no normal, if
    no depth is known. `~/paths` to `~/path_hits`.

    Parameters
    ----------
    node, world, view, kernels
        As of a `Batch`.
    footprint : sequence of Shapes
        Its convex parts, one row each, as they lie to a pose.
    """

    question_topic, answer_topic = 'paths', 'path_hits'
    question, needed_then = Poses, PATHS_THEN
    answer: type = Near
    message = Path

    def __init__(
        self, node: Node, world: World, view: View, kernels: OnDemand, footprint: Sequence[Shapes]
    ) -> None:
        self._footprint = footprint
        super().__init__(node, world, view, kernels)

    def _read(self, serialised: bytes) -> PathPoses:
        return PathPoses(serialised)

    def _questions(self, request: PathPoses) -> PathPoses:
        return request

    def _spans(self, moments: Poses, stamp: int) -> Spans | None:
        """As ever, stamps say nothing where there are no other times than now."""
        stamps, times = moments.stamps, self._world.times
        if times is None or not stamps.any():
            return None
        spans, timed = spans_between(stamps, stamps, times, self.now()), stamps != 0
        which = np.where(timed, spans.which, NOW)
        return spans._replace(which=which, unknown=spans.unknown & timed)

    def _ask(self, scene: NodeScene, questions: Poses, at: At, until: At) -> Near:
        mask, threads = self.view.mask, self._threads(len(questions.places))
        parts = [
            scene.collisions_many(paths.shapes(questions, part), mask, threads, at)
            for part in self._footprint
        ]
        handles, distances, places, points = nearest_of(parts, [part[1] for part in parts])
        return near(places, points, distances, handles)

    def _refusal(self, request: PathPoses, reason: str) -> PointCloud2:
        count = max(len(request), 1)
        self.refused.add(reason, count)
        return answers_cloud(unanswered(self.answer, count), 1, count, np.float64)


class SweepBatch(PathBatch):
    """Answers the poses of paths, each with the way from the pose before: `~/paths` to
    `~/path_hits`.
    """

    answer = PathHits

    def _read(self, serialised: bytes) -> PathPoses:
        return PathPoses(serialised, between=True)

    def _spans(self, moments: Poses, stamp: int) -> Spans | None:
        """A sweep begins at the time of the pose before."""
        before, stamps, times = moments.before.stamps, moments.stamps, self._world.times
        if times is None or not (stamps.any() or before.any()):
            return None
        now = self.now()
        begin, end = (np.where(moment != 0, moment, now) for moment in (before, stamps))
        timed, back = (stamps != 0) | (before != 0), end < begin
        spans = spans_between(begin, np.where(back, begin, end), times, now)
        which = np.where(timed, spans.which, NOW)
        return spans._replace(which=which, unknown=(spans.unknown | back) & timed)

    def _ask(self, scene: NodeScene, questions: Poses, at: At, until: At) -> Any:
        poses = super()._ask(scene, questions, until, until)
        before, mask = questions.before, self.view.mask
        starts, turns = before.places, rotations.set_ones(before.turns)
        goals, goal_turns = questions.places, rotations.set_ones(questions.turns)
        threads = self._threads(len(goals))
        given = starts, turns, goals, goal_turns
        parts: list[Any] = [
            scene.sweep_shape_many(part, *given, mask=mask, at=at, until=until, threads=threads)
            for part in self._footprint
        ]
        handles, t, _, points, normals = nearest_of(parts, [part.t for part in parts])
        # The first pose has no way before it.
        still = (starts == goals).all(axis=1) & (turns == goal_turns).all(axis=1)
        if at is not None and until is not None:
            still &= at == until
        hits, touches = np.isfinite(t) & ~still, poses.distances <= 0.0
        between = hits & ~touches
        poses.obstacles[between], poses.distances[between] = handles[between], 0.0
        poses.points[between], poses.normals[between] = (points[between], normals[between])
        return PathHits(*poses, np.where(hits, t, np.where(touches, 1.0, np.inf)))


def nearest_of(parts: Sequence[Sequence[Any]], far: Sequence[Any]) -> Sequence[Any]:
    """Of the answers about each part of a footprint those that are nearest, row by row."""
    if len(parts) == 1:
        return parts[0]
    best, rows = np.argmin(far, axis=0), np.arange(len(far[0]))
    return [np.stack(columns)[best, rows] for columns in zip(*parts, strict=True)]


def moved_back(transform: Transform, answers: Any) -> Any:
    """Return answers in the frame that the questions came from."""
    back = transform.inverse()
    with np.errstate(over='ignore', invalid='ignore'):
        answers = answers._replace(points=back.points(answers.points))
        if hasattr(answers, 'normals'):
            answers = answers._replace(normals=back.vectors(answers.normals))
    return answers


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
