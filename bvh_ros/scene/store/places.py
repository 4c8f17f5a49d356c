# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where obstacles are at other times than that of their last update.

They go on as they were told, for `max_prediction` seconds, and then stay where they are, as
the tree knows. Nobody knows it for sure: by `uncertainty`, m/s, those that move grow all round
while time goes by.
"""

from typing import NamedTuple

import numpy as np

from ...tree.access import CHANGES, LARGEST
from ..geometry.shapes import Floats
from .obstacles import Obstacles
from .registry import Slots

WIDER = 1.0 + 2.0**-40  # no computed distance is off by as much


class Movers(NamedTuple):
    """When the first and the last of those that move were told, s, in one version of the tree."""

    version: int
    earliest: float
    latest: float


def movers(held: Obstacles) -> Movers:
    """Who moves now."""
    version, known = held.tree.state.item(CHANGES), held.movers
    if known is not None and known.version == version:
        return known
    velocities, references = motions(held, np.flatnonzero(held.columns.tree_handle >= 0))
    told = references[velocities.any(axis=1)]
    first, last = (told.min(), told.max()) if len(told) else (np.inf, -np.inf)
    known = held.movers = Movers(version, float(first), float(last))
    return known


def motions(held: Obstacles, slots: Slots) -> tuple[Floats, Floats]:
    """Velocities (m, ndim) of obstacles, and the times (m,) in s from which they hold."""
    return held.tree.velocities(held.columns.tree_handle[slots])


def growths(held: Obstacles, slots: Slots, at: Floats, until: Floats) -> Floats:
    """By how much obstacles have grown from some times (m,) to others at most, m."""
    if not held.uncertainty:
        return np.zeros(len(slots))
    velocities, references = motions(held, slots)
    longest = np.maximum(np.abs(at - references), np.abs(until - references))
    grown = np.minimum(longest, LARGEST / max(held.uncertainty, 1.0)) * held.uncertainty
    return np.where(velocities.any(axis=1), grown, 0.0)


def most_growth(held: Obstacles, at: Floats, until: Floats) -> Floats | float:
    """What no growth exceeds in these spans of time (n,), m."""
    if not held.uncertainty:
        return 0.0
    known = movers(held)
    longest = np.maximum(until - known.earliest, known.latest - at)
    with np.errstate(over='ignore'):
        growth = held.uncertainty * np.maximum(longest, 0.0) * WIDER
    return np.minimum(growth, LARGEST)
