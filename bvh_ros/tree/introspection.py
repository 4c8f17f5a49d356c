# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a tree says of itself: its boxes, shape, cost, soundness and work done."""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from . import checks, validation
from .area import cost_now
from .compiler.kernel_cache import cache_folder
from .nodes import (
    BUILT_COST,
    COUNTERS,
    EXACT_RAYS,
    NONE,
    RAYS,
    ROOT,
    SERIAL,
    STATE_PLACES,
    WRITTEN,
    Tree,
    entry_points,
)
from .store.arrays import Floats, Ids, touched
from .store.storage import Storage, copy_bytes
from .store.turns import IS_CHANGED
from .timed import Timed

cost_entry = entry_points(cost_now, 0)


class Introspection(Timed):
    """Everything that only looks."""

    def __contains__(self, handle: object) -> bool:
        try:
            self._slot(handle)  # type: ignore[arg-type]
        except KeyError:
            return False
        return True

    def __iter__(self) -> Iterator[int]:
        return iter(self.ids().tolist())

    def ids(self) -> Ids:
        """All handles, ascending."""
        view = self._view()
        handles = view.tree.handles
        live = np.sort(handles[handles >= 0])
        self._check_unchanged(view)
        return live

    def boxes(self, handles: ArrayLike) -> tuple[Floats, Floats]:
        """Exact boxes (without margin) of the handles, shape (n, ndim) each. KeyError if one names
        no box.
        """
        view = self._view()
        nodes, tight = view.tree.nodes, view.tree.tight
        slots = checks.slots_of(view.tree.handles, handles, once=False)
        records = tight[slots] if len(tight) else nodes[2 * slots]
        self._check_unchanged(view)
        return records['lo'].reshape(-1, self.ndim).copy(), records['hi'].reshape(
            -1, self.ndim
        ).copy()

    def masks(self, handles: ArrayLike) -> NDArray[np.uint32]:
        """Masks of the handles, shape (n,). KeyError if one names no box."""
        view = self._view()
        slots = checks.slots_of(view.tree.handles, handles, once=False)
        masks = np.array(view.tree.nodes['mask'][2 * slots], np.uint32)
        self._check_unchanged(view)
        return masks

    @property
    def bounds(self) -> tuple[Floats, Floats] | None:
        """Smallest box around all exact boxes, as (lo, hi); None if the tree is empty."""
        view = self._view()
        nodes, tight = view.tree.nodes, view.tree.tight
        live = np.flatnonzero(view.tree.handles >= 0)
        records = tight[live] if len(tight) else nodes[2 * live]
        self._check_unchanged(view)
        if not len(live):
            return None
        return records['lo'].min(axis=0), records['hi'].max(axis=0)

    @property
    def height(self) -> int:
        """Levels of inner nodes; at most 4 log2(n) + 4."""
        self._settle()
        view = self._view()
        root = view.tree.state.item(ROOT)
        height: int = 0 if root == NONE else view.tree.heights.item(root)
        self._check_unchanged(view)
        return height

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
        view = self._view()
        all_nodes, root = view.tree.nodes, view.tree.state.item(ROOT)
        here = np.array([] if root == NONE else [root], np.int64)
        nodes, depths, depth = [here[:0]], [here[:0]], 0
        while len(here) and depth <= last and sum(map(len, nodes)) < most:
            if depth >= first:
                nodes.append(here)
                depths.append(np.full(len(here), depth))
            inner = all_nodes[here[here & 1 == 1]]
            self._check_unchanged(view)
            here = np.concatenate((inner['left'], inner['right'])).astype(np.int64)
            depth += 1
        records = all_nodes[np.concatenate(nodes)[:most]]
        self._check_unchanged(view)
        return records['lo'], records['hi'], np.concatenate(depths)[:most]

    def cost(self) -> float:
        """Sum over the inner nodes of area / area of the root (perimeter in 2D); the number of
        inner nodes if that is zero.
        """
        cost = float(cost_entry(self._ndim)(*self._view()))
        if cost == -1.0:
            raise RuntimeError(IS_CHANGED)
        return cost

    def validate(self) -> None:
        """Raise RuntimeError, saying what is broken, unless the tree is sound."""
        self._validate_copy(self._copied())

    def _validate_copy(self, tree: Tree) -> None:
        """`validate` what `_copied` returned, while others change the tree."""
        serial, state = tree.state.item(SERIAL), tree.state[:STATE_PLACES]
        complaint = validation.complaint_about(
            self.ndim, self.margin, serial, tree._replace(state=state)
        )
        if complaint:
            raise RuntimeError(complaint)

    def stats(self) -> dict[str, Any]:
        """Size, shape, memory, what has been done so far, and which parts are on."""
        view = self._view()
        stats = self._figures() | {'cost': self.cost()}
        self._check_unchanged(view)
        return stats

    def _figures(self) -> dict[str, Any]:
        """`stats` without the cost: that takes 50 ns a box."""
        view = self._view()
        tree, (written, _, snapshot, _) = view.tree, self._wide
        state = tree.state
        built_cost = state.view(np.float64).item(BUILT_COST)
        figures = {
            'boxes': len(self),
            'capacity': len(tree.handles),
            'ndim': self.ndim,
            'height': self.height,
            'cost_when_built': built_cost,  # at the last bulk build; 0 before the first
            'bytes': sum(array.nbytes for array in tree),
            'snapshot_bytes': snapshot.nbytes if snapshot else 0,
            'motion_bytes': 0 if self._motion is None else self._motion.nbytes,
            'margin': self.margin,
            'sibling_search': self.sibling_search,
            'exact_boxes_beside_nodes': bool(len(tree.tight)),
            'wide_snapshot': snapshot is not None and written == state.item(WRITTEN),
            'kernel_cache': str(cache_folder()),
            'rays': state.item(RAYS),
            'rays_decided_exactly': state.item(EXACT_RAYS),
            **{name: state.item(place) for name, place in COUNTERS.items()},
        }
        self._check_unchanged(view)
        return figures

    def _copied(self, room: Storage | None = None) -> Tree:
        """The tree's arrays, all as they were at one time; in `_room_for_copy`, if that fits."""
        self._settle()
        view = self._view()
        copies = Tree._make(np.empty_like(array) for array in view.tree)
        if room is not None and [a.nbytes for a in room.tree] == [a.nbytes for a in view.tree]:
            copies = room.tree
        both: list[tuple[Any, Any]] = [*zip(copies, view.tree, strict=True)]
        for copy, array in both:
            copy_bytes(array, copy)
        self._check_unchanged(view)
        return copies

    def _room_for_copy(self) -> Storage:
        """Memory for `_copied`; another thread may ask for it."""
        tree = self._storage.tree
        return touched(self.ndim, len(tree.handles), len(tree.tight) > 0)
