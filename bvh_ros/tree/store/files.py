# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree as plain arrays: what a file and a pickle hold.

Anybody may have written a file. Nothing is taken from it before it has the form that a tree of its
size has, and no tree is made of it that `validation` finds unsound.
"""

import io
import zipfile
from collections.abc import Iterable
from os import PathLike
from pathlib import Path
from typing import Any

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from .. import checks
from ..nodes import ALL_PLACES, COUNTERS, SERIAL, SLOT_MASK, STATE_PLACES, TURN
from ..validation import array_forms
from . import mapped
from .mapped import put_in_place
from .storage import READ_ONLY, allocate, storage_of

VERSION, WITH_MOTION = 1, 2  # the second holds velocities, too
VERSIONS = VERSION, WITH_MOTION
MOTION = ('moving', 'velocities', 'references')
LEFT = 'left'  # is stored beside them, where times are whole nanoseconds
ARRAYS = ('nodes', 'heights', 'tight', 'handles', 'state')
COPIED = {*ARRAYS, *MOTION}  # by `pack`
# A letter of numpy's for each kind of number or text that a value may be.
VALUES = {'version': 'i', 'ndim': 'i', 'margin': 'if', 'sibling_search': 'U', 'serial': 'i'}

# A node names others, so nodes do not become arbitrarily few bytes: 28 times smaller, at most
# (those of an empty tree). What is yet smaller would fill the memory with what is no tree.
SMALLEST_SHARE = 64
LARGEST_VALUE = 4096  # bytes


class Copied(dict[str, Any]):
    """What `pack` returned, of a tree in this process: it needs no validation."""


def pack(tree: Any) -> dict[str, Any]:
    """The arrays and values that make up a tree, by name."""
    arrays = tree._copied()
    state = arrays.state
    motion = tree._packed_velocities(arrays.handles)
    return {
        'version': WITH_MOTION if motion else VERSION,
        **motion,
        **arrays._asdict(),
        'state': state[:STATE_PLACES],
        'ndim': tree.ndim,
        'margin': tree.margin,
        'sibling_search': tree.sibling_search,
        'serial': int(state[SERIAL]),
        'counters': [(name, int(state[place])) for name, place in COUNTERS.items()],
    }


def save(path: str | PathLike[str], packed: dict[str, Any], to_map: bool) -> None:
    """Write one file under exactly this path: to be mapped, or else an .npz."""
    if to_map:
        if packed['version'] == WITH_MOTION:
            raise ValueError('a tree whose boxes have velocities cannot be saved to be mapped')
        mapped.save(Path(path), packed)
        return
    with put_in_place(Path(path)) as file:
        np.savez_compressed(file, **packed)


def load(path: str | PathLike[str]) -> dict[str, Any]:
    """Read what `save` wrote; ValueError if the file is anything else."""
    if mapped.is_mapped(Path(path)):
        return mapped.load(Path(path))
    data = Path(path).read_bytes()  # an OSError is about the disk; what comes now, the content
    try:
        with zipfile.ZipFile(io.BytesIO(data)) as archive:
            return _read(archive)
    except Exception as error:  # a damaged file makes zipfile and numpy raise errors of many kinds
        raise ValueError(f'{path} is no saved tree: {error}') from None


def _read(archive: zipfile.ZipFile) -> dict[str, Any]:
    _refuse_missing(name[:-4] for name in archive.namelist() if name.endswith('.npy'))
    packed = {}
    for name in (*VALUES, 'counters'):
        packed[name] = _small(archive, name)
        if name == 'version' and _value(packed, name) not in VERSIONS:
            raise ValueError(f'it has format version {packed[name]}; this is for {VERSIONS}')
    if f'{LEFT}.npy' in archive.namelist():
        packed[LEFT] = _small(archive, LEFT)
    forms = {name: _form(archive, name) for name in ARRAYS}
    _check_forms(_value(packed, 'ndim'), forms)
    nodes = archive.getinfo('nodes.npy')
    if nodes.file_size > SMALLEST_SHARE * nodes.compress_size:
        raise ValueError('its nodes are compressed as no tree can be')
    names: tuple[str, ...] = ARRAYS
    if packed['version'] == WITH_MOTION:
        names += MOTION
        _check_motion(_value(packed, 'ndim'), [_form(archive, name) for name in MOTION], forms)
    return packed | {name: _member(archive, name) for name in names}


def _check_motion(ndim: int, forms: list[Any], others: dict[str, Any]) -> None:
    """ValueError unless velocities are those of no more boxes than there is room for."""
    (count,), room = (*forms[0][1], 0)[:1], others['handles'][1][0]
    shapes = [form[1] for form in forms]
    if shapes != [(count,), (count, ndim), (count,)] or count > room:
        raise ValueError(f'its velocities are of shapes {shapes}')


def _refuse_missing(names: Iterable[str]) -> None:
    missing = {'counters', *ARRAYS, *VALUES} - set(names)
    if missing:
        raise ValueError(f'it lacks {sorted(missing)}')


def _small(archive: zipfile.ZipFile, name: str) -> Any:
    if archive.getinfo(f'{name}.npy').file_size > LARGEST_VALUE:
        raise ValueError(f'its {name} is too large')
    return _member(archive, name)


def _member(archive: zipfile.ZipFile, name: str) -> Any:
    with archive.open(f'{name}.npy') as file:
        return npy.read_array(file, allow_pickle=False)


def _form(archive: zipfile.ZipFile, name: str) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of an array, from its header; ValueError if its size is not what they say."""
    with archive.open(f'{name}.npy') as file:
        try:
            return mapped.form_of(file, archive.getinfo(f'{name}.npy').file_size)
        except ValueError as error:
            raise ValueError(f'its {name}: {error}') from None


def _check_forms(ndim: int, forms: dict[str, tuple[Any, Any]]) -> None:
    """ValueError unless the arrays have the types and lengths that belong together."""
    if ndim not in (2, 3):
        raise ValueError(f'its ndim must be 2 or 3, not {ndim}')
    shape = forms['handles'][1]
    if len(shape) != 1 or not 1 <= shape[0] <= SLOT_MASK + 1:
        raise ValueError(f'its handles must be from 1 to {SLOT_MASK + 1}, not of shape {shape}')
    fat = forms['tight'][1] != (0,)
    for name, wanted in array_forms(ndim, shape[0], fat).items():
        if forms[name] != wanted:
            (dtype, shape), (given, length) = wanted, forms[name]
            raise ValueError(
                f'its {name} must be {dtype} of shape {shape}, not {given} of shape {length}'
            )


def _value(packed: dict[str, Any], name: str) -> Any:
    """One number or word."""
    array = np.asarray(packed[name])
    if array.shape != () or array.dtype.kind not in VALUES[name]:
        raise ValueError(f'its {name} is {array.dtype} of shape {array.shape}')
    return array.item()


def _counters(given: Any, names: Iterable[str]) -> dict[str, int]:
    """How often things were done, by name; in a file all of it is text."""
    pairs = np.asarray(given)
    if pairs.dtype.kind != 'U' or pairs.ndim != 2 or pairs.shape[1] != 2:
        raise ValueError('its counters are no names and numbers')
    counts = dict(pairs.tolist())
    if len(counts) != len(pairs) or set(counts) != set(names):
        raise ValueError(f'its counters are {sorted(counts)}')
    if not all(
        count.isascii() and count.isdigit() and len(count) < 19 for count in counts.values()
    ):
        raise ValueError('its counters are not all natural numbers')
    return {name: int(counts[name]) for name in names}


def _sound(packed: Any, counters: Iterable[str]) -> dict[str, Any]:
    """What was kept, each of the kind it must be; ValueError if it is not."""
    if not isinstance(packed, dict):
        raise ValueError(f'a saved tree is a dict, not {type(packed).__name__}')
    _refuse_missing(packed)
    stored = {name: _value(packed, name) for name in VALUES}
    if stored['version'] not in VERSIONS:
        raise ValueError(f'it has format version {stored["version"]}; this is for {VERSIONS}')
    stored |= {name: np.asarray(packed[name]) for name in ARRAYS}
    _check_forms(
        stored['ndim'], {name: (stored[name].dtype, stored[name].shape) for name in ARRAYS}
    )
    return stored | {'counters': _counters(packed['counters'], counters)}


def attach(tree: Any, path: Path, verify: bool) -> None:
    """Let a new tree be what a file written by `mapped.save` holds, read-only and not copied.
    `verify`: read and check all of it.
    """
    header, arrays = mapped.attach(path, verify)
    tree._be(header['ndim'], header['margin'], header['sibling_search'])
    state = np.zeros(ALL_PLACES, np.int64)
    _fill_state(state, header, _counters(header['counters'], tree._COUNTERS))
    state[TURN] = 1  # of a query that never ends
    tree._storage = storage_of(arrays._replace(state=state), READ_ONLY)
    if verify:
        try:
            tree.validate()
        except RuntimeError as error:
            raise ValueError(f'{path} is damaged: {error}') from None


def _fill_state(
    state: NDArray[np.int64], stored: dict[str, Any], counters: dict[str, int]
) -> None:
    state[:STATE_PLACES], state[SERIAL] = stored['state'], stored['serial']
    for name, count in counters.items():
        state[COUNTERS[name]] = count


def unpack(tree: Any, packed: Any) -> None:
    """Fill a new tree; ValueError if what was kept is not a sound one."""
    stored = _sound(packed, tree._COUNTERS)
    tree._be(stored['ndim'], stored['margin'], stored['sibling_search'])
    storage = allocate(stored['ndim'], len(stored['handles']), bool(len(stored['tight'])))
    for name in ARRAYS[:-1]:
        getattr(storage.tree, name)[:] = stored[name]
    _fill_state(storage.tree.state, stored, stored['counters'])
    storage.tree.state[TURN] = 0
    tree._storage = storage
    try:
        if not isinstance(packed, Copied):
            tree.validate()
        if stored['version'] == WITH_MOTION:
            if LEFT in packed:
                tree._count_nanoseconds(checks.limit(LEFT, packed[LEFT]))
            tree.set_velocities(*(packed[name] for name in MOTION))
    except (RuntimeError, KeyError, ValueError) as error:
        raise ValueError(f'the saved tree is not sound: {error}') from None
