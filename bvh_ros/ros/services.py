# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The services: raycast, raycast_all and overlap as GetPlan, and the triggers."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

from nav_msgs.srv import GetPlan
from std_srvs.srv import Trigger

from bvh_ros.ros.conversions import plans
from bvh_ros.ros.refusals import Refused

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.frames import Frames
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.scene import Scene, SceneHit

Answer = Callable[[plans.Query], 'Sequence[SceneHit]']


class QueryServices:
    """Answers `~/raycast`, `~/raycast_all` and `~/overlap`, or says why it cannot.

    A request that cannot be answered never looks free: the reply holds one pose whose frame_id
    begins with `error: `.

    Parameters
    ----------
    node : rclpy.node.Node
    scene : Scene
    frames : Frames
    sources : sequence of Source
        Asked before each answer whether the world is complete.
    """

    def __init__(
        self, node: Node, scene: Scene, frames: Frames, sources: Sequence[Source]
    ) -> None:
        self.refused = Refused(node.get_logger(), 'query')
        self.answered = 0
        self._clock = node.get_clock()
        self._scene = scene
        self._frames = frames
        self._sources = sources
        self._serve(node, '~/raycast', self._raycast)
        self._serve(node, '~/raycast_all', self._raycast_all)
        self._serve(node, '~/overlap', self._overlap, oriented=True)

    def _serve(self, node: Node, name: str, answer: Answer, *, oriented: bool = False) -> None:
        def callback(request: GetPlan.Request, response: GetPlan.Response) -> GetPlan.Response:
            self._reply(request, response, answer, oriented)
            return response

        node.create_service(GetPlan, name, callback)

    def _raycast(self, query: plans.Query) -> Sequence[SceneHit]:
        hit = self._scene.raycast(query.start, query.goal, query.tolerance)
        return () if hit is None else (hit,)

    def _raycast_all(self, query: plans.Query) -> Sequence[SceneHit]:
        return self._scene.raycast_all(query.start, query.goal, query.tolerance)

    def _overlap(self, query: plans.Query) -> Sequence[SceneHit]:
        return self._scene.overlap(query.start, query.goal, query.orientation, query.tolerance)

    def _reply(self, request: Any, response: Any, answer: Answer, oriented: bool) -> None:
        now = self._clock.now().nanoseconds
        plan, scene, frame_id = response.plan, self._scene, self._frames.frame_id
        try:
            self._check_world(now)
            query = plans.query(request, self._frames.into_node, oriented=oriented)
            scene.expire(now)  # the timer that does this too may be late
            plans.fill(plan, answer(query), frame_id, scene.newest)
            self.answered += 1
            return
        except ValueError as error:
            reason = str(error)
        except Exception as error:  # whatever went wrong, the way must not look free
            reason = f'internal error: {error!r}'
        self.refused.add(reason)
        plans.fill_error(plan, request, reason, frame_id, now)

    def _check_world(self, now: int) -> None:
        for source in self._sources:
            problem = source.problem(now)
            if problem:
                raise ValueError(problem)


class TriggerServices:
    """`~/clear`, `~/rebuild` and `~/validate`."""

    def __init__(self, node: Node, scene: Scene, sources: Sequence[Source]) -> None:
        self._scene = scene
        self._sources = sources
        for name, act in (
            ('~/clear', self._clear),
            ('~/rebuild', self._rebuild),
            ('~/validate', self._validate),
        ):
            self._serve(node, name, act)

    @staticmethod
    def _serve(node: Node, name: str, act: Callable[[], str]) -> None:
        def callback(_request: Trigger.Request, response: Trigger.Response) -> Trigger.Response:
            try:
                response.message = act()
                response.success = True
            except Exception as error:
                response.message = f'{type(error).__name__}: {error}'
                node.get_logger().error(f'{name}: {response.message}')
            return response

        node.create_service(Trigger, name, callback)

    def _clear(self) -> str:
        removed = self._scene.clear()
        for source in self._sources:
            source.forget()
        return f'removed {removed} obstacles'

    def _rebuild(self) -> str:
        self._scene.rebuild()
        return self._tree_in_words()

    def _validate(self) -> str:
        self._scene.validate()
        return f'valid: {self._tree_in_words()}'

    def _tree_in_words(self) -> str:
        stats = self._scene.stats()
        return '{} obstacles, height {}, cost {:.3f}'.format(
            len(self._scene), stats['height'], stats['cost']
        )
