# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services of the package bvh_msgs: `~/query/raycast` and others, of one or many rows."""

from __future__ import annotations

import time
from array import array
from collections.abc import Callable, Generator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_msgs.srv import Clearance, Nearest, Overlap, Raycast, Sweep
from bvh_ros.ros.compile_jobs import (
    BOXES_ASKED,
    CLEARANCES,
    NEAREST_THEN,
    PATHS_THEN,
    POINTS,
    SWEEPS,
)
from bvh_ros.ros.conversions import nanoseconds, rotations
from bvh_ros.ros.conversions.query_clouds import (
    EVERYTHING,
    UNANSWERED,
    Boxes,
    Floats,
    Masks,
    Points,
    Rays,
    improper,
    take,
)
from bvh_ros.ros.parts.batches import Pace, Spans, checked, near, prepare, spans_after
from bvh_ros.ros.parts.part import Answerer
from bvh_ros.ros.parts.services import in_turns
from bvh_ros.ros.qos import repeated
from bvh_ros.ros.texts import explain
from bvh_ros.ros.world.world import CompilingError, IncompleteWorldError
from bvh_ros.scene import NO_NODE, ShapeKind, TooManyHitsError, unchecked_shapes

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.parts.readiness import OnDemand
    from bvh_ros.ros.world.frames import Transform
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import NodeScene

STATUS = Raycast.Response


class ShapeRows(NamedTuple):
    """Shapes of a clearance query, with unchecked values."""

    kinds: NDArray[np.uint8]  # (n,)
    places: Floats  # (n, 3) m
    sizes: Floats  # (n, 3) m
    turns: Floats  # (n, 4) quaternions
    reaches: Floats  # (n,) m, how far an obstacle may be
    masks: Masks  # (n,)
    since: Floats | None = None  # (n,) s after the request's stamp; None: now

    def faults(self) -> dict[str, NDArray[np.bool_]]:
        """Return why rows (n,) cannot be answered."""
        boxes = Boxes(self.places, self.sizes, self.turns, np.zeros(len(self.kinds)), self.masks)
        width, depth, height = self.sizes.T
        round_kind = self.kinds != ShapeKind.BOX
        sphere, capsule = self.kinds == ShapeKind.SPHERE, self.kinds == ShapeKind.CAPSULE
        uneven = (round_kind & (width != depth)) | (sphere & (width != height))
        return {
            'its kind is none of BOX, SPHERE, CYLINDER and CAPSULE': self.kinds >= ShapeKind.MESH,
            **boxes.faults(),
            'its diameters differ': uneven,
            'its height is below its diameter': capsule & (height < width),
            'its max_distance is NaN or negative': np.logical_not(self.reaches >= 0.0),
        }


class SweepRows(NamedTuple):
    """Shapes that go from pose to pose, with unchecked values."""

    kinds: NDArray[np.uint8]  # (n,)
    places: Floats  # (n, 3) m
    sizes: Floats  # (n, 3) m
    turns: Floats  # (n, 4) quaternions
    goals: Floats  # (n, 3) m
    goal_turns: Floats  # (n, 4) quaternions
    tolerances: Floats  # (n,) m
    masks: Masks  # (n,)
    since: Floats | None = None  # (n,) s after the request's stamp, when they start; None: now
    durations: Floats | None = None  # (n,) s; None: the world stands still meanwhile

    def _ends(self) -> tuple[ShapeRows, ShapeRows]:
        """The shapes at the starts, and at the goals."""
        reaches, masks = np.zeros(len(self.kinds)), self.masks
        start = ShapeRows(self.kinds, self.places, self.sizes, self.turns, reaches, masks)
        return start, start._replace(places=self.goals, turns=self.goal_turns)

    def faults(self) -> dict[str, NDArray[np.bool_]]:
        """Return why rows (n,) cannot be answered."""
        start, goal = self._ends()
        faults = start.faults()
        del faults['its max_distance is NaN or negative']
        faults |= {f'at its goal, {why}': rows for why, rows in goal.faults().items()}
        faults['its tolerance is not finite, or negative'] = improper(self.tolerances)
        with np.errstate(over='ignore', invalid='ignore'):
            far = np.isfinite(self.goals - self.places).all(axis=1)
        faults['its way is too long'] = np.logical_not(far)
        if self.durations is not None:
            faults['its duration is not finite, or negative'] = improper(self.durations)
        return faults


class Limit:
    """How many obstacles of all rows together may still come.

    Parameters
    ----------
    request : Any
        Its `limit`, if it is one for all rows.
    otherwise : int
        The limit of a request without one.
    """

    def __init__(self, request: Any, otherwise: int) -> None:
        given = request.limit if isinstance(request, Raycast.Request | Overlap.Request) else 0
        self.most = self.left = given or otherwise

    def check(self, count: int) -> None:
        """Raise TooManyHitsError if so many are too many."""
        if count > self.left:
            raise TooManyHitsError(f'more than {self.most} obstacles')

    def take(self, count: int) -> None:
        """Count some; TooManyHitsError if they are too many."""
        self.check(count)
        self.left -= count


class Answers(NamedTuple):
    """Obstacles of n rows, m in all, those of the first row first."""

    counts: NDArray[np.int64]  # (n,) obstacles of each row
    obstacles: Masks  # (m,) handles
    numbers: dict[str, Any]  # (m,) or (m, 3) of each obstacle, by fields of the response


class Question(NamedTuple):
    """One kind of question.

    Attributes
    ----------
    kind : type
        The service.
    read : callable
        From a request to its rows; ValueError if its arrays do not belong together.
    ask : callable
        From scene, request, rows, begin and end (ns, or None) and the limit to Answers.
    kernels, timed : sequence of str
        What is compiled on first use: for all its requests, and for those about other times.
    """

    kind: type
    read: Callable[[Any], Any]
    ask: Callable[..., Answers]
    kernels: Sequence[str] = ()
    timed: Sequence[str] = ()

    def needs(self, is_timed: bool) -> Sequence[str]:
        """Names of what a request needs compiled."""
        return [*self.kernels, *(self.timed if is_timed else ())]


class TypedServices(Answerer):
    """Answers `query/raycast`, `overlap`, `nearest`, `clearance` and `sweep` of a view, by rows.

    Parameters
    ----------
    world : World
        Checked for completeness before each answer.
    view : View
        What these services show.
    kernels : OnDemand
        Kernels that are compiled on first use.
    """

    def __init__(self, node: Node, world: World, view: View, kernels: OnDemand) -> None:
        super().__init__(node, world, view, 'typed query')
        self._kernels = kernels
        settings = world.settings
        self._limit, self._threads = settings.max_hits, settings.threads_for
        self._pace = Pace()
        self._work: list[Generator[None, None, str]] = []  # begun
        for question in (
            Question(Raycast, _rays, self._cast),
            Question(Overlap, _boxes, self._overlap, [BOXES_ASKED]),
            Question(Nearest, _points, self._nearest, [POINTS], [NEAREST_THEN]),
            Question(Clearance, _shapes, self._clearance, [CLEARANCES], [PATHS_THEN]),
            Question(Sweep, _swept_shapes, self._sweep, [SWEEPS]),
        ):
            self._serve(question)

    def _serve(self, question: Question) -> None:
        async def callback(request: Any, response: Any) -> Any:
            work = self._reply(request, response, question)
            self._work.append(work)
            try:
                await in_turns(self.node, work)
            finally:
                self._work.remove(work)
            return response

        name = f'query/{question.kind.__name__.lower()}'
        self.service(question.kind, self.view.topic(name), callback)
        self.repeated_service(question.kind, self.view.topic(repeated(name)), callback)

    def finish(self) -> None:
        """Answer until nothing reads the scene in the helper thread any more."""
        while self._world.changes.owner is self:
            for work in list(self._work):
                next(work, None)

    def _reply(
        self, request: Any, response: Any, question: Question
    ) -> Generator[None, None, str]:
        began = time.perf_counter_ns()
        status, count = STATUS.FAILED, 1
        try:
            count = max(1, rows_of(request))
            rows = question.read(request)
            yield from self._answer(request, response, question, rows)
            self.timings.add(began)
            return ''
        except CompilingError as error:
            status, reason = STATUS.COMPILING, str(error)
        except IncompleteWorldError as error:
            status, reason = STATUS.INCOMPLETE_WORLD, str(error)
        except TooManyHitsError as error:
            status = STATUS.TOO_MANY_HITS
            reason = f'{error} (limit): ask for a smaller part of the world'
        except ValueError as error:
            status, reason = STATUS.BAD_REQUEST, str(error)
        except Exception as error:  # whatever went wrong, no row may look free
            reason = explain(error)
        if status != STATUS.COMPILING:  # that is logged as progress
            self.refused.add(reason)
        nothing = unanswered(request, response, count)
        write(response, nothing, np.full(count, status), reason)
        self.timings.add(began)
        return reason

    def _answer(
        self, request: Any, response: Any, question: Question, rows: Any
    ) -> Generator[None, None, None]:
        """Fill in the response, with pauses; ValueError if no row can be answered."""
        world = self._world
        header, stamp = request.header, nanoseconds(request.header.stamp)
        transform = world.frames.into_node(header.frame_id, stamp)
        count = len(rows.masks)
        if rows.since is None and stamp and world.times is not None:
            rows = rows._replace(since=np.zeros(count))
        times = world.times
        if rows.since is not None and times is None:
            raise ValueError(
                'departures and durations have no meaning: no source predicts, and there is no '
                'history'
            )
        begin = stamp or self.now()
        needs = question.needs(rows.since is not None)
        for name in needs:
            yield from self._kernels.load(name)
        statuses = np.full(count, STATUS.OK, np.uint8)
        parts: list[tuple[NDArray[np.int64], Answers]] = []
        reasons: list[str] = []
        limit = Limit(request, self._limit)

        def spans_of(some: Any) -> Spans | None:
            if times is None or some.since is None:
                return None
            durations = getattr(some, 'durations', None)
            return spans_after(some.since, durations, begin, times, self.now())

        def answer(piece: slice) -> None:
            scene = world.at(self.now())
            given = checked(take(rows, piece), piece.start, transform, spans_of)
            numbers = np.arange(piece.start, piece.start + len(given.good))
            bad = numbers[~given.good]
            if len(bad):
                reasons.append(given.reason)
                statuses[bad] = STATUS.BAD_REQUEST
                parts.append((bad, unanswered(request, response, len(bad))))
            for state, these, at, until in given.by_state(scene):
                masks = given.rows.masks[these] & np.uint32(self.view.mask)
                these_rows = take(given.rows, these)._replace(masks=masks)
                found = question.ask(state, request, these_rows, at, until, limit)
                if request.with_names:
                    names = state.names_of(found.obstacles)
                    found.numbers['names'] = np.where(found.obstacles == NO_NODE, '', names)
                parts.append((numbers[these], found))

        rays = count if isinstance(rows, Rays) else 0
        yield from prepare(self, world, rays, partial(spans_of, rows))
        costs: tuple[bool, ...] = (rows.since is not None,)
        if isinstance(request, Raycast.Request):
            costs = *costs, len(request.radii) > 0, request.all_hits
        kind = question.kind, *needs, *costs
        yield from self._pace.answer(kind, count, answer)
        if not count:  # an incomplete world is no answer even to nothing
            world.at(self.now())
        answers = merged(count, parts)
        if transform is not None:
            answers = back(transform, answers)
        newest = world.scene.newest
        response.stamp.sec, response.stamp.nanosec = divmod(newest, 1_000_000_000)
        self.answered += count - int(np.count_nonzero(statuses))
        if reasons:
            self.refused.add(reasons[0], int(np.count_nonzero(statuses)))
        write(response, answers, statuses, reasons[0] if reasons else '')
        if request.with_names and len(answers.obstacles):
            response.names = answers.numbers['names'].tolist()

    def _cast(
        self, scene: NodeScene, request: Any, rows: Rays, at: Any, until: Any, limit: Limit
    ) -> Answers:
        view = self.view
        if request.all_hits:
            return self._cast_all(scene, request, rows, at, until, limit)
        hits = scene.raycast_many(
            *(rows.origins, rows.directions, rows.t_max, rows.masks, view.skip_inside),
            *(self._threads(len(rows.masks)), rows.radii, at, until),
        )
        hit = hits.handles != NO_NODE
        numbers = {'t': hits.t[hit], 'points': hits.points[hit], 'normals': hits.normals[hit]}
        if _wants_triangles(request):
            numbers |= {'triangles': hits.triangles[hit], 'uv': hits.uv[hit]}
        return Answers(hit.astype(np.int64), hits.handles[hit], numbers)

    def _cast_all(
        self, scene: NodeScene, request: Any, rows: Rays, at: Any, until: Any, limit: Limit
    ) -> Answers:
        counts, hits = [], []
        goals = rows.origins + rows.directions
        radii = np.zeros(len(goals)) if rows.radii is None else rows.radii
        for row, (start, goal) in enumerate(zip(rows.origins, goals, strict=True)):
            times = (None, None) if at is None else (int(at[row]), int(until[row]))
            found = scene.raycast_all(
                *(start, goal, radii[row], int(rows.masks[row]), self.view.skip_inside),
                *(limit.left, *times),
            )
            limit.take(len(found))
            counts.append(len(found))
            hits += found
        numbers = {
            't': np.array([hit.t for hit in hits], np.float64),
            'points': np.array([hit.point for hit in hits], np.float64).reshape(-1, 3),
            'normals': np.array([hit.normal for hit in hits], np.float64).reshape(-1, 3),
        }
        if _wants_triangles(request):
            numbers |= {
                'triangles': np.array([hit.triangle for hit in hits], np.int64),
                'uv': np.array([hit.uv for hit in hits], np.float64).reshape(-1, 2),
            }
        handles = np.array([hit.handle for hit in hits], np.uint32)
        return Answers(np.array(counts, np.int64), handles, numbers)

    def _overlap(
        self, scene: NodeScene, request: Any, rows: Boxes, at: Any, _until: Any, limit: Limit
    ) -> Answers:
        turns = rotations.set_ones(rows.turns)
        boxes = rows.places, rows.sizes, turns, rows.tolerances, rows.masks
        given: dict[str, Any] = {'threads': self._threads(len(rows.masks)), 'at': at}
        if len(rows.masks) * len(scene) > limit.left:  # else there might be no room for them
            limit.check(int(scene.overlap_many(*boxes, want='count', **given).sum()))
        offsets, handles = scene.overlap_many(*boxes, want='all', **given)
        limit.take(len(handles))
        return Answers(np.diff(offsets), handles.astype(np.uint32), {})

    def _nearest(
        self, scene: NodeScene, request: Any, rows: Points, at: Any, _until: Any, limit: Limit
    ) -> Answers:
        k = max(1, min(request.limit, len(scene)))
        limit.take(k * len(rows.masks))
        handles, distances, points = scene.nearest_many(
            *(rows.places, k, rows.reaches, rows.masks, request.signed_distances),
            threads=self._threads(len(rows.masks)),
            at=at,
        )
        found = handles != NO_NODE
        places = np.repeat(rows.places, k, axis=0)
        closest = near(places, points.reshape(-1, 3), distances.ravel(), handles.ravel())
        filled = found.ravel()
        numbers = {
            'distances': closest.distances[filled],
            'closest': closest.points[filled],
            'normals': closest.normals[filled],
        }
        return Answers(found.sum(axis=1), closest.obstacles[filled].astype(np.uint32), numbers)

    def _clearance(
        self, scene: NodeScene, request: Any, rows: ShapeRows, at: Any, _until: Any, _limit: Limit
    ) -> Answers:
        shapes = unchecked_shapes(rows.kinds, rows.places, rows.turns, rows.sizes)
        handles, distances, points, others = scene.clearance_many(
            *(shapes, rows.reaches, rows.masks, request.signed_distances),
            *(self._threads(len(rows.masks)), at),
        )
        numbers = {'distances': distances, 'shape_points': points, 'obstacle_points': others}
        return Answers(np.ones(len(handles), np.int64), handles.astype(np.uint32), numbers)

    def _sweep(
        self, scene: NodeScene, request: Any, rows: SweepRows, at: Any, until: Any, _limit: Limit
    ) -> Answers:
        handles = np.empty(len(rows.masks), np.uint32)
        numbers: dict[str, Any] = {
            **{name: np.empty((len(handles), 3)) for name in ('points', 'normals')},
            **{name: np.empty(len(handles)) for name in ('t', 'free_until')},
        }
        forms = np.column_stack((rows.kinds, rows.sizes))
        _, first, which = np.unique(forms, axis=0, return_index=True, return_inverse=True)
        for number, row in enumerate(first):
            these = np.flatnonzero(which.ravel() == number)
            some = take(rows, these)
            shape = unchecked_shapes(
                *(rows.kinds[[row]], np.zeros((1, 3)), np.zeros((1, 4)), rows.sizes[[row]])
            )
            found: Any = scene.sweep_shape_many(
                *(shape, some.places, rotations.set_ones(some.turns)),
                *(some.goals, rotations.set_ones(some.goal_turns), some.tolerances, some.masks),
                request.resolution,
                at=None if at is None else at[these],
                until=None if until is None else until[these],
                threads=self._threads(len(these)),
            )
            handles[these] = found.handles
            for name, column in numbers.items():
                column[these] = getattr(found, name)
        return Answers(np.ones(len(handles), np.int64), handles, numbers)


# What a request asks, as columns.


def rows_of(request: Any) -> int:
    """How many rows a request has."""
    places = next(getattr(request, name) for name in PLACES if hasattr(request, name))
    return len(places) // 3


PLACES = 'starts', 'centers', 'points', 'positions'


class Column(NamedTuple):
    """A field of requests with values of each row, or one value for all rows."""

    field: str
    width: int = 1  # numbers a row
    default: Any = None  # where the request has no values; None: rows have none then, either
    kind: Any = np.float64
    needed: bool = False  # requests with rows have values

    def read(self, request: Any, count: int) -> Any:
        """Return values (count,) or (count, width); ValueError if they belong to other rows."""
        values, width = np.array(getattr(request, self.field), self.kind), self.width
        shape = (count, width) if width > 1 else (count,)
        if len(values) not in (0, width, width * count):
            raise ValueError(
                f'{self.field} has {len(values)} values: {width} for all rows, or {width * count} '
                f'for {count} rows are needed'
            )
        if not len(values):
            if self.needed and count:
                raise ValueError(f'{self.field} is empty')
            return None if self.default is None else np.full(shape, self.default, self.kind)
        return np.ascontiguousarray(np.broadcast_to(values.reshape(-1, *shape[1:]), shape))


COLUMNS = {
    'kinds': Column('kinds', 1, 0, np.uint8, needed=True),
    'sizes': Column('sizes', 3, 0.0, needed=True),
    'turns': Column('orientations', 4, 0.0),
    'goal_turns': Column('goal_orientations', 4),
    'radii': Column('radii'),
    'tolerances': Column('tolerances', 1, 0.0),
    'reaches': Column('max_distances', 1, np.inf),
    'since': Column('departures'),
    'durations': Column('durations'),
    'masks': Column('masks', 1, EVERYTHING, np.uint32),
}
"""By fields of the rows."""


def _rows(kind: Any, request: Any, count: int, **given: Any) -> Any:
    """Return rows of a kind with the columns that are given, and those of the request."""
    for name in kind._fields:
        if name not in given:
            given[name] = COLUMNS[name].read(request, count)
    if given.get('durations') is not None and given['since'] is None:
        given['since'] = np.zeros(count)
    return kind(**given)


def _places(request: Any, name: str) -> Floats:
    values = np.array(getattr(request, name), np.float64)
    if len(values) % 3:
        raise ValueError(f'{name} has {len(values)} values, which is no multiple of 3')
    return values.reshape(-1, 3)


def _both(request: Any, name: str, other: str) -> tuple[Floats, Floats]:
    """As many places of the one as of the other."""
    places, others = _places(request, name), _places(request, other)
    if len(others) != len(places):
        raise ValueError(f'there are {len(places)} {name} and {len(others)} {other}')
    return places, others


def _rays(request: Any) -> Any:
    starts, goals = _both(request, 'starts', 'goals')
    with np.errstate(over='ignore', invalid='ignore'):  # such rows are refused
        directions = goals - starts
    given = {'origins': starts, 'directions': directions, 't_max': np.ones(len(starts))}
    return _rows(Rays, request, len(starts), **given, real=np.dtype(np.float64))


def _boxes(request: Any) -> Any:
    places = _places(request, 'centers')
    return _rows(Boxes, request, len(places), places=places)


def _points(request: Any) -> Any:
    places = _places(request, 'points')
    if not request.limit:
        raise ValueError('limit is 0: at least 1 obstacle of a row is needed')
    return _rows(Points, request, len(places), places=places)


def _shapes(request: Any) -> Any:
    places = _places(request, 'positions')
    return _rows(ShapeRows, request, len(places), places=places)


def _swept_shapes(request: Any) -> Any:
    places, goals = _both(request, 'positions', 'goal_positions')
    if not 0.0 < request.resolution < np.inf:
        raise ValueError(f'resolution must be finite and above 0, not {request.resolution:g}')
    rows = _rows(SweepRows, request, len(places), places=places, goals=goals)
    return rows if rows.goal_turns is not None else rows._replace(goal_turns=rows.turns)


# Rows, and the answers to them.


POINT_FIELDS = 'points', 'closest', 'shape_points', 'obstacle_points'
WIDTHS = {'t': 1, 'free_until': 1, 'distances': 1, 'normals': 3, **dict.fromkeys(POINT_FIELDS, 3)}
"""Numbers of an obstacle, by fields of the responses."""


def back(transform: Transform, answers: Answers) -> Answers:
    """Return answers in the frame that the request came from."""
    inverse, numbers = transform.inverse(), dict(answers.numbers)
    with np.errstate(over='ignore', invalid='ignore'):
        numbers |= {n: inverse.points(numbers[n]) for n in POINT_FIELDS if n in numbers}
        numbers |= {n: inverse.vectors(numbers[n]) for n in ['normals'] if n in numbers}
    return answers._replace(numbers=numbers)


def _fields(response: Any) -> dict[str, int]:
    return {name: width for name, width in WIDTHS.items() if hasattr(response, name)}


def _wants_triangles(request: Any) -> bool:
    return isinstance(request, Raycast.Request) and request.with_triangles


def unanswered(request: Any, response: Any, count: int) -> Answers:
    """Return rows that say that nothing is known."""
    numbers: dict[str, Any] = {
        name: np.full((count, width) if width > 1 else count, np.nan)
        for name, width in _fields(response).items()
    }
    if _wants_triangles(request):
        numbers |= {'triangles': np.full(count, -1), 'uv': np.full((count, 2), np.nan)}
    numbers['names'] = np.full(count, '', object)
    return Answers(np.ones(count, np.int64), np.full(count, UNANSWERED, np.uint32), numbers)


def merged(count: int, parts: Sequence[tuple[NDArray[np.int64], Answers]]) -> Answers:
    """Put the answers to some rows each together."""
    if len(parts) == 1 and len(parts[0][0]) == count:
        return parts[0][1]
    counts = np.zeros(count, np.int64)
    for rows, answers in parts:
        counts[rows] = answers.counts
    first, total = np.cumsum(counts) - counts, int(counts.sum())
    obstacles = np.empty(total, np.uint32)
    numbers: dict[str, Any] = {}
    for rows, answers in parts:
        begin = np.cumsum(answers.counts) - answers.counts
        places = np.repeat(first[rows] - begin, answers.counts) + np.arange(len(answers.obstacles))
        obstacles[places] = answers.obstacles
        for name, values in answers.numbers.items():
            column = numbers.setdefault(name, np.empty((total, *values.shape[1:]), values.dtype))
            column[places] = values
    return Answers(counts, obstacles, numbers)


def write(response: Any, answers: Answers, statuses: NDArray[np.uint8], reason: str) -> None:
    """Write answers into the response; the stamp and names are left to the caller."""
    failed = statuses[statuses != STATUS.OK]
    response.status, response.message = int(failed[0]) if len(failed) else STATUS.OK, reason
    response.statuses = _packed('B', statuses.astype(np.uint8))
    if hasattr(response, 'offsets'):
        ends = np.cumsum(answers.counts, dtype=np.uint32)
        response.offsets = _packed('I', np.concatenate((np.zeros(1, np.uint32), ends)))
    response.obstacles = _packed('I', answers.obstacles)
    for name in _fields(response):
        values = answers.numbers.get(name)
        setattr(response, name, _packed('d', np.zeros(0) if values is None else values))
    if 'triangles' in answers.numbers:
        response.triangles = _packed('i', answers.numbers['triangles'].astype(np.int32))
        response.uv = _packed('d', answers.numbers['uv'])


def _packed(code: str, values: NDArray[Any]) -> array[Any]:
    packed = array(code)
    packed.frombytes(np.ascontiguousarray(values).tobytes())
    return packed
