# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows as dask arrays: each block of them asks the forest where the block is."""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

import numpy as np

from ..tree import RayHits

if TYPE_CHECKING:
    from .forest import Forest


def is_dask(*arrays: Any) -> bool:
    """Whether one of them is a dask array; dask is not imported for that."""
    return any(type(array).__module__.partition('.')[0] == 'dask' for array in arrays)


def raycast(forest: Forest, origins: Any, directions: Any, *rest: Any) -> RayHits:
    """`Forest.raycast_many`; ids, t and normals are dask arrays."""
    columns, rest = _same_blocks((origins, directions), rest[:2]), rest[2:]
    outputs = ((), np.int64), ((), np.float64), ((forest.ndim,), np.float64)
    return RayHits(*_map('raycast_many', forest, columns, rest, outputs))


def occluded(forest: Forest, origins: Any, directions: Any, *rest: Any) -> Any:
    """`Forest.occluded_many` as a dask array."""
    columns, rest = _same_blocks((origins, directions), rest[:2]), rest[2:]
    return _map('occluded_many', forest, columns, rest, (((), np.bool_),))[0]


def nearest(forest: Forest, points: Any, k: int, max_distance: Any, mask: Any) -> Any:
    """`Forest.nearest_many`; ids and distances are dask arrays."""
    where, reach, masks = _same_blocks((points,), (max_distance, mask))
    outputs = ((k,), np.int64), ((k,), np.float64)
    return _map('nearest_many', forest, (where, None, reach, masks), (), outputs, k=k)


def overlap(forest: Forest, lo: Any, hi: Any, mask: Any, threads: int) -> Any:
    """`Forest.overlap_many`; offsets and ids are dask arrays, the ids in blocks of sizes that are
    known once they are computed.
    """
    import dask.array as da

    columns = _same_blocks((lo, hi), (mask,))
    sizes, ids = _map('overlap_many', forest, columns, (threads,), (((), np.int64),) * 2, ragged=1)
    return da.concatenate([da.zeros(1, np.int64), da.cumsum(sizes)]), ids


def _same_blocks(rows: tuple[Any, ...], values: tuple[Any, ...]) -> tuple[Any, ...]:
    """Arrays of shape (n, ndim) or (n,), cut at the same rows; a value for all rows stays."""
    import dask.array as da

    whole = [da.asarray(array) for array in (*rows, *values)]
    blocks = whole[0].chunks[0]
    for array, name in zip(whole, ('the first', 'the second', 'a value', 'a value'), strict=False):
        if array.ndim and array.chunks[0] != blocks and array.shape[0] != whole[0].shape[0]:
            raise ValueError(f'{name} has {array.shape[0]} rows, not {whole[0].shape[0]}')
    return tuple(
        array.rechunk((blocks, *((-1,) * (array.ndim - 1)))) if array.ndim else given
        for array, given in zip(whole, (*rows, *values), strict=True)
    )


def _map(
    query: str,
    forest: Forest,
    columns: tuple[Any, ...],
    rest: tuple[Any, ...],
    outputs: Any,
    *,
    k: int | None = None,
    ragged: int = 0,
) -> list[Any]:
    """Ask for each block; the outputs of all blocks, one array each, of these shapes and types.
    The last `ragged` ones have as many rows as the answer has.
    """
    import dask
    import dask.array as da

    blocks = columns[0].chunks[0]
    cut = [
        column.to_delayed().ravel() if is_dask(column) else [column] * len(blocks)
        for column in columns
    ]
    answered = [
        dask.delayed(_ask_block, nout=len(outputs))(forest, query, *block, *rest, k=k)
        for block in zip(*cut, strict=True)
    ]
    return [
        da.concatenate(
            [
                da.from_delayed(
                    answer[i],
                    (np.nan if i >= len(outputs) - ragged else rows, *shape),
                    np.dtype(dtype),
                )
                for answer, rows in zip(answered, blocks, strict=True)
            ]
        )
        for i, (shape, dtype) in enumerate(outputs)
    ]


def _ask_block(forest: Forest, query: str, *asked: Any, k: int | None) -> tuple[Any, ...]:
    if k is not None:
        points, _, *others = asked
        return forest.nearest_many(points, k, *others)
    answer = getattr(forest, query)(*asked)
    if query == 'overlap_many':
        return np.diff(answer[0]), answer[1]
    return answer if isinstance(answer, tuple) else (answer,)
