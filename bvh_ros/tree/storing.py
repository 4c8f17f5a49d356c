# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree as plain arrays: what a file and a pickle hold."""

from os import PathLike
from typing import Any

import numpy as np

from .nodes import SLOT_BITS, STATE_PLACES, aligned_empty, box_dtype, node_dtype

VERSION = 1
ARRAYS = ('nodes', 'heights', 'tight', 'handles', 'state')
VALUES = ('ndim', 'margin', 'sibling_search', 'serial')


def pack(tree: Any) -> dict[str, Any]:
    """The arrays and values that make up a tree, by name."""
    packed: dict[str, Any] = {name: getattr(tree, f'_{name}') for name in ARRAYS}
    return {
        'version': VERSION,
        **packed,
        'ndim': tree.ndim,
        'margin': tree.margin,
        'sibling_search': tree.sibling_search,
        'serial': tree._serial,
        'counters': list(tree._counters.items()),
    }


def save(path: str | PathLike[str], packed: dict[str, Any]) -> None:
    """Write one .npz under exactly this path."""
    with open(path, 'wb') as file:
        np.savez_compressed(file, **packed)


def load(path: str | PathLike[str]) -> dict[str, Any]:
    """Read what `save` wrote; ValueError if the file is anything else."""
    try:
        with open(path, 'rb') as file:
            archive = np.load(file, allow_pickle=False)
            if not isinstance(archive, np.lib.npyio.NpzFile):
                raise ValueError('it is one array')
            packed = {name: archive[name] for name in archive.files}
    except OSError:
        raise
    except Exception as error:  # a damaged file makes numpy raise errors of many kinds
        raise ValueError(f'{path} is no saved tree: {error}') from None
    missing = {'version', 'counters', *ARRAYS, *VALUES} - set(packed)
    if missing:
        raise ValueError(f'{path} is no saved tree: it lacks {sorted(missing)}')
    version = int(packed['version'])
    if version != VERSION:
        raise ValueError(f'{path} has format version {version}; this is for version {VERSION}')
    return packed


def _check_arrays(ndim: int, packed: dict[str, Any]) -> None:
    """ValueError unless the arrays have the types and lengths that belong together."""
    capacity = len(packed['handles'])
    fat = (capacity,) if len(packed['tight']) else (0,)
    kinds = {
        'nodes': (node_dtype(ndim), (2 * capacity,)),
        'heights': (np.dtype(np.int16), (2 * capacity,)),
        'tight': (box_dtype(ndim), fat),
        'handles': (np.dtype(np.int64), (capacity,)),
        'state': (np.dtype(np.int64), (STATE_PLACES,)),
    }
    for name, (dtype, shape) in kinds.items():
        array = packed[name]
        if array.dtype != dtype or array.shape != shape:
            raise ValueError(
                f'the saved {name} must be {dtype} of shape {shape}, '
                f'not {array.dtype} of shape {array.shape}'
            )


def unpack(tree: Any, packed: dict[str, Any]) -> None:
    """Fill a new tree; ValueError or RuntimeError if what was kept is not a sound one."""
    tree.__init__(
        int(packed['ndim']),
        margin=float(packed['margin']),
        sibling_search=str(packed['sibling_search']),
    )
    _check_arrays(tree.ndim, packed)
    tree._serial = int(packed['serial'])
    if tree._serial <= int(packed['handles'].max(initial=0)) >> SLOT_BITS:
        raise ValueError(f'the saved next serial number {tree._serial} was given already')
    tree._counters = {str(name): int(count) for name, count in packed['counters']}
    for name in ARRAYS:
        setattr(tree, f'_{name}', np.array(packed[name]))
    tree._nodes = aligned_empty(len(packed['nodes']), packed['nodes'].dtype)
    tree._nodes[:] = packed['nodes']
    tree.validate()
