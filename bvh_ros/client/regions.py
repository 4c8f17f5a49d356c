# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Several bvh nodes that share a world, a region each, queried as if they were one."""

from __future__ import annotations

import heapq
import math
import time
from collections.abc import Callable, Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from nav_msgs.srv import GetPlan
from numpy.typing import NDArray
from rclpy.node import Node

from bvh_ros.client.coverage import Box, Coverage, Floats, grown, swept
from bvh_ros.client.merging import HANDLE_BITS, Nearest
from bvh_ros.client.messages import Batch, BvhError, BvhTimeoutError, Hit
from bvh_ros.client.node import KINDS, OneNode
from bvh_ros.client.waiting import Question, Waiting, left
from bvh_ros.ros.conversions import query_clouds
from bvh_ros.ros.conversions.query_clouds import Boxes, Points, Rays

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
