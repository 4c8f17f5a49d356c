# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Batches of rays among boxes that move, as Python tells them and as kernels read them."""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..rays.raycasting import CLOSEST

Floats = NDArray[np.float64]
NO_TIMES, AS_ARRAYS = np.empty(0), (0.0, 0.0)


class RaysThen(NamedTuple):
    """Rays as of `rays.raycasting.Rays`, and when they start."""

    origins: Floats
    directions: Floats
    t_max: Floats
    masks: NDArray[np.uint32]
    skip_inside: bool
    mode: int
    at: Floats
    """One for all, or a row, as `pace`; NO_TIMES if `when` tells both."""
    pace: Floats
    when: tuple[float, float]
    """For all rays: of few, to make arrays takes as long as some of them."""


def told_once(when: tuple[Any, Any]) -> tuple[Floats, Floats, tuple[float, float]]:
    """`at`, `pace` and `when` of `RaysThen`, of what may be two numbers for all or two arrays."""
    return (NO_TIMES, NO_TIMES, when) if type(when[0]) is float else (*when, AS_ARRAYS)


class MovingRays(NamedTuple):
    """What of `RaysThen` and `sweeping.Sweep` each ray asks for."""

    origins: Any
    directions: Any
    t_max: Any
    masks: Any
    skip_inside: Any
    mode: Any
    at: Any
    pace: Any
    moving: Any
    leaves: Any


_ROW, _ROWS = np.empty(0), np.empty((0, 3))
NO_RAYS = RaysThen(
    *(_ROWS, _ROWS, _ROW, np.empty(0, np.uint32), False, CLOSEST), *(NO_TIMES, NO_TIMES, AS_ARRAYS)
)
