# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The world that every part of the node works on: scene, frames, sources and views."""

from __future__ import annotations

from dataclasses import dataclass
from typing import TYPE_CHECKING

from rclpy.clock import Clock, ClockType, JumpThreshold
from rclpy.duration import Duration

from bvh_ros.ros.texts import LOG_EVERY, Seldom

if TYPE_CHECKING:
    from collections.abc import Sequence

    from rclpy.node import Node

    from bvh_ros.ros.parameters import Settings
    from bvh_ros.ros.sources.source import Source
    from bvh_ros.ros.world.frames import Frames
    from bvh_ros.ros.world.known_times import KnownTimes
    from bvh_ros.ros.world.large_changes import LargeChanges
    from bvh_ros.ros.world.views import View
    from bvh_ros.scene import NodeScene

EXPIRED_AT_ONCE = 8192  # obstacles, about 10 ms


class IncompleteWorldError(ValueError):
    """What the answers depend on is missing: a source, or kernels. The text says which and why."""


class CompilingError(IncompleteWorldError):
    """Kernels are missing; the text says how far compiling has come."""


@dataclass
class World:
    """What is known, where it comes from, and whether that is enough to answer.

    Attributes
    ----------
    times : KnownTimes, optional
        The times that queries may name; None: stamps of requests say nothing.
    compiling : str
        Says how far compiling has come, while not every question can be answered.
    """

    settings: Settings
    changes: LargeChanges
    frames: Frames
    sources: Sequence[Source]
    views: Sequence[View]  # that of everything first
    times: KnownTimes | None = None
    compiling: str = ''

    @property
    def scene(self) -> NodeScene:
        """The scene as queries see it; only sources change it."""
        return self.changes.visible

    def at(self, now: int, *, thin_ray: bool = False) -> NodeScene:
        """Return the scene as it is at `now` (ns on the node's clock): what is due has expired. Of
        very many that are due the last go a little later, so that no query waits for them.

        Parameters
        ----------
        thin_ray : bool
            Whether the query is one thin ray. Among axis-aligned boxes that can be answered first.

        Raises
        ------
        IncompleteWorldError
            If a source is missing or silent for too long; an answer might look free. Or if the
            query is still being compiled.
        """
        self.catch_up()
        early = thin_ray and not self.scene.any_shaped
        problem = self._silence(now) if early else self.problem(now)
        if problem:
            raise (CompilingError if problem == self.compiling else IncompleteWorldError)(problem)
        self.expire(now)
        return self.scene

    def expire(self, now: int) -> bool:
        """Remove obstacles that are due; return whether some are left that are due, too."""
        if self.changes.copying:
            return False
        if self.scene.expire(now, EXPIRED_AT_ONCE) and self.times is not None:
            self.times.note_expiry(now)
        return self.scene.has_expired(now)

    def finish_changes(self) -> None:
        """Wait until no large change is under way."""
        while self.changes.owner is not None:
            self.changes.owner.finish()

    def catch_up(self) -> None:
        """Apply what has come, before a query or a clear."""
        for source in self.sources:
            source.catch_up()

    def problem(self, now: int) -> str:
        """Say why not every question can be answered, or return an empty text."""
        return self.compiling or self._silence(now)

    def _silence(self, now: int) -> str:
        if self.scene.interrupted:
            return 'a change of the world was interrupted: what it holds is unknown until ~/clear'
        for source in self.sources:
            problem = source.problem(now)
            if problem:
                return problem
        return ''

    def forget(self) -> None:
        """Forget the past."""
        if self.times is not None:
            self.times.forget()

    def shift(self, by: int, now: int) -> None:
        """Follow the clock, which jumped by so many ns to `now`: ages and lives left stay. Moving
        obstacles are at rest until their next update, and the past is forgotten.
        """
        self.finish_changes()
        self.scene.shift_expiries(by)
        self.scene.rest()
        self.forget()
        self.scene.newest = min(self.scene.newest, now)
        for source in self.sources:
            source.spoke_at += by


# The node's clock may jump: a simulation starts over, a recording loops, /clock takes over.
#
# What an obstacle has left to live and how long a source has been silent are carried over to the
# new time. Otherwise, after a jump back, obstacles would outlive their lifetimes by the length of
# the jump, and a silent source would look fresh for as long. A jump forward is time that passes.


class ClockJumps:
    """Moves the world to the new time whenever the clock jumps back or is exchanged."""

    def __init__(self, node: Node, world: World) -> None:
        self._clock = node.get_clock()
        self._node = node
        self._jumps = Seldom(lambda text: node.get_logger().warning(text))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self._timer = node.create_timer(LOG_EVERY, self._jumps.log, clock=steady)
        self._world = world
        self._before = 0  # ns
        self._handle = self._clock.create_jump_callback(
            JumpThreshold(min_forward=None, min_backward=Duration(nanoseconds=-1)),
            pre_callback=self._note_time,
            post_callback=self._on_jump,
        )

    def _note_time(self) -> None:
        self._before = self._clock.now().nanoseconds

    def _on_jump(self, _jump: object) -> None:
        # Not by the jump's own account: that is zero where /clock takes over.
        now = self._clock.now().nanoseconds
        by = now - self._before
        self._jumps.add(
            f'the clock jumped by {by / 1e9:.3f} s; lifetimes and ages go on from there'
        )
        self._world.shift(by, now)

    def destroy(self) -> None:
        """Take no notice any more."""
        self._handle.unregister()
        self._node.destroy_timer(self._timer)
