# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes at random in a node, and rays among them by brute force."""

import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from ros.messages import marker

Floats = NDArray[np.float64]


class Boxes:
    """So many boxes within 20 m, along the axes."""

    def __init__(self, count: int, seed: int) -> None:
        rng = np.random.default_rng(seed)
        self.centre, self.size = rng.uniform(-10, 10, (count, 3)), rng.uniform(0.2, 2, (count, 3))
        self.lo, self.hi = self.centre - self.size / 2, self.centre + self.size / 2
        self.names = [f'a/{number}' for number in range(count)]

    def fill(self, world: Any, **given: Any) -> None:
        """Tell a node of them, in their order, and wait until it knows them."""
        rows = zip(self.centre, self.size, strict=True)
        world.show(*(marker(number, *row, **given) for number, row in enumerate(rows)))

    def first_hits(
        self, origins: Floats, directions: Floats, t_max: ArrayLike = math.inf
    ) -> tuple[NDArray[np.int64], Floats]:
        """The first box (-1: none) of each ray, and its t (inf: none)."""
        with np.errstate(divide='ignore', invalid='ignore'):
            one = (self.lo - origins[:, None]) / directions[:, None]
            other = (self.hi - origins[:, None]) / directions[:, None]
        enter = np.maximum(np.minimum(one, other).max(axis=2), 0.0)
        leave = np.maximum(one, other).min(axis=2)
        t = np.where((enter <= leave) & (enter <= np.reshape(t_max, (-1, 1))), enter, np.inf)
        return np.where(np.isfinite(t.min(axis=1)), t.argmin(axis=1), -1), t.min(axis=1)
