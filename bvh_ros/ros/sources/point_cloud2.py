# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles from a PointCloud2 topic: many boxes a message, without a loop over its points."""

from __future__ import annotations

from collections.abc import Iterator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.cdr import point_cloud2 as decoder
from bvh_ros.ros.cdr.point_cloud2 import all_or_none, columns, structured
from bvh_ros.ros.conversions.placing import alike, moved
from bvh_ros.ros.sources.source import TOO_FAR_AHEAD, Applying, Source
from bvh_ros.scene import Block, Numbered, Part, Refusals, ShapeKind, Shapes
from bvh_ros.scene.store import run_in_thread

MANY = 30_000  # rows, whose ids take some 5 ms to compare
CENTRE = ('x', 'y', 'z')
SIZE = ('sx', 'sy', 'sz')
ORIENTATION = ('qx', 'qy', 'qz', 'qw')
VELOCITY = ('vx', 'vy', 'vz')


class PointCloud2Source(Source):
    """Replaces its boxes with those of each message, or updates them by id."""

    message_type = PointCloud2
    raw = True

    @staticmethod
    def says_everything(serialised: bytes) -> bool:
        """Whether a cloud replaces all boxes: it has no ids."""
        try:
            names = [field.name for field in decoder.read(serialised).fields]
        except ValueError:
            return False
        return bool(names) and 'id' not in names

    def apply(self, message: Any, now: int) -> Applying:
        """Replace all boxes, or update and delete by id."""
        given = decoder.read(*message)
        options = self.settings.options
        moving = options['predict'] == 'given'
        read = partial(BoxCloud, given, voxel=options['voxel'], moving=moving)
        large = given.width * given.height >= MANY
        cloud = (yield from run_in_thread(read)) if large else read()
        self.is_whole = not cloud.by_id
        stamp = given.stamp
        transform = self.frames.into_node(given.frame_id, stamp)
        prefix = f'{self.settings.prefix}{self.name}#'
        items = skipped = 0
        if (latest := self._latest(now)) is not None and stamp > latest:
            raise ValueError(f'{TOO_FAR_AHEAD}; what it replaces or deletes stays')

        def parts(length: int) -> Iterator[Part]:
            nonlocal items, skipped
            items = skipped = 0  # a late update begins again
            for boxes in cloud.parts(length):
                skipped += boxes.skipped
                items += len(boxes.numbers)
                if len(boxes.deleted):
                    self.scene.remove(self.name, Numbered(prefix, boxes.deleted))
                    self.removed_at = stamp or now
                names = Numbered(prefix, boxes.numbers)
                speeds: Any = boxes.velocities if moving else self.follow
                if moving and transform is not None:
                    speeds = transform.vectors(speeds)
                part = Part(names, moved(boxes.shapes, transform), stamp or now)
                yield part._replace(velocities=speeds)

        whole = not cloud.by_id
        refusals = yield from self._in_slices('', cloud.total, parts, whole=whole)
        self.skipped += skipped
        refusals.extend(cloud.refusals)
        return items + len(cloud.refusals), refusals


class Boxes(NamedTuple):
    """Some of the boxes of a cloud."""

    numbers: NDArray[np.int64]  # (n,) row in the cloud, or id
    shapes: Shapes  # (n,)
    deleted: NDArray[np.int64]  # ids whose size is NaN
    skipped: int  # points with a NaN coordinate
    velocities: NDArray[np.float64] | None  # (n, 3) m/s, finite or not; None: not asked for


class BoxCloud:
    """The boxes of a cloud, all at once or in parts.

    Parameters
    ----------
    cloud : sensor_msgs/PointCloud2
        Fields x, y, z (centre, m) and optionally sx, sy, sz (full edge lengths, m), qx, qy, qz,
        qw and id, each of any numeric type.
    voxel : float
        Edge length of every box where the cloud has no sizes.
    moving : bool
        Read the fields vx, vy, vz (m/s), too.

    Raises
    ------
    ValueError
        If the cloud contradicts itself; nothing of it can be trusted then.
    """

    def __init__(self, cloud: Any, *, voxel: float, moving: bool = False) -> None:
        wanted = *CENTRE, *SIZE, *ORIENTATION, 'id', *(VELOCITY if moving else ())
        points = structured(cloud, wanted)
        names = points.dtype.names or ()
        self._points = points.ravel()
        self._voxel = voxel
        self._moving = moving
        self.total = len(self._points)
        self.by_id = 'id' in names
        """Updates these ids; otherwise replaces everything."""
        self.refusals = Refusals()
        """Rows whose id is no good."""
        self._ids: NDArray[np.int64] | None = None
        self._good: NDArray[np.bool_] | None = None
        if not self.total:
            return
        self._has_size = all_or_none(names, SIZE)
        self._has_orientation = all_or_none(names, ORIENTATION)
        if not all_or_none(names, CENTRE):
            raise ValueError('the cloud has no fields x, y, z')
        if moving and not all_or_none(names, VELOCITY):
            raise ValueError('the cloud has no fields vx, vy, vz')
        if self.by_id:
            self._ids, self._good, self.refusals = _ids(self._points['id'])

    def parts(self, length: int) -> Iterator[Boxes]:
        """Read the boxes in parts of at most `length` rows; at least one part."""
        if not self.total:
            nothing, rows = np.empty(0, dtype=np.int64), np.empty((0, 3))
            yield Boxes(
                nothing, Shapes.boxes(rows, rows), nothing, 0, rows if self._moving else None
            )
        for begin in range(0, self.total, length):
            yield self._rows(begin, min(begin + length, self.total))

    def _rows(self, begin: int, end: int) -> Boxes:
        points, n = self._points[begin:end], end - begin
        centre = columns(points, CENTRE)
        size = columns(points, SIZE) if self._has_size else np.full((n, 3), self._voxel)
        turn = columns(points, ORIENTATION) if self._has_orientation else np.zeros((n, 4))
        numbers = np.arange(begin, end, dtype=np.int64)
        deleted = np.empty(0, dtype=np.int64)
        usable = np.ones(n, dtype=bool)
        if self._ids is not None and self._good is not None:
            numbers, usable = self._ids[begin:end], self._good[begin:end]
            is_deleted = usable & np.isnan(size).any(axis=1)
            deleted = numbers[is_deleted]
            usable = usable & ~is_deleted
        known = ~np.isnan(centre).any(axis=1)
        skipped = int((usable & ~known).sum())
        usable = usable & known
        shapes = alike(ShapeKind.BOX, centre, turn, size)
        velocities = columns(points, VELOCITY) if self._moving else None
        if not usable.all():
            numbers, shapes = numbers[usable], shapes.take(usable)
            velocities = None if velocities is None else velocities[usable]
        return Boxes(numbers, shapes, deleted, skipped, velocities)


def _ids(values: NDArray[Any]) -> tuple[NDArray[np.int64], NDArray[np.bool_], Refusals]:
    """Return the ids as integers, which rows to use, and the rows refused."""
    refused = []
    good = np.ones(len(values), dtype=bool)
    if values.dtype.kind == 'f':
        # Doubles beyond 2^53 no longer tell neighbouring ids apart.
        with np.errstate(invalid='ignore'):
            good = (values == np.rint(values)) & (np.abs(values) <= 2.0**53)
        refused.append(
            Block(
                np.flatnonzero(~good),
                lambda row: '',
                lambda row: f'id {values[row]} is not a whole number',
            )
        )
    ids = np.where(good, values, 0).astype(np.int64)
    last = _last_of_each(ids, good)
    if last is not None:
        refused.append(
            Block(
                np.flatnonzero(good & ~last),
                lambda row: str(ids[row]),
                lambda row: f'id {ids[row]} comes again in this cloud; the last one counts',
            )
        )
        good = good & last
    return ids, good, Refusals(*refused)


def _last_of_each(ids: NDArray[np.int64], good: NDArray[np.bool_]) -> NDArray[np.bool_] | None:
    """Return which rows are the last of their id, or None if no id repeats."""
    rows = np.flatnonzero(good)
    if (np.diff(ids[rows]) > 0).all():
        return None
    unique, first_from_behind = np.unique(ids[rows][::-1], return_index=True)
    if len(unique) == len(rows):
        return None
    last = np.zeros(len(ids), dtype=bool)
    last[rows[::-1][first_from_behind]] = True
    return last
