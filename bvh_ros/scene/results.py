# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the scene returns."""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from .geometry.shapes import ShapeKind

NO_NODE = 0xFFFFFFFF  # instead of a node handle: nothing is hit
LAST_NODE_HANDLE = 2**31 - 1


class TooManyHitsError(ValueError):
    """More obstacles are met than whoever asks wants to be told of."""


def require_few(count: int, most: int | None) -> None:
    """Raise TooManyHitsError if there are more than `most`; None is no limit."""
    if most is not None and count > most:
        raise TooManyHitsError(f'there may be {count} hits, more than {most}')


class SceneHit(NamedTuple):
    """An obstacle that a query meets."""

    name: str
    handle: int
    """Node handle, 1 to 2^31 - 1, not reused while the scene lives."""
    t: float
    """Rays: 0 at the start, 1 at the goal. Overlaps and nearest: distance of `point` from the
    query's centre, m.
    """
    point: NDArray[np.float64]
    """Shape (3,), m: where a ray meets the obstacle or a swept ball touches it.

    For overlaps its point closest to the centre.
    """
    normal: NDArray[np.float64]
    """Shape (3,), outward; zero where the query starts (for overlaps.

    Has its centre) in the obstacle.
    """
    stamp: int
    """Last update of the obstacle, ns."""


class CastHits(NamedTuple):
    """The first obstacles on n ways."""

    handles: NDArray[np.uint32]
    """(n,) node handles, NO_NODE (0xFFFFFFFF) where the way is free."""
    t: NDArray[np.float64]
    """(n,) from 0 at the start to 1 at the goal; inf where the way is free."""
    points: NDArray[np.float64]
    """(n, 3), m: on the obstacles; NaN where the way is free."""
    normals: NDArray[np.float64]
    """(n, 3) outward; zero where the way is free, or begins in the obstacle."""


class BoxHits(NamedTuple):
    """What touches n boxes: how many obstacles, and the first of each."""

    handles: NDArray[np.uint32]
    """(n,) node handles of those nearest to the centres, NO_NODE (0xFFFFFFFF) where there is
    none.
    """
    counts: NDArray[np.int64]
    """(n,) how many there are."""
    distances: NDArray[np.float64]
    """(n,) of the first one's closest point from the centre, m; inf where there is none."""
    points: NDArray[np.float64]
    """(n, 3) that point, m; NaN where there is none."""


class Clearance(NamedTuple):
    """How far an obstacle is from the nearest other one."""

    distance: float
    """m; 0 if they touch."""
    name: str
    """Of the other obstacle."""
    handle: int
    """Node handle of the other."""
    point: NDArray[np.float64]
    """Shape (3,), m: the point of the obstacle that is closest to the other; of both if they
    touch.
    """
    other_point: NDArray[np.float64]
    """Shape (3,), m: the point of the other that is closest."""


class Obstacle(NamedTuple):
    """What the scene knows of one obstacle.

    A box turned by right angles is kept as the same box unturned.
    """

    name: str
    handle: int
    kind: ShapeKind
    position: NDArray[np.float64]
    orientation: NDArray[np.float64]
    size: NDArray[np.float64]
    stamp: int
    expires: int
    source: str
    group: str
