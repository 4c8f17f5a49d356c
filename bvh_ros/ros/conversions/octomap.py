# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The occupied leaves of an octree as OctoMap writes it (Hornung et al. 2013, Autonomous Robots).

A stream holds the nodes in depth-first order, children 0 to 7: bit 0 of a child's number is its
half along x, bit 1 along y, bit 2 along z.

- A binary map has a record of two bytes for each inner node: two bits a child, the first child
  lowest, which are 0 for none, 1 for a free leaf, 2 for an occupied one, 3 for an inner node.
- A full map has a record for each node: its log odds as a float32, three bytes of colour in a
  ColorOcTree, and a byte with a bit for each child.
"""

from __future__ import annotations

import math
from collections.abc import Generator
from functools import partial
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.cdr.any_message import Columns
from bvh_ros.scene import ShapeKind, Shapes, unchecked_shapes
from bvh_ros.scene.store import run_in_thread
from bvh_ros.tree.compiler import lean_kernel, stack_array

LEVELS = 16  # below the root; the smallest cubes are 1 / 2^16 of the root
DEPTHS = LEVELS + 1
MANY = 50_000  # bytes, that take longer than 5 ms
FIELDS = 'header', 'binary', 'id', 'resolution', 'data'  # of octomap_msgs/Octomap
HALF = 1 << (LEVELS - 1)  # the root goes from -HALF to HALF smallest cubes along each axis
COLOURS = {'OcTree': 0, 'OcTreeStamped': 0, 'ColorOcTree': 3}  # bytes in a record of a full map
TRUNCATED, TOO_DEEP = -1, -2
REASONS = {
    TRUNCATED: 'the octree goes on beyond the end of its data',
    TOO_DEEP: f'the octree has more than {LEVELS} levels',
}


class Octree(NamedTuple):
    """An octree as a message brings it."""

    kind: str  # the class of OctoMap that wrote it
    binary: bool
    resolution: float  # m, edge of the smallest cubes
    data: NDArray[np.uint8]

    @classmethod
    def read(cls, columns: Columns, prefix: str = '') -> Octree:
        """The one that a message has in the fields that begin so."""
        (kind,) = columns.texts(f'{prefix}id')
        binary, resolution = (
            columns.numbers(f'{prefix}{name}').item() for name in ('binary', 'resolution')
        )
        data = columns.numbers(f'{prefix}data').view(np.uint8)[:, 0]
        return cls(kind, bool(binary), resolution, data)


@lean_kernel
def walk(inner, occupied, own, cubes):
    """Go through the records of an octree; return how many there are, or why it is none.

    Parameters
    ----------
    inner, occupied : (n,) uint8 arrays
        Which children of a record have records, and which others are occupied leaves.
    own : (n,) bool array
        Whether the record itself is an occupied leaf.
    cubes : (m, 4) int64 array
        For the occupied leaves: the lowest corner and the edge, in smallest cubes.
    """
    waiting, x = stack_array(DEPTHS, np.int64), stack_array(DEPTHS, np.int64)
    y, z = stack_array(DEPTHS, np.int64), stack_array(DEPTHS, np.int64)
    x[0] = y[0] = z[0] = -HALF
    depth = record = found = np.int64(0)
    while True:
        if record == inner.shape[0]:
            return np.int64(TRUNCATED)
        edge = np.int64(1) << (LEVELS - depth)
        if own[record]:
            cubes[found, 0], cubes[found, 1], cubes[found, 2] = x[depth], y[depth], z[depth]
            cubes[found, 3] = edge
            found += 1
        edge >>= 1
        if edge == 0 and (inner[record] or occupied[record]):
            return np.int64(TOO_DEEP)
        for child in range(8):
            if occupied[record] >> child & 1:
                cubes[found, 0] = x[depth] + (child & 1) * edge
                cubes[found, 1] = y[depth] + (child >> 1 & 1) * edge
                cubes[found, 2] = z[depth] + (child >> 2) * edge
                cubes[found, 3] = edge
                found += 1
        waiting[depth] = inner[record]
        record += 1
        while depth >= 0 and waiting[depth] == 0:
            depth -= 1
        if depth < 0:
            return record
        child = 0
        while waiting[depth] >> child & 1 == 0:
            child += 1
        waiting[depth] ^= 1 << child
        edge = np.int64(1) << (LEVELS - depth - 1)
        x[depth + 1] = x[depth] + (child & 1) * edge
        y[depth + 1] = y[depth] + (child >> 1 & 1) * edge
        z[depth + 1] = z[depth] + (child >> 2) * edge
        depth += 1


def boxes(tree: Octree, *, occupied_at: float, most: int) -> Generator[None, None, Shapes]:
    """Return the occupied leaves as disjoint cubes in the frame of the octree. Those of a large
    one are found in the helper thread, and others have their turn.

    Parameters
    ----------
    occupied_at : float
        Leaves of a full map with at least this probability are occupied.
    most : int
        More leaves than this are refused, all of them.

    Raises
    ------
    ValueError
        If the data are no octree, or of a class that is not known here; if the resolution is not a
        length, or there are too many leaves.
    """
    find = partial(_boxes, tree, occupied_at, most)
    if len(tree.data) < MANY:
        return find()
    return (yield from run_in_thread(find))


def _boxes(tree: Octree, occupied_at: float, most: int) -> Shapes:
    if not (math.isfinite(tree.resolution) and tree.resolution > 0.0):
        raise ValueError(f'resolution {tree.resolution} is not a length')
    read = _binary if tree.binary else _full
    inner, occupied, own = read(tree, occupied_at)
    count = int(np.unpackbits(occupied).sum()) + int(np.count_nonzero(own))
    if count > most:
        raise ValueError(f'the octree has {count} occupied leaves, more than {most}')
    cubes = np.empty((count, 4), np.int64)
    if len(inner):
        end = int(walk(inner, occupied, own, cubes))
        if end < 0:
            raise ValueError(REASONS[end])
        if end < len(inner):
            raise ValueError(f'the octree ends after {end} of {len(inner)} nodes in its data')
    edge = cubes[:, 3:] * tree.resolution
    return unchecked_shapes(
        np.full(count, ShapeKind.BOX, np.uint8),
        (cubes[:, :3] + 0.5 * cubes[:, 3:]) * tree.resolution,
        np.tile((0.0, 0.0, 0.0, 1.0), (count, 1)),
        np.repeat(edge, 3, axis=1),
    )


Records = tuple[NDArray[np.uint8], NDArray[np.uint8], NDArray[np.bool_]]


def _binary(tree: Octree, _occupied_at: float) -> Records:
    bits = _records(tree.data, np.dtype('<u2'))
    low, high = bits & 0x5555, bits >> 1 & 0x5555
    return _packed(low & high), _packed(high & ~low), np.zeros(len(bits), np.bool_)


def _packed(bits: NDArray[Any]) -> NDArray[np.uint8]:
    """Every other bit, the lowest first."""
    bits = (bits | bits >> 1) & 0x3333
    bits = (bits | bits >> 2) & 0x0F0F
    return ((bits | bits >> 4) & 0x00FF).astype(np.uint8)


def _full(tree: Octree, occupied_at: float) -> Records:
    if tree.kind not in COLOURS:
        known = ', '.join(COLOURS)
        raise ValueError(f"a full map is read if it is one of {known}, not '{tree.kind[:80]}'")
    fields = [('odds', '<f4'), ('colour', 'u1', (COLOURS[tree.kind],)), ('children', 'u1')]
    records = _records(tree.data, np.dtype(fields))
    inner, odds = records['children'].copy(), records['odds']
    leaf = inner == 0
    if np.isnan(odds[leaf]).any():
        raise ValueError('the log odds of a leaf are NaN')
    with np.errstate(divide='ignore'):
        least = np.float32(np.log(occupied_at) - np.log1p(-occupied_at))
    return inner, np.zeros(len(inner), np.uint8), leaf & (odds >= least)


def _records(data: NDArray[np.uint8], dtype: np.dtype) -> NDArray:
    """The records of a stream."""
    if len(data) % dtype.itemsize:
        raise ValueError(
            f'the octree has {len(data)} bytes of data, which are no records of {dtype.itemsize}'
        )
    return np.frombuffer(data, dtype)


def exercise() -> None:
    """Call the kernel as messages do."""
    _boxes(Octree('', True, 1.0, np.zeros(2, np.uint8)), occupied_at=0.5, most=0)
