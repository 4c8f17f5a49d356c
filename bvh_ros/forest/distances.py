# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points visit the parts in the order of their distance, until none can hold a nearer box."""

import numpy as np
from numpy.typing import NDArray

from ..tree import DynamicBVH
from ..tree.access import NONE, Floats, Ids
from .asking import Asking, parts_of, pieces

# Parts that are looked up at first; then four times as many, for the points that are not done.
FEW_PARTS = 4
# A distance is right to 4 roundings: as much larger may a part's be than that of a box in it.
DOUBT = 1.0 + 16 * 2.0**-53


def nearest(
    top: DynamicBVH,
    asking: Asking,
    points: Floats,
    k: int,
    reach: Floats,
    masks: NDArray[np.uint32],
) -> tuple[Ids, Floats]:
    """Ids and distances, shape (n, k)."""
    ids = np.full((len(points), k), NONE, np.int64)
    distances = np.full((len(points), k), np.inf)
    for piece in pieces(len(points)):
        _search(
            top, asking, (points[piece], reach[piece], masks[piece]), ids[piece], distances[piece]
        )
    return ids, distances


def _search(
    top: DynamicBVH,
    asking: Asking,
    asked: tuple[Floats, Floats, NDArray[np.uint32]],
    ids: Ids,
    distances: Floats,
) -> None:
    points, reach, masks = asked
    rows, seen, looked_up = np.arange(len(points)), 0, FEW_PARTS
    while len(rows) and seen < len(top):
        looked_up = min(looked_up, len(top))
        handles, gaps = top.nearest_many(points[rows], looked_up, reach[rows], masks[rows])
        parts = parts_of(top, handles)
        for place in range(seen, looked_up):
            limit = np.minimum(reach[rows], distances[rows, -1])
            open_ = (parts[:, place] != NONE) & (gaps[:, place] <= limit * DOUBT)
            rows, parts, gaps = rows[open_], parts[open_], gaps[open_]
            _visit(asking, asked, rows, parts[:, place], ids, distances)
        seen, looked_up = looked_up, 4 * looked_up


def _visit(
    asking: Asking,
    asked: tuple[Floats, Floats, NDArray[np.uint32]],
    rows: Ids,
    parts: Ids,
    ids: Ids,
    distances: Floats,
) -> None:
    """Ask one part for each of the rows."""
    points, reach, masks = asked
    k = ids.shape[1]
    limit = np.minimum(reach, distances[:, -1])
    for some, _, (found, gaps) in asking.each('nearest', rows, parts, (points, limit, masks), k):
        every, far = np.hstack((ids[some], found)), np.hstack((distances[some], gaps))
        last = np.where(every == NONE, np.iinfo(np.int64).max, every)
        order = np.lexsort((last, far))[:, :k]
        ids[some] = np.take_along_axis(every, order, 1)
        distances[some] = np.take_along_axis(far, order, 1)
