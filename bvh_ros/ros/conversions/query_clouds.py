# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Questions of batches and their answers as PointCloud2, row for row; both directions, for the
node and its clients.
"""

from __future__ import annotations

import functools
import sys
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sensor_msgs.msg import PointCloud2, PointField

from bvh_ros.ros.cdr.point_cloud2 import (
    DATATYPES,
    PointCloud,
    all_or_none,
    columns,
    structured,
    widest,
)
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.world.frames import Transform
from bvh_ros.tree.access import shown_rows

FREE = 0xFFFFFFFF  # instead of an obstacle's handle: nothing is hit
UNANSWERED = 0xFFFFFFFE  # instead of an obstacle's handle: not known
EVERYTHING = 0xFFFFFFFF  # the mask that sees every obstacle
CODES = {kind: code for code, kind in DATATYPES.items()}
ORIGIN, DIRECTION, NORMAL = ('x', 'y', 'z'), ('dx', 'dy', 'dz'), ('nx', 'ny', 'nz')
SIZE, TURN = ('sx', 'sy', 'sz'), ('qx', 'qy', 'qz', 'qw')

Floats = NDArray[np.float64]
Masks = NDArray[np.uint32]
Faults = dict[str, Any]  # (n,) bools by reason

# ---- Questions.


def improper(lengths: Floats) -> NDArray[np.bool_]:
    """Which lengths or durations are not finite, or negative."""
    return np.logical_not(np.isfinite(lengths) & (lengths >= 0.0))


class Rays(NamedTuple):
    """The rays of one cloud, in its frame; nothing is known of their values yet."""

    origins: Floats  # (n, 3) m
    directions: Floats  # (n, 3)
    t_max: Floats  # (n,) in units of the directions
    masks: Masks  # (n,)
    real: np.dtype[Any]  # float32 or float64: the widest type among the cloud's fields
    radii: Floats | None = None  # (n,) m, of balls that go along the rays; None: thin rays
    since: Floats | None = None  # (n,) s after the header's stamp, when rays begin; None: now
    durations: Floats | None = None  # (n,) s until t_max; None: the world stands still meanwhile

    def faults(self) -> Faults:
        """Return why rows (n,) cannot be answered."""
        faults: Faults = {
            'its origin is not finite': ~np.isfinite(self.origins).all(axis=1),
            'its direction is not finite': ~np.isfinite(self.directions).all(axis=1),
            'its t_max is NaN or negative': ~(self.t_max >= 0.0),
        }
        if self.radii is None and self.durations is None:
            return faults
        with np.errstate(over='ignore', invalid='ignore'):
            endless = ~np.isfinite(self.directions * self.t_max[:, None]).all(axis=1)
        if self.radii is not None:
            faults['its radius is not finite, or negative'] = improper(self.radii)
            faults['it has a radius, and no end by t_max'] = (self.radii > 0.0) & endless
        if self.durations is not None:
            faults['its duration is not finite, or negative'] = improper(self.durations)
            faults['it has a duration, and no end by t_max'] = (self.durations != 0.0) & endless
        return faults


class Points(NamedTuple):
    """Points of one cloud; nothing is known of their values yet."""

    places: Floats  # (n, 3) m
    reaches: Floats  # (n,) m, how far an obstacle may be
    masks: Masks  # (n,)
    since: Floats | None = None  # (n,) s after the header's stamp; None: now

    def faults(self) -> Faults:
        """Return why rows (n,) cannot be answered."""
        return {
            'its point is not finite': np.logical_not(np.isfinite(self.places).all(axis=1)),
            'its max_distance is NaN or negative': np.logical_not(self.reaches >= 0.0),
        }


class Boxes(NamedTuple):
    """Boxes of one cloud; nothing is known of their values yet."""

    places: Floats  # (n, 3) m, their centres
    sizes: Floats  # (n, 3) m
    turns: Floats  # (n, 4) quaternions
    tolerances: Floats  # (n,) m
    masks: Masks  # (n,)
    since: Floats | None = None  # (n,) s after the header's stamp; None: now

    def faults(self) -> Faults:
        """Return why rows (n,) cannot be answered."""
        with np.errstate(over='ignore', invalid='ignore'):
            reach = np.abs(self.places).max(axis=1) + 2.0 * self.sizes.sum(axis=1)
        return {
            'its centre is not finite': ~np.isfinite(self.places).all(axis=1),
            'its size is not finite, or negative': improper(self.sizes).any(axis=1),
            'its orientation is not finite': ~np.isfinite(self.turns).all(axis=1),
            rotations.OFF: rotations.are_off(self.turns),
            'its tolerance is not finite, or negative': improper(self.tolerances),
            'it reaches beyond the largest double': ~np.isfinite(reach),
        }


Question = TypeVar('Question', bound=tuple[Any, ...])
QUESTION_FIELDS: dict[str, tuple[str, ...]] = {
    'origins': ORIGIN,
    'places': ORIGIN,
    'directions': DIRECTION,
    'sizes': SIZE,
    'turns': TURN,
    't_max': ('t_max',),
    'radii': ('radius',),
    'reaches': ('max_distance',),
    'tolerances': ('tolerance',),
    'since': ('t0',),
    'durations': ('duration',),
    'masks': ('mask',),
}
NEEDED = 'origins', 'places', 'directions', 'sizes'
DEFAULTS = {
    'turns': 0.0,
    't_max': np.inf,
    'reaches': np.inf,
    'tolerances': 0.0,
    'masks': EVERYTHING,
}


@functools.cache
def all_fields(kind: Any) -> list[str]:
    """Fields that a cloud of these questions may have."""
    return [field for name in kind._fields for field in QUESTION_FIELDS.get(name, ())]


@functools.cache
def needed_fields(kind: Any) -> list[str]:
    """Fields that every cloud of these questions has."""
    return [field for name in NEEDED if name in kind._fields for field in QUESTION_FIELDS[name]]


class Moments(NamedTuple):
    """When the rows of a cloud begin, and how long they take, as of `Rays`."""

    since: Floats | None
    durations: Floats | None


class QueryCloud:
    """The rays, points or boxes of a cloud, to be read in parts.

    Parameters
    ----------
    cloud : sensor_msgs/PointCloud2
        The fields of QUESTION_FIELDS that the kind has, each float32 or float64; mask is an
        unsigned integer of up to 32 bits. Other fields are left alone.
    kind : type
        Rays, Points or Boxes.

    Raises
    ------
    ValueError
        If the cloud contradicts itself or lacks a field; none of its rows can be answered then.
    """

    def __init__(self, cloud: PointCloud | PointCloud2, kind: Any) -> None:
        self._kind = kind
        points = structured(cloud, all_fields(kind))
        self._points = points.ravel()
        self.real = np.dtype(np.float32)
        """float32 or float64: the widest type among the fields."""
        self._names = points.dtype.names or ()
        if not points.size:
            return
        needed = needed_fields(kind)
        if not all_or_none(self._names, needed):
            raise ValueError(f'the cloud has no fields {", ".join(needed)}')
        if kind is Boxes:
            all_or_none(self._names, TURN)
        self.real = widest(points)

    def __len__(self) -> int:
        return len(self._points)

    @property
    def has_radii(self) -> bool:
        """Whether balls go along the rays."""
        return 'radius' in self._names

    @property
    def has_times(self) -> bool:
        """Whether the rows are about other times than now."""
        return not {'t0', 'duration'}.isdisjoint(self._names)

    def moments(self) -> Moments:
        """Return when all rows begin, and how long they take."""
        return Moments(*(self._column(self._points, name) for name in Moments._fields))

    def rows(self, begin: int, end: int) -> Any:
        """Return some of the rows."""
        points = self._points[begin:end]
        return self._kind(
            *(
                self.real if name == 'real' else self._column(points, name)
                for name in self._kind._fields
            )
        )

    def _column(self, points: NDArray[np.void], name: str) -> Any:
        fields, count = QUESTION_FIELDS[name], len(points)
        if name == 'masks':
            masks = np.full(count, EVERYTHING, np.uint32)
            if 'mask' in self._names:
                masks[:] = points['mask']
            return masks
        if fields[0] in self._names:
            values = columns(points, fields)
            return values if len(fields) > 1 else values[:, 0]
        if name == 'since' and 'duration' in self._names:
            return np.zeros(count)
        if name not in DEFAULTS and name not in NEEDED:
            return None
        shape = (count, len(fields)) if len(fields) > 1 else count
        return np.full(shape, DEFAULTS.get(name, 0.0))


def take(questions: Question, rows: Any) -> Question:
    """Return some of the rows."""
    given: Any = questions
    some = {
        name: column[rows] if isinstance(column, np.ndarray) else take(column, rows)
        for name, column in given._asdict().items()
        if isinstance(column, (np.ndarray, tuple))
    }
    taken: Question = given._replace(**some)
    return taken


MOVED = {
    **dict.fromkeys(('origins', 'places', 'goals'), Transform.points),
    **dict.fromkeys(('turns', 'goal_turns'), Transform.orientations),
    'directions': Transform.vectors,
}
"""How columns get into another frame; lengths, and with them t, are the same there."""


def moved(questions: Question, transform: Transform) -> Question:
    """Return questions in the node's frame."""
    given: Any = questions
    names = MOVED.keys() & given._fields
    there = {name: MOVED[name](transform, getattr(given, name)) for name in names}
    if getattr(given, 'before', None) is not None:  # the poses before those of a path
        there['before'] = moved(given.before, transform)
    elsewhere: Question = given._replace(**there)
    return elsewhere


def fault(questions: Any, number: int = 0) -> tuple[NDArray[np.bool_], str]:
    """Return which rows (n,) cannot be answered, and of the first of them why; `number` is that of
    the first row in its cloud.
    """
    faults = questions.faults()
    bad = np.logical_or.reduce([*faults.values()])
    if not bad.any():
        return bad, ''
    first = int(bad.argmax())
    reason = next(why for why, rows in faults.items() if rows[first])
    return bad, f'row {number + first}: {reason}'


def questions_cloud(questions: Rays | Points | Boxes, real: DTypeLike) -> PointCloud2:
    """Write questions into a cloud of one row, its header left to the caller; columns that only
    hold defaults are left out.
    """
    own = {'masks': np.dtype('u4'), 'since': np.dtype('f8'), 'durations': np.dtype('f8')}
    given = {
        name: values
        for name in QUESTION_FIELDS
        if (values := getattr(questions, name, None)) is not None
        and not (name in DEFAULTS and (values == DEFAULTS[name]).all())
    }
    kinds = [(field, own.get(name, real)) for name in given for field in QUESTION_FIELDS[name]]
    table = np.empty(len(questions.masks), kinds)
    for name, values in given.items():
        _put(table, QUESTION_FIELDS[name], values)
    return _cloud(table, 1, len(table))


def size_of_reply(cloud: PointCloud, kind: type) -> tuple[int, int]:
    """Return height and width of the reply to a cloud that cannot be read.

    A size that its own data contradict, by promising more points than could stand in them, is not
    believed: one row says then that nothing is answered.
    """
    least = 4 * len(needed_fields(kind))  # bytes
    believed = 0 < cloud.height * cloud.width * least <= len(cloud.data)
    return (cloud.height, cloud.width) if believed else (1, 1)


# ---- Answers.


class Hits(NamedTuple):
    """What n rays meet, one row a ray."""

    obstacles: NDArray[np.uint32]  # (n,) node handles, FREE or UNANSWERED
    t: Floats  # (n,) in units of the directions; inf where free, NaN where unanswered
    points: Floats  # (n, 3) m, NaN where nothing is hit
    normals: Floats  # (n, 3) outward; zero where nothing is hit or the ray starts inside

    def __repr__(self) -> str:
        return _shown('Hits', self.obstacles, 'rays hit', 't', self.t)


class Near(NamedTuple):
    """The obstacles nearest to n points or shapes."""

    points: Floats  # (n, 3) m, on the obstacles
    distances: Floats  # (n,) m, negative in depth; inf where there is none, NaN where unanswered
    normals: Floats  # (n, 3) from there to the point; zero within the obstacle
    obstacles: NDArray[np.uint32]  # (n,) node handles, FREE or UNANSWERED

    def __repr__(self) -> str:
        return _shown('Near', self.obstacles, 'near an obstacle', 'distances', self.distances)


class PathHits(NamedTuple):
    """What a footprint meets at n poses, or on the ways to them from the poses before."""

    points: Floats  # as of `Near`, of the pose; of the way where the pose itself is free
    distances: Floats  # as of `Near`; 0 where only the way is not free
    normals: Floats
    obstacles: NDArray[np.uint32]
    t: Floats  # (n,) of the first contact, from the pose before (0) to this (1); inf: none

    def __repr__(self) -> str:
        return _shown('PathHits', self.obstacles, 'near an obstacle', 'distances', self.distances)


class Touched(NamedTuple):
    """What touches n boxes."""

    points: Floats  # (n, 3) m, of the first obstacle, closest to the box's centre
    distances: Floats  # (n,) m, from there to the centre; inf where there is none
    obstacles: NDArray[np.uint32]  # (n,) the first, nearest to the centre; FREE or UNANSWERED
    counts: NDArray[np.uint32]  # (n,) how many there are; UNANSWERED where not known

    def __repr__(self) -> str:
        return _shown('Touched', self.obstacles, 'boxes touched', 'distances', self.distances)


def _shown(name: str, obstacles: NDArray[Any], word: str, column: str, values: Floats) -> str:
    """`shown_rows`, and how many rows were not answered."""
    lost = obstacles == UNANSWERED
    shown = shown_rows(name, ~lost & (obstacles != FREE), word, column, values)
    return f'{shown[:-1]}, {np.count_nonzero(lost):,} unanswered)' if lost.any() else shown


Answer = TypeVar('Answer', Hits, Near, PathHits, Touched)
ANSWER_FIELDS: dict[str, tuple[str, ...]] = {
    'points': ORIGIN,
    't': ('t',),
    'distances': ('distance',),
    'normals': NORMAL,
    'obstacles': ('obstacle',),
    'counts': ('count',),
}
WHOLE = 'obstacles', 'counts'  # whole numbers


def unanswered(kind: Any, count: int) -> Any:
    """Return rows that say that nothing is known."""
    filled: dict[str, Any] = {
        'points': np.full((count, 3), np.nan),
        't': np.full(count, np.nan),
        'distances': np.full(count, np.nan),
        'normals': np.zeros((count, 3)),
        'obstacles': np.full(count, UNANSWERED, np.uint32),
        'counts': np.full(count, UNANSWERED, np.uint32),
    }
    return kind(*(filled[name] for name in kind._fields))


def put(answers: Any, rows: Any, others: Any) -> None:
    """Overwrite some rows of answers."""
    for column, values in zip(answers, others, strict=True):
        column[rows] = values


@functools.cache
def row_of_answers(kind: Any, real: Any) -> tuple[list[str], np.dtype[np.void]]:
    """The columns of answers, and the type of a row of their table."""
    names = [name for name in ANSWER_FIELDS if name in kind._fields]
    fields = [
        (field, 'u4' if name in WHOLE else real) for name in names for field in ANSWER_FIELDS[name]
    ]
    return names, np.dtype(fields, align=True)


class AnswerTable:
    """Room for the answers of a cloud of height x width points.

    Parameters
    ----------
    real : dtype
        Of all fields but obstacle and count, which are uint32.
    """

    def __init__(self, kind: type, height: int, width: int, real: Any) -> None:
        self._columns, row = row_of_answers(kind, real)
        self._size = height, width
        self._table = np.zeros(height * width, row)

    def write(self, rows: slice, answers: Hits | Near | PathHits | Touched) -> None:
        """Write answers into some rows, rounded to nearest."""
        with np.errstate(over='ignore'):  # farther than the largest float32 is inf in one
            for name in self._columns:
                _put(self._table[rows], ANSWER_FIELDS[name], getattr(answers, name))

    def cloud(self) -> PointCloud2:
        """Return the cloud, its header left to the caller; it is dense where every row has a
        finite t or distance.
        """
        cloud = _cloud(self._table, *self._size)
        certain = self._table['distance' if 'distances' in self._columns else 't']
        cloud.is_dense = bool(np.isfinite(certain).all())
        return cloud


def answers_cloud(
    answers: Hits | Near | PathHits | Touched, height: int, width: int, real: DTypeLike
) -> PointCloud2:
    """Write answers into a cloud of height x width points, its header left to the caller."""
    table = AnswerTable(type(answers), height, width, real)
    table.write(slice(None), answers)
    return table.cloud()


def read_answers(cloud: PointCloud2, kind: type[Answer]) -> Answer:
    """Read what `answers_cloud` writes."""
    wanted = [field for name in kind._fields for field in ANSWER_FIELDS[name]]
    rows = structured(cloud, wanted).ravel()
    if not all_or_none(rows.dtype.names or (), wanted):
        raise ValueError(f'the cloud has no fields {", ".join(wanted)}')
    given: dict[str, Any] = {}
    for name in kind._fields:
        fields = ANSWER_FIELDS[name]
        if name in WHOLE:
            given[name] = rows[fields[0]].astype(np.uint32)
        else:
            values = columns(rows, fields)
            given[name] = values if len(fields) > 1 else values[:, 0]
    return kind(**given)


def _put(table: NDArray[np.void], names: Sequence[str], values: NDArray[Any]) -> None:
    """Write values (n,) or (n, len(names)) into rows of a table."""
    rows = values.reshape(len(table), len(names))
    for axis, name in enumerate(names):
        table[name] = rows[:, axis]


def _cloud(table: NDArray[np.void], height: int, width: int) -> PointCloud2:
    data = array('B')
    data.frombytes(table.view(np.uint8).data)
    return PointCloud2(
        height=height,
        width=width,
        fields=[
            PointField(name=name, offset=place, datatype=CODES[kind.str[1:]], count=1)
            for name, (kind, place, *_) in dict(table.dtype.fields or {}).items()
        ],
        is_bigendian=sys.byteorder == 'big',
        point_step=table.itemsize,
        row_step=table.itemsize * width,
        data=data,
    )
