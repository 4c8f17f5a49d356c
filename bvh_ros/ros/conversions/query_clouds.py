# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Points and boxes that are asked about, and what is told of them, as PointCloud2, row for row."""

from __future__ import annotations

from typing import Any, NamedTuple, TypeVar

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr.point_cloud2 import PointCloud
from bvh_ros.ros.conversions import rotations
from bvh_ros.ros.conversions.cloud_fields import all_or_none, columns, structured, widest
from bvh_ros.ros.conversions.ray_clouds import (
    EVERYTHING,
    NORMAL,
    ORIGIN,
    UNANSWERED,
    Floats,
    first_fault,
    put_columns,
    table_cloud,
)
from bvh_ros.ros.world.frames import Transform

SIZE, TURN = ('sx', 'sy', 'sz'), ('qx', 'qy', 'qz', 'qw')


class Points(NamedTuple):
    """Points of one cloud; nothing is known of their values yet."""

    places: Floats  # (n, 3) m
    reaches: Floats  # (n,) m, how far an obstacle may be
    masks: NDArray[np.uint32]  # (n,)
    since: Floats | None = None  # (n,) s after the header's stamp; None: now

    def faults(self) -> dict[str, NDArray[np.bool_]]:
        """Return why rows (n,) cannot be answered."""
        return {
            'its point is not finite': np.logical_not(np.isfinite(self.places).all(axis=1)),
            'its max_distance is NaN or negative': np.logical_not(self.reaches >= 0.0),
        }

    def moved(self, transform: Transform) -> Points:
        """Return the same in the node's frame."""
        return self._replace(places=transform.points(self.places))


class Boxes(NamedTuple):
    """Boxes of one cloud; nothing is known of their values yet."""

    places: Floats  # (n, 3) m, their centres
    sizes: Floats  # (n, 3) m
    turns: Floats  # (n, 4) quaternions
    tolerances: Floats  # (n,) m
    masks: NDArray[np.uint32]  # (n,)
    since: Floats | None = None  # (n,) s after the header's stamp; None: now

    def faults(self) -> dict[str, NDArray[np.bool_]]:
        """Return why rows (n,) cannot be answered."""
        with np.errstate(over='ignore', invalid='ignore'):
            reach = np.abs(self.places).max(axis=1) + 2.0 * self.sizes.sum(axis=1)
        return {
            'its centre is not finite': ~np.isfinite(self.places).all(axis=1),
            'its size is not finite, or negative': ~(
                np.isfinite(self.sizes) & (self.sizes >= 0.0)
            ).all(axis=1),
            'its orientation is not finite': ~np.isfinite(self.turns).all(axis=1),
            'its tolerance is not finite, or negative': ~(
                np.isfinite(self.tolerances) & (self.tolerances >= 0.0)
            ),
            'it reaches beyond the largest double': ~np.isfinite(reach),
        }

    def moved(self, transform: Transform) -> Boxes:
        """Return the same in the node's frame."""
        turns = rotations.normalised(self.turns)
        return self._replace(
            places=transform.points(self.places), turns=transform.orientations(turns)
        )


class Near(NamedTuple):
    """The obstacles nearest to n points or shapes."""

    points: Floats  # (n, 3) m, on the obstacles
    distances: Floats  # (n,) m, negative in depth; inf where there is none, NaN where unanswered
    normals: Floats  # (n, 3) from there to the point; zero within the obstacle
    obstacles: NDArray[np.uint32]  # (n,) node handles, FREE or UNANSWERED


class Touched(NamedTuple):
    """What touches n boxes."""

    points: Floats  # (n, 3) m, of the first obstacle, closest to the box's centre
    distances: Floats  # (n,) m, from there to the centre; inf where there is none
    obstacles: NDArray[np.uint32]  # (n,) the first, nearest to the centre; FREE or UNANSWERED
    counts: NDArray[np.uint32]  # (n,) how many there are; UNANSWERED where nobody knows


Question = TypeVar('Question', Points, Boxes)
Answer = TypeVar('Answer', Near, Touched)
FIELDS: dict[str, tuple[str, ...]] = {
    'points': ORIGIN,
    'distances': ('distance',),
    'normals': NORMAL,
    'obstacles': ('obstacle',),
    'counts': ('count',),
}


def unanswered(kind: type[Answer], count: int) -> Answer:
    """Return rows that say that nobody knows."""
    filled: dict[str, Any] = {
        'points': np.full((count, 3), np.nan),
        'distances': np.full(count, np.nan),
        'normals': np.zeros((count, 3)),
        'obstacles': np.full(count, UNANSWERED, np.uint32),
        'counts': np.full(count, UNANSWERED, np.uint32),
    }
    return kind(*(filled[name] for name in kind._fields))


def answers_cloud(told: Near | Touched, height: int, width: int, real: DTypeLike) -> PointCloud2:
    """Write answers into a cloud of height x width points, its header left to the caller."""
    kinds = [
        (field, real if values.dtype.kind == 'f' else np.dtype('u4'))
        for name, values in told._asdict().items()
        for field in FIELDS[name]
    ]
    table = np.zeros(height * width, np.dtype(kinds, align=True))
    with np.errstate(over='ignore'):  # farther than the largest float32 is inf in one
        for name, values in told._asdict().items():
            put_columns(table, FIELDS[name], values.reshape(len(table), len(FIELDS[name])))
    return table_cloud(table, height, width, table['distance'])


def read_answers(cloud: PointCloud2, kind: type[Answer]) -> Answer:
    """Read what `answers_cloud` writes."""
    wanted = [field for name in kind._fields for field in FIELDS[name]]
    rows = structured(cloud, wanted)
    if not all_or_none(rows.dtype.names or (), wanted):
        raise ValueError(f'the cloud has no fields {", ".join(wanted)}')
    told: dict[str, Any] = {}
    for name in kind._fields:
        values = columns(rows, FIELDS[name])
        told[name] = values if len(FIELDS[name]) > 1 else values[:, 0]
    for name in {'obstacles', 'counts'} & {*told}:
        told[name] = told[name].astype(np.uint32)
    return kind(**told)


class QueryCloud:
    """The points or boxes of a cloud, to be read in parts.

    Parameters
    ----------
    cloud : sensor_msgs/PointCloud2
        Fields x, y, z (m), of boxes sx, sy, sz (m), all float32 or float64; optionally
        max_distance (m) of points; qx, qy, qz, qw and tolerance (m) of boxes; t0, s after the
        header's stamp; mask, an unsigned integer of up to 32 bits. Other fields are left alone.
    kind : type
        Points or Boxes.

    Raises
    ------
    ValueError
        If the cloud contradicts itself or lacks a field; none of its rows can be answered then.
    """

    def __init__(self, cloud: PointCloud | PointCloud2, kind: type[Points] | type[Boxes]) -> None:
        needed = ORIGIN if kind is Points else (*ORIGIN, *SIZE)
        others = ('max_distance',) if kind is Points else (*TURN, 'tolerance')
        points = structured(cloud, (*needed, *others, 't0', 'mask'))
        self._kind = kind
        self._points = points.ravel()
        self.real = np.dtype(np.float32)
        """float32 or float64: the widest type among the fields."""
        self._names = points.dtype.names or ()
        if not points.size:
            return
        if not all_or_none(self._names, needed):
            raise ValueError(f'the cloud has no fields {", ".join(needed)}')
        if kind is Boxes:
            all_or_none(self._names, TURN)
        self.real = widest(points)

    def __len__(self) -> int:
        return len(self._points)

    @property
    def has_times(self) -> bool:
        """Whether the rows are about other times than now."""
        return 't0' in self._names

    def rows(self, begin: int, end: int) -> Points | Boxes:
        """Return some of the rows."""
        points = self._points[begin:end]
        masks = np.full(len(points), EVERYTHING, np.uint32)
        if 'mask' in self._names:
            masks[:] = points['mask']
        since = self._column(points, 't0', 0.0) if self.has_times else None
        if self._kind is Points:
            reaches = self._column(points, 'max_distance', np.inf)
            return Points(columns(points, ORIGIN), reaches, masks, since)
        turns = np.zeros((len(points), 4))
        if TURN[0] in self._names:
            turns = columns(points, TURN)
        tolerances = self._column(points, 'tolerance', 0.0)
        sizes = columns(points, SIZE)
        return Boxes(columns(points, ORIGIN), sizes, turns, tolerances, masks, since)

    def _column(self, points: NDArray[np.void], name: str, otherwise: float) -> Floats:
        if name in self._names:
            return columns(points, [name])[:, 0]
        return np.full(len(points), otherwise)


def take(asked: Question, rows: Any) -> Question:
    """Return some of the rows."""
    given = asked._asdict().items()
    some: Any = {name: values[rows] for name, values in given if values is not None}
    return asked._replace(**some)


def fault(asked: Points | Boxes, number: int) -> tuple[NDArray[np.bool_], str]:
    """Return which rows (n,) cannot be answered, and of the first of them why; `number` is that of
    the first row in its cloud.
    """
    return first_fault(asked.faults(), number)


def questions_cloud(asked: Points | Boxes, real: DTypeLike) -> PointCloud2:
    """Write points or boxes into a cloud of one row, its header left to the caller."""
    names = {
        'places': ORIGIN,
        'sizes': SIZE,
        'turns': TURN,
        'reaches': ('max_distance',),
        'tolerances': ('tolerance',),
        'masks': ('mask',),
        'since': ('t0',),
    }
    own = {'masks': np.dtype('u4'), 'since': np.dtype('f8')}
    given = {name: values for name, values in asked._asdict().items() if values is not None}
    kinds = [(field, own.get(name, real)) for name in given for field in names[name]]
    table = np.empty(len(asked.places), kinds)
    for name, values in given.items():
        put_columns(table, names[name], values.reshape(len(table), len(names[name])))
    return table_cloud(table, 1, len(table), table['x'])
