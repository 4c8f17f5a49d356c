# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Arrays of points as the bytes of a MarkerArray.

A Python object for every point would take longer than to find it: a drawing of ten thousand boxes
has hundreds of thousands. The fields are those that `cdr.marker_array` reads.
"""

from __future__ import annotations

import struct
import sys
from collections.abc import Sequence
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from numpy.typing import NDArray
from visualization_msgs.msg import Marker

IDENTITY = (0.0, 0.0, 0.0, 1.0)
WHITE = (1.0, 1.0, 1.0, 1.0)
HEADER = bytes((0, int(sys.byteorder == 'little'), 0, 0))
ORIGIN = (0.0, 0.0, 0.0)


Vector = Sequence[float] | NDArray[np.float64]


def _no_points() -> NDArray[np.float64]:
    return np.empty((0, 3))


@dataclass(frozen=True)
class Drawing:
    """What a marker needs to be drawn; the rest of its fields is zero."""

    kind: int  # Marker.CUBE_LIST and so on
    scale: Vector
    colour: Sequence[float] = WHITE  # red, green, blue, alpha: 0 to 1
    namespace: str = ''
    position: Vector = ORIGIN
    orientation: Vector = IDENTITY
    points: NDArray[np.float64] = field(default_factory=_no_points)  # (n, 3)
    colours: NDArray[np.float32] | None = None  # (n, 4), one a point
    text: str = ''


def marker_array(drawings: Sequence[Drawing], frame_id: str, stamp: int) -> bytes:
    """Return a serialised MarkerArray that draws this and nothing else.

    Parameters
    ----------
    frame_id : str
        Frame of all of them.
    stamp : int
        ns.
    """
    writer = _Writer()
    writer.put('I', 1 + len(drawings))
    clear = Drawing(Marker.CUBE, (0.0, 0.0, 0.0))
    _write(writer, clear, frame_id, stamp, 0, Marker.DELETEALL)
    for number, drawing in enumerate(drawings):
        _write(writer, drawing, frame_id, stamp, number, Marker.ADD)
    return bytes(writer.data)


class _Writer:
    """Appends values, each aligned to its own size counted from the end of the header."""

    def __init__(self) -> None:
        self.data = bytearray(HEADER)

    def put(self, kinds: str, *values: Any) -> None:
        self._align(struct.calcsize(kinds[-1]))
        self.data += struct.pack(f'={kinds}', *values)

    def string(self, text: str) -> None:
        characters = text.encode() + b'\0'
        self.put('I', len(characters))
        self.data += characters

    def table(self, rows: NDArray[Any]) -> None:
        self.put('I', len(rows))
        if len(rows):
            self._align(rows.itemsize)
            self.data += rows.tobytes()

    def _align(self, size: int) -> None:
        self.data += bytes(-(len(self.data) - len(HEADER)) % size)


def _write(
    writer: _Writer, drawing: Drawing, frame_id: str, stamp: int, number: int, action: int
) -> None:
    """Append a Marker, its fields in the order of their definition."""
    writer.put('iI', *divmod(stamp, 1_000_000_000))
    writer.string(frame_id)
    writer.string(drawing.namespace)
    writer.put('iii', number, drawing.kind, action)
    writer.put('10d', *drawing.position, *drawing.orientation, *drawing.scale)
    writer.put('4f', *drawing.colour)
    writer.put('iI', 0, 0)  # lifetime: for ever
    writer.put('?', False)  # frame_locked
    writer.table(np.asarray(drawing.points, np.float64))
    colours = drawing.colours
    writer.table(np.empty((0, 4), np.float32) if colours is None else colours)
    writer.string('')  # texture_resource
    writer.put('iI', 0, 0)  # texture: header, format and data
    for _ in range(2):
        writer.string('')
    writer.put('I', 0)
    writer.put('I', 0)  # uv_coordinates
    writer.string(drawing.text)
    for _ in range(2):
        writer.string('')  # mesh_resource, mesh_file.filename
    writer.put('I', 0)  # mesh_file.data
    writer.put('?', False)  # mesh_use_embedded_materials
