# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene holds: for each obstacle a box in the tree, a name and a row of columns."""

import functools
from collections import Counter
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import Future, ThreadPoolExecutor, wait
from functools import cache
from typing import TYPE_CHECKING, Any, Generic, NamedTuple, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from ..tree.access import LARGEST, SLOT_MASK, OpenTree, checks, copy_bytes, touch
from ..tree.compiler import entry_point, lean_kernel
from .names import NO_OWNER, UNKNOWN, Families, Groups, Registry, Slots
from .results import LAST_NODE_HANDLE, SceneHit
from .rows import Rows
from .shapes.footprint import FOOTPRINT, footprints
from .shapes.hull import NO_HULLS, AnyHulls, Hulls, MeshStore, of_one_type
from .shapes.shape import GEOMETRY, MESH, UNTURNED, Floats, by_mesh, shapes_of

# ---- Long work in another thread, while others have their turn.

P = ParamSpec('P')
R = TypeVar('R')
PATIENCE = 0.002  # seconds between two looks whether the other thread is done
WAITS = True  # is yielded where a further step would wait for the other thread only


def run_in_thread(
    call: Callable[P, R], *arguments: P.args, **named: P.kwargs
) -> Generator[Any, None, R]:
    """Return what a call returns that changes nothing others see; yield WAITS until it does, at
    least once.
    """
    work = _helper().submit(call, *arguments, **named)
    try:
        return (yield from until_done(work))
    finally:
        if not work.cancel():
            wait((work,))


def until_done(work: Future[R]) -> Generator[Any, None, R]:
    """Return the result of what another thread does; yield WAITS until it is there, at least
    once.
    """
    done = False
    while not done:
        wait((work,), PATIENCE)
        done = work.done()
        yield WAITS
    return work.result()


@cache
def _helper() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, 'beside')


# ---- Room that questions write to, and that is kept for the next ones.

Room = TypeVar('Room')


class ScratchPool(Generic[Room]):
    """A pool of scratch buffers. A query takes one, and gives it back when its results are read;
    after an error it is lost. A buffer for each thread would not do: a signal handler, or the
    garbage collector, may query in the middle of another query of its thread.
    """

    def __init__(self, make: Callable[[], Room]) -> None:
        self._make = make
        self._free: list[Room] = []
        self.give = self._free.append

    def take(self) -> Room:
        """A buffer that no other query uses."""
        try:
            return self._free.pop()  # one step: no other thread gets the same
        except IndexError:
            return self._make()


# ---- A change of a scene that is under way, or was interrupted.

UNFINISHED = (
    'a change of the scene was interrupted (or is under way): what it holds is not known before '
    'it is cleared'
)


class Change:
    """Around whatever is written to tree, columns, names and groups: they agree only at its end.

    An interruption in between (Ctrl-C, MemoryError) leaves it `unfinished`. A query meanwhile,
    from a signal handler or another thread, finds it so.
    """

    def __init__(self) -> None:
        self.unfinished = False

    def require_none(self) -> None:
        """RuntimeError if a change was interrupted, or is under way."""
        if self.unfinished:
            raise RuntimeError(UNFINISHED)

    def __enter__(self) -> None:
        self.require_none()
        self.unfinished = True

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self.unfinished = kind is not None


# ---- What the scene knows of each obstacle, as arrays indexed by the slot of its box in the
# tree.

if TYPE_CHECKING:
    from .rows import Rows

FREE = -1
NEVER = np.iinfo(np.int64).max


class Kept(NamedTuple):
    """The columns that every update writes, for `write_rows`."""

    geometry: Any
    stamp: Any
    expires: Any
    source: Any
    group: Any


class Bodies(NamedTuple):
    """What the narrow phase reads."""

    shapes: Any
    """Records by slot."""
    footprints: Any
    """The same seen from above; None where the scene is not planar."""
    hulls: Hulls | None
    """Meshes of the scene; None where neither it nor the query has any."""
    query_hulls: Hulls | None


@lean_kernel
def write_rows(arrays, slots, records, stamp, expires, owner):
    """Write rows of an update to their slots; owner = (source, group). Returns how many obstacles
    were in another group before, or in none; when the first of them expires, ns; how many more
    need a narrow phase, and whether one of them does, or did.
    """
    source, group = owner
    joined, shaped, concerned, soonest = 0, 0, False, np.int64(NEVER)
    for i in range(slots.shape[0]):
        slot = slots[i]
        joined += arrays.group[slot] != group
        before, now = arrays.geometry[slot].shaped, records[i].shaped
        shaped += now - before
        concerned = concerned or before or now
        arrays.geometry[slot] = records[i]
        arrays.stamp[slot], arrays.expires[slot] = stamp[i], expires[i]
        arrays.source[slot], arrays.group[slot] = source, group
        if expires[i] > 0:
            soonest = min(soonest, expires[i])
    return joined, soonest, shaped, concerned


@functools.cache
def _write_rows() -> Callable[..., Any]:
    """The machine code of `write_rows`."""
    records, numbers = np.empty(0, GEOMETRY), np.empty(0, np.int64)
    arrays = Kept(records, *[numbers] * 4)
    return entry_point(write_rows, arrays, numbers, records, numbers, numbers, (0, 0))


class Columns:
    """Growable arrays, one row a slot; a slot is in use where `tree_handle` is not FREE."""

    # What kernels get, at hand for each of them: to gather it takes a tenth of a call of a row.
    hulls: Hulls | None
    """The meshes; None without any: what is None is not compiled."""
    shapes: tuple[Any, Any]
    """(records, hulls), and (footprints, hulls), one of which is None: see `cast.arguments`."""
    bodies: Bodies
    rows_of_hit: int
    """Point and normal of a hit; in a scene of meshes in space the triangle, too."""

    def __init__(self, planar: bool, meshes: bool = False, any_mesh: bool = False) -> None:
        self.tree_handle = np.empty(0, np.int64)
        self.node_handle = np.empty(0, np.int64)
        self.geometry = np.empty(0, GEOMETRY)
        self.footprint = np.empty(0, FOOTPRINT) if planar else None
        self.categories = np.empty(0, np.uint32)
        self.stamp = np.empty(0, np.int64)
        self.expires = np.empty(0, np.int64)
        self.source = np.empty(0, np.int64)
        self.group = np.empty(0, np.int64)
        self.shadow = np.empty(0, np.bool_)  # where an obstacle was, see slicing.py
        self.shadows = 0  # how many there are
        self.shaped = 0  # how many rows need a narrow phase
        self.meshes = MeshStore()
        self._expects_meshes, self._expects_any = meshes, any_mesh
        # Pairs of true shapes that overlap queries compared, and those that GJK left open.
        self.pairs_compared = self.pairs_in_more_digits = 0
        self._gather()

    def _gather(self) -> None:
        """Have at hand what kernels get, after an array or a mesh was replaced."""
        solid, flat = self.geometry, self.footprint
        hulls = self.meshes.hulls if self._expects_meshes or self.meshes.by_number else None
        if hulls is not None and self._expects_any:
            hulls = AnyHulls(*hulls)
        self.hulls = hulls
        self.shapes = ((solid, hulls), None) if flat is None else (None, (flat, hulls))
        self.rows_of_hit = 3 if flat is None and hulls is not None else 2
        self.bodies = Bodies(solid, flat, hulls, hulls and of_one_type(hulls, NO_HULLS)[1])

    def clear(self) -> None:
        """Forget all obstacles."""
        counts = self.pairs_compared, self.pairs_in_more_digits
        expected = self._expects_meshes, self._expects_any
        self.__init__(self.footprint is not None, *expected)  # type: ignore[misc]
        self.pairs_compared, self.pairs_in_more_digits = counts

    def room_for(self, count: int) -> dict[str, NDArray[Any]]:
        """Larger arrays for `grow`, empty if there is no need. Fresh memory takes longer to get
        than to fill, so another thread may ask for it.
        """
        room = self._larger(count)
        for name, array in room.items():
            if name != 'footprint' or self.shaped:  # else it is in no memory yet
                touch(array)
        return room

    def grow(self, count: int, room: dict[str, NDArray[Any]] | None = None) -> None:
        """Make room for the slots below `count`."""
        old = len(self.tree_handle)
        if count <= old:
            return
        for name, bigger in (room or self._larger(count)).items():
            if name != 'footprint' or self.shaped:
                copy_bytes(getattr(self, name), bigger)
            setattr(self, name, bigger)
        self._gather()

    def _larger(self, count: int) -> dict[str, NDArray[Any]]:
        """Arrays for the slots below `count`, at least twice as long; none if these will do."""
        old = len(self.tree_handle)
        if count <= old:
            return {}
        arrays = {n: array for n, array in vars(self).items() if isinstance(array, np.ndarray)}
        larger = {name: np.zeros(max(count, 2 * old), arrays[name].dtype) for name in arrays}
        larger['tree_handle'].fill(FREE)
        larger['geometry'][:] = UNTURNED
        return larger

    def different(self, slots: Slots) -> Slots:
        """Rows of the first place of each obstacle, ascending: one may stand at two, see
        slicing.py.
        """
        if not self.shadows:
            return np.arange(len(slots))
        return np.sort(np.unique(self.node_handle[slots], return_index=True)[1])

    def shadows_of(self, slots: Slots) -> Slots:
        """Where else the obstacles of some slots stand, see slicing.py."""
        shadows = np.flatnonzero(self.shadow)
        return shadows[np.isin(self.node_handle[shadows], self.node_handle[slots])]

    def copy(self, slots: Slots, copies: Slots) -> None:
        """Write to some slots what others hold."""
        for array in vars(self).values():
            if isinstance(array, np.ndarray):
                array[copies] = array[slots]
        self.shaped += int(np.count_nonzero(self.geometry['shaped'][copies]))
        for number, times in self._uses_of_meshes(copies):
            self.meshes.take(self.meshes[number], times)

    def write(self, slots: Slots, rows: 'Rows', owner: tuple[int, int]) -> tuple[int, int]:
        """Write rows of an update; `owner` is (source, group). Returns how many obstacles were in
        another group before, or in none, and when the first of them expires, ns.
        """
        if rows.mesh is not None:
            self._take_meshes(rows)
        if len(self.meshes):
            self._release_meshes(slots)  # afterwards: what only moves is never forgotten
            self._gather()
        # As Kept(...), which would take one more call of a function of Python's.
        columns = self.geometry, self.stamp, self.expires, self.source, self.group
        arrays, fields = tuple.__new__(Kept, columns), (rows.records, rows.stamp, rows.expires)
        joined, soonest, shaped, concerned = _write_rows()(arrays, slots, *fields, owner)
        self.shaped += shaped
        if self.footprint is not None and concerned:
            self.footprint[slots] = footprints(shapes_of(rows.records), rows.records['shaped'])
            if rows.mesh is not None:
                seen = rows.records['kind'] == MESH
                self.footprint['polygon'][slots[seen]] = rows.records['mesh'][seen] + 1
        return joined, soonest

    def _take_meshes(self, rows: 'Rows') -> None:
        """Use the meshes of rows, whose records get the numbers."""
        which = np.flatnonzero(rows.records['kind'] == MESH)
        for mesh, some in by_mesh(np.asarray(rows.mesh), which):
            rows.records['mesh'][some] = self.meshes.take(mesh, len(some))

    def _uses_of_meshes(self, slots: Slots) -> Iterator[tuple[int, int]]:
        """The numbers of the meshes in some slots, and how many of these have each."""
        if not len(self.meshes):
            return
        slots = slots[self.geometry['kind'][slots] == MESH]
        yield from Counter(self.geometry['mesh'][slots].tolist()).items()

    def _release_meshes(self, slots: Slots) -> None:
        for number, times in self._uses_of_meshes(slots):
            self.meshes.release(number, times)

    def used(self) -> Slots:
        """Slots in use, in order of the node handles, that is of first appearance."""
        slots = np.flatnonzero(self.tree_handle != FREE)
        return slots[np.argsort(self.node_handle[slots], kind='stable')]

    def forget(self, slots: Slots) -> None:
        """Mark slots as free. What scans whole columns must not find them."""
        self.tree_handle[slots] = FREE
        self.node_handle[slots] = 0
        if len(self.meshes):
            self._release_meshes(slots)
            self._gather()
        if self.footprint is not None:
            self.footprint['shaped'][slots[self.geometry['shaped'][slots]]] = False
        self.shaped -= int(np.count_nonzero(self.geometry['shaped'][slots]))
        self.geometry[slots] = UNTURNED
        self.expires[slots] = 0
        self.categories[slots] = 0
        self.group[slots] = 0
        self.source[slots] = 0
        self.shadows -= int(np.count_nonzero(self.shadow[slots]))
        self.shadow[slots] = False

    @property
    def nbytes(self) -> int:
        """Memory of the arrays."""
        return sum(a.nbytes for a in vars(self).values() if isinstance(a, np.ndarray))


# ---- The obstacles of a scene: for each a box in the tree, a name and a row of columns, at one
# slot.

EXACT = 1 << 53  # ns, 104 days: each of them is a double
KNOWN = 1 << 51  # ns, 26 days: of each of them a double of seconds tells which one it is
FEW = 32  # times for which numpy takes longer than Python
MANY = 10_000  # boxes: where fresh memory takes longer than a turn


def in_seconds(nanoseconds: int) -> float:
    """A length of time, rounded once where it is below EXACT."""
    if -EXACT < nanoseconds < EXACT:
        return nanoseconds / 1e9
    return float(np.longdouble(nanoseconds) / 10**9)


def all_in_seconds(nanoseconds: NDArray[np.longdouble]) -> Floats:
    """The same of many."""
    near = nanoseconds.astype(np.float64) / 1e9
    far = (nanoseconds / 10**9).astype(np.float64)
    return np.where(np.abs(nanoseconds) < EXACT, near, far)


class Obstacles:
    """What the parts of a scene share."""

    def __init__(
        self, planar: bool, margin: float, meshes: bool, most: int, any_mesh: bool = False
    ) -> None:
        self.planar = planar
        self.most = checks.whole('max_obstacles', most, 1)
        self.tree = OpenTree(ndim=2 if planar else 3, margin=margin)
        self.columns = Columns(planar, meshes, any_mesh)
        self.change = Change()
        self.registry = Registry()
        self.groups = Groups()
        self.newest = 0
        """Stamp of the newest update included, ns; 0 if there is none."""
        self.moves = False
        """Whether any obstacle has got a velocity since none had one."""
        self.epoch = 0
        """Time 0 of the tree, ns."""
        self.max_prediction = np.inf
        """s: an obstacle moves on for no longer than that after its last update."""
        self.uncertainty = 0.0
        """m/s by which moving obstacles grow all round, since their last update."""
        self.movers: Any = None
        """`Movers`, once a query needs them."""
        self.next_node_handle = 1
        self.next_expiry = NEVER
        """Nothing expires earlier, ns."""

    def __len__(self) -> int:
        return len(self.registry)

    def hit(
        self, slot: int, t: float, point: Floats, normal: Floats, triangle: Floats | None = None
    ) -> SceneHit:
        """What a query tells of an obstacle; `triangle`: row, u and v."""
        columns = self.columns
        handle, stamp = columns.node_handle.item(slot), columns.stamp.item(slot)
        fields = self.registry.name(slot), handle, t, point, normal, stamp
        hit = tuple.__new__(SceneHit, fields)  # half the time of SceneHit(...)
        if triangle is not None:
            hit._triangle = triangle
        return hit

    def hits(self, found: Any, rows: list[int]) -> list[SceneHit]:
        """What a query tells of rows of a `query.Found`."""
        return [
            self.hit(
                found.slots.item(row),
                found.distances.item(row),
                found.points[row].copy(),
                found.normals[row].copy(),
            )
            for row in rows
        ]

    def each_once(self, hits: list[SceneHit]) -> list[SceneHit]:
        """Of hits of one obstacle at two places, see slicing.py, the first."""
        if not self.columns.shadows:
            return hits
        first: dict[int, SceneHit] = {}
        for hit in hits:
            first.setdefault(hit.handle, hit)
        return list(first.values())

    def slot(self, name: object) -> int:
        """Slot of a name. KeyError if there is none."""
        slot = self.registry.slot(name) if isinstance(name, str) else UNKNOWN
        if slot == UNKNOWN:
            raise KeyError(
                name if isinstance(name, str) else f'a name is a str, not {type(name).__name__}'
            )
        return slot

    def members(self, source: str, group: str, besides: Slots | None = None) -> Slots:
        """Members of a group ('': all of the source), besides some."""
        columns = self.columns
        number = self.groups.number(source, group) if group else self.groups.source(source)
        if number == NO_OWNER:
            return np.empty(0, np.int64)
        member = (columns.group if group else columns.source) == number
        if besides is not None:
            member[besides] = False
        return np.flatnonzero(member)

    def require_handles(self, count: int) -> None:
        """OverflowError if there are no numbers for so many more."""
        if self.next_node_handle + count - 1 > LAST_NODE_HANDLE:
            raise OverflowError(
                f'the {LAST_NODE_HANDLE} node handles of this run are used up; restart the node'
            )

    def make_room(self, more: int) -> Iterator[None]:
        """Make room for so many more boxes, with pauses if they are many."""
        if more < MANY:
            return
        count = min(len(self.tree) + more, 2 * self.most)
        self.tree.move_into((yield from run_in_thread(self.tree.room_for, count)))
        yield
        columns = yield from run_in_thread(self.columns.room_for, count)
        with self.change:
            self.columns.grow(count, columns)
        yield
        names = yield from run_in_thread(self.registry.room_for, count)
        with self.change:
            self.registry.grow(count, names)
        yield

    def move(self, rows: Rows, source: str, group: str) -> None:
        """Give obstacles that exist their new shape and pose."""
        slots, columns = rows.slot, self.columns
        if not len(slots):
            return
        self.tree.move_sound(slots, rows.lo, rows.hi)
        masks = rows.categories
        if masks is not None and (columns.categories[slots] != masks).any():
            self.tree.set_masks(columns.tree_handle[slots], masks)
            columns.categories[slots] = masks
        before = columns.group[slots]
        joined = self._write(rows, slots, source, group)
        if joined:
            self.groups.join(source, group, joined)
            self.groups.leave(before[before != columns.group[slots]])

    def set_velocities(self, slots: Slots, rows: Rows, speeds: Floats | None) -> None:
        """Velocities of rows of an update that stand at these slots now, from their stamps on;
        where there are none, all of them are at rest.
        """
        if not len(slots) or (speeds is None and not self.moves):
            return
        if speeds is None:
            now = np.zeros((len(slots), self.tree.ndim))
        else:
            now = speeds[rows.row]
            if not self.moves:
                self.epoch = rows.stamp.item(0)
                self.moves = bool(now.any())
                if self.moves:
                    self.tree.count_nanoseconds(self.max_prediction)
        if self.moves:
            self._follow_time(rows.stamp)
            since = self.seconds(rows.stamp)
            self.tree.set_velocities(self.columns.tree_handle[slots], now, since)

    def _follow_time(self, stamps: NDArray[np.int64]) -> None:
        """Bring the tree's time 0 along where stamps have left it so far behind that they would
        lose nanoseconds: a run of months, or one that began before its clock was set.
        """
        latest = stamps.item(0) if len(stamps) == 1 else int(stamps.max())
        if latest - self.epoch < KNOWN:
            return
        self.epoch, handles = latest, self.tree.ids()
        times = self.seconds(self.columns.stamp[handles & SLOT_MASK])
        self.tree.set_velocities(handles, self.tree.velocities(handles)[0], times)

    def second(self, stamp: int) -> float:
        """One of `seconds`."""
        return in_seconds(stamp - self.epoch)

    def seconds(self, stamps: NDArray[np.int64]) -> Floats:
        """Times in ns as the tree has them: seconds since the first velocity came, or 26 days
        ago at most, so that it knows which whole nanosecond is meant.
        """
        if len(stamps) <= FEW:
            return np.array([in_seconds(stamp - self.epoch) for stamp in stamps.tolist()])
        return all_in_seconds(stamps.astype(np.longdouble) - np.longdouble(self.epoch))

    def leave_shadows(self, rows: Rows) -> Slots:
        """Copies of the obstacles that are about to move, of the same names and handles, that stay
        where they are, see slicing.py; return their handles in the tree.
        """
        columns = self.columns
        if not len(rows.slot):
            return rows.slot
        lo, hi = self.tree.boxes(columns.tree_handle[rows.slot])
        stays = (lo == rows.lo).all(axis=1) & (hi == rows.hi).all(axis=1)
        moves = ~stays | rows.records['shaped'] | columns.geometry['shaped'][rows.slot]
        slots = rows.slot[moves]
        handles = self.tree.insert_many(lo[moves], hi[moves], columns.categories[slots])
        if self.moves:
            before = self.tree.velocities(columns.tree_handle[slots])
            self.tree.set_velocities(handles, *before)
        copies = self.tree.slots(handles)
        columns.grow(int(copies.max(initial=-1)) + 1)
        columns.copy(slots, copies)
        columns.tree_handle[copies] = handles
        columns.shadow[copies] = True
        columns.shadows += len(copies)
        self.registry.copy(slots, copies)
        return handles

    def still_there(self, handles: NDArray[np.int64]) -> Slots:
        """Slots of those of some handles of the tree that are still there."""
        known = self.columns.tree_handle
        handles = handles[handles & SLOT_MASK < len(known)]
        slots = handles & SLOT_MASK
        return slots[known[slots] == handles]

    def insert(self, rows: Rows, names: Families, source: str, group: str) -> Slots:
        """Add obstacles; node handles ascend with the tree's, so that both order ties alike."""
        masks, columns = rows.categories, self.columns
        handles = self.tree.insert_many(rows.lo, rows.hi, masks)
        slots: Slots = handles & SLOT_MASK
        columns.grow(int(slots.max()) + 1)
        columns.tree_handle[slots] = handles
        columns.categories[slots] = 1 if masks is None else masks
        first = self.next_node_handle
        self.next_node_handle += len(slots)
        columns.node_handle[slots] = np.arange(first, self.next_node_handle)
        self.registry.add(names, slots)
        self.groups.join(source, group, self._write(rows, slots, source, group))
        return slots

    def _write(self, rows: Rows, slots: Slots, source: str, group: str) -> int:
        """Write rows of columns; return how many obstacles came from other groups, or none."""
        joined, soonest = self.columns.write(slots, rows, self.groups.open(source, group))
        if soonest < self.next_expiry:
            self.next_expiry = int(soonest)
        return joined

    def remove(self, slots: Slots) -> int:
        """Forget obstacles as one change; return how many there were."""
        if not len(slots):
            return 0
        with self.change:
            return self.drop(slots)

    def drop(self, slots: Slots) -> int:
        """Forget obstacles, within a change, and where else they stand, see slicing.py; return how
        many there were.
        """
        removed = slots[~self.columns.shadow[slots]]
        if self.columns.shadows and len(removed):
            slots = np.union1d(slots, self.columns.shadows_of(removed))
        if len(slots) == len(self.tree) > 0:
            self._forget_all()
        elif len(slots):
            self.tree.remove_many(self.columns.tree_handle[slots])
            self.registry.discard(slots)
            self.groups.leave(self.columns.group[removed])
            self.columns.forget(slots)
        return len(removed)

    def clear(self) -> int:
        """Forget all obstacles, whatever became of a change before; return how many there were."""
        count = len(self)
        self.change.unfinished = True
        self._forget_all()
        self.newest = 0
        self.change.unfinished = False
        return count

    def _forget_all(self) -> None:
        self.moves = False  # so the next velocity begins the tree's time anew
        self.tree.clear()
        self.registry.clear()
        self.groups.clear()
        self.columns.clear()

    def note_next_expiry(self) -> None:
        """Look when the next obstacle expires."""
        mortal = self.columns.expires[self.columns.expires > 0]
        self.next_expiry = int(mortal.min()) if len(mortal) else NEVER


# ---- Where obstacles are at other times than that of their last update.
#
# They go on at their velocities for `max_prediction` seconds, and then stay where they are. This
# the tree computes. Predictions are uncertain: moving obstacles grow all round by `uncertainty`,
# m/s, while time goes by.

WIDER = 1.0 + 2.0**-40  # no computed distance is off by as much


class Movers(NamedTuple):
    """The first and the last update of moving obstacles, s, in one version of the tree."""

    version: int
    earliest: float
    latest: float


def movers(store: Obstacles) -> Movers:
    """The obstacles that move now."""
    version, known = store.tree.view().version, store.movers
    if known is not None and known.version == version:
        return known
    velocities, references = motions(store, np.flatnonzero(store.columns.tree_handle >= 0))
    times = references[velocities.any(axis=1)]
    first, last = (times.min(), times.max()) if len(times) else (np.inf, -np.inf)
    known = store.movers = Movers(version, float(first), float(last))
    return known


def motions(store: Obstacles, slots: Slots) -> tuple[Floats, Floats]:
    """Velocities (m, ndim) of obstacles, and the times (m,) in s from which they hold."""
    return store.tree.velocities(store.columns.tree_handle[slots])


def growths(store: Obstacles, slots: Slots, at: Floats, until: Floats) -> Floats:
    """By how much obstacles have grown from some times (m,) to others at most, m."""
    if not store.uncertainty:
        return np.zeros(len(slots))
    velocities, references = motions(store, slots)
    longest = np.maximum(np.abs(at - references), np.abs(until - references))
    grown = np.minimum(longest, LARGEST / max(store.uncertainty, 1.0)) * store.uncertainty
    return np.where(velocities.any(axis=1), grown, 0.0)


def most_growth(store: Obstacles, at: Floats, until: Floats) -> Floats | float:
    """What no growth exceeds in these spans of time (n,), m."""
    if not store.uncertainty:
        return 0.0
    known = movers(store)
    longest = np.maximum(until - known.earliest, known.latest - at)
    with np.errstate(over='ignore'):
        growth = store.uncertainty * np.maximum(longest, 0.0) * WIDER
    return np.minimum(growth, LARGEST)
