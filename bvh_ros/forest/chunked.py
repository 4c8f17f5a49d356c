# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows as dask arrays: each block of them asks the forest where the block is."""

from __future__ import annotations

import math
from typing import TYPE_CHECKING, Any

import numpy as np

from ..tree import RayHits

if TYPE_CHECKING:
    from .forest import Forest


VALUES = 't_max', 'max_distance', 'mask'  # one for all rows, or one a row


def are_meant(executor: Any, *columns: Any) -> bool:
    """Whether one of the columns is a dask array; ValueError if there is an executor beside it,
    which nobody would ask.
    """
    if not any(map(is_dask, columns)):
        return False
    if executor is not None:
        raise ValueError('executor must be None where rows are dask arrays: Dask asks then')
    return True


def is_dask(array: Any) -> bool:
    """Whether this is a dask array; dask is not imported for that."""
    return type(array).__module__.partition('.')[0] == 'dask'


def raycast(
    forest: Forest, origins: Any, directions: Any, t_max: Any, mask: Any, *rest: Any
) -> RayHits:
    """`Forest.raycast_many`; ids, t and normals are dask arrays."""
    asked = _rays(forest.ndim, origins, directions, t_max, mask)
    outputs = ((), np.int64), ((), np.float64), ((forest.ndim,), np.float64)
    return RayHits(*_map(forest, 'raycast_many', (*asked, *rest), outputs))


def occluded(
    forest: Forest, origins: Any, directions: Any, t_max: Any, mask: Any, *rest: Any
) -> Any:
    """`Forest.occluded_many` as a dask array."""
    asked = _rays(forest.ndim, origins, directions, t_max, mask)
    return _map(forest, 'occluded_many', (*asked, *rest), (((), np.bool_),))[0]


def nearest(forest: Forest, points: Any, k: int, max_distance: Any, mask: Any) -> Any:
    """`Forest.nearest_many`; ids and distances are dask arrays."""
    where, reach, masks = _same_blocks(
        forest.ndim, points=points, max_distance=max_distance, mask=mask
    )
    outputs = ((k,), np.int64), ((k,), np.float64)
    return _map(forest, 'nearest_many', (where, k, reach, masks), outputs)


def overlap(forest: Forest, lo: Any, hi: Any, mask: Any, threads: int) -> Any:
    """`Forest.overlap_many`; offsets and ids are dask arrays, the ids in blocks of sizes that are
    known once they are computed.
    """
    import dask.array as da

    asked = *_same_blocks(forest.ndim, lo=lo, hi=hi, mask=mask), threads
    sizes, ids = _map(forest, 'overlap_many', asked, (((), np.int64),) * 2, ragged=1)
    return da.concatenate([da.zeros(1, np.int64), da.cumsum(sizes)]), ids


def _rays(ndim: int, origins: Any, directions: Any, t_max: Any, mask: Any) -> tuple[Any, ...]:
    return _same_blocks(ndim, origins=origins, directions=directions, t_max=t_max, mask=mask)


def _same_blocks(ndim: int, **columns: Any) -> tuple[Any, ...]:
    """Arrays of shape (n, ndim) or (n,), cut where the first is; a value for all rows stays."""
    import dask.array as da

    first, cut = None, list[Any]()
    for name, column in columns.items():
        if name in VALUES and not is_dask(column) and np.ndim(column) == 0:
            cut.append(column)
            continue
        array = da.asarray(column)
        if not all(map(math.isfinite, array.shape)):
            raise ValueError(f'{name} has blocks of unknown size: call its compute_chunk_sizes()')
        first = array if first is None else first
        if name in VALUES and array.shape == ():
            array = da.broadcast_to(array, (len(first),))
        wide = () if name in VALUES else (ndim,)
        if array.shape != (*first.shape[:1], *wide):
            shape = ', '.join(map(str, ('n', *wide)))
            raise ValueError(f'{name} must have shape ({shape}), all of one n, not {array.shape}')
        cut.append(array.rechunk((first.chunks[0], *((-1,) * len(wide)))))
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
