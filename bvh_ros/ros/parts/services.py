# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services: raycast, raycast_all, overlap and nearest as GetPlan, and the triggers."""

from __future__ import annotations

import contextlib
import math
import time
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from types import coroutine
from typing import TYPE_CHECKING, Any

from nav_msgs.srv import GetPlan
from rclpy.callback_groups import MutuallyExclusiveCallbackGroup
from std_srvs.srv import Trigger

from bvh_ros.ros.compile_jobs import NEAREST, NEAREST_THEN
from bvh_ros.ros.conversions import plans
from bvh_ros.ros.parts.part import Answerer, NodePart
from bvh_ros.ros.qos import repeated
from bvh_ros.ros.texts import explain, why
from bvh_ros.ros.world.known_times import NOW, Span, span_of
from bvh_ros.ros.world.large_changes import PATIENCE
from bvh_ros.scene import TooManyHitsError

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.parts.drawing import QueryDrawing
    from bvh_ros.ros.parts.readiness import OnDemand
    from bvh_ros.ros.world.views import View
    from bvh_ros.ros.world.world import World
    from bvh_ros.scene import NodeScene, SceneHit

FEW = 10_000  # obstacles, of which the tree is built anew in some 5 ms
Acting = Generator[None, None, str]  # pauses, and returns the reply
Answer = Callable[['NodeScene', plans.Query, Span], 'Sequence[SceneHit]']


class QueryServices(Answerer):
    """Answers `raycast`, `raycast_all`, `overlap` and `nearest` of a view, or says why it cannot.

    A request that cannot be answered never looks free: the reply holds one pose whose frame_id
    begins with `error: `.

    Parameters
    ----------
    world : World
        Checked for completeness before each answer.
    view : View
        The part of the world that these services see.
    drawing : QueryDrawing
        Gets questions and answers while it has subscribers.
    kernels : OnDemand
        Kernels that are compiled on first use.
    """

    def __init__(
        self, node: Node, world: World, view: View, drawing: QueryDrawing, kernels: OnDemand
    ) -> None:
        logged = f"query of '{view.name}'" if view.name else 'query'
        super().__init__(node, world, view, 'queries', logged)
        self._replies = plans.Replies()
        self._drawing = drawing
        self._kernels = kernels
        self._most, self._nearest_limit = world.settings.max_hits, world.settings.nearest_limit
        self._serve('raycast', self._raycast)
        self._serve('raycast_all', self._raycast_all)
        self._serve('overlap', self._overlap, oriented=True)
        self._serve('nearest', self._nearest)

    def _serve(self, name: str, answer: Answer, *, oriented: bool = False) -> None:
        def callback(request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
            self._reply(request, response, answer, oriented)
            return response

        self.service(GetPlan, self.view.topic(name), callback)
        self.repeated_service(GetPlan, self.view.topic(repeated(name)), callback)

    def _raycast(self, scene: NodeScene, query: plans.Query, span: Span) -> Sequence[SceneHit]:
        view = self.view
        ray = query.start, query.goal, query.tolerance, view.mask, view.skip_inside
        hit = scene.raycast(*ray, *span)
        return () if hit is None else (hit,)

    def _raycast_all(self, scene: NodeScene, query: plans.Query, span: Span) -> Sequence[SceneHit]:
        view = self.view
        ray = query.start, query.goal, query.tolerance, view.mask, view.skip_inside
        return scene.raycast_all(*ray, self._most, *span)

    def _overlap(self, scene: NodeScene, query: plans.Query, span: Span) -> Sequence[SceneHit]:
        box = query.start, query.goal, query.orientation, query.tolerance, self.view.mask
        return scene.overlap(*box, self._most, span.at)

    def _nearest(self, scene: NodeScene, query: plans.Query, span: Span) -> Sequence[SceneHit]:
        self._kernels.require(NEAREST if span.at is None else NEAREST_THEN)
        reach = query.tolerance or math.inf
        return scene.nearest(
            *(query.start, self._nearest_limit, reach, self.view.mask), at=span.at
        )

    def _span(self, request: Any, answer: Answer, now: int) -> Span:
        """The times that a request is about; ValueError if they are not known."""
        times = self._world.times
        if times is None:
            return NOW
        moves = answer in (self._raycast, self._raycast_all)
        return times.require(span_of(request, moves=moves), now)

    def _reply(self, request: Any, response: Any, answer: Answer, oriented: bool) -> None:
        began = time.perf_counter_ns()
        now = self.now()
        plan, frames = response.plan, self._world.frames
        try:
            span = self._span(request, answer, now)
            thin_ray = not oriented and answer == self._raycast and request.tolerance == 0.0
            scene = self._world.at(now, thin_ray=thin_ray and span.at is None)
            query = plans.query(request, frames.into_node, oriented=oriented)
            if answer == self._nearest:
                query = plans.of_point(request, query)
            if span.at is not None and self._world.times is not None:
                scene = self._world.times.state(span.at, now)  # as it was known then
            hits = answer(scene, query, span)
            if span.at is not None and span.until is not None:
                ns = span.until - span.at
                hits = [hit._replace(stamp=span.at + round(hit.t * ns)) for hit in hits]
            self._replies.fill(plan, hits, frames.frame_id, scene.newest)
            if self._drawing.is_watched:
                self._drawing.add_query(query, hits, scene, is_box=oriented)
            self.timings.add(began)
            return
        except TooManyHitsError as error:
            reason = f'{error} (max_hits): ask for a smaller part of the world'
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = why(error)
        if reason != self._world.compiling:  # that is logged as progress
            self.refused.add(reason)
        plans.fill_error(plan, request, reason, frames.frame_id, now)


@coroutine
def in_turns(node: Node, work: Acting) -> Acting:
    """Go on with work whenever the executor has come round; return what it returns."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return str(end.value)
        node.executor.wake()
        yield


class TriggerServices(NodePart):
    """`~/clear`, `~/rebuild` and `~/validate`, one at a time; queries are answered in between."""

    def __init__(self, node: Node, world: World) -> None:
        super().__init__(node)
        self._world = world
        self._sources = world.sources
        self._group = MutuallyExclusiveCallbackGroup()
        self._work: Iterable[None] = ()  # in the helper thread
        for name, act in (
            ('~/clear', self.clear),
            ('~/rebuild', self.rebuild),
            ('~/validate', self.validate),
        ):
            self._serve(name, act)

    def _serve(self, name: str, act: Callable[[], Acting]) -> None:
        async def callback(
            _request: Trigger.Request, response: Trigger.Response
        ) -> Trigger.Response:
            try:
                response.message = await in_turns(self.node, act())
                response.success = True
                return response
            except Exception as error:
                response.message = explain(error)
            with contextlib.suppress(Exception):
                self.node.get_logger().error(f'{name}: {response.message}')
            return response

        self.service(Trigger, name, callback, callback_group=self._group)

    def clear(self) -> Acting:
        """Remove all obstacles; sources begin anew."""
        self._world.catch_up()
        yield from self._until_unchanged()
        removed = self._world.scene.clear()
        self._world.forget()
        for source in self._sources:
            source.forget()
        yield
        return f'removed {removed} obstacles'

    def rebuild(self) -> Acting:
        """Build the tree anew: a large one in the helper thread, while a copy answers."""
        yield from self._until_unchanged()
        scene = self._world.scene
        if len(scene) < FEW:
            scene.rebuild()
        else:
            self._work = self._world.changes.make(self, scene.rebuild)
            yield from self._work
        return (yield from self._tree_in_words())

    def finish(self) -> None:
        """Build the tree anew until it is done."""
        for _ in self._work:
            pass

    def validate(self) -> Acting:
        """Check everything, bit by bit."""
        if self._world.compiling:
            raise RuntimeError(self._world.compiling)
        yield from self._until_unchanged()
        self._world.changes.reading = True
        try:
            yield from self._world.scene.validate_in_turns()
        finally:
            self._world.changes.reading = False
        return f'valid: {yield from self._tree_in_words()}'

    def _until_unchanged(self) -> Iterator[None]:
        """Pause while a large change is under way."""
        while self._world.changes.owner is not None:
            time.sleep(PATIENCE)
            yield

    def _tree_in_words(self) -> Acting:
        """Height and cost, read in the helper thread: the cost of 10^6 boxes takes 40 ms."""
        scene = self._world.scene
        read: list[dict[str, Any]] = []  # here also where `finish` ends the work
        self._work = self._world.changes.read(self, lambda: read.append(scene.stats()))
        yield from self._work
        height, cost = read[0]['height'], read[0]['cost']
        return f'{len(scene)} obstacles, height {height}, cost {cost:.3f}'
