# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The class: checks input, owns the arrays, and hands the work to the kernels."""

from __future__ import annotations

import copy
import inspect
from os import PathLike
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike

from . import changing, checks, plotting
from .nodes import View
from .query.box_queries import BoxQueries
from .query.ray_queries import RayQueries
from .store import files
from .store.arrays import Floats, Ids
from .store.storage import clear_entry, new_storage
from .store.turns import accepted

if TYPE_CHECKING:
    from typing_extensions import Self

    from .motion.queries import MotionQueries

STILL = np.zeros(3)  # a displacement
SEARCHES = ('greedy', 'branch_and_bound')

# move_many, measured (see `bvh_report speed`): from this share of boxes that move near by on,
# writing them in place and refitting the whole tree is faster than inserting each again, ...
REFIT_SHARE = 0.05
# ... from this share that move far away on, so is building the tree anew, ...
REBUILD_SHARE = 0.3
# (Which is also done when refits have made it too costly, see `changing`.)
SHARES = REFIT_SHARE, REBUILD_SHARE


class DynamicBVH(RayQueries, BoxQueries):
    """A bounding volume hierarchy of axis-aligned boxes that can be inserted, moved and removed at
    any time.

    Any number of threads may query a tree at the same time. A change while another thread queries
    or changes it, and a query while another thread changes it, is refused with a RuntimeError
    instead of a wrong answer; nothing is changed then, and it may be tried again. Whatever
    interrupts a change (Ctrl-C, a MemoryError), it is done or it is not begun.

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

    _COUNTERS = ('inserted', 'removed', 'kept', 'reinserted', 'refitted', 'rebuilds')

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
        self._be(ndim, margin, sibling_search)
        places = checks.capacity('capacity', capacity)
        self._storage = new_storage(self._ndim, places, self._margin > 0.0)

    def _be(self, ndim: int, margin: float, sibling_search: str) -> None:
        """Be a tree of this kind whose storage is still to come."""
        self._ndim = checks.whole('ndim', ndim, 2, 3)
        if not isinstance(sibling_search, str) or sibling_search not in SEARCHES:
            shown = checks.shown_short(sibling_search)
            raise ValueError(f'sibling_search must be one of {SEARCHES}, not {shown}')
        self._margin = checks.limit('margin', margin)
        if np.isinf(self._margin):
            raise ValueError('margin must be finite')
        self._sibling_search = sibling_search
        self._thorough = sibling_search == 'branch_and_bound'
        self._wide = 0, 0, None, None
        self._motion = self._room = None

    @classmethod
    def from_boxes(
        cls, lo: ArrayLike, hi: ArrayLike, *, mask: ArrayLike | None = None, margin: float = 0.0
    ) -> Self:
        """Bulk build by binned SAH from boxes of shape (n, ndim); `ids()` are the handles in row
        order. A subclass whose `__init__` takes other arguments than this class' is made without
        it.
        """
        checks.few_enough(lo)
        refused = isinstance(lo, np.ndarray) and lo.shape[1:] not in ((2,), (3,))
        low = np.asarray(lo) if refused else checks.floats('lo', lo)
        if low.ndim != 2 or low.shape[1] not in (2, 3):
            raise ValueError(f'lo must have shape (n, 2) or (n, 3), not {low.shape}')
        ndim = low.shape[1]
        capacity = checks.capacity('the number of rows of lo', max(len(low), 1))
        try:
            # Of this one it is known, and 25 us are a box in ten of 1,000.
            if cls.__init__ is not DynamicBVH.__init__:
                inspect.signature(cls).bind(ndim, margin=margin, capacity=capacity)
        except TypeError:
            tree = cls.__new__(cls)
            tree._begin(ndim, margin, SEARCHES[1], capacity)
        else:
            tree = cls(ndim, margin=margin, capacity=capacity)
        tree.insert_many(low, hi, mask)
        return tree

    @staticmethod
    def _tree_of_boxes(lo: Floats, hi: Floats, masks: Any) -> View:
        return DynamicBVH.from_boxes(lo, hi, mask=masks)._view()

    def __repr__(self) -> str:
        shown = f'{type(self).__name__}({self._ndim}D, '
        try:
            count = len(self)
            return f'{shown}{count:,} {"box" if count == 1 else "boxes"}, height {self.height})'
        except RuntimeError:
            return f'{shown}being changed)'

    # ---- changes: each is one kernel of `changing`

    def insert(self, lo: ArrayLike, hi: ArrayLike, mask: int = 1) -> int:
        """Insert the box from `lo` to `hi`, shape (ndim,) each; return its handle. Handles ascend
        with every insertion.
        """
        ndim = self._ndim
        low, high = checks.vector('lo', lo, ndim), checks.vector('hi', hi, ndim)
        handle = self._change(
            changing.insert_entry(ndim), low, high, checks.mask(mask), self._margin, self._thorough
        )
        if handle >= 0:
            return handle
        if handle == changing.NO_BOX:
            raise checks.no_box(low, high, ndim)
        self._settle_soon()
        return -handle

    def insert_many(self, lo: ArrayLike, hi: ArrayLike, mask: ArrayLike | None = None) -> Ids:
        """Insert n boxes, shape (n, ndim) each; return their handles in row order.

        `mask` is one for all or of shape (n,); None is 1 for all. As many as the tree holds
        already, or more, and it is built anew.
        """
        checks.few_enough(lo)
        low, high = checks.boxes(lo, hi, self.ndim)
        masks = checks.masks(1 if mask is None else mask, len(low))
        new = np.empty(len(low), np.int64)
        self._change_many(changing.INSERT, new, (low, high, low), masks)
        return new

    def remove(self, handle: int) -> None:
        """Remove a box. KeyError if the handle names none."""
        number = checks.handle(handle)
        done = self._change(changing.remove_entry(self._ndim), number)
        if done == changing.UNKNOWN:
            raise checks.unknown(handle)
        if done > 1:
            self._settle_soon()

    def remove_many(self, handles: ArrayLike) -> None:
        """Remove boxes; all or, if a handle is unknown (KeyError) or given twice (ValueError),
        none.
        """
        tree, version = self._view()
        slots = checks.slots_of(tree.handles, handles)
        self._change_many(changing.REMOVE, slots, version=version)

    def clear(self) -> None:
        """Remove all boxes. Their handles stay stale for ever."""
        self._change(clear_entry(self._ndim))

    def move(
        self, handle: int, lo: ArrayLike, hi: ArrayLike, displacement: ArrayLike | None = None
    ) -> bool:
        """Give a box its new bounds; true if the tree changed, false if the box stayed within its
        fat box.

        `displacement`, shape (ndim,), is where the box is expected to be next, relative to now:
        its fat box then reaches there. KeyError if the handle names no box.
        """
        number, ndim, ahead = checks.handle(handle), self._ndim, STILL
        low, high = checks.vector('lo', lo, ndim), checks.vector('hi', hi, ndim)
        if displacement is not None:
            there = checks.point('displacement', displacement, ndim)
            ahead = self._ahead(there[None], 1)[0]
        arguments = number, low, high, self._margin, ahead, self._thorough
        changed = self._change(changing.move_entry(ndim), *arguments)
        if changed == changing.UNKNOWN:
            raise checks.unknown(handle)
        if changed == changing.NO_BOX:
            raise checks.no_box(low, high, ndim)
        if changed > 1:
            self._settle_soon()
        return changed > 0

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
        tree, version = self._view()
        slots = checks.slots_of(tree.handles, handles)
        low, high = checks.boxes(lo, hi, self.ndim, len(slots))
        boxes = low, high, self._ahead(displacement, len(slots))
        return self._change_many(changing.MOVE, slots, boxes, version=version, shares=SHARES)

    def _move_sound(self, slots: Ids, lo: Floats, hi: Floats) -> None:
        """`move_many` of boxes that the caller made, at slots in use, each once: C-ordered
        float64, finite, lo <= hi. Nothing is looked at or copied.
        """
        if len(slots) != 1:
            boxes = lo, hi, self._ahead(None, len(slots))
            self._change_many(changing.MOVE, slots, boxes, shares=SHARES)
            return
        handle = self._storage.tree.handles.item(slots.item())
        arguments = handle, lo[0], hi[0], self._margin, STILL, self._thorough
        if accepted(self._change(changing.move_entry(self._ndim), *arguments)) > 1:
            self._settle_soon()

    def _ahead(self, displacement: ArrayLike | None, count: int) -> Floats:
        if displacement is None:
            return np.zeros((1, self._ndim))
        ahead = checks.points('displacement', displacement, self.ndim, count)
        if ahead.any():
            self._keep_exact_boxes()
        return ahead

    def set_masks(self, handles: ArrayLike, mask: ArrayLike) -> None:
        """Give boxes new masks: one for all or of shape (n,). Errors as `remove_many`."""
        tree, version = self._view()
        slots = checks.slots_of(tree.handles, handles)
        masks = checks.masks(mask, len(slots))
        self._change(changing.masks_entry(self._ndim), version, slots, masks)

    def rebuild(self) -> None:
        """Build the tree anew by binned SAH over all axes. Handles stay."""
        self._change_many(changing.BUILD)

    def optimize(self) -> None:
        """Lower the tree's cost without building it anew: rebuild its top over subtrees, and the
        subtrees in turn.
        """
        self._change_many(changing.OPTIMIZE)

    # ---- a picture

    def plot(
        self,
        axes: Any = None,
        *,
        levels: plotting.Levels = None,
        rays: ArrayLike | None = None,
        hits: ArrayLike | None = None,
    ) -> Any:
        """Draw the boxes with matplotlib (`pip install matplotlib`); some thousands at most.

        Parameters
        ----------
        axes : matplotlib axes, optional
            With `projection='3d'` unless ndim is 2; new ones by default.
        levels : int or (int, int), optional
            The tree's boxes of this depth, or from one depth to another, by their edges. The
            root's is 0.
        rays : array_like, shape (n, 2, ndim), optional
            The two ends of each. They are cast: each is drawn to its first hit, which is marked.
        hits : array_like, shape (m, ndim), optional
            More points to mark.

        Returns
        -------
        matplotlib axes
        """
        no_triangles = np.empty((0, 2, self.ndim))
        world = plotting.World(
            self.ndim,
            self.bounds,
            {'box': plotting.box_faces(*self.boxes(self.ids()))},
            self.levels,
            lambda starts, goals: (self.raycast_many(starts, goals - starts, 1.0).t, no_triangles),
        )
        return plotting.picture(axes, world, levels, rays, hits)

    # ---- keeping

    def save(self, path: str | PathLike[str], mapped: bool = False) -> None:
        """Write the tree to one file, from which `load` gives it back with the same handles: an
        .npz, or with `mapped` a file that is larger and can be mapped into memory. An older file
        is replaced once the new one is whole.
        """
        files.save(checks.path('path', path), files.pack(self), checks.flag('mapped', mapped))

    @classmethod
    def load(cls, path: str | PathLike[str], mmap: bool = False, verify: bool = False) -> Self:
        """Read what `save` wrote. ValueError if the file is of another format version, not such a
        file, or of a tree that is not sound. A subclass' `__init__` is not called.

        `mmap`: map what was saved with ``mapped=True`` into memory, which all processes of a
        machine share. The tree is read-only: a change raises ValueError. The first time, a process
        checks the header and the links between nodes (0.1 s a million boxes), so that no query
        leads outside the file; after that, mapping takes a millisecond. Boxes and masks are
        trusted, unless `verify` reads and checks all (0.4 s a million boxes). Do not write into a
        file that is mapped: `save` puts a new one in its place.
        """
        tree, file = cls.__new__(cls), checks.path('path', path)
        every = checks.flag('verify', verify)
        if checks.flag('mmap', mmap):
            files.attach(tree, Path(file), every)
        else:
            tree.__setstate__(files.load(file))
        return tree

    def __getstate__(self) -> dict[str, Any]:
        """The tree, and what a subclass has added."""
        own = vars(DynamicBVH(self.ndim))
        added = {name: value for name, value in vars(self).items() if name not in own}
        return files.pack(self) | {'added': added}

    def __copy__(self) -> Self:
        twin = type(self).__new__(type(self))
        twin.__setstate__(files.Copied(self.__getstate__()))
        return twin

    def __deepcopy__(self, memo: dict[int, Any]) -> Self:
        twin = memo[id(self)] = type(self).__new__(type(self))
        state = self.__getstate__()
        new = {name: copy.deepcopy(state[name], memo) for name in {*state} - files.COPIED}
        twin.__setstate__(files.Copied(state | new))
        return twin

    def __setstate__(self, state: dict[str, Any]) -> None:
        added = state.get('added', {}) if isinstance(state, dict) else {}
        fresh = type(self).__new__(type(self))
        files.unpack(fresh, state)
        vars(self).update({**added, **vars(fresh)})  # at once: it is this tree, or as it was


class OpenTree(DynamicBVH):
    """A tree whose arrays, slots and steps other rooms of the package use; its callers need none
    of this.
    """

    arrays = DynamicBVH._arrays
    slots = DynamicBVH._slots
    view = DynamicBVH._view
    latest = DynamicBVH._latest
    check_unchanged = DynamicBVH._check_unchanged
    snapshot_for = DynamicBVH._snapshot_for
    ready_snapshot = DynamicBVH._ready_snapshot
    few_rays = DynamicBVH._few_rays
    first_hits = DynamicBVH._first_hits
    move_sound = DynamicBVH._move_sound
    count_nanoseconds = DynamicBVH._count_nanoseconds
    room_for = DynamicBVH._room_for
    move_into = DynamicBVH._move_into
    room_for_copy = DynamicBVH._room_for_copy
    copied = DynamicBVH._copied
    validate_copy = DynamicBVH._validate_copy
    figures = DynamicBVH._figures

    @property
    def motion(self) -> MotionQueries | None:
        """Queries of moving boxes; None where no box ever had a velocity."""
        return self._motion
