# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities of the rows of an update: as they are told, or as somebody follows obstacles."""

from typing import Any, NamedTuple, Protocol

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import checks
from .geometry.shapes import Floats
from .store.obstacles import Obstacles
from .store.registry import Slots
from .store.updating import Rows, Validated


class Sighting(NamedTuple):
    """Where n obstacles were told to be."""

    places: Floats
    """Shape (n, 3), m."""
    stamps: NDArray[np.int64]
    """(n,) ns."""


class Follow(Protocol):
    """Tells velocities from successive updates, see `tracking`."""

    @property
    def max_speed(self) -> float:
        """None is faster, m/s."""

    def __call__(
        self, slots: Slots, handles: NDArray[np.int64], before: Sighting, now: Sighting, /
    ) -> Floats:
        """Velocities, (n, 3) m/s, of obstacles from where they were told to be."""


def velocity_rows(given: Any, count: int) -> Floats:
    """Velocities (count, 3), finite or not; ValueError if they are none."""
    rows = checks.floats('velocities', given)
    if rows.shape != (count, 3):
        raise ValueError(f'velocities must have shape ({count}, 3), not {rows.shape}')
    return rows


def speeds_of(
    held: Obstacles, given: ArrayLike | Follow, valid: Validated
) -> tuple[Floats, Validated]:
    """Velocities of the rows along the tree's axes; and the rows that have one."""
    count, ndim = len(valid.reasons.good), held.tree.ndim
    if callable(given):
        return _followed(held, given, valid.known, count), valid
    rows = velocity_rows(given, count)
    wrong = np.logical_not(np.isfinite(rows).all(axis=1))
    valid = _without(valid, wrong, 'its velocity is not finite')
    return np.ascontiguousarray(rows[:, :ndim]), valid


def reach_of(held: Obstacles, given: ArrayLike | Follow, speeds: Floats) -> Floats:
    """How far along each axis rows may be from where they are told to be, m, at times that may be
    asked for. Whoever is followed is seen before its velocity is known.
    """
    fastest = np.full(speeds.shape, given.max_speed) if callable(given) else np.abs(speeds)
    way = np.zeros(speeds.shape)
    with np.errstate(over='ignore'):  # infinite: anywhere
        fastest = fastest + held.uncertainty * (fastest.max(axis=1, keepdims=True) > 0.0)
        return np.multiply(fastest, held.max_prediction, out=way, where=fastest > 0.0)


def _without(valid: Validated, wrong: NDArray[np.bool_], reason: str) -> Validated:
    """Refuse some rows."""
    if not wrong.any():
        return valid
    valid.reasons.add(wrong, reason)
    added, known = (some.take(~wrong[some.row]) for some in valid[:2])
    return Validated(added, known, valid.reasons)


def _followed(held: Obstacles, follow: Follow, known: Rows, count: int) -> Floats:
    """Velocities from where obstacles were told to be before."""
    columns, rows = held.columns, np.zeros((count, held.tree.ndim))
    before = Sighting(columns.geometry['position'][known.slot], columns.stamp[known.slot])
    now = Sighting(known.records['position'], known.stamp)
    found = follow(known.slot, columns.node_handle[known.slot], before, now)
    rows[known.row] = found[:, : held.tree.ndim]
    return rows
