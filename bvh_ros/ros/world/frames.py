# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Other frames: transformed where tf2 knows them, else refused, never ignored."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rclpy.time import Time

from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.parameters import ConfigurationError, TransformSettings
from bvh_ros.ros.texts import as_line, shortened

if TYPE_CHECKING:
    from rclpy.node import Node


class FrameError(ValueError):
    """No transform into the node's frame; the text says why."""


class Transform(NamedTuple):
    """A rigid motion from another frame into the node's."""

    translation: NDArray[np.float64]  # (3,) metres
    rotation: NDArray[np.float64]  # (4,) unit quaternion x, y, z, w

    @classmethod
    def of(cls, place: Any, turn: Any) -> Transform:
        """The motion to a Point or Vector3, with a Quaternion, of messages."""
        quaternion = rotations.normalised((turn.x, turn.y, turn.z, turn.w))
        return cls(np.array((place.x, place.y, place.z)), quaternion)

    def points(self, points: ArrayLike) -> NDArray[np.float64]:
        """Return (..., 3) points in the node's frame."""
        return rotations.rotate(self.rotation, points) + self.translation

    def vectors(self, vectors: ArrayLike) -> NDArray[np.float64]:
        """Return (..., 3) directions in the node's frame."""
        return rotations.rotate(self.rotation, vectors)

    def inverse(self) -> Transform:
        """Return the way back: from the node's frame into the other."""
        back = self.rotation * (-1.0, -1.0, -1.0, 1.0)
        return Transform(-rotations.rotate(back, self.translation), back)

    def after(self, first: Transform) -> Transform:
        """Return the motion that does `first` and then this one."""
        turn = rotations.normalised(rotations.multiply(self.rotation, first.rotation))
        return Transform(self.points(first.translation), turn)

    def orientations(self, quaternions: ArrayLike) -> NDArray[np.float64]:
        """Return (..., 4) orientations in the node's frame; one that is off stays off."""
        return rotations.multiply(self.rotation, rotations.normalised_if_near(quaternions))


# target frame, source frame, stamp (ns, 0 = latest) -> Transform; raises FrameError, never waits.
Lookup = Callable[[str, str, int], Transform]


class Frames:
    """Knows the node's frame and how to get there.

    Parameters
    ----------
    frame_id : str
        The node's own frame.
    lookup : callable, optional
        Finds a transform; None where tf2_ros is not installed or not wanted.
    fixed : sequence of TransformSettings
        Frames whose places never change. They may stand on each other, and go before what
        `lookup` says of the same frame.

    Raises
    ------
    ConfigurationError
        If fixed transforms contradict each other, or lead where there is nothing to stand on.
    """

    def __init__(
        self, frame_id: str, lookup: Lookup | None = None, fixed: Sequence[TransformSettings] = ()
    ) -> None:
        self.frame_id = frame_id
        self.lookup = lookup
        # For each fixed frame: the frame at the lower end of its chain, and how to get there.
        self._fixed = {given.frame_id: self._foot(given, fixed) for given in fixed}

    def into_node(self, frame_id: str, stamp: int = 0) -> Transform | None:
        """Return the transform from `frame_id`, or None if that is the node's own frame.

        Raises
        ------
        FrameError
            If there is no such transform at that time.
        """
        if frame_id in ('', self.frame_id):
            return None
        if frame_id in self._fixed:
            foot, transform = self._fixed[frame_id]
            below = self.into_node(foot, stamp)
            return transform if below is None else below.after(transform)
        if self.lookup is None:
            raise FrameError(
                f"frame '{shortened(frame_id)}' is not '{shortened(self.frame_id)}', "
                'and tf2_ros is not available here'
            )
        return self.lookup(self.frame_id, frame_id, stamp)

    def _foot(
        self, given: TransformSettings, fixed: Sequence[TransformSettings]
    ) -> tuple[str, Transform]:
        """Follow a chain of fixed transforms down to what is not one of them."""
        parents = {one.frame_id: one for one in fixed}
        if len(parents) < len(fixed):
            twice = next(f for f in parents if sum(one.frame_id == f for one in fixed) > 1)
            raise ConfigurationError(
                f"parameter 'transforms': frame '{shortened(twice)}' is placed twice"
            )
        if self.frame_id in parents:
            raise ConfigurationError(
                f"parameter 'transforms': '{shortened(self.frame_id)}' is the node's own frame; "
                'it is placed nowhere'
            )
        transform, frame, passed = _transform(given), given.parent, {given.frame_id}
        while frame in parents:
            if frame in passed:
                raise ConfigurationError(
                    f"parameter 'transforms': '{shortened(frame)}' stands on itself"
                )
            passed.add(frame)
            transform, frame = _transform(parents[frame]).after(transform), parents[frame].parent
        if frame != self.frame_id and self.lookup is None:
            raise ConfigurationError(
                f"parameter 'transforms': '{shortened(given.frame_id)}' stands on "
                f"'{shortened(frame)}', which is not '{shortened(self.frame_id)}', "
                'and tf2_ros is not available here'
            )
        return frame, transform


def _transform(given: TransformSettings) -> Transform:
    return Transform(np.array(given.xyz), rotations.normalised(given.xyzw))


class Tf2:
    """A lookup in a tf2 buffer that listens on this node.

    Raises
    ------
    ImportError
        Where tf2_ros is not installed.
    """

    def __init__(self, node: Node) -> None:
        import tf2_ros

        self._error = tf2_ros.TransformException
        self._buffer = tf2_ros.Buffer()
        self._listener = tf2_ros.TransformListener(self._buffer, node)

    def __call__(self, target: str, source: str, stamp: int) -> Transform:
        """Return the transform at `stamp` (ns, 0 = latest); see `Lookup`."""
        try:
            # No timeout: waiting inside a callback would stop the thread that receives /tf.
            found = self._buffer.lookup_transform(target, source, Time(nanoseconds=stamp))
        except self._error as error:
            raise FrameError(
                f"no transform from '{shortened(source)}' to '{shortened(target)}': "
                f'{as_line(error)}'
            ) from error
        return Transform.of(found.transform.translation, found.transform.rotation)

    def destroy(self) -> None:
        """Listen no longer."""
        self._listener.unregister()


def listen_to_tf2(node: Node) -> Tf2 | None:
    """Return a lookup in tf2, or None where tf2_ros is not installed."""
    try:
        return Tf2(node)
    except ImportError:
        return None
