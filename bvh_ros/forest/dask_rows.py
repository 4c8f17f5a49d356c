# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rows as dask arrays: each block of them asks the forest where the block is."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any

import numpy as np

from ..tree.access import checks

VALUES = 't_max', 'max_distance', 'mask'  # one for all rows, or one a row
Query = Callable[..., Any]  # a method of `Forest`


def are_given(executor: Any, *columns: Any) -> bool:
    """Whether one of the columns is a dask array; ValueError if there is an executor, too, which
    would not be used.
    """
    if not any(map(is_dask, columns)):
        return False
    if executor is not None:
        raise ValueError('executor must be None where rows are dask arrays: Dask asks then')
    return True


def is_dask(array: Any) -> bool:
    """Whether this is a dask array; dask is not imported for that."""
    return type(array).__module__.partition('.')[0] == 'dask'


def rays(
    query: Query,
    outputs: Any,
    ndim: int,
    origins: Any,
    directions: Any,
    t_max: Any,
    mask: Any,
    skip_inside: bool,
    threads: int,
) -> list[Any]:
    """`Forest.raycast_many` or `occluded_many`; the outputs are dask arrays."""
    rest = checks.flag('skip_inside', skip_inside), checks.whole('threads', threads, 1)
    columns = {'origins': origins, 'directions': directions, 't_max': t_max, 'mask': mask}
    return _map(query, (*_same_blocks(ndim, **columns), *rest), outputs)


def nearest(
    query: Query, ndim: int, k: int, points: Any, max_distance: Any, mask: Any
) -> tuple[Any, Any]:
    """`Forest.nearest_many`; ids and distances are dask arrays."""
    where, reach, masks = _same_blocks(ndim, points=points, max_distance=max_distance, mask=mask)
    outputs = ((k,), np.int64), ((k,), np.float64)
    ids, distances = _map(query, (where, k, reach, masks), outputs)
    return ids, distances


def overlap(query: Query, ndim: int, threads: int, **columns: Any) -> tuple[Any, Any]:
    """`Forest.overlap_many`; offsets and ids are dask arrays, the ids in blocks of sizes that are
    known once they are computed.
    """
    import dask.array as da

    given = *_same_blocks(ndim, **columns), threads
    sizes, ids = _map(query, given, (((), np.int64),) * 2, ragged=True)
    return da.concatenate([da.zeros(1, np.int64), da.cumsum(sizes)]), ids


def _same_blocks(ndim: int, **columns: Any) -> list[Any]:
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
    return cut


def _map(query: Query, arguments: Any, outputs: Any, *, ragged: bool = False) -> list[Any]:
    """Ask for each block; the outputs of all blocks, one array each, of these shapes and types.
    `ragged`: the answers are offsets, which become sizes, and rows of any number.
    """
    import dask
    import dask.array as da

    blocks = arguments[0].chunks[0]
    cut = [one.to_delayed().ravel() if is_dask(one) else [one] * len(blocks) for one in arguments]
    answered = [
        dask.delayed(_ask_block, nout=len(outputs))(query, ragged, *block)
        for block in zip(*cut, strict=True)
    ]
    return [
        da.concatenate(
            [
                da.from_delayed(
                    answer[i], (np.nan if ragged and i else rows, *shape), np.dtype(dtype)
                )
                for answer, rows in zip(answered, blocks, strict=True)
            ]
        )
        for i, (shape, dtype) in enumerate(outputs)
    ]


def _ask_block(query: Query, ragged: bool, *arguments: Any) -> tuple[Any, ...]:
    answer = query(*arguments)
    if ragged:
        return np.diff(answer[0]), answer[1]
    return answer if isinstance(answer, tuple) else (answer,)
