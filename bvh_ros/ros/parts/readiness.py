# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Kernels that are compiled while the node serves."""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING

from bvh_ros.ros.compilation import Compilation, Progress
from bvh_ros.ros.parts.part import NodePart
from bvh_ros.ros.world.world import CompilingError
from bvh_ros.scene.store import run_in_thread

if TYPE_CHECKING:
    from rclpy.node import Node

    from bvh_ros.ros.compile_jobs import Job
    from bvh_ros.ros.world.world import World


class OnDemand(NodePart):
    """Compiles kernels on first use; until they are there, queries say how far that has come.

    Parameters
    ----------
    jobs : sequence of Job
        Each compiles the kernels of some queries.
    """

    def __init__(self, node: Node, jobs: Sequence[Job]) -> None:
        super().__init__(node)
        self._jobs = {job.name: job for job in jobs}
        self._under_way: dict[str, Compilation] = {}

    def require(self, name: str) -> None:
        """Return if the kernels of this job are there.

        Raises
        ------
        CompilingError
            If they are not, with how far they have come.
        """
        if name not in self._jobs:
            return
        compilation = self._begun(name)
        compilation.go_on()
        if not compilation.is_done:
            raise CompilingError(compilation.in_words())
        self._end(name)
        del self._jobs[name]

    def load(self, name: str) -> Iterator[None]:
        """`require` with pauses: the helper thread loads the kernels, which takes longer than a
        turn.
        """
        if name in self._jobs:
            yield from run_in_thread(self._begun(name).go_on)
        self.require(name)

    def _begun(self, name: str) -> Compilation:
        if name not in self._under_way:
            compilation = self._under_way[name] = Compilation([self._jobs[name]], 1)
            if compilation.seconds:  # else it was compiled before, and is but loaded
                self.node.get_logger().info(f'compiling {name}: first use')
            self._close.append(partial(self._end, name))
        return self._under_way[name]

    def _end(self, name: str) -> None:
        compilation = self._under_way.pop(name, None)
        if compilation is not None:
            compilation.end()


# Compiling what the first answers need, then the rest beside the node, which serves by then.

LOOK = 0.2  # seconds between two looks at the progress


class Readiness(NodePart):
    """Sees to it that kernels are there; until all are, the world says how far they have come.

    Parameters
    ----------
    world : World
        Its `compiling` is set while not every query can be answered.
    done : callable
        Called once the world is ready, if that is later than the first answers.
    """

    def __init__(
        self, node: Node, world: World, compilation: Compilation, done: Callable[[], object]
    ) -> None:
        super().__init__(node)
        self._world = world
        self._compilation = compilation
        self._done = done
        self._progress = Progress(node.get_logger().info)
        self._close.append(compilation.end)

    def begin(self, *, wholly: bool) -> None:
        """Wait until the first answers can be given, or all; else the rest comes while the node
        spins.
        """
        compilation = self._compilation
        wholly = wholly or not compilation.seconds  # loading takes less than a second
        self._progress.begin(compilation)
        while not (compilation.is_done or (compilation.has_begun_to_answer and not wholly)):
            compilation.go_on(LOOK)
            self._progress.show(compilation)
        if compilation.is_done:
            self._progress.end(compilation)
        else:
            self._world.compiling = compilation.in_words()
            self.every(LOOK, self._look)

    def _look(self) -> None:
        compilation = self._compilation
        compilation.go_on()
        if not compilation.is_done:
            self._world.compiling = compilation.in_words()
            self._progress.show(compilation)
            return
        self._world.compiling = ''
        self._progress.end(compilation)
        self._done()
        self.destroy()
