# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Where obstacles are at other times than that of their last update.

They go on as they were told, for `max_prediction` seconds, and then stay where they are. Nobody
knows that for sure: by `uncertainty`, m/s, those that move grow all round while time goes by.
"""

import functools
import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ...tree.dynamic_bvh import DynamicBVH
from ...tree.moving import LARGEST
from ...tree.nodes import CHANGES
from ..geometry.shapes import Floats
from .obstacles import Obstacles
from .registry import Slots

NOBODY = np.empty(0, np.int64)
WIDER = 1.0 + 2.0**-40  # no computed distance is off by as much


class Movers(NamedTuple):
    """Those that have a velocity, in one version of the tree."""

    version: int
    earliest: float
    latest: float
    """When the first and the last of them were told, s."""
    ends: Floats
    """When they come to rest, ascending; none where nobody ever does."""
    slots: Slots
    """Of those."""
    first_end: float


def movers(held: Obstacles) -> Movers:
    """Who moves now."""
    version, known = held.tree.state.item(CHANGES), held.movers
    if known is not None and known.version == version:
        return known
    slots = np.flatnonzero(held.columns.tree_handle >= 0)
    velocities, references = motions(held, slots)
    moving = np.flatnonzero(velocities.any(axis=1))
    slots, told = slots[moving], references[moving]
    ends, order = told[:0], NOBODY
    if not np.isinf(held.max_prediction):
        order = np.argsort(told)
        ends = told[order] + held.max_prediction
    first, last = (told.min(), told.max()) if len(told) else (np.inf, -np.inf)
    end = float(ends[0]) if len(ends) else np.inf
    known = held.movers = Movers(version, float(first), float(last), ends, slots[order], end)
    return known


def motions(held: Obstacles, slots: Slots) -> tuple[Floats, Floats]:
    """Velocities (m, ndim) of obstacles, and the times (m,) in s from which they hold."""
    return held.tree.velocities(held.columns.tree_handle[slots])


def at_rest(held: Obstacles, last: float) -> Slots:
    """Slots of obstacles that have moved until some time before `last`, s: the tree knows no such
    end, so who asks it has to look for these elsewhere, see `rest`.
    """
    if not held.moves or math.isinf(held.max_prediction):
        return NOBODY
    known = movers(held)
    if last <= known.first_end:
        return NOBODY
    return known.slots[: np.searchsorted(known.ends, last)]


class Rest(NamedTuple):
    """Where those that move come to rest at last, in one version of the tree."""

    version: int
    tree: DynamicBVH
    """Their boxes there, larger by more than rounding."""
    slots: Slots
    """Of the obstacles, by slot of that tree."""
    nodes: NDArray[np.void]
    """Its bounds, see `tree.motion.bounds`, at any time."""


def rest(held: Obstacles) -> Rest:
    """Where they do, if anybody ever does: so who is `at_rest` is found through a tree, too."""
    version, known = held.tree.state.item(CHANGES), held.rest
    if known is not None and known.version == version:
        return known
    slots, most = movers(held).slots, np.finfo(np.float64).max
    handles, (velocities, _) = held.columns.tree_handle[slots], motions(held, slots)
    lo, hi = held.tree.boxes(handles)
    with np.errstate(over='ignore'):
        way = np.clip(velocities * held.max_prediction, -most, most)
        more = (np.abs(lo) + np.abs(hi) + np.abs(way)) * (WIDER - 1.0)
        low, high = np.clip(lo + way - more, -most, most), np.clip(hi + way + more, -most, most)
    tree = DynamicBVH.from_boxes(low, high, mask=held.columns.categories[slots])
    tree.set_velocities(tree.ids(), np.zeros(low.shape))  # so it can be asked as the other one
    of = np.empty(len(slots), np.int64)
    of[tree.slots(tree.ids())] = slots
    assert tree.motion is not None
    known = held.rest = Rest(version, tree, of, tree.motion.fit(tree, 0.0, 1.0).nodes)
    return known


@functools.cache
def nobody_rests(ndim: int) -> Rest:
    """`rest` where nobody does."""
    return Rest(0, DynamicBVH(ndim), NOBODY, np.empty(0, np.void))


def seen(held: Obstacles, slots: Slots, mask: np.uint32 | NDArray[np.uint32]) -> NDArray[np.bool_]:
    """Which obstacles have a bit of the mask."""
    found: NDArray[np.bool_] = (held.columns.categories[slots] & mask) != 0
    return found


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
