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


def raycast(
    forest: Forest, origins: Any, directions: Any, t_max: Any, mask: Any, *rest: Any
) -> RayHits:
    """`Forest.raycast_many`; ids, t and normals are dask arrays."""
    asked = _same_blocks(origins=origins, directions=directions, t_max=t_max, mask=mask)
    outputs = ((), np.int64), ((), np.float64), ((forest.ndim,), np.float64)
    return RayHits(*_map(forest, 'raycast_many', (*asked, *rest), outputs))


def occluded(
    forest: Forest, origins: Any, directions: Any, t_max: Any, mask: Any, *rest: Any
) -> Any:
    """`Forest.occluded_many` as a dask array."""
    asked = _same_blocks(origins=origins, directions=directions, t_max=t_max, mask=mask)
    return _map(forest, 'occluded_many', (*asked, *rest), (((), np.bool_),))[0]


def nearest(forest: Forest, points: Any, k: int, max_distance: Any, mask: Any) -> Any:
    """`Forest.nearest_many`; ids and distances are dask arrays."""
    where, reach, masks = _same_blocks(points=points, max_distance=max_distance, mask=mask)
    outputs = ((k,), np.int64), ((k,), np.float64)
    return _map(forest, 'nearest_many', (where, k, reach, masks), outputs)


def overlap(forest: Forest, lo: Any, hi: Any, mask: Any, threads: int) -> Any:
    """`Forest.overlap_many`; offsets and ids are dask arrays, the ids in blocks of sizes that are
    known once they are computed.
    """
    import dask.array as da

    asked = *_same_blocks(lo=lo, hi=hi, mask=mask), threads
    sizes, ids = _map(forest, 'overlap_many', asked, (((), np.int64),) * 2, ragged=1)
    return da.concatenate([da.zeros(1, np.int64), da.cumsum(sizes)]), ids


def _same_blocks(**columns: Any) -> tuple[Any, ...]:
    """Arrays of shape (n, ndim) or (n,), cut where the first is; a value for all rows stays."""
    import dask.array as da

    arrays = {name: da.asarray(column) for name, column in columns.items()}
    first, *_ = arrays.values()
    cut = []
    for name, array in arrays.items():
        if array.ndim and len(array) != len(first):
            raise ValueError(f'{name} has {len(array)} rows, not {len(first)}')
        blocks = first.chunks[0], *((-1,) * (array.ndim - 1))
        cut.append(array.rechunk(blocks) if array.ndim else columns[name])
    return tuple(cut)


def _map(
    forest: Forest, query: str, asked: tuple[Any, ...], outputs: Any, *, ragged: int = 0
) -> list[Any]:
    """Ask for each block; the outputs of all blocks, one array each, of these shapes and types.
    The last `ragged` ones have as many rows as the answer has.
    """
    import dask
    import dask.array as da

    blocks = asked[0].chunks[0]
    cut = [one.to_delayed().ravel() if is_dask(one) else [one] * len(blocks) for one in asked]
    answered = [
        dask.delayed(_ask_block, nout=len(outputs))(forest, query, *block)
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


def _ask_block(forest: Forest, query: str, *asked: Any) -> tuple[Any, ...]:
    answer = getattr(forest, query)(*asked)
    if query == 'overlap_many':
        return np.diff(answer[0]), answer[1]
    return answer if isinstance(answer, tuple) else (answer,)
