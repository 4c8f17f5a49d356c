# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a MarkerArray topic: a message as one change, what goes, and what comes."""

from __future__ import annotations

from collections.abc import Callable, Generator, Iterable, Iterator
from functools import partial
from typing import TYPE_CHECKING, Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import MarkerArray

from bvh_ros.ros.cdr import definitions, marker_array
from bvh_ros.ros.cdr.marker_array import Floats, Integers, MarkerTable
from bvh_ros.ros.compile_jobs import Job
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.placing import IntoNode, Placing, examined, numbered
from bvh_ros.ros.parameters import ConfigurationError
from bvh_ros.ros.sources.source import TOO_FAR_AHEAD, Applying, Source
from bvh_ros.ros.texts import shortened
from bvh_ros.scene import (
    AS_CONVEX,
    Block,
    Families,
    Mesh,
    Part,
    Refusals,
    ShapeKind,
    Shapes,
    unchecked_shapes,
)
from bvh_ros.scene.names import as_families
from bvh_ros.scene.shapes.shape import FINE, as_shapes, canonicalise

if TYPE_CHECKING:
    from bvh_ros.ros.sources.mesh_resources import MeshFile, MeshFiles


class MarkerArraySource(Source):
    """Keeps one obstacle for each marker, and one for each element of a list marker."""

    message_type = MarkerArray
    raw = True

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self._files: MeshFiles | None = None
        self._lists: dict[str, int] = {}  # list markers, and how many elements each has at most
        if other := definitions.difference(MarkerArray, marker_array.DEFINITION):
            raise ConfigurationError(
                f"source '{self.name}': {other} is defined here otherwise than in ROS 2 Jazzy"
            )
        self.together = self.follow is None

    def to_compile(self) -> Iterable[Job]:
        """Return the decoder."""
        decode = partial(marker_array.read, marker_array.EMPTY)
        return [Job('decode markers', 'decode markers', 2.0, decode, early=True)]

    def apply(self, message: Any, now: int) -> Applying:
        """Remove what the markers remove, then add and modify."""
        try:
            return (yield from self._apply(message, now))
        finally:
            if self._files is not None:
                self._files.loading = ''

    def _apply(self, message: Any, now: int) -> Applying:
        columns = marker_array.read(*message)
        wanted = yield from change(
            columns,
            now=now,
            into_node=self.frames.into_node,
            latest=self._latest(now),
            prefix=self.settings.prefix,
            planar=self.scene.planar,
            meshes=self.settings.options['meshes'],
            files=self._find_files,
        )
        self.is_whole, self.removed_at = wanted.clears, wanted.removed_at
        part = Part(wanted.names, wanted.shapes, wanted.stamp, wanted.expires)
        part = part._replace(velocities=self.follow)
        removed = self._with_elements(wanted.removed)
        leaving = self.scene.find(self.name, removed, wanted.namespaces)
        self._forget_lists(wanted)
        for name, size in wanted.lists.items():  # before: should anything go wrong on the way
            self._lists[name] = max(size, self._lists.get(name, 0))
        refused = yield from self._change(part, leaving, clears=wanted.clears)
        count, refusals = len(wanted.names), wanted.refusals
        refusals.extend(refused)
        yield from self._settle_lists(wanted)
        return len(columns.id) + count - len(wanted.singles), refusals

    def forget(self) -> None:
        """Start over."""
        super().forget()
        self._lists.clear()
        self._files = None  # what could not be read is tried again

    def _find_files(self) -> MeshFiles | None:
        if self._files is None and self.mesh_files is not None:
            self._files = self.mesh_files()
        return self._files

    def _loading(self) -> str:
        return '' if self._files is None else self._files.loading

    def _with_elements(self, names: Families) -> Families:
        """These names, and the elements of those that are lists."""
        lists = self._lists_among(names)
        return self._elements({name: (0, self._lists[name]) for name in lists}, names)

    def _forget_lists(self, change: Change) -> None:
        if change.clears:
            self._lists.clear()
        for name in self._lists_among(change.removed):
            del self._lists[name]
        if change.namespaces and self._lists:
            spaces = set(change.namespaces)
            for name in [n for n in self._lists if n.rpartition('/')[0] in spaces]:
                del self._lists[name]

    def _settle_lists(self, change: Change) -> Iterator[None]:
        """Remove what lists no longer have, and what changed between a list and a single one."""
        ended = self._lists_among(change.singles).difference(change.lists)
        # A refused update keeps the list.
        ended = {name for name in ended if len(self.scene.find(self.name, [name]))}
        left = {name: (0, self._lists.pop(name)) for name in ended}
        for name, size in change.lists.items():
            left[name] = size, self._lists[name]
            self._lists[name] = size
        if left:
            leaving = self._elements(left, as_families(list(change.lists)))
            yield from self.scene.discard_in_slices(
                self.scene.find(self.name, leaving), besides=[]
            )

    def _lists_among(self, names: Families) -> set[str]:
        return self._lists.keys() & names.texts() if self._lists else set()

    @staticmethod
    def _elements(lists: dict[str, tuple[int, int]], names: Families) -> Families:
        """Elements of lists from one number to another, after other names."""
        spans = {f'{name}#': range(begin, end) for name, (begin, end) in lists.items()}
        return numbered(spans, after=names)


# What a MarkerArray leaves standing, when its markers are read in order.
#
# A later marker undoes earlier ones: DELETE those of its name, DELETEALL those of its namespace or
# all. What is undone need not be done. So a message of any length and order comes down to this:
# remove some, then add some.

# visualization_msgs/msg/Marker
ADD_OR_MODIFY, DELETE, DELETE_ALL = 0, 2, 3
SINGLE_SHAPES = {1: ShapeKind.BOX, 2: ShapeKind.SPHERE, 3: ShapeKind.CYLINDER}
LISTED_SHAPES = {6: ShapeKind.BOX, 7: ShapeKind.SPHERE}
MESH_RESOURCE, TRIANGLES = 10, 11
TYPE_NAMES = (
    *('ARROW', 'CUBE', 'SPHERE', 'CYLINDER', 'LINE_STRIP', 'LINE_LIST', 'CUBE_LIST'),
    *('SPHERE_LIST', 'POINTS', 'TEXT_VIEW_FACING', 'MESH_RESOURCE', 'TRIANGLE_LIST'),
    'ARROW_STRIP',
)

SINGLE, LISTED, MESH, REMOVAL, SWEEP, NOTHING = range(6)  # what a marker asks for
NEVER = -1  # instead of a row

Mask = NDArray[np.bool_]


class Order(NamedTuple):
    """What n markers ask for, and what comes of it."""

    wish: Integers  # (n,) NOTHING where it cannot be understood
    alive: Mask  # (n,) adds an obstacle that no later marker removes
    key: Integers | None  # (n,) the same for equal names; None where no name matters
    clears: bool  # all of the source's obstacles go first
    swept: Integers  # namespaces, as the table numbers them, whose obstacles go first
    removed: Integers  # rows of the names that go first


def order_of(table: MarkerTable, refused: Mask) -> Order:
    """Read the actions of markers in order; refused ones ask for nothing."""
    wish = _wishes(table)
    wish[refused] = NOTHING
    adds = wish <= MESH
    if (wish == SINGLE).all():
        none = np.empty(0, np.int64)
        return Order(wish, adds, None, False, none, none)
    rows = np.arange(len(wish))
    sweep, removal = wish == SWEEP, wish == REMOVAL
    nameless = np.array([not namespace for namespace in table.namespaces], np.bool_)
    everything = np.flatnonzero(sweep & nameless[table.namespace])
    last_clear = int(everything[-1]) if len(everything) else NEVER
    last_sweep = _last(rows[sweep], table.namespace[sweep], len(table.namespaces))
    key = np.unique((table.namespace << 32) + table.id, return_inverse=True)[1].reshape(-1)
    last_removal = _last(rows[removal], key[removal], len(rows))
    before = np.maximum(last_sweep[table.namespace], last_clear)
    return Order(
        wish,
        adds & (rows > np.maximum(before, last_removal[key])),
        key,
        last_clear > NEVER,
        np.flatnonzero((last_sweep > last_clear) & ~nameless),
        rows[removal & (rows > before) & (rows == last_removal[key])],
    )


def last_of_lists(order: Order, good: Mask) -> Mask:
    """Of good rows, which to keep: of a name that is a list somewhere only the last.

    Of single markers of one name the scene takes the last good one; but a list that becomes
    shorter, or a single marker, must not leave elements of an earlier one behind.
    """
    listed = good & (order.wish == LISTED)
    if order.key is None or not listed.any():
        return good
    rows = np.arange(len(good))
    last = _last(rows[good], order.key[good], len(rows))
    in_lists = np.zeros(len(rows), np.bool_)
    in_lists[order.key[listed]] = True
    return good & (~in_lists[order.key] | (rows == last[order.key]))


def _last(rows: Integers, of: Integers, count: int) -> Integers:
    """The last of ascending rows for each of so many numbers, else NEVER."""
    last = np.full(count, NEVER)
    last[of] = rows  # of several, the last is written last
    return last


# What a marker that adds wants, by its type; the last is for types that there are not.
_ADDED = np.full(TRIANGLES + 2, NOTHING)
_ADDED[list(SINGLE_SHAPES)], _ADDED[list(LISTED_SHAPES)] = SINGLE, LISTED
_ADDED[[MESH_RESOURCE, TRIANGLES]] = MESH


def _wishes(table: MarkerTable) -> Integers:
    kind, action = table.type, table.action
    known = (kind >= 0) & (kind <= TRIANGLES)
    wish: Integers = _ADDED[np.where(known, kind, TRIANGLES + 1)]
    wish[(action != ADD_OR_MODIFY) | (table.lifetime < 0)] = NOTHING
    wish[action == DELETE] = REMOVAL
    wish[action == DELETE_ALL] = SWEEP
    return wish


def why_not(table: MarkerTable, row: int) -> str:
    """Say why a marker of this type and action cannot be used."""
    kind, action = int(table.type[row]), int(table.action[row])
    if action != ADD_OR_MODIFY:
        return f'unknown marker action {action}'
    if table.lifetime[row] < 0:
        return f'negative lifetime {table.lifetime[row] / 1e9:g} s'
    type_name = TYPE_NAMES[kind] if 0 <= kind < len(TYPE_NAMES) else 'unknown'
    return f'marker type {kind} ({type_name}) is not a box, sphere, cylinder, list or mesh'


# What markers are called in the scene: `ns/id`, and `ns/id#3` for an element of a list.


class MarkerNames(NamedTuple):
    """Names of the rows of a table."""

    table: MarkerTable
    prefix: str

    def of(self, row: int) -> str:
        """The name of one marker."""
        namespace = self.table.namespaces[self.table.namespace[row]]
        return f'{self.prefix}{namespace}/{self.table.id[row]}'

    def singles(self, rows: Integers) -> Families:
        """Two families a namespace: `ns/` and, for negative ids, `ns/-`."""
        table, number = self.table, self.table.id[rows]
        if not len(rows):
            return Families([], rows, number)
        used, place = np.array([0]), np.zeros(len(rows), np.int64)
        if len(table.namespaces) > 1:
            used, place = np.unique(table.namespace[rows], return_inverse=True)
        spaces = [f'{self.prefix}{table.namespaces[space]}/' for space in used.tolist()]
        prefixes = [spaces[i // 2] + '-' * (i % 2) for i in range(2 * len(spaces))]
        return Families(prefixes, 2 * place + (number < 0), np.abs(number))

    def with_elements(
        self, rows: Integers, counts: Integers, listed: Mask
    ) -> tuple[Families, Families, dict[str, int]]:
        """Names of all obstacles, of those that are no elements of lists, and list markers;
        `counts` is how many obstacles each row is.
        """
        single = self.singles(rows)
        if not listed.any():
            return single, single, {}
        lists = [self.of(row) for row in rows[listed].tolist()]
        prefixes = [*single.prefixes, *(f'{name}#' for name in lists)]
        family, numbers = single.family.copy(), np.repeat(single.numbers, counts)
        family[listed] = len(single.prefixes) + np.arange(len(lists))
        places = np.arange(len(numbers)) - np.repeat(np.cumsum(counts) - counts, counts)
        element = np.repeat(listed, counts)
        numbers[element] = places[element]
        sizes = dict(zip(lists, counts[listed].tolist(), strict=True))
        return (
            Families(prefixes, np.repeat(family, counts), numbers),
            single.take(np.flatnonzero(~listed)),
            sizes,
        )


# A MarkerArray as one change of the scene: what goes, and what comes.

# By marker type.
_KINDS = np.zeros(12, np.uint8)
for _kinds in (SINGLE_SHAPES, LISTED_SHAPES):
    _KINDS[list(_kinds)] = list(_kinds.values())
AT_A_TIME = 256  # lists between two pauses
ELEMENTS = 8192  # between two pauses


class Change(NamedTuple):
    """What a message asks for. What goes goes first."""

    clears: bool  # everything of the source goes
    namespaces: list[str]  # whose obstacles go
    removed: Families  # that leave, as a single obstacle or as a list
    names: Families  # (n,) that come or are modified: single ones, and elements of lists
    shapes: Shapes  # (n,)
    stamp: Integers  # (n,) ns
    expires: Integers  # (n,) ns on the node's clock, 0 = never
    lists: dict[str, int]  # list markers, and how many elements each has now
    singles: Families  # those among the names that are no elements
    refusals: Refusals  # the markers that cannot be used
    removed_at: int  # the latest stamp of those that remove, ns; 0 without any


def change(
    table: MarkerTable,
    *,
    now: int,
    into_node: IntoNode,
    latest: int | None = None,
    prefix: str = '',
    planar: bool = False,
    meshes: str = AS_CONVEX,
    files: Callable[[], MeshFiles | None] = lambda: None,
) -> Generator[None, None, Change]:
    """Read markers; pause now and then, nothing is changed yet.

    Parameters
    ----------
    now : int
        Time of reception on the node's clock, ns: lifetimes begin here, as in RViz.
    into_node : callable
        From a frame and a stamp to the transform into the node's frame, or None if there is none
        to apply; raises FrameError.
    latest : int, optional
        No later stamp is believed, ns: what such a marker removes stays.
    prefix : str
        Begins every obstacle's name.
    planar : bool
        Whether the scene is.
    meshes : str
        What lists of triangles and mesh files become, a form of `mesh_of`.
    files : callable, optional
        Returns what reads mesh files, once a marker names one; None: such markers are refused.
    """
    reader = _Reader(table, into_node, prefix, planar, meshes)
    reader.refuse_later_than(latest)
    order = order_of(table, reader.faulty)
    reader.faulty[order.wish == NOTHING] = True
    good = order.alive.copy()
    yield from reader.find_frames(good)
    yield from reader.make_meshes(np.flatnonzero(good & (table.type == TRIANGLES)))
    yield from reader.read_files(np.flatnonzero(good & (table.type == MESH_RESOURCE)), files)
    yield from reader.read_lists(np.flatnonzero(good & (order.wish == LISTED)))
    good &= ~reader.faulty
    if reader.points:
        bad = reader.bad_singles(good & (order.wish == SINGLE))  # the scene says why
        good = last_of_lists(order, good & ~bad) | bad
    rows = np.flatnonzero(good)
    counts = reader.counts(rows)
    of = np.repeat(rows, counts)
    shapes = yield from reader.shapes(rows, of)
    names, singles, lists = reader.names.with_elements(rows, counts, reader.listed(rows))
    stamps = np.where(table.stamp == 0, now, table.stamp)
    removes = (order.wish == REMOVAL) | (order.wish == SWEEP)
    removes |= good & (order.wish == LISTED)  # of a list that becomes shorter
    lifetime = table.lifetime[of]
    return Change(
        order.clears,
        [f'{prefix}{table.namespaces[space]}' for space in order.swept.tolist()],
        reader.names.singles(order.removed),
        names,
        shapes,
        stamps[of],
        np.where(lifetime > 0, lifetime + now, 0),
        lists,
        singles,
        reader.refusals(),
        int(stamps[removes].max(initial=0)),
    )


class _Reader:
    """Reads one message, stage by stage."""

    def __init__(
        self, table: MarkerTable, into_node: IntoNode, prefix: str, planar: bool, form: str
    ) -> None:
        self.table = table
        self.names = MarkerNames(table, prefix)
        self.planar, self.form = planar, form
        self.faulty = np.zeros(len(table.id), np.bool_)
        self.reasons: dict[int, str] = {}  # of the rows where it is not the type or action
        self.meshes: dict[int, Mesh] = {}
        self.points: dict[int, Floats] = {}  # of lists
        self.placing = Placing(table.frame_ids, table.frame, table.stamp, into_node)

    def refuse(self, row: int, reason: str) -> None:
        self.faulty[row] = True
        self.reasons[row] = reason

    def refuse_later_than(self, latest: int | None) -> None:
        if latest is not None:
            for row in np.flatnonzero(self.table.stamp > latest).tolist():
                self.refuse(row, TOO_FAR_AHEAD)

    def refusals(self) -> Refusals:
        return Refusals(Block(np.flatnonzero(self.faulty), self.names.of, self._reason))

    def find_frames(self, good: Mask) -> Generator[None, None, None]:
        """Look up how markers get into the node's frame; refuse those that cannot."""
        reasons = yield from self.placing.find(np.flatnonzero(good))
        for row, reason in reasons.items():
            self.refuse(row, reason)
        good[list(reasons)] = False

    def make_meshes(self, rows: Integers) -> Generator[None, None, None]:
        """Examine lists of triangles, three points each; scale multiplies them."""
        for row in rows.tolist():
            points = self.table.points(row) * self.table.scale[row]
            if len(points) % 3 or not len(points):
                self.refuse(row, f'{len(points)} points are not triangles')
                continue
            try:
                triangles = points.reshape(-1, 3, 3)
                self.meshes[row] = yield from examined(triangles, self.planar, self.form)
            except ValueError as error:
                self.refuse(row, str(error))
                yield

    def read_files(
        self, rows: Integers, find_files: Callable[[], MeshFiles | None]
    ) -> Generator[None, None, None]:
        """Make meshes of the files that markers name; scale multiplies them."""
        files = find_files() if len(rows) else None
        if files is None:
            for row in rows.tolist():
                self.refuse(row, f'{TYPE_NAMES[MESH_RESOURCE]}: no mesh files are read here')
            return
        scales = self.table.scale
        found: dict[int, MeshFile] = {}
        reading = []  # all begin before the first is waited for
        for row in rows.tolist():
            try:
                found[row] = file = files.find(self.table.resource(row))
            except ValueError as error:
                self.refuse_file(row, error)
                continue
            if not files.knows(file, scales[row], self.form):
                reading.append(files.start(file))
        for row, file in found.items():
            uri = self.table.resource(row)
            given = uri, file, scales[row], self.form
            try:
                self.meshes[row] = yield from files.mesh(*given, planar=self.planar)
            except ValueError as error:
                self.refuse_file(row, error)
        files.latest = [self.meshes[row] for row in found if row in self.meshes]

    def refuse_file(self, row: int, reason: ValueError) -> None:
        uri = shortened(self.table.resource(row))
        self.refuse(row, f'{TYPE_NAMES[MESH_RESOURCE]} {uri}: {reason}')

    def read_lists(self, rows: Integers) -> Generator[None, None, None]:
        """Find the points of list markers."""
        if not len(rows):
            return
        table = self.table
        given = np.hstack((table.position[rows], table.orientation[rows], table.scale[rows]))
        finite = np.isfinite(given).all(axis=1)
        for row in rows[~finite].tolist():
            self.refuse(row, 'pose or scale of the list is not finite')
        for number, row in enumerate(rows[finite].tolist()):
            self.points[row] = table.points(row)
            if number % AT_A_TIME == AT_A_TIME - 1:
                yield

    def bad_singles(self, which: Mask) -> Mask:
        """Which single markers the scene would refuse for their shapes."""
        rows, table = np.flatnonzero(which), self.table
        given = table.position[rows], table.orientation[rows], table.scale[rows]
        bad = np.zeros(len(which), np.bool_)
        bad[rows] = (
            canonicalise(as_shapes(unchecked_shapes(_KINDS[table.type[rows]], *given))).faults
            != FINE
        )
        return bad

    def listed(self, rows: Integers) -> Mask:
        """Which of these are lists."""
        if not self.points:
            return np.zeros(len(rows), np.bool_)
        return np.array([row in self.points for row in rows.tolist()], np.bool_)

    def counts(self, rows: Integers) -> Integers:
        """How many obstacles each marker is."""
        if not self.points:
            return np.ones(len(rows), np.int64)
        found = (len(self.points[row]) if row in self.points else 1 for row in rows.tolist())
        return np.fromiter(found, np.int64, len(rows))

    def shapes(self, rows: Integers, of: Integers) -> Generator[None, None, Shapes]:
        """Obstacles in the node's frame; `of` is the marker that each comes from."""
        shapes = yield from self._placed(rows, of)
        if self.meshes:
            given = np.empty(len(of), object)
            for at in np.flatnonzero(self.table.type[of] >= MESH_RESOURCE).tolist():
                given[at] = mesh = self.meshes[int(of[at])]
                shapes.kind[at], shapes.size[at] = ShapeKind.MESH, mesh.size
            shapes = shapes._replace(mesh=given)
        yield from self.placing.move(shapes, of)
        return shapes

    def _placed(self, rows: Integers, of: Integers) -> Generator[None, None, Shapes]:
        """The shapes in their markers' frames; elements of lists at their points."""
        table, count, done = self.table, len(of), 0
        position, turn, size = (np.empty((count, width)) for width in (3, 4, 3))
        points = [self.points[row] for row in rows.tolist() if row in self.points]
        local = np.concatenate(points) if points else position[:0]
        for begin in range(0, count, ELEMENTS):
            if begin:
                yield
            some = slice(begin, begin + ELEMENTS)
            marker = of[some]
            position[some], size[some] = table.position[marker], table.scale[marker]
            turn[some] = table.orientation[marker]
            if done == len(local):
                continue
            place = begin + np.flatnonzero(np.isin(table.type[marker], list(LISTED_SHAPES)))
            turn[place] = rotations.normalised_if_near(turn[place])
            position[place] += rotations.rotate(turn[place], local[done : done + len(place)])
            done += len(place)
        return unchecked_shapes(_KINDS[table.type[of]], position, turn, size)

    def _reason(self, row: int) -> str:
        if row in self.reasons:
            return self.reasons[row]
        return why_not(self.table, row)
