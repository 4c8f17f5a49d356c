# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The names of a serialised PointCloud2's fields, without reading its points."""

from __future__ import annotations

import struct

MOST_FIELDS = 1000


def field_names(serialised: bytes) -> list[str]:
    """Return the names of the fields; none where the bytes are no cloud."""
    order = '<' if serialised[1:2] == b'\x01' else '>'
    names = []
    try:
        _, place = _string(serialised, order, 12)  # header.frame_id, after its stamp
        place = _aligned(place) + 8  # height, width
        (count,) = struct.unpack_from(f'{order}I', serialised, place)
        place += 4
        for _ in range(min(count, MOST_FIELDS)):
            name, place = _string(serialised, order, _aligned(place))
            names.append(name)
            place = _aligned(place) + 12  # offset, datatype, count
    except struct.error:
        return []
    return names


def _string(serialised: bytes, order: str, place: int) -> tuple[str, int]:
    (length,) = struct.unpack_from(f'{order}I', serialised, place)
    begin, end = place + 4, place + 4 + length
    return serialised[begin : end - 1].decode(errors='replace'), end


def _aligned(place: int) -> int:
    return (place + 3) & ~3
