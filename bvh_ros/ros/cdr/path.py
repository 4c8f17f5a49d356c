# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The bytes of a nav_msgs/Path as columns, one row a pose.

rclpy makes Python objects of every pose, some 30 us each, while nothing else is answered.
"""

from __future__ import annotations

import functools
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr import reading
from bvh_ros.ros.cdr.reading import TRUNCATED, aligned, same_bytes, skip, text, whole_number
from bvh_ros.tree.compiler import lean_kernel

STAMP, POSE = 8, 56  # bytes
SMALLEST = STAMP + 4 + POSE  # no pose is shorter
EMPTY = b'\0\1\0\0' + bytes(16)  # a message without poses


class Path(NamedTuple):
    """A path of n poses."""

    frame_id: str
    stamp: int  # ns
    stamps: NDArray[np.int64]  # (n,) ns
    positions: NDArray[np.float64]  # (n, 3) m
    orientations: NDArray[np.float64]  # (n, 4) quaternions x, y, z, w
    elsewhere: NDArray[np.bool_]  # (n,) whether the pose names another frame than the path


@lean_kernel
def read_poses(data, at, big_endian, frame, frame_length, rows, elsewhere):
    """Read as many poses as there are rows, from `at` on; return where they end, or why they
    cannot be read and the number of the pose. `frame` is where the frame of the path is written.
    """
    for number in range(rows.shape[0]):
        end = skip(data, at, STAMP, 4)
        begin = length = 0
        if end >= 0:
            for place in range(STAMP):
                rows[number, place] = data[end - STAMP + place]
            begin, length, end = text(data, end, big_endian)
        if end >= 0:
            pose = aligned(end, 8)
            end = pose + POSE if pose + POSE <= data.shape[0] else TRUNCATED
            if end >= 0:
                for place in range(POSE):
                    rows[number, STAMP + place] = data[pose + place]
        if end < 0:
            return end, number
        same = length == frame_length and same_bytes(data, frame, begin, length)
        elsewhere[number] = length > 0 and not same
        at = end
    return at, rows.shape[0]


def read(message: bytes) -> Path:
    """Read a serialised Path.

    Raises
    ------
    ValueError
        If it is none, as a whole: truncated, or with lengths that contradict its size.
    """
    body, order = reading.body_of(message)
    big_endian = order == '>'
    begin, length, end = text(body, STAMP, big_endian) if len(body) > STAMP else (0, 0, TRUNCATED)
    if end < 0:
        raise ValueError(f'the header of the path {reading.REASONS[end]}')
    at = aligned(end, 4) + 4
    if at > len(body):
        raise ValueError(f'the path {reading.REASONS[TRUNCATED]}')
    count = int(whole_number(body, at - 4, big_endian))
    if count * SMALLEST > len(body):  # before anything is allocated
        raise ValueError(f'{count} poses do not fit in a message of {len(message)} bytes')
    rows, elsewhere = np.empty((count, STAMP + POSE), np.uint8), np.empty(count, np.bool_)
    end, number = read_poses(body, at, big_endian, begin, length, rows, elsewhere)
    if end < 0:
        raise ValueError(f'pose {number} of {count} {reading.REASONS[end]}')
    columns = rows.view(_pose_type(order))[:, 0]
    frame_id = body[begin : begin + length].tobytes().decode('utf-8', 'replace')  # as rclpy does
    return Path(
        frame_id,
        int(reading.nanoseconds(body[:STAMP].view(reading.time_type(order)))[0]),
        reading.nanoseconds(columns['stamp']),
        columns['position'].astype(np.float64),
        columns['orientation'].astype(np.float64),
        elsewhere,
    )


@functools.cache
def _pose_type(order: str) -> np.dtype[np.void]:
    time, numbers = reading.time_type(order), f'{order}f8'
    return np.dtype([('stamp', time), ('position', numbers, (3,)), ('orientation', numbers, (4,))])
