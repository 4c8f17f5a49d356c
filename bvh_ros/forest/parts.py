# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a worker does: open a part, ask it, and name boxes by their ids."""

from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tree import DynamicBVH
from ..tree.access import NONE, mapped
from .building import ids_file, part_file

# Parts that a process has open: each has a snapshot of its own once enough rays have come.
OPEN_PARTS = 2


class Part(NamedTuple):
    """A mapped tree, and the ids of its boxes by slot."""

    tree: DynamicBVH
    ids: NDArray[np.int64]

    def named(self, handles: NDArray[np.int64]) -> NDArray[np.int64]:
        """Ids instead of handles; NONE stays."""
        names, found = np.full(handles.shape, NONE, np.int64), handles != NONE
        names[found] = self.ids[self.tree.slots(handles[found])]
        return names


class Found(NamedTuple):
    """First hits of rays among the boxes of a part."""

    ids: NDArray[np.int64]
    t: NDArray[np.float64]
    normals: NDArray[np.float64]
    handles: NDArray[np.int64]
    """By which the part knows the boxes."""


@lru_cache(maxsize=OPEN_PARTS)
def _open(folder: str, number: int, checksum: int) -> Part:
    """`checksum` tells a part from one that was in this folder before, or came there since."""
    file, beside = part_file(Path(folder), number), ids_file(Path(folder), number)
    tree = DynamicBVH.load(file, mmap=True)
    if mapped.checksum(file) != checksum:
        raise ValueError(f'{file} is of another forest or part')
    try:
        ids = np.load(beside, mmap_mode='r')
    except EOFError:
        raise ValueError(f'{beside} is empty') from None
    if ids.shape != (len(tree) + 1,) or ids.dtype != np.int64 or ids[-1] != checksum:
        raise ValueError(f'{beside} is of another part')
    return Part(tree, ids)


def _raycast(part: Part, *asked: Any) -> Found:
    handles, t, normals = part.tree.raycast_many(*asked)
    return Found(part.named(handles), t, normals, handles)


def _occluded(part: Part, *asked: Any) -> NDArray[np.bool_]:
    return part.tree.occluded_many(*asked)


def _overlap(part: Part, *asked: Any) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    offsets, handles = part.tree.overlap_many(*asked)
    return np.diff(offsets), part.named(handles)


def _nearest(
    part: Part, points: Any, reach: Any, masks: Any, k: int
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    handles, distances = part.tree.nearest_many(points, k, reach, masks)
    return part.named(handles), distances


def _boxes(part: Part, handles: NDArray[np.int64]) -> tuple[Any, Any]:
    return part.tree.boxes(handles)


QUERIES = {
    'raycast': _raycast,
    'occluded': _occluded,
    'overlap': _overlap,
    'nearest': _nearest,
    'boxes': _boxes,
}


def ask(folder: str, checksum: int, number: int, query: str, *asked: Any) -> Any:
    """Ask a part one of QUERIES."""
    return QUERIES[query](_open(folder, number, checksum), *asked)
