# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree as plain arrays: what a file and a pickle hold."""

import zipfile
from os import PathLike
from typing import Any

import numpy as np

from .nodes import aligned_empty

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
    """Read what `save` wrote."""
    try:
        with np.load(path, allow_pickle=False) as file:
            packed = {name: file[name] for name in file.files}
    except (zipfile.BadZipFile, EOFError, ValueError) as error:
        raise ValueError(f'{path} is no saved tree: {error}') from None
    missing = {'version', 'counters', *ARRAYS, *VALUES} - set(packed)
    if missing:
        raise ValueError(f'{path} is no saved tree: it lacks {sorted(missing)}')
    version = int(packed['version'])
    if version != VERSION:
        raise ValueError(f'{path} has format version {version}; this is for version {VERSION}')
    return packed


def unpack(tree: Any, packed: dict[str, Any]) -> None:
    """Fill a new tree; RuntimeError if what was kept is not a sound one."""
    tree.ndim, tree.margin = int(packed['ndim']), float(packed['margin'])
    tree.sibling_search, tree._serial = str(packed['sibling_search']), int(packed['serial'])
    tree._counters = {str(name): int(count) for name, count in packed['counters']}
    for name in ARRAYS:
        setattr(tree, f'_{name}', np.array(packed[name]))
    nodes = aligned_empty(len(tree._nodes), tree._nodes.dtype)
    nodes[:] = tree._nodes
    tree._nodes = nodes
    tree._start()
    tree.validate()
