# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Other frames: transformed where tf2 knows them, else refused, never ignored."""

from __future__ import annotations

from collections.abc import Callable
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray
from rclpy.time import Time

from bvh_ros.ros.conversions import rotations

if TYPE_CHECKING:
    from rclpy.node import Node


class FrameError(ValueError):
    """No transform into the node's frame; the text says why."""


class Transform(NamedTuple):
    """A rigid motion from another frame into the node's."""

    translation: NDArray[np.float64]  # (3,) metres
    rotation: NDArray[np.float64]  # (4,) unit quaternion x, y, z, w

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

    def orientations(self, quaternions: ArrayLike) -> NDArray[np.float64]:
        """Return (..., 4) orientations in the node's frame."""
        return rotations.multiply(self.rotation, rotations.normalised(quaternions))


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
    """

    def __init__(self, frame_id: str, lookup: Lookup | None = None) -> None:
        self.frame_id = frame_id
        self.lookup = lookup

    def into_node(self, frame_id: str, stamp: int = 0) -> Transform | None:
        """Return the transform from `frame_id`, or None if that is the node's own frame.

        Raises
        ------
        FrameError
            If there is no such transform at that time.
        """
        if frame_id in ('', self.frame_id):
            return None
        if self.lookup is None:
            raise FrameError(
                f"frame '{frame_id}' is not '{self.frame_id}', and tf2_ros is not available here"
            )
        return self.lookup(self.frame_id, frame_id, stamp)


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
            raise FrameError(f"no transform from '{source}' to '{target}': {error}") from error
        move, turn = found.transform.translation, found.transform.rotation
        return Transform(
            np.array((move.x, move.y, move.z)),
            rotations.normalised((turn.x, turn.y, turn.z, turn.w)),
        )

    def destroy(self) -> None:
        """Listen no longer."""
        self._listener.unregister()


def listen_to_tf2(node: Node) -> Tf2 | None:
    """Return a lookup in tf2, or None where tf2_ros is not installed."""
    try:
        return Tf2(node)
    except ImportError:
        return None
