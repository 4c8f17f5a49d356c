# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Query boxes visit the parts that they touch."""

import numpy as np
from numpy.typing import NDArray

from ..tree import DynamicBVH
from ..tree.access import Floats, Ids
from .asking import Asking, parts_of, pieces


def overlaps(
    top: DynamicBVH,
    asking: Asking,
    lo: Floats,
    hi: Floats,
    masks: NDArray[np.uint32],
    threads: int,
) -> tuple[Ids, Ids]:
    """Offsets and ids, ascending in each row."""
    rows, ids = [np.empty(0, np.int64)], [np.empty(0, np.int64)]
    for piece in pieces(len(lo)):
        asked = lo[piece], hi[piece], masks[piece]
        ends, handles = top.overlap_many(*asked)
        row = np.repeat(np.arange(len(asked[0])), np.diff(ends))
        parts = parts_of(top, handles)
        for some, _, (sizes, found) in asking.each('overlap', row, parts, asked, threads):
            rows.append(np.repeat(some, sizes) + piece.start)
            ids.append(found)
    row, found = np.concatenate(rows), np.concatenate(ids)
    offsets = np.zeros(len(lo) + 1, np.int64)
    np.cumsum(np.bincount(row, minlength=len(lo)), out=offsets[1:])
    return offsets, found[np.lexsort((found, row))]
