# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays and hits as PointCloud2, row for row; both directions, for the node and its clients."""

from __future__ import annotations

import sys
from array import array
from collections.abc import Sequence
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import DTypeLike, NDArray
from sensor_msgs.msg import PointCloud2, PointField

from bvh_ros.ros.cdr.point_cloud2 import PointCloud
from bvh_ros.ros.conversions.cloud_fields import (
    DATATYPES,
    all_or_none,
    columns,
    structured,
    widest,
)

ORIGIN = ('x', 'y', 'z')
DIRECTION = ('dx', 'dy', 'dz')
OPTIONAL = ('t_max', 'radius', 't0', 'duration')
NORMAL = ('nx', 'ny', 'nz')
FREE = 0xFFFFFFFF  # instead of an obstacle's handle: nothing is hit
UNANSWERED = 0xFFFFFFFE  # instead of an obstacle's handle: nobody knows
EVERYTHING = 0xFFFFFFFF  # the mask that sees every obstacle
LEAST_RAY = 24  # bytes: origin and direction as float32
CODES = {kind: code for code, kind in DATATYPES.items()}

Floats = NDArray[np.float64]


class Rays(NamedTuple):
    """The rays of one cloud, in its frame; nothing is known of their values yet."""

    origins: Floats  # (n, 3) m
    directions: Floats  # (n, 3)
    t_max: Floats  # (n,) in units of the directions
    masks: NDArray[np.uint32]  # (n,)
    real: np.dtype[Any]  # float32 or float64: the widest type among the cloud's fields
    radii: Floats | None = None  # (n,) m, of balls that go along the rays; None: thin rays
    since: Floats | None = None  # (n,) s after the header's stamp, when rays begin; None: now
    durations: Floats | None = None  # (n,) s until t_max; None: the world stands still meanwhile

    def take(self, rows: NDArray[np.bool_] | NDArray[np.int64]) -> Rays:
        """Return some of the rows."""
        given = self._asdict()
        some: Any = {n: c[rows] for n, c in given.items() if isinstance(c, np.ndarray)}
        return self._replace(**some)

    def fault(self, number: int = 0) -> tuple[NDArray[np.bool_], str]:
        """Return which rows (n,) cannot be answered, and of the first of them why.

        `number` is that of the first row in its cloud.
        """
        faults: dict[str, NDArray[np.bool_]] = {
            'its origin is not finite': np.logical_not(np.isfinite(self.origins).all(axis=1)),
            'its direction is not finite': np.logical_not(
                np.isfinite(self.directions).all(axis=1)
            ),
            'its t_max is NaN or negative': np.logical_not(self.t_max >= 0.0),
        }
        if self.radii is not None:
            faults['its radius is not finite, or negative'] = np.logical_not(
                np.isfinite(self.radii) & (self.radii >= 0.0)
            )
            with np.errstate(over='ignore', invalid='ignore'):
                ways = self.directions * self.t_max[:, None]
            faults['it has a radius, and no end by t_max'] = (self.radii > 0.0) & np.logical_not(
                np.isfinite(ways).all(axis=1)
            )
        if self.durations is not None:
            with np.errstate(over='ignore', invalid='ignore'):
                ways = self.directions * self.t_max[:, None]
            ends = (self.durations == 0.0) | np.isfinite(ways).all(axis=1)
            faults['its duration is not finite, or negative'] = np.logical_not(
                np.isfinite(self.durations) & (self.durations >= 0.0)
            )
            faults['it has a duration, and no end by t_max'] = np.logical_not(ends)
        return first_fault(faults, number)


class Hits(NamedTuple):
    """What n rays meet, one row a ray."""

    obstacles: NDArray[np.uint32]  # (n,) node handles, FREE or UNANSWERED
    t: Floats  # (n,) in units of the directions; inf where free, NaN where unanswered
    points: Floats  # (n, 3) m, NaN where nothing is hit
    normals: Floats  # (n, 3) outward; zero where nothing is hit or the ray starts inside

    @classmethod
    def unanswered(cls, count: int) -> Hits:
        """Return rows that say that nobody knows."""
        # One row in memory, whatever the count.
        obstacle, nan = np.array([UNANSWERED], np.uint32), np.array([np.nan])
        return cls(
            np.broadcast_to(obstacle, (count,)),
            np.broadcast_to(nan, (count,)),
            np.broadcast_to(nan, (count, 3)),
            np.broadcast_to(np.zeros(1), (count, 3)),
        )

    def put(self, rows: NDArray[np.bool_], others: Hits) -> Hits:
        """Return the same with some of the rows overwritten."""
        hits = Hits(*map(np.array, self))
        hits.obstacles[rows], hits.t[rows] = others.obstacles, others.t
        hits.points[rows], hits.normals[rows] = others.points, others.normals
        return hits


class RayCloud:
    """The rays of a cloud, to be read in parts.

    Parameters
    ----------
    cloud : sensor_msgs/PointCloud2
        Fields x, y, z (origin, m), dx, dy, dz (direction) and optionally t_max, radius (m), t0 (s
        after the header's stamp) and duration (s until t_max), each float32 or float64, and mask,
        an unsigned integer of up to 32 bits. Other fields are left alone.

    Raises
    ------
    ValueError
        If the cloud contradicts itself or lacks a field; none of its rows can be answered then.
    """

    def __init__(self, cloud: PointCloud | PointCloud2) -> None:
        points = structured(cloud, (*ORIGIN, *DIRECTION, *OPTIONAL, 'mask'))
        self._points = points.ravel()
        self.real = np.dtype(np.float32)
        """float32 or float64: the widest type among the fields."""
        names = points.dtype.names or ()
        if not points.size:
            return
        if not all_or_none(names, (*ORIGIN, *DIRECTION)):
            raise ValueError('the cloud has no fields x, y, z, dx, dy, dz')
        self.real = widest(points)

    def __len__(self) -> int:
        return len(self._points)

    @property
    def has_radii(self) -> bool:
        """Whether balls go along the rays."""
        return 'radius' in (self._points.dtype.names or ())

    @property
    def has_times(self) -> bool:
        """Whether the rays are about other times than now."""
        return not {'t0', 'duration'}.isdisjoint(self._points.dtype.names or ())

    def rows(self, begin: int, end: int) -> Rays:
        """Return some of the rays."""
        points = self._points[begin:end]
        names = points.dtype.names or ()
        t_max = np.full(len(points), np.inf)
        if 't_max' in names:
            t_max = columns(points, ['t_max'])[:, 0]
        masks = np.full(len(points), EVERYTHING, np.uint32)
        if 'mask' in names:
            masks[:] = points['mask']
        radii, since, durations = (
            columns(points, [name])[:, 0] if name in names else None for name in OPTIONAL[1:]
        )
        if durations is not None and since is None:
            since = np.zeros(len(points))
        origins, directions = columns(points, ORIGIN), columns(points, DIRECTION)
        return Rays(origins, directions, t_max, masks, self.real, radii, since, durations)


def rays_cloud(given: Rays) -> PointCloud2:
    """Write rays into a cloud of one row, its header left to the caller."""
    t_max = not np.isposinf(given.t_max).all()
    masks = (given.masks != EVERYTHING).any()
    names = [*ORIGIN, *DIRECTION, *(['t_max'] if t_max else [])]
    names += [] if given.radii is None else ['radius']
    kinds: list[tuple[str, DTypeLike]] = [(name, given.real) for name in names]
    times = (('t0', given.since), ('duration', given.durations))
    kinds += [(name, np.float64) for name, column in times if column is not None]
    if masks:
        kinds.append(('mask', np.uint32))
    table = np.empty(len(given.t_max), kinds)
    put_columns(table, ORIGIN, given.origins)
    put_columns(table, DIRECTION, given.directions)
    if t_max:
        table['t_max'] = given.t_max
    if given.radii is not None:
        table['radius'] = given.radii
    for name, column in times:
        if column is not None:
            table[name] = column
    if masks:
        table['mask'] = given.masks
    return _cloud(table, 1, len(table))


def hits(cloud: PointCloud2) -> Hits:
    """Read hits as `hits_cloud` writes them."""
    points = structured(cloud, (*ORIGIN, 't', *NORMAL, 'obstacle'))
    return Hits(
        points['obstacle'].ravel(),
        columns(points, ['t'])[:, 0],
        columns(points, ORIGIN),
        columns(points, NORMAL),
    )


def hits_table(count: int, real: DTypeLike) -> NDArray[np.void]:
    """Return room for so many hits.

    Fields x, y, z, t, nx, ny, nz of type `real` and obstacle (uint32).
    """
    kinds = [*((name, real) for name in (*ORIGIN, 't', *NORMAL)), ('obstacle', 'u4')]
    return np.zeros(count, np.dtype(kinds, align=True))


def write_hits(table: NDArray[np.void], found: Hits) -> None:
    """Write hits into rows of a table, rounded to nearest."""
    with np.errstate(over='ignore'):  # farther than the largest float32 is inf in one
        put_columns(table, ORIGIN, found.points)
        table['t'] = found.t
    put_columns(table, NORMAL, found.normals)
    table['obstacle'] = found.obstacles


def table_cloud(
    table: NDArray[np.void], height: int, width: int, certain: NDArray[Any]
) -> PointCloud2:
    """Return a table as a cloud of height x width points, its header left to the caller; it is
    dense where all of `certain` is finite.
    """
    cloud = _cloud(table, height, width)
    cloud.is_dense = bool(np.isfinite(certain).all())
    return cloud


def hits_cloud(found: Hits, height: int, width: int, real: DTypeLike) -> PointCloud2:
    """Write hits into a cloud of height x width points, its header left to the caller."""
    table = hits_table(height * width, real)
    write_hits(table, found)
    return table_cloud(table, height, width, table['t'])


def rows_of(cloud: PointCloud, least: int) -> tuple[int, int]:
    """Return height and width of the reply to a cloud that cannot be read; a point has at least so
    many bytes.

    A size that its own data contradict, by promising more points than could stand in them, is not
    believed: one row says then that nothing is answered.
    """
    believed = 0 < cloud.height * cloud.width * least <= len(cloud.data)
    return (cloud.height, cloud.width) if believed else (1, 1)


def first_fault(
    faults: dict[str, NDArray[np.bool_]], number: int
) -> tuple[NDArray[np.bool_], str]:
    """Return which rows (n,) have any of these faults, and which that is of the first of them."""
    bad = np.logical_or.reduce([*faults.values()])
    if not bad.any():
        return bad, ''
    first = int(bad.argmax())
    return bad, f'row {number + first}: ' + next(
        why for why, rows in faults.items() if rows[first]
    )


def put_columns(table: NDArray[np.void], names: Sequence[str], values: NDArray[Any]) -> None:
    """Write columns (n, len(names)) into rows of a table."""
    for axis, name in enumerate(names):
        table[name] = values[:, axis]


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
