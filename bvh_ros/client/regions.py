# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Several bvh nodes that share a world, a region each, queried as if they were one."""

from __future__ import annotations

import heapq
import itertools
import math
import time
from collections.abc import Callable, Mapping, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from nav_msgs.srv import GetPlan
from numpy.typing import NDArray
from rclpy.node import Node

from bvh_ros.client.messages import Batch, BvhError, BvhTimeoutError, Hit
from bvh_ros.client.node import KINDS, OneNode
from bvh_ros.client.waiting import Question, Waiting, left
from bvh_ros.ros.conversions import query_clouds
from bvh_ros.ros.conversions.query_clouds import FREE, UNANSWERED, Boxes, Points, Rays

# ---- Which regions a box touches, and whether all of it lies in regions


Floats = NDArray[np.float64]
Box = tuple[Floats, Floats]  # lower and upper corners, (n, 3) m


class Coverage:
    """The regions of several nodes, closed boxes.

    Along each axis their finite faces cut the world into planes and gaps. A cell is a plane or a
    gap of each axis. A region holds all of a cell or nothing. So the number of cells of a box
    that lie in no region is a sum over a table.

    Parameters
    ----------
    lo, hi : ndarray, shape (regions, 3)
        Corners, m; may be infinite.
    """

    def __init__(self, lo: Floats, hi: Floats) -> None:
        self.lo, self.hi = lo, hi
        faces = np.concatenate((lo, hi))
        self._planes = [np.unique(x[np.isfinite(x)]) for x in faces.T]
        unknown = np.ones([2 * len(planes) + 1 for planes in self._planes], np.int64)
        for first, last in zip(self._cells(lo), self._cells(hi), strict=True):
            unknown[tuple(slice(a, b + 1) for a, b in zip(first, last, strict=True))] = 0
        self._unknown_below = np.zeros([size + 1 for size in unknown.shape], np.int64)
        self._unknown_below[1:, 1:, 1:] = unknown.cumsum(0).cumsum(1).cumsum(2)

    def owners(self, box: Box) -> NDArray[np.bool_]:
        """Return which regions together know all that touches each box, (n, regions): the first
        one that holds all of it; where there is none, all that the box touches.
        """
        lo, hi = box[0][:, None], box[1][:, None]
        whole: Any = ((self.lo <= lo) & (self.hi >= hi)).all(axis=2)
        first = whole & (np.cumsum(whole, axis=1) == 1)
        touched = ((self.lo <= hi) & (self.hi >= lo)).all(axis=2)
        return np.asarray(np.where(whole.any(axis=1)[:, None], first, touched))

    def covers(self, box: Box) -> NDArray[np.bool_]:
        """Whether every point of each box lies in a region, (n,)."""
        ends = self._cells(box[0]), self._cells(box[1]) + 1
        unknown = np.zeros(len(box[0]), np.int64)
        for corner in itertools.product((0, 1), repeat=3):
            sign = -1 if sum(corner) % 2 == 0 else 1
            unknown += (
                sign
                * self._unknown_below[tuple(ends[end][:, axis] for axis, end in enumerate(corner))]
            )
        return unknown == 0

    def holds(self, regions: NDArray[np.int64], places: Floats) -> NDArray[np.bool_]:
        """Whether each place, (n, 3), lies in the region of a number, (n,)."""
        inside = (self.lo[regions] <= places) & (self.hi[regions] >= places)
        return np.asarray(inside.all(axis=1))

    def _cells(self, places: Floats) -> NDArray[np.int64]:
        """Numbers of cells along each axis, (n, 3): planes are odd, gaps are even."""
        cells = np.empty(places.shape, np.int64)
        for axis, planes in enumerate(self._planes):
            below = np.searchsorted(planes, places[:, axis], 'left')
            cells[:, axis] = below + np.searchsorted(planes, places[:, axis], 'right')
        return cells


def grown(box: Box, lengths: Any) -> Box:
    """Boxes that are larger by lengths, (n,) or (n, 3), on both sides; rounded outwards."""
    by = np.asarray(lengths)
    by = by[:, None] if by.ndim == 1 else by
    return -total(-box[0], by), total(box[1], by)


def total(a: Floats, b: Any) -> Floats:
    """a + b, or the next larger double where that is not exact."""
    with np.errstate(over='ignore', invalid='ignore'):
        rounded = a + b
        share = rounded - a
        exact = (a - (rounded - share)) + (b - share) == 0.0  # Knuth, TAOCP 2, 4.2.2, theorem B
        return np.where(exact, rounded, np.nextafter(rounded, np.inf))


def swept(origins: Floats, directions: Floats, t: Floats, radii: Any) -> Box:
    """Bounds of balls that go along ``origins + t * directions``; rounded outwards."""
    lengths = t[:, None]
    with np.errstate(over='ignore', invalid='ignore'):
        moved = np.where(directions == 0.0, 0.0, lengths * directions)
    exact = np.isin(np.abs(directions), (0.0, 1.0)) | np.isin(lengths, (0.0, 1.0))
    most, least = (np.where(exact, moved, np.nextafter(moved, end)) for end in (np.inf, -np.inf))
    lo = np.minimum(origins, -total(-origins, -least))
    return grown((lo, np.maximum(origins, total(origins, most))), radii)


# ---- Merging the answers of several nodes about the same rows: the nearest obstacle of each


HANDLE_BITS = 32  # of an obstacle's number; above them is the number of its node

Numbers = NDArray[np.int64]


class Nearest:
    """The nearest obstacle of each of n rows so far.

    Of equal distances at one place, the answer of the node counts in whose region the place lies:
    it knows all that is there. At different places the names decide, see `settle`.
    """

    def __init__(self, kind: Any, bad: NDArray[np.bool_], coverage: Coverage) -> None:
        count = len(bad)
        self._kind, self._coverage = kind, coverage
        self.unknown = bad.copy()
        """(n,) rows about which a node does not know all."""
        self._columns: dict[str, Any] = query_clouds.unanswered(kind, count)._asdict()
        self._columns['obstacles'] = np.full(count, FREE, np.int64)
        if 'counts' in self._columns:
            self._columns['counts'] = np.zeros(count, np.int64)
        self._far = 't' if 't' in self._columns else 'distances'
        self.distances = self._columns[self._far] = np.full(count, np.inf)
        self._obstacles, self._points = self._columns['obstacles'], self._columns['points']
        self._ties: list[tuple[Numbers, dict[str, Any]]] = []

    def add(self, rows: Numbers, region: int, answer: Any) -> None:
        """Add the answer of the node of a region about some rows."""
        its = answer._asdict()
        handles = its['obstacles'].astype(np.int64)
        hit = (handles != FREE) & (handles != UNANSWERED)
        self.unknown[rows[handles == UNANSWERED]] = True
        its['obstacles'] = handles | region << HANDLE_BITS
        if 'counts' in its:
            self._count(rows[hit], its.pop('counts')[hit].astype(np.int64))
        rows, its = rows[hit], {name: column[hit] for name, column in its.items()}
        distances = its[self._far]
        known = self._obstacles[rows] != FREE
        nearer = ~known | (distances < self.distances[rows])
        tied = known & (distances == self.distances[rows])
        same = tied & (its['points'] == self._points[rows]).all(axis=1)
        at_home = self._coverage.holds(its['obstacles'] >> HANDLE_BITS, its['points'])
        other = self._coverage.holds(self._obstacles[rows] >> HANDLE_BITS, its['points'])
        self._put(rows, its, nearer | (same & at_home & ~other))
        apart = tied & ~same
        if apart.any():
            self._ties.append((rows[apart], {name: its[name][apart] for name in its}))

    def _count(self, rows: Numbers, counts: Numbers) -> None:
        """Counts of one node hold; those of several would count an obstacle of both twice."""
        mine = self._columns['counts']
        mine[rows] = np.where(mine[rows] > 0, UNANSWERED, counts)

    def _put(self, rows: Numbers, its: Mapping[str, Any], better: NDArray[np.bool_]) -> None:
        for name, column in its.items():
            self._columns[name][rows[better]] = column[better]

    def tied(self) -> set[int]:
        """Obstacles whose names decide."""
        tied: set[int] = set()
        for rows, its in self._ties:
            still = self._still(rows, its)
            tied |= {*its['obstacles'][still].tolist(), *self._obstacles[rows[still]].tolist()}
        return tied

    def settle(self, names: Mapping[int, str]) -> None:
        """Of obstacles as far away take the first by name; those without a name come last."""
        last = chr(0x10FFFF)
        for rows, its in self._ties:
            ours = [names.get(one, last) for one in self._obstacles[rows].tolist()]
            theirs = [names.get(one, last) for one in its['obstacles'].tolist()]
            first = np.array([a < b for a, b in zip(theirs, ours, strict=True)], np.bool_)
            self._put(rows, its, first & self._still(rows, its))

    def _still(self, rows: Numbers, its: Mapping[str, Any]) -> NDArray[np.bool_]:
        return np.asarray(its[self._far] == self.distances[rows])

    def answer(self) -> Any:
        """Return all rows; the unknown ones as a node writes an UNANSWERED row."""
        answer = self._kind(**self._columns)
        lost = query_clouds.unanswered(self._kind, int(np.count_nonzero(self.unknown)))
        query_clouds.put(answer, self.unknown, lost)
        return answer


# ---- Several bvh nodes that share a world, a region each, queried as if they were one


LEAVES = 'the query leaves the regions of all nodes'
PARAMETERS = ('region', 'planar', 'frame_id', 'footprint', 'nearest_limit')
NAMES_PATIENCE = 2.0  # seconds; names are published once a second
SILENT = 5.0  # seconds for which a node that did not answer is remembered, ...
PROBE = 0.3  # ... and meanwhile has this many seconds to answer
SAME = 1e-9  # of the radius: what a ball touches where it starts
Answer = TypeVar('Answer')


class Region(NamedTuple):
    """The parameters of one node that matter here."""

    name: str
    publishers: frozenset[bytes]
    """Of names: another publisher is another life of the node."""
    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    frame_id: str
    footprint: tuple[float, ...]
    nearest_limit: int

    def is_current(self, node: OneNode) -> bool:
        """Whether no new life of the node is seen. A node that has died is current: only
        questions about its region wait for it, in vain.
        """
        return node.publishers_of_names()[1] <= self.publishers


class Layout(NamedTuple):
    """The regions of all nodes, in their order."""

    regions: list[Region]
    coverage: Coverage

    @property
    def nearest_limit(self) -> int:
        """How many of the nearest obstacles all of them return."""
        return min(region.nearest_limit for region in self.regions)

    def footprint(self) -> tuple[float, ...]:
        """The one footprint; BvhError if there are two, or none."""
        first, *others = (region.footprint for region in self.regions)
        if any(other != first for other in others) or first in ((), (0.0,)):
            raise BvhError("the nodes do not have the same parameter 'footprint'")
        return first

    def is_current(self, nodes: Sequence[OneNode]) -> bool:
        """Whether no node was started again since."""
        return all(map(Region.is_current, self.regions, nodes))


class Part(NamedTuple):
    """Some rows of a batch, as a question to one node."""

    region: int
    rows: NDArray[np.int64]
    question: Question
    end: float
    """Until when its answer is waited for, on the monotonic clock."""

    def is_over(self) -> bool:
        """Whether there is an answer, or no time is left for it."""
        return bool(self.question.answer.done()) or left(self.end) == 0.0


class SeveralNodes:
    """Queries several nodes as if they were one.

    A query goes to the nodes whose region it meets, to one alone if that holds all of it. The
    answers are merged: nearest first, equal distances by name, an obstacle of several regions
    once. What no node knows is not free: it is an error, in a batch an UNANSWERED row. The region
    of a node that was started again is read anew.
    """

    def __init__(self, node: Node, names: Sequence[str], waiting: Waiting) -> None:
        if not names:
            raise ValueError('there must be a name of a bvh node at least')
        self._nodes = [OneNode(node, name, waiting) for name in names]
        self._waiting = waiting
        self._silent_until: dict[int, float] = {}
        """By region, whose node did not answer: how long that is remembered."""
        self._layout: Layout | None = None

    def wait_until_ready(self, timeout: float) -> None:
        """Wait until all nodes are ready; see `BvhClient.wait_until_ready`."""
        deadline = time.monotonic() + timeout
        for node in self._nodes:
            node.wait_until_ready(left(deadline))

    def wait_until_batches_are_ready(self, timeout: float) -> None:
        """See `BvhClient.wait_until_batches_are_ready`."""
        deadline = time.monotonic() + timeout
        for node in self._nodes:
            node.wait_until_batches_are_ready(left(deadline))

    def coverage(self, timeout: float) -> Coverage:
        """Return the regions of all nodes."""
        return self._with_layout(lambda layout, _: layout.coverage, timeout)

    def names(self, handles: set[int], timeout: float) -> dict[int, str]:
        """Return names of the numbers that batches return; see `BvhClient.names`."""
        deadline, names = time.monotonic() + timeout, dict[int, str]()
        for region, node in enumerate(self._nodes):
            above = region << HANDLE_BITS
            own = {n - above for n in handles if n >> HANDLE_BITS == region}
            if own:
                found = node.names(own, left(deadline))
                names |= {above + handle: name for handle, name in found.items()}
        return names

    def hits(self, query: str, request: GetPlan.Request, timeout: float) -> list[Hit]:
        """Return the hits of one question, merged."""
        _refuse_frame(request.start.header.frame_id)
        a, b = _place(request.start), _place(request.goal)
        length = request.tolerance
        if query == 'nearest':
            return self._nearest(request, a, timeout)
        if query == 'overlap':
            turn = request.start.pose.orientation
            center, box = a * 0.5 + b * 0.5, _box(a, b, 0.0)
            if turn.x or turn.y or turn.z:  # a ball around the box, however that is turned
                box = _box(center, center, math.nextafter(math.dist(a, b) * 0.5, math.inf))
            box = grown(box, [_float32(length)])

            def distance(hit: Hit) -> float:
                return math.dist(hit.point, center)
        else:
            box = _box(a, b, _float32(length))

            def distance(hit: Hit) -> float:
                return _share(hit, a, b - a, length)

        def work(layout: Layout, deadline: float) -> list[Hit]:
            if not layout.coverage.covers(box)[0]:
                raise BvhError(LEAVES)
            regions = layout.coverage.owners(box)[0]
            return _merged(self._replies(query, request, regions, deadline), distance)

        return self._with_layout(work, timeout)

    def _nearest(
        self, request: GetPlan.Request, place: NDArray[np.float64], timeout: float
    ) -> list[Hit]:
        def distance(hit: Hit) -> float:
            return math.dist(hit.point, place)

        def work(layout: Layout, deadline: float) -> list[Hit]:
            reach = _float32(request.tolerance) or math.inf
            regions = layout.coverage.owners(_box(place, place, reach))[0]
            hits = _merged(self._replies('nearest', request, regions, deadline), distance)
            if len(hits) >= layout.nearest_limit:
                hits = hits[: layout.nearest_limit]
                reach = distance(hits[-1])
            if not layout.coverage.covers(_box(place, place, reach))[0]:
                raise BvhError(LEAVES)
            return hits

        return self._with_layout(work, timeout)

    def _replies(
        self, query: str, request: GetPlan.Request, regions: NDArray[np.bool_], deadline: float
    ) -> list[list[Hit]]:
        """Ask the nodes of some regions at once; return the replies of all, or the first error."""
        nodes = [self._nodes[region] for region in np.flatnonzero(regions)]
        questions = [node.question(query, request) for node in nodes]
        return self._waiting.results(questions, left(deadline))

    def answers(
        self, batch: Batch, timeout: float, frame_id: str = '', stamp: int | None = None
    ) -> Any:
        """Return the answers to a batch: the nearest obstacle of each row.

        Each row goes to the region where it begins, then to all regions that may know something
        nearer. A row that leaves the regions, or whose node does not answer, is
        UNANSWERED.
        """
        _refuse_frame(frame_id)
        if stamp is not None:
            raise ValueError('several nodes take no stamp')

        def work(layout: Layout, deadline: float) -> Any:
            rows, coverage = _rows(batch, layout), layout.coverage
            nearest = Nearest(KINDS[batch.kind].kind, rows.bad, coverage)
            count = len(rows.bad)
            answered = np.zeros((count, len(self._nodes)), np.bool_)
            waiting = answered.copy()
            parts: list[Part] = []
            failure: BvhError | None = None
            nearest.unknown |= ~coverage.covers(rows.around(np.zeros(count)))
            while True:
                # First the region where a row begins, then all that are as near as its answer.
                found = np.clip(nearest.distances, 0.0, rows.most)  # a depth reaches no farther
                reach = np.where(answered.any(axis=1), found, 0.0)
                owners = coverage.owners(rows.around(reach)) & ~answered
                owners[nearest.unknown | waiting.any(axis=1)] = False
                waiting |= owners
                for region in np.flatnonzero(owners.any(axis=0)).tolist():
                    some = np.flatnonzero(owners[:, region])
                    question = self._nodes[region].batch_question(batch, some=some)
                    parts.append(Part(region, some, question, self._end(region, deadline)))
                if not parts:
                    break
                for part in self._take_over(parts):
                    waiting[part.rows, part.region] = False
                    answered[part.rows, part.region] = True
                    try:
                        nearest.add(part.rows, part.region, self._answer(part))
                    except BvhError as error:
                        nearest.unknown[part.rows] = True
                        failure = failure or error
            nearest.unknown |= ~coverage.covers(rows.around(reach))
            if count and nearest.unknown.all():
                raise failure or BvhError(f'no row can be answered: NaN, or {LEAVES}')
            if tied := nearest.tied():
                nearest.settle(self.names(tied, min(left(deadline), NAMES_PATIENCE)))
            return nearest.answer()

        return self._with_layout(work, timeout)

    def _end(self, region: int, deadline: float) -> float:
        """Return until when a node is waited for: not long if it did not answer a moment ago."""
        now = time.monotonic()
        silent = self._silent_until.get(region, 0.0) > now
        return min(deadline, now + PROBE) if silent else deadline

    def _take_over(self, parts: list[Part]) -> list[Part]:
        """Wait until some parts are over; take them out of the list."""
        self._waiting.until(
            lambda: any(part.is_over() for part in parts),
            left(min(part.end for part in parts)),
            [part.question for part in parts],
        )
        over: list[Part] = []
        others: list[Part] = []
        for part in parts:
            (over if part.is_over() else others).append(part)
        parts[:] = others
        return over

    def _answer(self, part: Part) -> Any:
        """Return the answer to a part that is over; remember a node that did not answer."""
        try:
            answer = self._waiting.result(part.question, 0.0)
        except BvhTimeoutError:
            self._silent_until[part.region] = time.monotonic() + SILENT
            raise BvhTimeoutError(f'no answer from {part.question.name}') from None
        self._silent_until.pop(part.region, None)
        return answer

    def _with_layout(self, work: Callable[[Layout, float], Answer], timeout: float) -> Answer:
        """Do what asks the nodes; again, if one of them was started again meanwhile: its region
        may be another one.
        """
        deadline = time.monotonic() + timeout
        while True:
            layout = self._layout = self._read_layout(deadline)
            try:
                answer = work(layout, deadline)
            except BvhError:
                if layout.is_current(self._nodes):
                    raise
            else:
                if layout.is_current(self._nodes):
                    return answer

    def _read_layout(self, deadline: float) -> Layout:
        """Ask the nodes that are not known yet, or were started again.

        Raises
        ------
        BvhError
            If they do not fit together; BvhTimeoutError if one does not answer until `deadline`.
        """
        old = self._layout
        if old is not None and old.is_current(self._nodes):
            return old
        regions = []
        for number, node in enumerate(self._nodes):
            if old is not None and old.regions[number].is_current(node):
                regions.append(old.regions[number])
            else:
                regions.append(self._read_region(node, deadline))
        for region in regions:
            if region.frame_id != regions[0].frame_id:
                raise BvhError(
                    f"'{region.name}' is in frame '{region.frame_id}', '{regions[0].name}' in "
                    f"'{regions[0].frame_id}': their regions cannot be compared"
                )
        corners = [np.array([r.lo for r in regions]), np.array([r.hi for r in regions])]
        return Layout(regions, Coverage(*corners))

    def _read_region(self, node: OneNode, deadline: float) -> Region:
        if not self._waiting.until(lambda: node.publishers_of_names()[0] != '', left(deadline)):
            raise BvhTimeoutError(f"'{node.name}' is not found")
        # The publishers first: if the parameters are those of a later life, that shows.
        publishers = node.publishers_of_names()[1]
        values = dict(zip(PARAMETERS, node.parameters(PARAMETERS, left(deadline)), strict=True))
        corners = np.array(values['region'].double_array_value)
        if corners.shape != (6,):
            raise BvhError(f"'{node.name}' has no parameter 'region'")
        lo, hi = corners[:3], corners[3:]
        if values['planar'].bool_value:  # such a node ignores z: its region has any height
            lo[2], hi[2] = -math.inf, math.inf
        return Region(
            name=node.name,
            publishers=publishers,
            lo=lo,
            hi=hi,
            frame_id=values['frame_id'].string_value,
            footprint=tuple(values['footprint'].double_array_value),
            nearest_limit=values['nearest_limit'].integer_value,
        )


class Rows(NamedTuple):
    """Where the answers to the rows of a batch can lie."""

    bad: NDArray[np.bool_]
    """(n,) rows that no node can answer."""
    most: Floats
    """(n,) no obstacle is looked for beyond this distance."""
    around: Callable[[Floats], Box]
    """Bounds of all places that are as near as some distances (n,): a node that knows what
    touches them knows whether there is anything so near.
    """


def _rows(batch: Batch, layout: Layout) -> Rows:
    questions, count = batch.questions, len(batch)
    if isinstance(questions, Rays):  # a distance is a t
        rays, radii = questions, np.zeros(1) if questions.radii is None else questions.radii

        def around_rays(t: Floats) -> Box:
            return swept(rays.origins, rays.directions, t, radii)

        return Rows(query_clouds.fault(rays)[0], rays.t_max, around_rays)
    places = (questions.places, questions.places)
    if isinstance(questions, Points):
        bad = query_clouds.fault(questions)[0]
        return Rows(bad, questions.reaches, lambda distances: grown(places, distances))
    if isinstance(questions, Boxes):  # whatever touches a box lies around all of it
        half = questions.sizes * 0.5
        with np.errstate(over='ignore', invalid='ignore'):
            ball = np.nextafter(np.linalg.norm(half, axis=1), np.inf)[:, None]
            half = np.where((questions.turns[:, :3] != 0.0).any(axis=1)[:, None], ball, half)
            box = grown(grown(places, half), questions.tolerances)
        bad = query_clouds.fault(questions)[0]
        return Rows(bad, np.zeros(count), lambda _: box)
    footprint = layout.footprint()  # edge lengths of a box, or the radius of a ball
    radius = footprint[0] if len(footprint) == 1 else float(np.linalg.norm(footprint)) * 0.5
    reach = np.nextafter(radius, np.inf)
    bad = np.logical_not(np.isfinite(np.hstack(questions)).all(axis=1))

    def around_poses(distances: Floats) -> Box:
        return grown(grown(places, reach), np.maximum(distances, 0.0))

    return Rows(bad, np.full(count, np.inf), around_poses)


def _refuse_frame(frame_id: str) -> None:
    if frame_id:
        raise ValueError('several nodes answer in their own frame, without frame_id')


def _place(stamped: Any) -> NDArray[np.float64]:
    place = stamped.pose.position
    return np.array((place.x, place.y, place.z))


def _box(a: NDArray[np.float64], b: NDArray[np.float64], reach: float) -> Box:
    """Return one row: the box with these corners, grown."""
    return grown((np.minimum(a, b)[None], np.maximum(a, b)[None]), [reach])


def _float32(length: float) -> float:
    """Return the larger of a length and what becomes of it in a request."""
    return max(length, float(np.float32(length)))


def _share(hit: Hit, start: Any, segment: Any, radius: float) -> float:
    """Return how much of its segment a ball has passed where it meets an obstacle."""
    length = float(np.linalg.norm(segment))
    if length == 0.0 or math.dist(hit.point, start) <= radius * (1.0 + SAME):
        return 0.0
    center = np.array(hit.point) + radius * np.array(hit.normal)
    return float((center - start) @ (segment / length)) / length


def _merged(replies: list[list[Hit]], distance: Callable[[Hit], float]) -> list[Hit]:
    """Return all obstacles once; those of one node stay in its order."""
    known: dict[str, Hit] = {}
    for hit in heapq.merge(*replies, key=lambda hit: (distance(hit), hit.name)):
        known.setdefault(hit.name, hit)
    return list(known.values())
