# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The class: checks input, owns the arrays, and hands the work to the kernels."""

import inspect
from os import PathLike
from threading import Lock
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import building, checks, moving, storing
from .arrays import Floats, Ids
from .box_queries import BoxQueries
from .introspection import Introspection
from .nodes import (
    LAST_SERIAL,
    NONE,
    RAYS,
    ROOT,
    SLOT_MASK,
    aligned_empty,
    box_dtype,
    link_free,
    node_dtype,
)
from .ray_queries import RayQueries

SEARCHES = ('greedy', 'branch_and_bound')

# move_many, measured (see `bvh_report speed`): from this share of boxes that move near by on,
# writing them in place and refitting the whole tree is faster than inserting each again, ...
REFIT_SHARE = 0.05
# ... from this share that move far away on, so is building the tree anew, ...
REBUILD_SHARE = 0.3
# ... which is also done when refits have made the tree so much costlier than it was when built.
WORSE = 1.2
# The cost is looked at after so many moves a box.
REFITS_BEFORE_A_LOOK = 1


class DynamicBVH(RayQueries, BoxQueries, Introspection):
    """A bounding volume hierarchy of axis-aligned boxes that can be inserted, moved and removed at
    any time.

    Parameters
    ----------
    ndim : {2, 3}
        A planar scene pays for no z.
    margin : float
        Boxes in the tree are grown by this on every side (m), so that small moves cost nothing.
        Answers do not depend on it.
    sibling_search : {'branch_and_bound', 'greedy'}
        How an insertion looks for the best sibling: the best of all, or what one descent meets
        (faster, for a worse tree).
    capacity : int
        Boxes to make room for at first; the storage grows by itself.

    Raises
    ------
    ValueError
        If an argument is out of its range.

    Examples
    --------
    >>> tree = DynamicBVH()
    >>> crate = tree.insert([0, 0, 0], [1, 1, 1])
    >>> tree.raycast([-3, 0.5, 0.5], [1, 0, 0]).t
    3.0
    >>> tree.move(crate, [5, 0, 0], [6, 1, 1])
    True
    >>> tree.raycast([-3, 0.5, 0.5], [1, 0, 0]).point.tolist()
    [5.0, 0.5, 0.5]
    """

    COUNTERS = ('inserted', 'removed', 'kept', 'reinserted', 'refitted', 'rebuilds')

    def __init__(
        self,
        ndim: int = 3,
        *,
        margin: float = 0.0,
        sibling_search: str = 'branch_and_bound',
        capacity: int = 16,
    ) -> None:
        self._begin(ndim, margin, sibling_search, capacity)

    def _begin(self, ndim: int, margin: float, sibling_search: str, capacity: int) -> None:
        """Be a new tree, also where a subclass has its own `__init__`."""
        self._ndim = checks.whole('ndim', ndim, 2, 3)
        if not isinstance(sibling_search, str) or sibling_search not in SEARCHES:
            raise ValueError(f'sibling_search must be one of {SEARCHES}, not {sibling_search!r}')
        self._margin = checks.limit('margin', margin)
        if np.isinf(self._margin):
            raise ValueError('margin must be finite')
        self._sibling_search = sibling_search
        self._serial = 1
        self._start()
        self._counters = dict.fromkeys(self.COUNTERS, 0)
        self._allocate(checks.capacity('capacity', capacity))

    @classmethod
    def from_boxes(
        cls, lo: ArrayLike, hi: ArrayLike, *, mask: ArrayLike | None = None, margin: float = 0.0
    ) -> 'DynamicBVH':
        """Bulk build by binned SAH from boxes of shape (n, ndim); `ids()` are the handles in row
        order. A subclass whose `__init__` takes other arguments than this class' is made without
        it.
        """
        low = checks.floats('lo', lo)
        if low.ndim != 2 or low.shape[1] not in (2, 3):
            raise ValueError(f'lo must have shape (n, 2) or (n, 3), not {low.shape}')
        ndim, capacity = (
            low.shape[1],
            checks.capacity('the number of rows of lo', max(len(low), 1)),
        )
        try:
            inspect.signature(cls).bind(ndim, margin=margin, capacity=capacity)
        except TypeError:
            tree = cls.__new__(cls)
            tree._begin(ndim, margin, SEARCHES[1], capacity)
        else:
            tree = cls(ndim, margin=margin, capacity=capacity)
        tree.insert_many(low, hi, mask)
        return tree

    def _start(self) -> None:
        self._lock = Lock()
        self._changes = 0
        self._snapshot, self._snapshot_of, self._rays_since = None, 0, 0
        self._refits = 0  # boxes moved since the last look at the cost
        self._built = 0, 0.0  # boxes and cost after the last bulk build

    # ---- storage

    def _allocate(self, capacity: int) -> None:
        self._nodes = aligned_empty(2 * capacity, node_dtype(self.ndim))
        self._heights = np.zeros(2 * capacity, np.int16)
        self._tight = np.empty(capacity if self.margin > 0.0 else 0, box_dtype(self.ndim))
        self._handles = np.full(capacity, NONE, np.int64)
        self._state = np.array([NONE, 0, NONE, NONE, 0, 0], np.int64)
        link_free(self._nodes, self._state, 0, capacity)

    def _reserve(self, more: int) -> None:
        """Make room for so many more boxes, at least doubling, and check that the numbers last."""
        if self._serial + more - 1 > LAST_SERIAL:
            raise ValueError(f'lo and hi are too many: a tree can name {LAST_SERIAL} insertions')
        old, need = len(self._handles), len(self) + more
        if need <= old:
            return
        capacity = min(max(need, 2 * old), SLOT_MASK + 1)
        if need > capacity:
            raise ValueError(f'lo and hi are too many: a tree holds at most {SLOT_MASK + 1} boxes')
        nodes = aligned_empty(2 * capacity, self._nodes.dtype)
        nodes[: 2 * old] = self._nodes
        self._nodes = nodes
        self._heights = np.concatenate([self._heights, np.zeros(2 * (capacity - old), np.int16)])
        self._handles = np.concatenate([self._handles, np.full(capacity - old, NONE, np.int64)])
        if len(self._tight):
            self._tight = np.concatenate(
                [self._tight, np.empty(capacity - old, self._tight.dtype)]
            )
        link_free(self._nodes, self._state, old, capacity)

    def _keep_exact_boxes(self) -> None:
        """From the first predicted displacement on, fat and exact boxes differ even where the
        margin is zero.
        """
        if not len(self._tight):
            self._tight = np.empty(len(self._handles), box_dtype(self.ndim))
            self._tight['lo'], self._tight['hi'] = self._nodes['lo'][::2], self._nodes['hi'][::2]

    def _row_by_row(self, kernel: Any, count: int, *arguments: Any) -> None:
        """Have a kernel of `moving` change the tree by so many rows, and keep its height."""
        row = 0
        while row < count:
            row = kernel(*arguments, row)
            if row < 0:
                row = -row
                self._restructure(building.NEITHER)

    def _restructure(self, how: int) -> None:
        building.restructure(self._nodes, self._heights, self._handles, self._state, how)

    @property
    def _thorough(self) -> bool:
        return self.sibling_search == 'branch_and_bound'

    # ---- changes

    def insert(self, lo: ArrayLike, hi: ArrayLike, mask: int = 1) -> int:
        """Insert the box from `lo` to `hi`, shape (ndim,) each; return its handle. Handles ascend
        with every insertion.
        """
        low, high = checks.box(lo, hi, self.ndim)
        return int(self._insert(low[None], high[None], checks.masks(checks.mask(mask), 1))[0])

    def insert_many(self, lo: ArrayLike, hi: ArrayLike, mask: ArrayLike | None = None) -> Ids:
        """Insert n boxes, shape (n, ndim) each; return their handles in row order.

        `mask` is one for all or of shape (n,); None is 1 for all. As many as the tree holds
        already, or more, and it is built anew.
        """
        low, high = checks.boxes(lo, hi, self.ndim)
        return self._insert(low, high, checks.masks(1 if mask is None else mask, len(low)))

    def _insert(self, low: Floats, high: Floats, masks: NDArray[np.uint32]) -> Ids:
        count = len(low)
        self._reserve(count)
        build = count >= max(2, len(self))
        new = np.empty(count, np.int64)
        self._row_by_row(
            moving.insert_rows,
            count,
            self._nodes,
            self._heights,
            self._tight,
            self._handles,
            self._state,
            low,
            high,
            masks,
            self.margin,
            self._serial,
            self._thorough,
            not build,
            new,
        )
        self._serial += count
        self._changes += 1
        self._counters['inserted'] += count
        if build:
            self.rebuild()
        return new

    def remove(self, handle: int) -> None:
        """Remove a box. KeyError if the handle names none."""
        self._remove(np.array([self._slot(handle)]))

    def remove_many(self, handles: ArrayLike) -> None:
        """Remove boxes; all or, if a handle is unknown (KeyError) or given twice (ValueError),
        none.
        """
        self._remove(checks.slots_of(self._handles, handles))

    def _remove(self, slots: Ids) -> None:
        arrays = self._nodes, self._heights, self._handles, self._state
        self._row_by_row(moving.remove_rows, len(slots), *arrays, slots)
        self._counters['removed'] += len(slots)
        self._changes += 1

    def clear(self) -> None:
        """Remove all boxes. Their handles stay stale for ever."""
        self._counters['removed'] += len(self)
        tally = self._state[RAYS:].copy()
        self._allocate(len(self._handles))
        self._state[RAYS:] = tally
        self._changes += 1

    def move(
        self, handle: int, lo: ArrayLike, hi: ArrayLike, displacement: ArrayLike | None = None
    ) -> bool:
        """Give a box its new bounds; true if the tree changed, false if the box stayed within its
        fat box.

        `displacement`, shape (ndim,), is where the box is expected to be next, relative to now:
        its fat box then reaches there. KeyError if the handle names no box.
        """
        slot = self._slot(handle)
        low, high = checks.box(lo, hi, self.ndim)
        if displacement is not None:
            displacement = checks.point('displacement', displacement, self.ndim)[None]
        ahead = self._ahead(displacement, 1)
        changed = moving.move_one(
            self._nodes,
            self._heights,
            self._tight,
            self._state,
            2 * slot,
            low,
            high,
            self.margin,
            ahead[0],
            self._thorough,
        )
        if changed < 0:
            self._restructure(building.NEITHER)
        self._counters['reinserted' if changed else 'kept'] += 1
        self._changes += abs(changed)
        self._refits += abs(changed)
        if self._refits >= REFITS_BEFORE_A_LOOK * len(self):
            self._rebuild_if_worse()
        return bool(changed)

    def move_many(
        self,
        handles: ArrayLike,
        lo: ArrayLike,
        hi: ArrayLike,
        displacement: ArrayLike | None = None,
    ) -> int:
        """Give n boxes their new bounds, shape (n, ndim) each; return how many changed the tree.

        Few that leave their fat boxes, and those that go far, are inserted again one by one; many
        that stay near are written in place and the tree is refitted; where many go far, or refits
        have made the tree costlier, it is built anew. All or, if a handle is unknown (KeyError) or
        given twice (ValueError), none.
        """
        slots = checks.slots_of(self._handles, handles)
        low, high = checks.boxes(lo, hi, self.ndim, len(slots))
        ahead = self._ahead(displacement, len(slots))
        near, far = np.empty(len(slots), np.int64), np.empty(len(slots), np.int64)
        near_count, far_count = moving.sort_rows(
            self._nodes, self._tight, slots, low, high, self.margin, ahead, near, far
        )
        near, far = near[:near_count], far[:far_count]
        count = near_count + far_count
        self._counters['kept'] += len(slots) - count
        if not count:
            return 0
        self._changes += 1
        moved = slots, low, high, self.margin, ahead
        if far_count >= REBUILD_SHARE * len(self):
            moving.write_rows(self._nodes, self._tight, near, *moved)
            moving.write_rows(self._nodes, self._tight, far, *moved)
            self.rebuild()
            return count
        if count < REFIT_SHARE * len(self):
            self._reinsert(near, *moved)
        else:
            moving.write_rows(self._nodes, self._tight, near, *moved)
            building.refit_all(self._nodes, self._heights, int(self._state[ROOT]))
            self._counters['refitted'] += near_count
            self._refits += near_count
        self._reinsert(far, *moved)
        if self._refits >= REFITS_BEFORE_A_LOOK * len(self):
            self._rebuild_if_worse()
        return count

    def _reinsert(self, rows: Ids, *moved: Any) -> None:
        arrays = self._nodes, self._heights, self._tight, self._state
        self._row_by_row(moving.reinsert_rows, len(rows), *arrays, rows, *moved, self._thorough)
        self._counters['reinserted'] += len(rows)
        self._refits += len(rows)

    def _rebuild_if_worse(self) -> None:
        """See what many moves have done to the tree."""
        self._refits = 0
        count, cost = self._built
        if not 0.8 * count < len(self) < 1.25 * count or self.cost() > WORSE * cost:
            self.rebuild()

    def _ahead(self, displacement: ArrayLike | None, count: int) -> Floats:
        if displacement is None:
            return np.zeros((count, self.ndim))
        ahead = checks.points('displacement', displacement, self.ndim, count)
        if ahead.any():
            self._keep_exact_boxes()
        return ahead

    def set_masks(self, handles: ArrayLike, mask: ArrayLike) -> None:
        """Give boxes new masks: one for all or of shape (n,). Errors as `remove_many`."""
        slots = checks.slots_of(self._handles, handles)
        moving.set_masks(self._nodes, slots, checks.masks(mask, len(slots)))
        self._changes += 1

    def rebuild(self) -> None:
        """Build the tree anew by binned SAH over all axes. Handles stay."""
        self._restructure(building.BUILD)
        self._refits, self._built = 0, (len(self), self.cost())
        self._counters['rebuilds'] += 1
        self._changes += 1

    def optimize(self) -> None:
        """Lower the tree's cost without building it anew: rebuild its top over subtrees, and the
        subtrees in turn.
        """
        self._restructure(building.OPTIMIZE)
        self._changes += 1

    # ---- keeping

    def save(self, path: str | PathLike[str]) -> None:
        """Write the tree to one .npz file; `load` gives it back with the same handles."""
        storing.save(checks.path('path', path), self._packed())

    @classmethod
    def load(cls, path: str | PathLike[str]) -> 'DynamicBVH':
        """Read what `save` wrote. ValueError if the file is of another format version, not such a
        file, or of a tree that is not sound. A subclass' `__init__` is not called.
        """
        tree = cls.__new__(cls)
        tree.__setstate__(storing.load(checks.path('path', path)))
        return tree

    def _packed(self) -> dict[str, Any]:
        return storing.pack(self)

    def __getstate__(self) -> dict[str, Any]:
        """The tree, and what a subclass has added."""
        own = vars(DynamicBVH(self.ndim))
        return self._packed() | {
            'added': {name: value for name, value in vars(self).items() if name not in own}
        }

    def __setstate__(self, state: dict[str, Any]) -> None:
        vars(self).update(state.get('added', {}) if isinstance(state, dict) else {})
        storing.unpack(self, state)
