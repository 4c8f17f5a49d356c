# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Changes of a scene: rows of messages come in, obstacles go."""

from collections.abc import Callable, Collection, Iterator
from dataclasses import dataclass, field
from typing import Any, NamedTuple, Protocol
from weakref import WeakSet

import numpy as np
from numpy.typing import ArrayLike, NDArray

from ..tree.access import ALL, FIRST_TIME, LAST_TIME, checks, whole_ns
from .names import UNKNOWN, Families, Names, Slots, as_families
from .results import Refusals
from .rows import Owner, Rows, Validated, column, text, validate_rows, whole_time
from .shapes.shape import UINT8, Floats, Shapes, as_shapes
from .store import NEVER, Obstacles

# ---- The part of the world whose obstacles a scene keeps.

Region = tuple[NDArray[np.float64], NDArray[np.float64]]  # lo, hi


def as_region(given: tuple[ArrayLike, ArrayLike] | None, planar: bool) -> Region | None:
    """Corners of a box that may be infinite; ValueError if it is none."""
    if given is None:
        return None
    corners = [
        checks.vector('region', corner, 3, planar)[: 2 if planar else 3].copy()
        for corner, _ in zip(checks.iterator('region', given), range(3), strict=False)
    ]
    if len(corners) != 2:
        raise ValueError('region must be two corners')
    lo, hi = corners
    if not (lo <= hi).all():
        raise ValueError('region must be two corners, the lower one first')
    return lo, hi


def within(
    region: Region | None, valid: Validated, reach: Floats | None
) -> tuple[Rows, Rows, Slots]:
    """New and known obstacles whose bounds touch the region, or are as near to it as their
    `reach`, see `speeds.reach_of`; and slots of those that leave.
    """
    added, known = valid[:2]
    if region is None:
        return added, known, NONE
    new, old = _near(region, added, reach), _near(region, known, reach)
    return added.take(new), known.take(old), known.slot[~old]


def _near(region: Region, rows: Rows, reach: Floats | None) -> NDArray[np.bool_]:
    (lo, hi), more = region, 0.0 if reach is None else reach[rows.row]
    return np.asarray(((rows.lo - more <= hi) & (rows.hi + more >= lo)).all(axis=1))


# ---- Velocities of the rows of an update: given, or estimated by following the obstacles.


class Sighting(NamedTuple):
    """Reported positions of n obstacles."""

    places: Floats
    """Shape (n, 3), m."""
    stamps: NDArray[np.int64]
    """(n,) ns."""


class Follow(Protocol):
    """Estimates velocities from successive updates, see `tracking`."""

    @property
    def max_speed(self) -> float:
        """None is faster, m/s."""

    def __call__(
        self, slots: Slots, handles: NDArray[np.int64], before: Sighting, now: Sighting, /
    ) -> Floats:
        """Velocities, (n, 3) m/s, of obstacles from two reports of their positions."""


def given_speeds(given: ArrayLike | Follow | None, count: int, planar: bool) -> Floats | None:
    """Velocities (n, 3) of the rows, m/s; None if there are none, or they are to be estimated."""
    if given is None or (callable(given) and hasattr(given, 'max_speed')):
        return None
    velocities: Any = given
    return checks.rows('velocities', velocities, 3, count, planar)


def reach_of(store: Obstacles, given: ArrayLike | Follow, speeds: Floats) -> Floats:
    """How far (m) along each axis rows may be from their reported positions, at any time that a
    query may name. A followed obstacle is reported before its velocity is known.
    """
    fastest = np.full(speeds.shape, given.max_speed) if callable(given) else np.abs(speeds)
    reach = np.zeros(speeds.shape)
    with np.errstate(over='ignore'):  # infinite: anywhere
        fastest = fastest + store.uncertainty * (fastest.max(axis=1, keepdims=True) > 0.0)
        return np.multiply(fastest, store.max_prediction, out=reach, where=fastest > 0.0)


def _followed(store: Obstacles, follow: Follow, known: Rows, count: int) -> Floats:
    """Velocities of rows, from the positions that were reported before."""
    columns, rows = store.columns, np.zeros((count, store.tree.ndim))
    before = Sighting(columns.geometry['position'][known.slot], columns.stamp[known.slot])
    now = Sighting(known.records['position'], known.stamp)
    found = follow(known.slot, columns.node_handle[known.slot], before, now)
    rows[known.row] = found[:, : store.tree.ndim]
    return rows


# ---- Rows of an update, and parts of them.


class Part(NamedTuple):
    """Some rows of an update, as for `Scene.update`."""

    names: Names
    shapes: Shapes
    stamp: ArrayLike
    expires: ArrayLike = 0
    categories: ArrayLike | None = None
    velocities: ArrayLike | Follow | None = None

    def cut(self, length: int) -> Iterator['Part']:
        """The same in parts of at most so many rows."""
        if isinstance(self.shapes, Shapes) and np.size(self.shapes.kind) <= length:
            yield self
            return
        given = as_shapes(self.shapes)
        total = len(given.kind)
        names = name_each(self.names, total)
        columns: list[Any] = [
            column('stamp', self.stamp, total, LAST_TIME, FIRST_TIME),
            column('expires', self.expires, total, LAST_TIME),
            None,
            None,
        ]
        if self.categories is not None:
            columns[2] = column('categories', self.categories, total, ALL)
        given_velocities: Any = self.velocities
        follow = given_velocities if callable(given_velocities) else None
        if given_velocities is not None and not follow:
            columns[3] = checks.copied_rows('velocities', given_velocities, 3, total)
        for begin in range(0, max(total, 1), length):
            rows = slice(begin, begin + length)
            shapes = given.take(rows)
            rest: list[Any] = [None if each is None else each[rows] for each in columns]
            rest[3] = follow or rest[3]
            yield Part(names.take(rows), shapes, *rest)


def stamp_of(
    given: ArrayLike | None, velocities: ArrayLike | Follow | None, shapes: Shapes
) -> ArrayLike:
    """The stamp of an update, which may be left out where nothing moves by itself."""
    if given is not None:
        return given if type(given) is int else _stamps(given, shapes)
    if velocities is not None:
        raise ValueError('stamp must be given where obstacles have velocities')
    return 0


def _stamps(given: Any, shapes: Shapes) -> Any:
    """The same in ns, if these are floats."""
    try:
        times = np.asarray(given)
    except checks.FOREIGN:
        return given  # will be refused
    few = isinstance(shapes, Shapes) and 0 < times.size <= max(np.size(shapes.kind), 1)
    return whole_ns('stamp', times, given) if few and times.dtype.kind == 'f' else given


def name_each(given: Names, count: int) -> Families:
    """The names of so many shapes; ValueError if there are not as many, or they have no order."""
    if isinstance(given, (set, frozenset)):
        raise ValueError('names must be a sequence of strings: a set has no order')
    names = as_families(given)
    if len(names) != count:
        raise ValueError(f'there are {len(names)} names for {count} shapes')
    return names


# ---- Rows of messages into a scene.

NONE = np.empty(0, np.int64)
BYTES_A_ROW, BYTES_A_SLOT = 1000, 500  # more than it takes to apply a row, to keep an obstacle
FEW_ROWS = 64  # so few are only checked for the room of new ones
# From n names to their masks, of shape (n,).
Categorise = Callable[[Families], NDArray[np.uint32]]


@dataclass(eq=False)
class Sliced:
    """An update in slices that is under way. Obstacles are known by handles of the tree."""

    source: str
    group: str
    begun: int
    """The next node handle when it began."""
    left: int
    """Rows that are still to come; a replacement keeps room for them."""
    replaced: Slots | None
    """Obstacles of when a replacement began: they go unless named. What comes meanwhile stays."""
    stays: int = 0
    """At most so many of these were named so far."""
    surveyed: bool = False
    """All that is named is known, `replaced` are the others, and `left` are new names."""
    new: list[int] = field(default_factory=list)
    """How many new names each part brings then, the first part last."""
    newest: int = 0
    """Latest stamp of its rows so far, ns: what the scene holds is as new when all are in."""
    named: list[tuple[Slots, bool]] = field(default_factory=list)
    """Obstacles named so far, in order, and whether they leave the region, and so go."""
    shadows: list[Slots] = field(default_factory=list)


class Checked(NamedTuple):
    """Rows of an update, before they are applied."""

    names: Families
    slots: Slots
    valid: Validated
    speeds: Floats | None
    """Velocities that are given, along the tree's axes."""


class Updates:
    """Adds and modifies obstacles. Knows which replacements are under way: what they still bring
    has its room.
    """

    def __init__(
        self, store: Obstacles, categorise: Categorise | None, region: Region | None
    ) -> None:
        self._store = store
        self._categorise = categorise
        self._region = region
        self.under_way: WeakSet[Sliced] = WeakSet()  # forgetting one ends it

    def of(self, store: Obstacles) -> 'Updates':
        """The same for other obstacles."""
        return Updates(store, self._categorise, self._region)

    def update(
        self,
        source: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: ArrayLike | None = None,
        expires: ArrayLike = 0,
        categories: ArrayLike | None = None,
        velocities: ArrayLike | Follow | None = None,
    ) -> Refusals:
        """Add or modify obstacles. One that `replace` brought in a group leaves that group.

        Parameters
        ----------
        source : str
            The owner: no other source can change these obstacles.
        names : sequence of n str, Numbered or Families
            Of several good rows with one name the last holds.
        shapes : Shapes
            n rows.
        stamp : one time, or array_like of shape (n,), optional
            Time of the data: an int in ns, or a float in s. A scene without velocities needs none:
            None is 0.
        expires : one time, or array_like of shape (n,)
            When they vanish on the caller's clock, see `expire`; 0 is never.
        categories : int or (n,) array, optional
            32-bit masks; a query sees an obstacle if its own mask has a bit in common. None: known
            obstacles keep theirs, new ones get what the scene's `categorise` says.
        velocities : (n, 3) array or Tracks, optional
            m/s, from the stamp on: what queries with `at` count on. Only places move, nothing
            turns. A row whose velocity is not finite is refused. `tracking.Tracks` tells them from
            the updates before. None: the rows' obstacles are at rest.

        Returns
        -------
        sequence of Refusal
            The rows that are not taken over, in order, and why. Their obstacles stay as they were.

        Raises
        ------
        ValueError
            If arrays do not fit together; nothing is changed then.
        OverflowError
            If the node handles of this run are used up; nothing is changed then.
        """
        time = stamp_of(stamp, velocities, shapes)
        return self.apply(source, '', Part(names, shapes, time, expires, categories, velocities))

    def replace(
        self,
        source: str,
        group: str,
        names: Names,
        shapes: Shapes,
        *,
        stamp: ArrayLike | None = None,
        expires: ArrayLike = 0,
        categories: ArrayLike | None = None,
        velocities: ArrayLike | Follow | None = None,
    ) -> Refusals:
        """`update`, and remove the obstacles of this group that are not named. The group '' is all
        that the source owns.

        A refused row counts as named: its obstacle stays.
        """
        time = stamp_of(stamp, velocities, shapes)
        part = Part(names, shapes, time, expires, categories, velocities)
        return self.apply(source, group, part, whole=True)

    def apply(
        self,
        source: str,
        group: str,
        part: Part,
        *,
        whole: bool = False,
        sliced: Sliced | None = None,
    ) -> Refusals:
        """Apply rows; all that the message has if `whole`, a part of what is `sliced`."""
        store = self._store
        text('source', source), text('group', group)
        rows, reach = self._checked(source, part), None
        names, slots, valid, speeds = rows.names, rows.slots, rows.valid, rows.speeds
        if part.velocities is not None:
            if speeds is None:
                follow: Any = part.velocities
                speeds = _followed(store, follow, valid.known, len(slots))
            reach = reach_of(store, part.velocities, speeds)
        added, known, outside = within(self._region, valid, reach)
        present = slots[slots != UNKNOWN] if whole or sliced else slots
        stale = store.members(source, group, present) if whole else NONE
        if len(outside) and not sliced:
            stale = np.append(stale, outside)
        if len(added.row):
            self.require_memory(len(added.row))
            room = self._room(len(added.row), sliced) + len(stale)
            added = self._fitting(added, room, valid, names)
        whole = whole or (sliced is not None and sliced.replaced is not None)
        newest = max(sliced.newest if sliced else store.newest, _latest(part, valid, whole))
        with store.change:
            if len(stale):
                store.drop(stale)
            if sliced:
                self._note_named(sliced, present, outside)
                sliced.shadows.append(store.leave_shadows(known))
            store.move(known, source, group)
            store.set_velocities(known.slot, known, speeds)
            if len(added.row):
                new = store.insert(added, names.take(added.row), source, group)
                store.set_velocities(new, added, speeds)
            (sliced or store).newest = newest
        return valid.reasons.refusals(names.text)

    def _checked(self, source: str, part: Part) -> Checked:
        """What is known of the rows, and which of them can be applied."""
        store = self._store
        store.change.require_none()
        self.remove_orphans()
        shapes = as_shapes(part.shapes, store.planar)
        if len(shapes.kind) > FEW_ROWS:
            self.require_memory(len(shapes.kind))
        names = name_each(part.names, len(shapes.kind))
        slots = store.registry.find(names)
        groups = store.groups
        # As Owner(...), which would take one more call of a function of Python's.
        parts = groups.source(source), store.columns.source, groups.source_name
        owner = tuple.__new__(Owner, parts)
        speeds = given_speeds(part.velocities, len(slots), store.planar)
        valid = validate_rows(names, shapes, slots, owner, part[2:5], speeds, store.planar)
        if speeds is not None:
            speeds = np.ascontiguousarray(speeds[:, : store.tree.ndim])
        return Checked(names, slots, valid, speeds)

    def _fitting(self, added: Rows, room: int, valid: Validated, names: Families) -> Rows:
        """New obstacles that there is room for; where the message brings no masks, with those that
        the scene gives. The others are refused.
        """
        if room < len(added.row):
            full = f'the scene is full (max_obstacles is {self._store.most})'
            valid.reasons.add(added.row[room:], full)
            added = added.take(slice(room))
        if added.categories is None and self._categorise is not None:
            added = added._replace(categories=self._categorise(names.take(added.row)))
        self._store.require_handles(len(added.row))
        return added

    def rest(self) -> None:
        """Let all obstacles stand at their reported positions: their stamps say nothing any more,
        as the clock was set.
        """
        store = self._store
        store.change.require_none()
        handles = store.tree.ids() if store.moves else NONE
        if len(handles):
            still = np.zeros((len(handles), store.tree.ndim))
            store.tree.set_velocities(handles, still, store.tree.velocities(handles)[1])
            store.moves = False  # so the next velocity begins the tree's time anew

    def require_memory(self, rows: int) -> None:
        """Raise MemoryError now, and not when half of the rows are applied."""
        columns = self._store.columns
        capacity, used = len(columns.tree_handle), len(self._store.registry) + columns.shadows
        grown = 2 * capacity if used + rows > capacity else 0
        np.empty(rows * BYTES_A_ROW + grown * BYTES_A_SLOT, UINT8)  # reserved, not used

    def leaving(self, running: Sliced) -> Slots:
        """What goes when the update ends, as far as it is known."""
        goes = np.zeros(len(self._store.columns.tree_handle), np.bool_)
        if running.replaced is not None:
            goes[self._store.still_there(running.replaced)] = True
        for handles, leave in running.named:
            goes[self._store.still_there(handles)] = leave
        return np.flatnonzero(goes)

    def _room(self, wanted: int, own: Sliced | None) -> int:
        """How many obstacles may come, once what is under way has ended; that `wanted` may is
        known without looking at all that is there.
        """
        room = self._store.most - len(self._store)
        if room >= wanted and not self.under_way:
            return wanted
        replacing = [one for one in self.under_way if one.replaced is not None]
        room -= sum(max(one.left, 0) for one in replacing if not (one is own and one.surveyed))
        if room + sum(map(self._surely_leaving, replacing)) >= wanted:
            return wanted
        return max(room + sum(len(self.leaving(one)) for one in replacing), 0)

    def room_beside(self, running: Sliced) -> int:
        """How many obstacles may come besides those of other updates, if none leave."""
        others = [one for one in self.under_way if one.replaced is not None and one is not running]
        room = self._store.most - len(self._store)
        return max(room + sum(len(self.leaving(one)) - max(one.left, 0) for one in others), 0)

    def _note_named(self, sliced: Sliced, present: Slots, outside: Slots) -> None:
        if sliced.surveyed and self._region is None:
            return
        handles = self._store.columns.tree_handle
        sliced.named += [(handles[present], False), (handles[outside], True)]
        sliced.stays += len(present)

    def _surely_leaving(self, running: Sliced) -> int:
        """At least so many go."""
        if running.group:  # members of other groups may have joined it
            return 0
        store = self._store
        come = store.next_node_handle - running.begun  # of whatever source
        return max(store.groups.members(running.source, '') - come - running.stays, 0)

    def remove_orphans(self) -> None:
        """Remove the shadows of updates in slices that were interrupted at their very end."""
        if self._store.columns.shadows and not self.under_way:
            self._store.remove(np.flatnonzero(self._store.columns.shadow))


def _latest(part: Part, valid: Validated, whole: bool) -> int:
    """The latest stamp of the rows that are applied, ns; of the message if that is `whole`."""
    stamp: Any = part.stamp
    if not whole and not len(valid.known.row) + len(valid.added.row):
        return FIRST_TIME
    if type(stamp) is int:
        return stamp
    if whole:
        stamps = np.asarray(stamp)  # of any integers
        return int(stamps.max()) if stamps.size else FIRST_TIME
    return max(int(some.stamp.max()) for some in valid[:2] if len(some.stamp))


# ---- Taking obstacles away: those of some names, those whose time is over, or all.

AT_A_TIME = 8192  # obstacles, about 10 ms


class Removals:
    """How obstacles leave a scene."""

    def __init__(self, store: Obstacles) -> None:
        self._store = store
        self.expired = 0
        """How many obstacles `expire` has removed so far."""

    def remove(self, source: str, names: Names) -> int:
        """Remove obstacles of this source by name; return how many there were.

        Names it does not own are left alone.
        """
        return self.discard(self.find(source, names))

    def remove_group(self, source: str, group: str) -> int:
        """Remove the obstacles of a group ('': all that the source owns).

        Return how many there were.
        """
        text('source', source), text('group', group)
        return self._store.remove(self._store.members(source, group))

    def remove_namespace(self, source: str, namespace: str | None = None) -> int:
        """Remove the source's obstacles named `namespace`/x, where x has no slash; None: all.

        Return how many there were.
        """
        if namespace is None:
            return self.remove_group(source, '')
        text('namespace', namespace)
        return self.discard(self.find(source, [], {namespace}))

    def find(self, source: str, names: Names, namespaces: Collection[str] = ()) -> Slots:
        """Obstacles of a source with one of these names or namespaces; for `discard`."""
        text('source', source)
        slots = self._store.registry.find(as_families(names))
        slots = slots[slots != UNKNOWN]
        if inside := checks.strings('namespaces', namespaces):
            slots = np.concatenate((slots, self._store.registry.in_namespaces(inside)))
        if len(slots) > 1:
            slots = np.unique(slots)
        return self._store.columns.tree_handle[
            slots[self._store.columns.source[slots] == self._store.groups.source(source)]
        ]

    def discard(self, found: Slots) -> int:
        """Remove those that `find` found, as far as they are still there; return how many."""
        once = np.unique(found) if len(found) > 1 else found
        return self._store.remove(self._store.still_there(once))

    def discard_in_slices(self, found: Slots, besides: Names) -> Iterator[None]:
        """`discard`, with pauses, obstacles with none of the names `besides`."""
        if not len(found):
            return
        slots = self._store.registry.find(as_families(besides))
        in_use = self._store.columns.tree_handle[slots[slots != UNKNOWN]]
        found = found[~np.isin(found, in_use)]
        if len(found) <= AT_A_TIME:
            self.discard(found)
            return
        for begin in range(0, len(found), AT_A_TIME):
            self.discard(found[begin : begin + AT_A_TIME])
            yield

    def expire(self, now: int, most: int | None = None) -> int:
        """Remove the obstacles with 0 < expires <= now; return how many there were.

        Costs nothing while none can be due. `most` is how many are removed one by one; where more
        are due, the others are still there, see `has_expired`.
        """
        most = checks.whole_or_none('most', most, 0)
        now = whole_time('now', now)
        if now < self._store.next_expiry:
            return 0
        expires = self._store.columns.expires
        due = np.flatnonzero((expires > 0) & (expires <= now))
        removed = self._store.remove(due if len(due) == len(self._store.tree) else due[:most])
        self.expired += removed
        self._store.note_next_expiry()
        return removed

    def has_expired(self, now: int) -> bool:
        """Whether the time of some obstacle is over that is still there."""
        return whole_time('now', now) >= self._store.next_expiry

    def shift_expiries(self, by: int) -> None:
        """The caller's clock jumped by so many ns: what an obstacle has left to live stays."""
        by = whole_time('by', by)
        expires = self._store.columns.expires
        mortal = expires > 0
        # Never 0, which is for ever, nor later than an int64 can say.
        times = np.minimum(expires[mortal], min(NEVER - by, NEVER)) + by
        with self._store.change:
            expires[mortal] = np.maximum(times, 1)
            self._store.note_next_expiry()
