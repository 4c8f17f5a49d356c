# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a tree says of itself: its boxes, shape, cost, soundness and work done."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks, validation
from .area import tree_cost
from .arrays import Arrays, Floats, Ids
from .kernel_cache import cache_folder
from .nodes import EXACT_RAYS, NONE, RAYS, ROOT, SLOT_MASK


class Introspection(Arrays):
    """Everything that only looks."""

    _serial: int
    _counters: dict[str, int]
    _built: tuple[int, float]

    def __contains__(self, handle: object) -> bool:
        try:
            self._slot(handle)
        except KeyError:
            return False
        return True

    def __iter__(self) -> Iterator[int]:
        return iter(self.ids().tolist())

    def ids(self) -> Ids:
        """All handles, ascending."""
        return np.sort(self._handles[self._handles >= 0])

    def boxes(self, handles: ArrayLike) -> tuple[Floats, Floats]:
        """Exact boxes (without margin) of the handles, shape (n, ndim) each. KeyError if one names
        no box.
        """
        slots = checks.slots_of(self._handles, handles, once=False)
        records = self._tight[slots] if len(self._tight) else self._nodes[2 * slots]
        return records['lo'].reshape(-1, self.ndim).copy(), records['hi'].reshape(
            -1, self.ndim
        ).copy()

    def masks(self, handles: ArrayLike) -> NDArray[np.uint32]:
        """Masks of the handles, shape (n,). KeyError if one names no box."""
        slots = checks.slots_of(self._handles, handles, once=False)
        return np.array(self._nodes['mask'][2 * slots], np.uint32)

    @property
    def bounds(self) -> tuple[Floats, Floats] | None:
        """Smallest box around all exact boxes, as (lo, hi); None if the tree is empty."""
        live = np.flatnonzero(self._handles >= 0)
        if not len(live):
            return None
        records = self._tight[live] if len(self._tight) else self._nodes[2 * live]
        return records['lo'].min(axis=0), records['hi'].max(axis=0)

    @property
    def height(self) -> int:
        """Levels of inner nodes; at most 4 log2(n) + 4."""
        root = int(self._state[ROOT])
        return 0 if root == NONE else int(self._heights[root])

    def levels(self, first: int, last: int, most: int) -> tuple[Floats, Floats, Ids]:
        """Boxes (as queries see them, with margin) of the nodes from depth `first` to `last`.

        Parameters
        ----------
        first, last : int
            Depths; the root has 0.
        most : int
            No more than so many boxes, the upper ones first.

        Returns
        -------
        lo, hi : (m, ndim) arrays
        depths : (m,)
        """
        first, last, most = (
            checks.whole(name, value, 0)
            for name, value in (('first', first), ('last', last), ('most', most))
        )
        root = int(self._state[ROOT])
        here = np.array([] if root == NONE else [root], np.int64)
        nodes, depths, depth = [here[:0]], [here[:0]], 0
        while len(here) and depth <= last and sum(map(len, nodes)) < most:
            if depth >= first:
                nodes.append(here)
                depths.append(np.full(len(here), depth))
            inner = self._nodes[here[here & 1 == 1]]
            here = np.concatenate((inner['left'], inner['right'])).astype(np.int64)
            depth += 1
        records = self._nodes[np.concatenate(nodes)[:most]]
        return records['lo'], records['hi'], np.concatenate(depths)[:most]

    def cost(self) -> float:
        """Sum over the inner nodes of area / area of the root (perimeter in 2D); the number of
        inner nodes if that is zero.
        """
        root = int(self._state[ROOT])
        return 0.0 if root == NONE else float(tree_cost(self._nodes, root))

    def validate(self) -> None:
        """Raise RuntimeError, saying what is broken, unless the tree is sound."""
        arrays = self._nodes, self._heights, self._tight, self._handles, self._state
        complaint = validation.complaint_about(self.ndim, self.margin, self._serial, arrays)
        if complaint:
            raise RuntimeError(complaint)

    def stats(self) -> dict[str, Any]:
        """Size, shape, memory, what has been done so far, and which parts are on."""
        arrays = (self._nodes, self._heights, self._tight, self._handles, self._state)
        return {
            'boxes': len(self),
            'capacity': len(self._handles),
            'ndim': self.ndim,
            'height': self.height,
            'cost': self.cost(),
            'cost_when_built': self._built[1],  # at the last bulk build; 0 before the first
            'bytes': sum(array.nbytes for array in arrays),
            'snapshot_bytes': self._snapshot.nbytes if self._snapshot else 0,
            'margin': self.margin,
            'sibling_search': self.sibling_search,
            'exact_boxes_beside_nodes': bool(len(self._tight)),
            'wide_snapshot': self._snapshot is not None and self._snapshot_of == self._changes,
            'kernel_cache': str(cache_folder()),
            'rays': int(self._state[RAYS]),
            'rays_decided_exactly': int(self._state[EXACT_RAYS]),
            **self._counters,
        }

    def _slot(self, handle: Any) -> int:
        """Slot of a live handle, else KeyError; what is no integer is no handle either."""
        if checks.is_integer(handle) and not isinstance(handle, bool) and handle >= 0:
            slot = int(handle) & SLOT_MASK
            if slot < len(self._handles) and self._handles[slot] == handle:
                return slot
        raise KeyError(f'handle {handle!r} names no box of this tree')
