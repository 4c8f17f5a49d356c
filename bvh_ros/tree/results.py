# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the queries return."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray


def shown_point(point: NDArray[np.float64]) -> str:
    """Coordinates in six digits, for people."""
    return f'[{", ".join(f"{coordinate:.6g}" for coordinate in point)}]'


def shown_rows(
    name: str, found: NDArray[np.bool_], word: str, column: str, values: NDArray[np.float64]
) -> str:
    """How many rows of a batch found something, and the range of a column, for people."""
    shown = f'{name}({np.count_nonzero(found):,} of {len(found):,} {word}'
    if found.any():
        some = values[found]
        shown += f', {column} from {some.min():.6g} to {some.max():.6g}'
    return f'{shown})'


class RayHit(NamedTuple):
    """Where a ray enters a box."""

    id: int
    """Handle of the box."""
    t: float
    """Distance in units of the direction, within 2 ulp; inf where the exact one exceeds the
    largest double. 0 inside.
    """
    point: NDArray[np.float64]
    """The point of entry, shape (ndim,), in the closed box, on the entered face. The origin where
    the ray starts inside.
    """
    normal: NDArray[np.float64]
    """The outward normal of the face entered, shape (ndim,); zero where the ray starts inside."""

    def __repr__(self) -> str:
        return (
            f'RayHit(id={self.id}, t={self.t:.6g}, point={shown_point(self.point)}, '
            f'normal={shown_point(self.normal)})'
        )


class RayHits(NamedTuple):
    """First hits of n rays, row for row."""

    ids: NDArray[np.int64]
    """Handles, shape (n,); -1 where nothing is hit."""
    t: NDArray[np.float64]
    """Distances in units of the directions, shape (n,); inf where nothing is hit."""
    normals: NDArray[np.float64]
    """Outward normals, shape (n, ndim); zero where nothing is hit or the ray starts inside."""

    def __repr__(self) -> str:
        return shown_rows('RayHits', self.ids >= 0, 'rays hit', 't', self.t)
