# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Orientations from angles."""

from __future__ import annotations

from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from .tree.access import checks


def quaternions(
    *, yaw: ArrayLike | None = None, rpy: ArrayLike | None = None
) -> NDArray[np.float64]:
    """Quaternions x, y, z, w from angles in radians, as every argument `orientation` takes them.

    Parameters
    ----------
    yaw : float, or array_like of shape (n,)
        About z, counter-clockwise as seen from above.
    rpy : array_like, shape (3,) or (n, 3)
        Roll, pitch and yaw: about the fixed axes x, y and z, in this order, as in URDF.

    Returns
    -------
    (4,) or (n, 4) float64

    Examples
    --------
    >>> import math
    >>> from bvh_ros import quaternions
    >>> quaternions(yaw=math.pi).round(3).tolist()
    [0.0, 0.0, 1.0, 0.0]
    >>> quaternions(rpy=[[0, 0, 0], [math.pi / 2, 0, 0]]).round(3).tolist()
    [[0.0, 0.0, 0.0, 1.0], [0.707, 0.0, 0.0, 0.707]]
    """
    if (yaw is None) == (rpy is None):
        raise ValueError('either yaw or rpy must be given, and not both')
    name, shapes = ('rpy', (1, 2)) if yaw is None else ('yaw', (0, 1))
    given: Any = rpy if yaw is None else yaw
    angles = checks.floats(name, given)
    if angles.ndim not in shapes or (rpy is not None and angles.shape[-1] != 3):
        wanted = 'one number or of shape (n,)' if rpy is None else 'of shape (3,) or (n, 3)'
        raise ValueError(f'{name} must be {wanted}, not of shape {angles.shape}')
    if not np.isfinite(angles).all():
        raise ValueError(f'{name} must be finite')
    if rpy is None:
        angles = np.stack((np.zeros_like(angles), np.zeros_like(angles), angles), axis=-1)
    (a, b, c), (x, y, z) = np.cos(0.5 * angles.T), np.sin(0.5 * angles.T)
    turns = (
        x * b * c - a * y * z,
        a * y * c + x * b * z,
        a * b * z - x * y * c,
        a * b * c + x * y * z,
    )
    return np.stack(turns, axis=-1)
