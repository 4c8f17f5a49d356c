# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Between the world, in metres and doubles, and the page, where seven digits are left."""

from __future__ import annotations

import numpy as np

from bvh_ros.view.worlds import Floats

SMALLEST, LARGEST = 1e-2, 1e5  # m: worlds that the page shows in metres
FAR = 100.0  # times its own size: farther from the origin, a world is shown about its middle


class Placing:
    """Where the page's origin lies in the world, and how long its unit is.

    A browser draws in float32: on a map in UTM coordinates (5e6 m) it would tell half a metre
    apart, and what is 1e12 or 1e-12 m large fits no camera. Both stay as they are until `fit`.

    Attributes
    ----------
    origin : (3,) array
        m.
    unit : float
        m.
    """

    def __init__(self) -> None:
        self.origin = np.zeros(3)
        self.unit = 1.0

    def fit(self, lo: Floats, hi: Floats) -> None:
        """Choose them for a world between two corners (3,), m."""
        middle, half = 0.5 * lo + 0.5 * hi, float((0.5 * hi - 0.5 * lo).max())
        largest = max(half, 1e-300)
        if not SMALLEST <= 2.0 * min(half, LARGEST) <= LARGEST:
            self.unit = 10.0 ** np.floor(np.log10(largest))
        if np.abs(middle).max() > FAR * largest:
            step = 10.0 ** np.ceil(np.log10(largest))  # the grid stays at round coordinates
            self.origin = np.rint(middle / step) * step

    def shown(self, points: Floats) -> Floats:
        """Where points (..., 3) of the world, m, are on the page."""
        placed: Floats = (points - self.origin) / self.unit
        return placed

    def meant(self, points: Floats) -> Floats:
        """Which points of the world, m, are meant by points (..., 3) of the page."""
        places: Floats = self.origin + self.unit * points
        return places
