# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that few nodes need: compiled beside the node once somebody asks."""

from __future__ import annotations

from collections.abc import Sequence
from functools import partial
from typing import TYPE_CHECKING

from bvh_ros.ros.compilation import Compilation
from bvh_ros.ros.parts.part import NodePart
from bvh_ros.ros.world.world import IncompleteWorldError

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.compile_jobs import Job


class OnDemand(NodePart):
    """Compiles what is asked for; until it is there, the answer is how far that has come.

    Parameters
    ----------
    jobs : sequence of Job
        What may be asked for.
    """

    def __init__(self, node: Node, jobs: Sequence[Job]) -> None:
        super().__init__(node)
        self._jobs = {job.name: job for job in jobs}
        self._under_way: dict[str, Compilation] = {}

    def require(self, name: str) -> None:
        """Return if the kernels of this job are there.

        Raises
        ------
        IncompleteWorldError
            If they are not, with how far they have come.
        """
        job = self._jobs.get(name)
        if job is None:
            return
        if name not in self._under_way:
            compilation = self._under_way[name] = Compilation([job], 1)
            if compilation.seconds:  # else it was compiled before, and is but loaded
                self.node.get_logger().info(f'compiling {name}: somebody asks for the first time')
            self._close.append(partial(self._end, name))
        compilation = self._under_way[name]
        compilation.go_on()
        if not compilation.is_done:
            raise IncompleteWorldError(compilation.in_words())
        self._end(name)
        del self._jobs[name]

    def _end(self, name: str) -> None:
        compilation = self._under_way.pop(name, None)
        if compilation is not None:
            compilation.end()
