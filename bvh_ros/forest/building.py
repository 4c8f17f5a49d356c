# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that may not fit into memory become parts of bounded size, near boxes in one part.

All boxes are written to a pile on disk. A pile too large for a part is dealt out, in the order of
a Hilbert curve through a grid over its own bounds, to piles of consecutive cells; so one far box
costs a level, not the order of the others.
"""

import itertools
import json
import os
import shutil
import tempfile
import zlib
from collections.abc import Iterable, Iterator
from functools import cache
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tree.access import OpenTree, checks, mapped

VERSION = 3
HEADER, TOP = 'forest.json', 'top.tree'
ROWS_AT_ONCE = 1 << 18  # of a pile in memory
CELL_BITS = 4  # an axis of the grid


class Pile(NamedTuple):
    """Boxes on disk, in the order of their ids."""

    file: Path
    rows: int
    lo: NDArray[np.float64]
    hi: NDArray[np.float64]


def part_file(folder: Path, number: int) -> Path:
    """The tree of a part."""
    return folder / f'part-{number:06}.tree'


def ids_file(folder: Path, number: int) -> Path:
    """The ids of a part's boxes, by slot, and at the end the checksum of its tree."""
    return folder / f'part-{number:06}.ids.npy'


def row_dtype(ndim: int) -> np.dtype[Any]:
    """A box in a pile."""
    corner = ('<f8', (ndim,))
    return np.dtype([('id', '<i8'), ('lo', *corner), ('hi', *corner), ('mask', '<u4')])


def build(folder: Path, chunks: Iterable[Any], max_boxes: int) -> None:
    """Write a forest; the folder appears when it is whole."""
    taken = FileExistsError(f'{folder} exists already')
    if os.path.lexists(folder):
        raise taken
    work = Path(tempfile.mkdtemp(prefix=f'.{folder.name}.', dir=folder.parent))
    try:
        pile = _gather(work / 'all', chunks)
        parts = _plant(work, pile, max_boxes)
        header = {
            'version': VERSION,
            'ndim': len(pile.lo),
            'top': mapped.checksum(work / TOP),
            'parts': parts,
        }
        (work / HEADER).write_text(json.dumps(header))
        try:
            os.rename(work, folder)
        except OSError:
            if os.path.lexists(folder):  # another builder was faster
                raise taken from None
            raise
    finally:
        shutil.rmtree(work, ignore_errors=True)


def _gather(file: Path, chunks: Iterable[Any]) -> Pile:
    """Write all chunks to one pile; ValueError, naming the chunk, if one is no boxes."""
    pile = None
    for number, chunk in enumerate(chunks):
        try:
            low, high, masks = _boxes_of(chunk, len(pile.lo) if pile else 0)
        except ValueError as error:
            raise ValueError(f'chunk {number}: {error}') from None
        pile = pile or _empty_pile(file, low.shape[1])
        rows = np.empty(len(low), row_dtype(len(pile.lo)))
        rows['id'] = np.arange(pile.rows, pile.rows + len(low))
        rows['lo'], rows['hi'], rows['mask'] = low, high, masks
        pile = _append(pile, rows)
    if pile is None:
        raise ValueError('chunks are none: no box says whether the forest is planar')
    return pile


def _boxes_of(chunk: Any, ndim: int) -> tuple[Any, Any, Any]:
    if not isinstance(chunk, (tuple, list)) or len(chunk) not in (2, 3):
        raise ValueError('must be (lo, hi) or (lo, hi, mask)')
    lo = np.asarray(chunk[0])
    if not ndim:
        if lo.ndim != 2 or lo.shape[1] not in (2, 3):
            raise ValueError(f'lo must have shape (n, 2) or (n, 3), not {lo.shape}')
        ndim = lo.shape[1]
    low, high = checks.boxes(chunk[0], chunk[1], ndim)
    return low, high, checks.masks(chunk[2] if len(chunk) == 3 else 1, len(low))


def _plant(work: Path, whole: Pile, max_boxes: int) -> list[tuple[int, int, int]]:
    """Write the trees of all parts, in the order of the curve, and the tree over them; how many
    boxes each part has, its checksum, and that of its ids.
    """
    piles, bounds, parts = [whole], list[tuple[Any, Any, Any]](), list[tuple[int, int, int]]()
    while piles:
        pile = piles.pop()
        if pile.rows > max_boxes:
            piles += reversed(_deal(pile, max_boxes))
        elif pile.rows:
            mask, checksum, of_ids = _plant_part(work, len(parts), pile)
            bounds.append((pile.lo, pile.hi, mask))
            parts.append((pile.rows, checksum, of_ids))
        pile.file.unlink()
    ndim = len(whole.lo)
    top = OpenTree(ndim, capacity=max(len(bounds), 1))
    if bounds:
        lo, hi, masks = (np.array(column) for column in zip(*bounds, strict=True))
        top.insert_many(lo, hi, masks)
    top.save(work / TOP, mapped=True)
    return parts


def _plant_part(work: Path, number: int, pile: Pile) -> tuple[np.uint32, int, int]:
    """Write one part; return all its masks, the checksum of its tree, which follows the ids, too
    (files of two parts or forests do not go together), and that of the ids.
    """
    rows = np.fromfile(pile.file, row_dtype(len(pile.lo)))
    tree = OpenTree.from_boxes(rows['lo'], rows['hi'], mask=rows['mask'])
    tree.save(part_file(work, number), mapped=True)
    ids = np.empty(len(rows) + 1, np.int64)
    ids[tree.slots(tree.ids())] = rows['id']
    ids[-1] = checksum = mapped.checksum(part_file(work, number))
    np.save(ids_file(work, number), ids)
    return np.bitwise_or.reduce(rows['mask']), checksum, zlib.crc32(ids.tobytes())


def _deal(pile: Pile, max_boxes: int) -> list[Pile]:
    """Deal a pile out to smaller ones, in the order of the curve, so that few are much smaller
    than a part. Boxes whose centers are all in one cell are dealt out by their ids.
    """
    ndim = len(pile.lo)
    lo, hi = _bounds_of_centers(pile)
    counts = np.zeros(1 << (CELL_BITS * ndim), np.int64)
    for rows in _read(pile):
        counts += np.bincount(cells(_centers(rows), lo, hi), minlength=len(counts))
    by_id = counts.max() == pile.rows
    pile_of = _runs(counts, max_boxes)
    number = -(-pile.rows // max_boxes) if by_id else int(pile_of[-1]) + 1
    files = [pile.file.with_name(f'{pile.file.name}.{i}') for i in range(number)]
    dealt = [_empty_pile(file, ndim) for file in files]
    read_rows = 0
    for rows in _read(pile):
        if by_id:
            goes = (np.arange(read_rows, read_rows + len(rows))) // max_boxes
        else:
            goes = pile_of[cells(_centers(rows), lo, hi)]
        read_rows += len(rows)
        for i in np.unique(goes):
            dealt[i] = _append(dealt[i], rows[goes == i])
    return [one for one in dealt if one.rows]


def _runs(counts: NDArray[np.int64], max_boxes: int) -> NDArray[np.int64]:
    """Which pile each cell goes to: consecutive cells share one as long as it is a part."""
    pile_of, pile, filled = np.empty(len(counts), np.int64), 0, 0
    for cell, count in enumerate(counts.tolist()):
        if filled and filled + count > max_boxes:
            pile, filled = pile + 1, 0
        pile_of[cell] = pile
        filled += count
    return pile_of


def _empty_pile(file: Path, ndim: int) -> Pile:
    return Pile(file, 0, np.full(ndim, np.inf), np.full(ndim, -np.inf))


def _append(pile: Pile, rows: NDArray[Any]) -> Pile:
    with open(pile.file, 'ab') as file:
        file.write(rows.view(np.uint8).data)  # unlike tofile, says that the disk is full
    lo = rows['lo'].min(0, initial=np.inf)
    hi = rows['hi'].max(0, initial=-np.inf)
    lo, hi = np.minimum(pile.lo, lo), np.maximum(pile.hi, hi)
    return Pile(pile.file, pile.rows + len(rows), lo, hi)


def _read(pile: Pile) -> Iterator[NDArray[Any]]:
    with open(pile.file, 'rb') as file:
        while len(rows := np.fromfile(file, row_dtype(len(pile.lo)), ROWS_AT_ONCE)):
            yield rows


def _centers(rows: NDArray[Any]) -> NDArray[np.float64]:
    return np.asarray(rows['lo'] * 0.5 + rows['hi'] * 0.5)


def _bounds_of_centers(pile: Pile) -> tuple[Any, Any]:
    lo, hi = np.full(len(pile.lo), np.inf), np.full(len(pile.lo), -np.inf)
    for rows in _read(pile):
        centers = _centers(rows)
        lo, hi = np.minimum(lo, centers.min(0)), np.maximum(hi, centers.max(0))
    return lo, hi


# ---- cells of a grid in the order of a Hilbert curve: consecutive ones are neighbours


def cells(centers: NDArray[np.float64], lo: Any, hi: Any) -> NDArray[np.int64]:
    """Number on the curve of the cell of each center, shape (n, ndim), in a grid over the box from
    `lo` to `hi`: from 0 to ``2**(CELL_BITS * ndim) - 1``.
    """
    lo, hi = np.asarray(lo), np.asarray(hi)
    half = np.maximum(hi * 0.5 - lo * 0.5, 1e-300)
    place = (centers * 0.5 - lo * 0.5) / half  # halves: a difference of finite doubles is finite
    last = (1 << CELL_BITS) - 1
    columns = np.clip(place * (last + 1), 0, last).astype(np.int64).T
    return _numbers(centers.shape[1])[tuple(columns)]


@cache
def _numbers(ndim: int) -> NDArray[np.int64]:
    """The number of every cell, shape (2**CELL_BITS,) * ndim."""
    numbers = np.empty((1 << CELL_BITS,) * ndim, np.int64)
    for cell in itertools.product(range(1 << CELL_BITS), repeat=ndim):
        numbers[cell] = _number(list(cell))
    return numbers


def _number(axes: list[int]) -> int:
    """Skilling 2004, "Programming the Hilbert curve": from a cell to the bits of its number, which
    come out transposed.
    """
    bit = 1 << (CELL_BITS - 1)
    while bit > 1:
        for i in range(len(axes)):
            if axes[i] & bit:
                axes[0] ^= bit - 1
            else:
                flipped = (axes[0] ^ axes[i]) & (bit - 1)
                axes[0] ^= flipped
                axes[i] ^= flipped
        bit >>= 1
    for i in range(1, len(axes)):
        axes[i] ^= axes[i - 1]
    flips, bit = 0, 1 << (CELL_BITS - 1)
    while bit > 1:
        if axes[-1] & bit:
            flips ^= bit - 1
        bit >>= 1
    number = 0
    for level in reversed(range(CELL_BITS)):
        for axis in axes:
            number = number << 1 | ((axis ^ flips) >> level & 1)
    return number
