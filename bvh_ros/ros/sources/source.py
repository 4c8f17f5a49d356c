# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all sources share: when they spoke, what they refused, whether to trust the world; and
how those read messages that take only the fields that matter.
"""

from __future__ import annotations

import math
import time
from abc import ABC, abstractmethod
from collections import deque
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from functools import partial
from typing import TYPE_CHECKING, Any, ClassVar

import numpy as np
from rclpy.serialization import deserialize_message

from bvh_ros.ros.cdr import any_message
from bvh_ros.ros.cdr.any_message import Columns, plan_of
from bvh_ros.ros.compile_jobs import Job
from bvh_ros.ros.conversions.placing import moved
from bvh_ros.ros.parameters import ConfigurationError
from bvh_ros.ros.qos import DEPTH, Delivery
from bvh_ros.ros.sources.subscribing import Completeness, FollowingSubscription, Heard
from bvh_ros.ros.texts import Refused, Timings, shortened, why
from bvh_ros.ros.world.large_changes import LargeChanges
from bvh_ros.scene import Numbered, Part, Refusal, Refusals, ShapeKind, Shapes
from bvh_ros.scene.slicing import AT_ONCE
from bvh_ros.scene.store import WAITS

if TYPE_CHECKING:
    from rclpy.guard_condition import GuardCondition
    from rclpy.node import Node

    from bvh_ros.ros.parameters import SourceSettings
    from bvh_ros.ros.sources.mesh_resources import MeshFiles
    from bvh_ros.ros.world.frames import Frames
    from bvh_ros.scene import NodeScene
    from bvh_ros.scene.names import Slots
    from bvh_ros.scene.slicing import Parts
    from bvh_ros.scene.updates import Follow

Applying = Generator[None, None, tuple[int, Sequence[Refusal]]]
Slices = Generator[None, None, Refusals]
SLICE = 0.005  # seconds after which others get a turn; whoever asks may wait for two
SMALL_SHARE = 0.125  # of a scene: slices of so many rows take less than a copy of the scene
TOO_FAR_AHEAD = 'its stamp is too far in the future'
COSTLY_AS_ROWS = 60  # rows of boxes that take as long as one with a mesh
DONE = object()


class Source(ABC):
    """Brings the messages of one topic into the scene, and owns the obstacles it brought."""

    message_type: ClassVar[type]
    depth: ClassVar[int] = DEPTH
    follows_publisher: ClassVar[bool] = True
    raw: ClassVar[bool] = False  # whether `apply` takes messages as serialised bytes
    says_everything: ClassVar[Any] = None  # whether a message does: of such, few may wait

    def __init__(
        self, node: Node, settings: SourceSettings, scene: NodeScene, frames: Frames
    ) -> None:
        self.settings = settings
        self.name = settings.name
        self.scene = scene
        self.frames = frames
        self.refused = Refused(node.get_logger(), f"source '{settings.name}'")
        self.messages = 0
        self.timings = Timings()  # of the steps in which messages are applied
        self.skipped = 0  # points without a place
        self.spoke_at = 0  # ns on the node's clock
        self.has_spoken = False
        self.completeness = Completeness()
        # Called after each message; may pause.
        self.on_applied: Callable[[Source, int], Iterable[None]] = lambda source, now: ()
        self.changes = LargeChanges(scene)
        # Reads the mesh files that messages name, made when there is one; None: none are read.
        self.mesh_files: Callable[[], MeshFiles] | None = None
        self.is_whole = False  # whether the message that is being applied says everything
        self.removed_at = 0  # the latest stamp at which that message removes anything, ns
        self.together = False  # whether `apply` takes several small messages
        self.follow = _follower(settings)
        self._node = node
        self.longest_slice = 0.0  # s that nobody else had a turn
        self.subscription: FollowingSubscription | None = None
        self._work: Iterator[None] | None = None  # the message that is being applied
        self._size = 0  # bytes of that message
        self._waiting: deque[tuple[Callable[[], object], int]] = deque()  # what is to follow
        self._waits = 0  # bytes of that
        self._hurried = False  # whether to apply all at once, without the helper thread
        self._turn: GuardCondition | None = None

    def to_compile(self) -> Iterable[Job]:
        """Return what compiles the kernels that only this source uses."""
        return ()

    def subscribe(self) -> None:
        """Begin to listen."""
        self._turn = self._node.create_guard_condition(self._go_on)
        # raw: rclpy would drop what it cannot deserialise without telling us
        delivery = Delivery(self.depth, latched=True, follow=self.follows_publisher, raw=True)
        self.subscription = FollowingSubscription(
            self._node,
            self.message_type,
            self.settings.topic,
            self.receive,
            delivery._replace(together=self.together),
            on_irregular=self._note,
            says_everything=self.says_everything,
            is_full=self._is_full,
        )

    def destroy(self) -> None:
        """Listen no longer; the obstacles stay, and a required source has to speak again."""
        if self.subscription is not None:
            self.subscription.destroy()
            self.subscription = None
        if self._turn is not None:
            self._node.destroy_guard_condition(self._turn)
            self._turn = None
        self.finish()
        if self.has_spoken:
            self.completeness.forget('it was not listened to for a while')
        self.has_spoken = self.has_spoken and not self.settings.required

    def catch_up(self) -> None:
        """Apply what has come before somebody asks, where the executor does not see to that."""
        if self.subscription is not None:
            self.subscription.catch_up()

    def _note(self, heard: Heard, latched: bool) -> None:
        """The message that comes now does not just follow those before it."""
        self._then(partial(self.completeness.note, heard, latched=latched))

    def receive(self, messages: Sequence[bytes]) -> None:
        """Apply a message, or several small ones as one, after those before."""
        self.messages += len(messages)
        now = self._node.get_clock().now().nanoseconds
        self._then(partial(self._begin, messages, now), sum(map(len, messages)))

    def apply_now(self, serialised: bytes, now: int) -> None:
        """Apply a message at once, as if it came at `now` (ns on whatever clock)."""
        self.messages += 1
        self._hurried = True
        for _ in self.applying([serialised], now):
            pass

    def _begin(self, messages: Sequence[bytes], now: int) -> None:
        self._size = sum(map(len, messages))
        self._work = self.applying(messages, now)

    def _then(self, act: Callable[[], object], size: int = 0) -> None:
        """Do this when all before is applied."""
        self._waiting.append((act, size))
        self._waits += size
        if self._work is None:
            self._go_on()

    def _is_full(self) -> bool:
        """Whether as much waits as is being applied: more messages have to wait elsewhere."""
        return self._work is not None and (self._waits >= self._size or len(self._waiting) > DEPTH)

    def finish(self) -> None:
        """Apply what is left of a message, and what waits, at once."""
        self._hurried = True
        while self._work is not None or self._waiting:
            if self._must_wait():
                self.changes.owner.finish()
            self._go_on(math.inf)
        self._hurried = False

    def _go_on(self, limit: float = SLICE) -> None:
        """Apply until so many seconds are over, and go on after others had their turn."""
        if self._must_wait():
            self.changes.call_at_end(self._resume)
            return
        began = time.perf_counter()
        while self._work is not None or self._waiting:
            if self._work is None:
                act, size = self._waiting.popleft()
                self._waits -= size
                act()
            else:
                step = next(self._work, DONE)
                if step is DONE:
                    self._work = None
                elif step is WAITS and limit < math.inf:
                    break
            if time.perf_counter() - began >= limit:
                break
        self.longest_slice = max(self.longest_slice, time.perf_counter() - began)
        self._resume()
        if self.subscription is not None:
            self.subscription.resume()

    def _must_wait(self) -> bool:
        """Whether another source makes a large change now."""
        return self.changes.owner not in (None, self)

    def _resume(self) -> None:
        if (self._work is not None or self._waiting) and self._turn is not None:
            self._turn.trigger()

    def applying(self, messages: Sequence[bytes], now: int) -> Iterator[None]:
        """Apply messages; what cannot be used is counted and explained, never raised."""
        began = time.perf_counter_ns()
        alone, self.is_whole, self.removed_at = len(messages) == 1, False, 0
        try:
            items, refusals = yield from self.apply(self._read(messages), now)
            useless = 0 < items == len(refusals)
            if useless and not alone:
                raise ValueError('none of several messages can be used')  # each says why, below
            self.timings.add(began)
            self.refused.add_rows(refusals)
            self.scene.newest = max(self.scene.newest, self.removed_at)
            yield from self.on_applied(self, now)
            if not useless:
                self.spoke_at, self.has_spoken = now, True
                if self.is_whole:
                    self.completeness.note_all_known()
            return
        except Exception as error:  # a fault of ours must not silence the other sources
            reason = why(error)
        # Not earlier: an error holds in memory whatever its function was working on.
        if alone:
            self.refused.add(reason)
            return
        for message in messages:  # some may be of use
            yield from self.applying([message], now)

    def _in_slices(
        self, group: str, total: int, parts: Parts, *, whole: bool, costly: bool = False
    ) -> Slices:
        """`Scene.in_slices` for this source. An update that is large beside the scene is made at
        once in a helper thread: that takes less time in all.
        """
        given = self.name, group, total, parts
        apply = partial(self.scene.in_slices, *given, whole=whole, costly=costly)
        is_long = self.scene.is_long(self.name, total, whole=whole, group=group)
        if costly or not is_long or self._hurried:
            return (yield from apply(at_once=self._hurried and not costly))
        if total < SMALL_SHARE * len(self.scene):
            return (yield from apply())
        return (yield from self.changes.make(self, partial(_run, apply(at_once=True))))

    def _replace_all(self, shapes: Shapes, frame_id: str, stamp: int, now: int) -> Applying:
        """Replace all obstacles by numbered ones, which a frame and a stamp place."""
        shapes = moved(shapes, self.frames.into_node(frame_id, stamp))
        total = len(shapes.kind)
        names = Numbered(f'{self.settings.prefix}{self.name}#', np.arange(total))
        part = Part(names, shapes, stamp or now)
        return total, (yield from self._in_slices('', total, part.cut, whole=True))

    def _change(self, part: Part, leaving: Slots, *, clears: bool = False) -> Slices:
        """Let some obstacles go, or all if `clears`, and others come: first the ones, then the
        others, but for an update that pauses. Others ask meanwhile, so it removes last.
        """
        count, costly = len(part.shapes.kind), is_costly(part)
        is_long = self.scene.is_long(self.name, count, whole=clears, costly=costly)
        at_once = len(leaving) < AT_ONCE and not is_long
        if at_once:
            self.scene.remove_group(self.name, '') if clears else self.scene.discard(leaving)
        whole = clears and not at_once
        refused = yield from self._in_slices('', count, part.cut, whole=whole, costly=costly)
        if not at_once:
            yield from self.scene.discard_in_slices(leaving, besides=part.names)
        return refused

    def _read(self, messages: Sequence[bytes]) -> Any:
        if self.raw:
            return messages
        (serialised,) = messages
        try:
            return deserialize_message(serialised, self.message_type)
        except Exception as error:  # of several classes, none of which rclpy names
            name = self.message_type.__name__
            raise ValueError(f'{len(serialised)} bytes are no {name}: {error}') from error

    @abstractmethod
    def apply(self, message: Any, now: int) -> Applying:
        """Bring what `_read` returns into the scene; yield between slices of what takes long.

        Returns
        -------
        int, sequence of Refusal
            How many items the message has, and which of them were refused.

        Raises
        ------
        ValueError
            If the whole message is refused; the scene is unchanged.
        """

    def _latest(self, now: int) -> int | None:
        """No later stamp is believed, ns; None where it does not matter."""
        most = self.scene.max_prediction
        return now + round(most * 1e9) if self.settings.predicts and math.isfinite(most) else None

    def _loading(self) -> str:
        """What a message names and is not known yet: an answer without it might look free."""
        return ''

    def forget(self) -> None:
        """Start over, after the scene was cleared: a required source must speak again."""
        self._work = None
        self.has_spoken = False
        self.completeness.forget('what it had told was cleared')

    def problem(self, now: int) -> str:
        """Say why the world is incomplete without this source, or return an empty text."""
        settings = self.settings
        if loading := self._loading():
            return f"source '{self.name}' loads {shortened(loading)}: what it shows is unknown yet"
        if not self.has_spoken:
            return f"required source '{self.name}' has not spoken yet" if settings.required else ''
        if settings.required and (missing := self.completeness.missing()):
            return f"required source '{self.name}' has to tell all again: {missing}"
        silent = (now - self.spoke_at) / 1e9
        if settings.max_age and silent > settings.max_age:
            return (
                f"source '{self.name}' is silent for {silent:.3g} s, "
                f'longer than its max_age of {settings.max_age:g} s'
            )
        return ''


class ColumnsSource(Source):
    """Reads the bytes of messages by a kernel, as columns of some fields."""

    raw = True
    fields: ClassVar[tuple[str, ...]]  # paths, as `plan_of` takes them

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        try:
            self._plan = plan_of(self.message_type, self.fields)
        except ValueError as error:
            raise ConfigurationError(f"source '{self.name}': {error}") from error

    def to_compile(self) -> Iterable[Job]:
        """Return the reader."""
        name = 'decode messages'
        return [Job(name, name, 2.0, any_message.exercise, early=True)]

    def _columns(self, messages: Sequence[bytes]) -> Columns:
        (message,) = messages
        return Columns(message, self._plan)


def is_costly(part: Part) -> bool:
    """Whether meshes are what its rows take time for."""
    meshes = int(np.count_nonzero(part.shapes.kind == ShapeKind.MESH))
    return COSTLY_AS_ROWS * meshes > len(part.shapes.kind)


def _run(update: Slices) -> Refusals:
    """Run an update to its end; return the refusals."""
    while True:
        try:
            next(update)
        except StopIteration as end:
            refusals: Refusals = end.value
            return refusals


def _follower(settings: SourceSettings) -> Follow | None:
    """What makes velocities of successive updates; None, and not imported, where none are."""
    if settings.options.get('predict') != 'constant_velocity':
        return None
    from bvh_ros.scene.tracking import Tracks

    return Tracks(settings.options['smoothing'], settings.options['max_speed'])
