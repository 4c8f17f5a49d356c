# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities of the rows of an update: as they are told, or as somebody follows obstacles."""

from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree import checks
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


# From slots, node handles, where they were told to be before, and where now, see `tracking`.
Follow = Callable[[Slots, NDArray[np.int64], Sighting, Sighting], Floats]


def velocity_rows(given: Any, count: int) -> Floats:
    """Velocities (count, 3), finite or not; ValueError if they are none."""
    rows = checks.floats('velocities', given)
    if rows.shape != (count, 3):
        raise ValueError(f'velocities must have shape ({count}, 3), not {rows.shape}')
    return rows


def speeds_of(
    held: Obstacles, given: ArrayLike | Follow | None, valid: Validated
) -> tuple[Floats | None, Validated]:
    """Velocities of the rows along the tree's axes, None if none are told; and the rows that have
    one.
    """
    if given is None:
        return None, valid
    count, ndim = len(valid.reasons.good), held.tree.ndim
    if callable(given):
        return _followed(held, given, valid.known, count), valid
    rows = velocity_rows(given, count)
    wrong = np.logical_not(np.isfinite(rows).all(axis=1))
    valid = _without(valid, wrong, 'its velocity is not finite')
    return np.ascontiguousarray(rows[:, :ndim]), valid


def none_later(valid: Validated, latest: int | None) -> Validated:
    """The rows that are not stamped later, ns."""
    if latest is None:
        return valid
    wrong = np.zeros(len(valid.reasons.good), np.bool_)
    for some in valid[:2]:
        wrong[some.row[some.stamp > latest]] = True
    return _without(valid, wrong, 'its stamp is too far in the future')


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
