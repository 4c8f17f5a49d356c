# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Large changes are made in a helper thread, while a copy of the scene answers the queries."""

from __future__ import annotations

import time
from collections.abc import Callable, Generator
from typing import Any, TypeVar

from bvh_ros.scene import NodeScene
from bvh_ros.scene.store import run_in_thread

T = TypeVar('T')
PATIENCE = 0.002  # seconds between two looks whether another change has ended


class LargeChanges:
    """At most one large change of a scene at a time; other changes have to wait for its end.

    Attributes
    ----------
    owner : object
        Makes a large change now, or reads the scene in the helper thread; None if nothing does.
        It has a method `finish`.
    reading : bool
        Set by a caller that reads the scene for a while: large changes wait, small ones do not.
    """

    def __init__(self, scene: NodeScene) -> None:
        self.owner: Any = None
        self.reading = False
        self._scene = scene
        self._copy: NodeScene | None = None
        self._waiting: list[Callable[[], object]] = []

    @property
    def visible(self) -> NodeScene:
        """The scene that answers queries: a copy as long as a helper changes the scene itself."""
        return self._scene if self._copy is None else self._copy

    @property
    def copying(self) -> bool:
        """Whether a helper reads the scene: even what is due must not be removed from it."""
        return self.owner is not None and self._copy is None

    def call_at_end(self, resume: Callable[[], object]) -> None:
        """Call this once when the change that is under way has ended."""
        self._waiting.append(resume)

    def make(self, owner: object, change: Callable[[], T]) -> Generator[None, None, T]:
        """Call `change` in the helper thread and return its result; pause until it is there."""

        def change_and_refit() -> T:
            result = change()
            self._scene.refit()
            return result

        while self.reading:
            time.sleep(PATIENCE)
            yield
        self.owner = owner
        try:
            self._copy = yield from run_in_thread(self._scene.copy)
            return (yield from run_in_thread(change_and_refit))
        finally:
            self._end()

    def read(self, owner: object, call: Callable[[], T]) -> Generator[None, None, T]:
        """Call `call`, which reads the scene, in the helper thread and return its result; pause
        until it is there. The scene stays as it is meanwhile.
        """
        while self.owner is not None:
            time.sleep(PATIENCE)
            yield
        self.owner = owner
        try:
            return (yield from run_in_thread(call))
        finally:
            self._end()

    def _end(self) -> None:
        self.owner = self._copy = None
        waiting, self._waiting = self._waiting, []
        for resume in waiting:
            resume()
