# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The velocities of a tree's boxes, and bounds of its nodes over the times of queries."""

import functools
import math
from collections.abc import Callable
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from .. import checks
from ..batch.snapshot import Snapshot, take_snapshot
from ..compiler import CACHE_LINE, WIDTH, entry_point, lean_kernel
from ..nodes import (
    CHANGES,
    COUNT,
    NONE,
    QUERIES_LEFT,
    RAYS,
    ROOT,
    SLOT_MASK,
    TURN,
    Tree,
    View,
    aligned_empty,
    empty_tree,
    entry_points,
)
from ..query.ray import of_row
from ..store.turns import IS_CHANGED, NOT_FINITE, REFUSED, begin_change, end_change
from .bounds import (
    AT_REST,
    AT_START,
    AT_STOP,
    EVER_SO_MANY,
    LONGEST,
    LOOKED,
    OUTSIDE,
    Layout,
    fit_nodes,
    moving_dtype,
    no_motion,
)
from .exact_contact import Moving, velocity_dtype, velocity_records
from .sweep import FEW, Sweep, swept

Ids = NDArray[np.int64]
Build = Callable[[NDArray[np.float64], NDArray[np.float64], NDArray[np.uint32]], View]
"""From lower and upper corners and masks to a tree."""


@lean_kernel
def write_velocities(tree, version, records, handles, velocities, references):
    """Write velocities, (n, ndim), and references, (n,) or one for all, of the boxes of `handles`;
    0, or why not.
    """
    refused = begin_change(tree.state, version)
    if refused != 0:
        return np.int64(refused)
    for i in range(handles.shape[0]):
        slot = handles[i] & SLOT_MASK
        here = records[slot]
        here.owner, here.reference = handles[i], references[i if references.shape[0] > 1 else 0]
        for axis in range(velocities.shape[1]):
            here.velocity[axis] = velocities[i, axis]
    end_change(tree.state, True)
    return np.int64(0)


def velocities_of(
    records: NDArray[Any], handles: NDArray[np.int64], slots: NDArray[np.int64]
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """(velocities, references) of the boxes of slots; zeros where a box has none."""
    rows = records[np.minimum(slots, len(records) - 1)]
    owned = rows['owner'] == handles[slots]
    return np.where(owned[:, None], rows['velocity'], 0.0), np.where(owned, rows['reference'], 0.0)


def packed_velocities(records: NDArray[Any], handles: Ids) -> dict[str, NDArray[Any]]:
    """The velocities of living boxes, as a file holds them."""
    count = min(len(records) - 1, len(handles))
    owners = records['owner'][:count]
    live = records[np.flatnonzero((owners == handles[:count]) & (owners >= 0))]
    names = {'moving': 'owner', 'velocities': 'velocity', 'references': 'reference'}
    return {name: np.ascontiguousarray(live[field]) for name, field in names.items()}


_IDS, _ROWS = np.empty(0, np.int64), np.empty((0, 3))
write_entry = entry_points(
    *(
        write_velocities,
        0,
        lambda ndim: np.empty(0, velocity_dtype(ndim)),
        _IDS,
        _ROWS,
        np.empty(0),
    )
)


FARTHEST = 1e300  # m: a tree takes finite boxes


@functools.cache
def layout_of_tree(ndim: int) -> Layout:
    """Boxes stay in the nodes of the tree."""
    return Layout(empty_tree(ndim).nodes, NONE, np.empty(0, np.int64))


def rebuild_at_time(
    build: Build, view: View, records: NDArray[np.void], at: float, left: float
) -> Layout:
    """Nodes built over the rounded places of all boxes at a time; boxes move for `left` s.
    `bounds` are fitted to them.
    """
    (tree, _), slots = _built(build, view, records, at, left)
    return Layout(tree.nodes, tree.state.item(ROOT), slots)


def snapshot_at_time(
    build: Build, view: View, records: NDArray[np.void], at: float, left: float
) -> Snapshot | None:
    """A snapshot of such nodes, for `sweeping`."""
    built, slots = _built(build, view, records, at, left)
    snapshot = take_snapshot(built)
    if snapshot is None:
        return None
    children = snapshot.children[: snapshot.size * WIDTH]
    children[children < 0] = ~slots[~children[children < 0]]
    return snapshot


def _built(
    build: Build, view: View, records: NDArray[np.void], at: float, left: float
) -> tuple[View, NDArray[np.int64]]:
    """A tree of all boxes at a time, and their slots in the other tree, in its order of slots;
    RuntimeError if that is being changed.
    """
    (nodes, _, tight, handles, state), version = view
    slots = np.flatnonzero(handles >= 0)
    boxes, masks = tight[slots] if len(tight) else nodes[2 * slots], nodes['mask'][2 * slots]
    velocities, references = velocities_of(records, handles, slots)
    if state.item(TURN) < 0 or state.item(CHANGES) != version:
        raise RuntimeError(IS_CHANGED)
    with np.errstate(over='ignore'):
        shifts = velocities * np.minimum(at - references, left)[:, None]
        lo, hi = (np.clip(boxes[side] + shifts, -FARTHEST, FARTHEST) for side in ('lo', 'hi'))
    return build(lo, hi, masks), slots


Floats = NDArray[np.float64]


def both_times(times: tuple[Any, Any], count: int) -> tuple[Floats, Floats]:
    """`at` and `pace`: each one for all or (n,), finite."""
    at, pace = times
    return checks.moments('at', at, count), checks.moments('pace', pace, count)


def span_of(at: float, pace: float, t_max: float) -> tuple[float, float]:
    """First and last time of a ray; both now where it is too long for bounds."""
    last = at if pace == 0.0 else at + t_max * pace
    if -LONGEST < at < LONGEST and -LONGEST < last < LONGEST:
        return (at, last) if at <= last else (last, at)
    return 0.0, 0.0


def times_of(at: Floats, pace: Floats, t_max: Floats) -> tuple[tuple[float, float], bool]:
    """`span_of` of all rows for which there can be bounds, and whether that is all rows."""
    first, last, every = _entry()(at, pace, t_max)
    return (first, last), every


@lean_kernel
def span_of_rows(at, pace, t_max):
    """First and last time of all rows for which there can be bounds, (n,) or one for all, and
    whether that is all rows.
    """
    first, last, every = np.inf, -np.inf, True
    counts = at.shape[0], pace.shape[0], t_max.shape[0]
    for i in range(max(counts) if min(counts) > 0 else 0):
        begin, going = of_row(at, i), of_row(pace, i)
        end = begin if going == 0.0 else begin + of_row(t_max, i) * going
        if abs(begin) < LONGEST and abs(end) < LONGEST:
            first, last = min(first, begin, end), max(last, begin, end)
        else:
            every = False
    return (first, last, every) if first <= last else (0.0, 0.0, every)


@functools.cache
def _entry() -> Callable[..., Any]:
    """The machine code of `span_of_rows`."""
    return entry_point(span_of_rows, *(np.empty(0),) * 3)


NOT_FITTED = -2  # no tree's version, nor ANY_VERSION
HANDFUL = 17  # so few rays go through any sweep, however long its span, however few its boxes
HORIZON = 1.0  # s: from one time on bounds are fitted to so many more
# Batches for which sweeping a snapshot pays: so many rays a box.
RAYS_PER_BOX = 0.05
LAYOUT_RAYS_PER_BOX = 2.0  # rays that grow as much for which sweeping another snapshot pays
# The span of a sweep may be so many times as long as that of a large batch.
LONGER = 1.5
# Where nodes are PARTED times as large as at rest, their boxes have parted. Then nodes are rebuilt
# over boxes that lie close together at the time of the query. That takes as long as
# QUERIES_PER_BOX queries a box lose by it; of batches, ROWS take as long as one query, see
# `bounds`. Rebuilt nodes hold until they have grown by SOON.
PARTED, QUERIES_PER_BOX, LEAST_QUERIES, SOON = 1.15, 0.135, 256, 0.5
LEAST_SPAN = 2.0**-40  # of a time
fit_entry = entry_points(fit_nodes, no_motion, layout_of_tree, np.empty(0, np.int64), np.empty(3))


def rows_were_changed() -> ValueError:
    """The error where an argument was changed while a kernel read it."""
    return ValueError('a row was changed while it was read')


class SweepCache(NamedTuple):
    """How many rays needed a sweep of a span of time, and the sweep, once it is made."""

    version: int
    """Of the tree."""
    start: float
    stop: float
    rays: int
    made: bool = False
    sweep: Sweep | None = None
    enough: float = 0.0
    """So many rays make a sweep worth while."""
    rebuild_after: float = np.inf
    """Nodes are rebuilt for this time when `state[RAYS]` of the tree reaches this."""


def queries_before_check(boxes: int, grown: float) -> int:
    """How many queries use bounds before `Motion` looks at them again."""
    if not grown > PARTED:
        return EVER_SO_MANY
    return max(LEAST_QUERIES, int(QUERIES_PER_BOX * boxes / (grown - 1.0)))


class Motion:
    """The velocities of a tree, and bounds of its nodes over the times of queries.

    Parameters
    ----------
    ndim : int
        2 or 3.
    build : callable
        Builds a tree over the places of boxes at a time.
    nanoseconds, left
        As of `DynamicBVH._count_nanoseconds`.
    """

    def __init__(
        self, ndim: int, build: Build, nanoseconds: bool = False, left: float = math.inf
    ) -> None:
        self._build = build
        self.velocities = velocity_records(0, ndim)
        known = no_motion(ndim)._replace(version=NOT_FITTED)
        self.moving = known._replace(nanoseconds=nanoseconds, left=left)
        self._no_nodes = self.moving.nodes
        self._cache = SweepCache(NOT_FITTED, 0.0, 0.0, 0)
        # Queries at one time use these first: bounds of nodes that are rebuilt for a time, if
        # there are any. Where these do not hold, `moving` may.
        self.bounds = self.moving
        # How many times as large as at rest the nodes of the tree are at the start of `moving`,
        # and by how much more each second.
        self._parted, self._queries_left = (0.0, 0.0), EVER_SO_MANY

    def write(self, tree: Any, version: int, handles: Ids, rows: Floats, times: Floats) -> int:
        """Call `write_velocities`, with room for all slots."""
        capacity = len(tree.handles)
        if len(self.velocities) <= capacity:
            self.velocities = velocity_records(capacity, rows.shape[1], self.velocities)
        kernel = write_entry(rows.shape[1])
        done: int = kernel(tree, version, self.velocities, handles, rows, times)
        return done

    def packed(self, handles: Ids) -> dict[str, Any]:
        """`packed_velocities`; and `left`, where times are whole nanoseconds."""
        packed = packed_velocities(self.velocities, handles)
        return packed | {'left': self.moving.left} if self.moving.nanoseconds else packed

    def velocities_of(self, handles: Ids, slots: Ids) -> tuple[Floats, Floats]:
        """`velocities_of`."""
        return velocities_of(self.velocities, handles, slots)

    # ---- bounds

    def ask(
        self,
        tree: Any,
        spans: Callable[[], tuple[tuple[float, float], bool]],
        call: Any,
        moments: bool = True,
    ) -> Any:
        """What call(arrays, moving) returns, with bounds that hold for the times of the query: it,
        or its first value, is not negative. `spans` returns the times: ((first, last), ...);
        `moments`: whether all queries are at one time.
        """
        moving = self.bounds if moments else self.moving
        while True:
            done = call(tree._view().tree, moving)
            why = done[0] if isinstance(done, tuple) else done
            if why >= 0:
                return done
            if why == NOT_FINITE:
                raise rows_were_changed()
            moving = self.others(tree, moving, why, spans()[0], moments)

    def others(
        self, tree: Any, moving: Moving, why: int, span: tuple[float, float], moments: bool = True
    ) -> Moving:
        """The next bounds to try where these did not hold, and why."""
        if moving is self.bounds is not self.moving and why == OUTSIDE:
            return self.moving
        return self.fit(tree, *span, moments)

    def fit(self, tree: Any, first: float, last: float, moments: bool = True) -> Moving:
        """Fit bounds of the tree as it is now to a span of time, at whose ends they are tight. If
        there are bounds for another span since the last change, the new span holds both. If they
        hold already, there were many queries at one time: for these, nodes may be rebuilt. Returns
        bounds that hold; RuntimeError if the tree is being changed.
        """
        view, before = tree._view(), self.moving
        if before.version != view.version:
            stop = last
            if first == last:
                stop = first + max(HORIZON, LEAST_SPAN * abs(first))
            self.moving = self.bounds = self._fit(view, layout_of_tree(tree.ndim), first, stop)
            return self.moving
        if view.tree.state.item(TURN) < 0:
            raise RuntimeError(IS_CHANGED)
        if before.start <= first <= last <= before.stop:
            return self._bounds_for(view, first, last) if moments else before
        # Further in the direction in which the times move, as they may go on.
        earlier, later = first < before.start, last > before.stop
        first, last = min(first, before.start), max(last, before.stop)
        more = 0.5 * (last - first)
        first, last = first - more * earlier, last + more * later
        moving = self._fit(view, layout_of_tree(tree.ndim), first, last)
        if self.bounds is before:
            self.bounds = moving
        self.moving = moving
        return moving

    def _fit(self, view: View, layout: Layout, first: float, last: float) -> Moving:
        """Fit bounds of the nodes of a layout."""
        arrays, ndim, own = view.tree, view.tree.nodes['lo'].shape[1], layout.root == NONE
        # Processors fetch two cache lines together, if the first of them is an even one.
        nodes = aligned_empty(len(arrays.nodes), moving_dtype(ndim), 2 * CACHE_LINE)
        order, areas = np.empty(len(arrays.nodes), np.int64), np.empty(3)
        span = float(first), float(last)
        moving = Moving(self.velocities, nodes, *span, view.version, *self.moving[-2:])
        if fit_entry(ndim)(arrays, moving, layout, order, areas) == REFUSED:
            raise RuntimeError(IS_CHANGED)
        if own:
            with np.errstate(all='ignore'):
                start, stop = areas[AT_START] / areas[AT_REST], areas[AT_STOP] / areas[AT_REST]
                self._parted = start.item(), ((stop - start) / (last - first)).item()
            self._queries_left = queries_before_check(
                arrays.state.item(COUNT), max(start.item(), stop.item())
            )
            arrays.state[QUERIES_LEFT] = self._queries_left
        return moving

    def _bounds_for(self, view: View, first: float, last: float) -> Moving:
        """Rebuild nodes for these times, of which there were many queries, if boxes have parted by
        then; bounds that hold.
        """
        moving, laid, (parted, per_second) = self.moving, self.bounds, self._parted
        middle = 0.5 * first + 0.5 * last
        if laid is not moving and laid.start <= first <= last <= laid.stop:
            moving = laid
        elif parted + per_second * (middle - moving.start) > PARTED:
            layout = rebuild_at_time(self._build, view, self.velocities, middle, moving.left)
            soon = min(HORIZON, SOON / per_second) if per_second > 0.0 else HORIZON
            stop = max(last, first + max(soon, LEAST_SPAN * abs(first)))
            self.bounds = moving = self._fit(view, layout, first, stop)
        view.tree.state[QUERIES_LEFT] = LOOKED - self._queries_left
        return moving

    def holds(self, version: int, first: float, last: float) -> bool:
        """Whether bounds are fitted that hold for a span of time."""
        moving = self.moving
        return moving.version == version and moving.start <= first and last <= moving.stop

    def prepare(self, tree: Any, count: int, first: float, last: float) -> None:
        """Fit bounds for a span of time; sweep a snapshot if so many rays in it would do so."""
        view = tree._view()
        if not self.holds(view.version, first, last):
            self.fit(tree, first, last, moments=False)
        cache, enough = self._cache, RAYS_PER_BOX * view.tree.state.item(COUNT)
        before = cache.rays if cache.version == view.version else 0
        if (
            count
            and before + 2 * count >= enough  # once more by the batch
            and self.ready_sweep(view.tree, count, first, last) is None
        ):
            self.swept_for(tree, view, max(count, math.ceil(enough)), (first, last))

    def refit(self, tree: Any, first: float) -> None:
        """Fit bounds to the time from `first` on, if any were fitted before."""
        if self.moving.version != NOT_FITTED and not self.holds(
            tree._view().version, first, first
        ):
            self.fit(tree, first, first, moments=False)

    def swept_for(self, tree: Any, view: View, count: int, span: Any) -> Sweep | None:
        """The sweep for `count` rays whose times lie in a span; None while that does not pay or
        would not help. The rays of small batches add up until they are enough for one together.
        """
        (first, last), cache = span, self._cache
        known, sweep = cache.version == view.version, None
        if known:
            if view.tree.state.item(RAYS) >= cache.rebuild_after:
                self._cache = cache = self._rebuilt(view, cache)
            sweep = self.ready_sweep(view.tree, count, first, last)
        if sweep is not None:
            return sweep
        rest = tree._snapshot_for(count, view)
        if rest is None:
            return None
        enough = RAYS_PER_BOX * view.tree.state.item(COUNT)
        covered = known and cache.start <= first and last <= cache.stop
        if covered and cache.made:
            if count < enough or cache.stop - cache.start <= LONGER * (last - first):
                return None  # the sweep did not help
            known = False
        if not known or (cache.made and not covered):
            cache = SweepCache(view.version, first, last, 0)
        rays, start, stop, rebuild_after = cache.rays + count, first, last, np.inf
        if count < enough:
            start, stop = min(first, cache.start), max(last, cache.stop)
        made = rays >= enough
        if made:
            sweep, grown = swept(view.tree, self.known(view, start, stop), rest)
            rebuild_after = self._rebuild_after(view, start, stop, grown)
        self._cache = SweepCache(
            view.version, start, stop, rays, made, sweep, enough, rebuild_after
        )
        return sweep

    def _rebuild_after(self, view: View, start: float, stop: float, grown: float) -> float:
        """The `rebuild_after` of nodes that have grown so much: where boxes have parted before the
        span, not only within it.
        """
        if not grown > PARTED:
            return np.inf
        references = self.velocities['reference'][self.velocities['owner'] >= 0]
        if abs(0.5 * (start + stop) - np.median(references)) <= stop - start:
            return np.inf
        state = view.tree.state
        rays: float = LAYOUT_RAYS_PER_BOX * state.item(COUNT) / (grown - 1.0)
        return state.item(RAYS) + rays

    def _rebuilt(self, view: View, cache: SweepCache) -> SweepCache:
        """The sweep of nodes that are built for its time."""
        start, stop, sweep = cache.start, cache.stop, cache.sweep
        middle, left = 0.5 * start + 0.5 * stop, self.moving.left
        snapshot = snapshot_at_time(self._build, view, self.velocities, middle, left)
        if snapshot is not None:
            sweep, _ = swept(view.tree, self.known(view, start, stop), snapshot)
        return cache._replace(sweep=sweep, rebuild_after=np.inf)

    def ready_sweep(self, tree: Tree, count: int, one: float, other: float) -> Sweep | None:
        """The sweep that exists, of any version of the tree, if it serves so many rays from one
        time to the other.
        """
        _, start, stop, _, _, sweep, enough, rebuild_after = self._cache
        if sweep is None or not (start <= one <= stop and start <= other <= stop):
            return None
        if count < enough or stop - start <= LONGER * abs(other - one):
            return sweep if tree.state.item(RAYS) < rebuild_after else None
        return None

    def few_sweep(self, count: int) -> Sweep | None:
        """The sweep that exists, of any version of the tree and any span, if it serves so many
        rays, and they are few.
        """
        _, _, _, _, _, sweep, enough, _ = self._cache
        return sweep if count < FEW and count < max(enough, HANDFUL) else None

    def known(self, view: View, start: float, stop: float) -> Moving:
        """The motion of a tree over a span, without bounds."""
        _, _, _, _, _, nanoseconds, left = self.moving
        parts = self.velocities, self._no_nodes, start, stop, view[1], nanoseconds, left
        return tuple.__new__(Moving, parts)

    @property
    def sweep(self) -> Sweep | None:
        """The swept snapshot that batches of rays go through, if there is one."""
        return self._cache.sweep

    @property
    def nbytes(self) -> int:
        """Memory of all."""
        more = 0 if self.sweep is None else self.sweep.nbytes
        more += 0 if self.bounds is self.moving else self.bounds.nodes.nbytes
        return self.velocities.nbytes + self.moving.nodes.nbytes + more
