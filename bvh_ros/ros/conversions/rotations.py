# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Unit quaternions (x, y, z, w) on arrays."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import ArrayLike, NDArray

from bvh_ros.scene.shapes.shape import unit_quaternions
from bvh_ros.tree.access import checks

Quaternion = tuple[float, float, float, float]

OFF = 'the length of its orientation is neither 1 nor 0'
IDENTITY: Quaternion = (0.0, 0.0, 0.0, 1.0)


def normalised(quaternions: ArrayLike) -> NDArray[np.float64]:
    """Return unit quaternions; a zero quaternion (an unset field) is no rotation.

    Parameters
    ----------
    quaternions : (4,) or (n, 4) array_like
        x, y, z, w; NaN and infinity stay NaN, for the caller to refuse.
    """
    q = np.array(quaternions, dtype=np.float64)
    with np.errstate(invalid='ignore'):
        return unit_quaternions(q.reshape(-1, 4)).reshape(q.shape)


def normalised_if_near(quaternions: ArrayLike) -> NDArray[np.float64]:
    """Return the same, but those that `are_off` as they are, for the caller to refuse."""
    return np.where(are_off(quaternions)[..., None], quaternions, normalised(quaternions))


def set_ones(quaternions: ArrayLike) -> NDArray[np.float64]:
    """Return the same with the identity where a quaternion is zero (an unset field)."""
    q = np.array(quaternions, dtype=np.float64)
    zero = ~q.any(axis=-1, keepdims=True)
    return np.where(zero, IDENTITY, q)


def are_off(quaternions: ArrayLike) -> NDArray[np.bool_]:
    """Return which quaternions (..., 4) are neither zero nor of length 1 to within 1 %."""
    q = np.asarray(quaternions, dtype=np.float64)
    with np.errstate(over='ignore', invalid='ignore'):
        return np.asarray(~checks.are_unit(*np.moveaxis(q, -1, 0)) & q.any(axis=-1))


def multiply(first: ArrayLike, second: ArrayLike) -> NDArray[np.float64]:
    """Return the rotation `second` followed by `first`; both (..., 4), broadcast."""
    x1, y1, z1, w1 = np.moveaxis(np.asarray(first, dtype=np.float64), -1, 0)
    x2, y2, z2, w2 = np.moveaxis(np.asarray(second, dtype=np.float64), -1, 0)
    return np.stack(
        (
            w1 * x2 + x1 * w2 + y1 * z2 - z1 * y2,
            w1 * y2 - x1 * z2 + y1 * w2 + z1 * x2,
            w1 * z2 + x1 * y2 - y1 * x2 + z1 * w2,
            w1 * w2 - x1 * x2 - y1 * y2 - z1 * z2,
        ),
        axis=-1,
    )


def rotate(quaternion: ArrayLike, points: ArrayLike) -> NDArray[np.float64]:
    """Turn (..., 3) points by (..., 4) unit quaternions, broadcast."""
    q = np.asarray(quaternion, dtype=np.float64)
    v = np.asarray(points, dtype=np.float64)
    twice = 2.0 * np.cross(q[..., :3], v)
    turned: NDArray[np.float64] = v + q[..., 3:] * twice + np.cross(q[..., :3], twice)
    return turned


def from_normal(nx: float, ny: float, nz: float) -> Quaternion:
    """Return the shortest rotation that turns +x onto the unit vector (nx, ny, nz).

    A zero vector gives the identity, -x half a turn about z.
    """
    across = math.hypot(ny, nz)
    if across == 0.0:
        return (0.0, 0.0, 1.0, 0.0) if nx < 0.0 else IDENTITY
    # (x cross n, 1 + x . n), where 1 + nx = across^2 / (1 - nx) avoids cancellation close to -x.
    w = across * across / (1.0 - nx) if nx < 0.0 else 1.0 + nx
    length = math.hypot(across, w)
    return (0.0, -nz / length, ny / length, w / length)
