# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree as a file that is mapped into memory: opened at once, whatever its size, and shared by
all processes of a machine.

The file: MAGIC, length and CRC-32 of the header (uint32 each, little-endian), the header as JSON,
then the arrays of the tree, each on a page of its own.

When a process maps a file for the first time, it checks the header, the length and the links
between nodes, so that no query leads outside the arrays. Boxes and masks are trusted, unless the
caller asks to verify them. A file that is read without mapping is always checked as a whole.
"""

import functools
import json
import math
import mmap
import os
import secrets
import struct
import sys
import zlib
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.lib import format as npy
from numpy.typing import NDArray

from ..nodes import COUNT, LAST_SERIAL, NONE, ROOT, SLOT_MASK, Tree
from ..validation import COMPLAINTS, SOUND, array_forms, check_structure


@contextmanager
def put_in_place(path: Path) -> Iterator[BinaryIO]:
    """A file to write to, that takes the place of `path` at the end, and leaves nothing behind if
    there is none. A process that reads meanwhile, or has mapped the older one, keeps that.
    """
    path = Path(os.path.realpath(path))  # a link stays one
    if path.exists() and not path.is_file():  # a pipe is written to; a folder says what it is
        with open(path, 'wb') as file:
            yield file
        return
    draft = path.with_name(f'.{secrets.token_hex(8)}.part')  # two may write at once
    try:
        with open(draft, 'xb') as file:
            yield file
        os.replace(draft, path)
    finally:
        draft.unlink(missing_ok=True)


MAGIC = b'BVHTREE\n'
VERSION = 1
HEAD = struct.Struct('<8sII')  # magic, length and CRC-32 of the header
PAGE = 4096
LONGEST_HEADER = 1 << 16
MOST_REMEMBERED = 4096
_linked: dict[tuple[int, ...], None] = {}  # versions of files whose links this process checked
ARRAYS = ('nodes', 'heights', 'tight', 'handles')
KINDS = {
    **dict.fromkeys(('version', 'ndim', 'serial', 'capacity', 'crc'), int),
    'margin': float,
    'sibling_search': str,
    'byteorder': str,
    'fat': bool,
    'state': list,
    'counters': list,
}


def is_mapped(path: Path) -> bool:
    """Whether a file begins as `save` begins it."""
    with open(path, 'rb') as file:
        return file.read(len(MAGIC)) == MAGIC


def save(path: Path, packed: dict[str, Any]) -> None:
    """Write `files.pack` of a tree. A process that has mapped the older file keeps it."""
    header = {name: packed[name] for name in ('ndim', 'margin', 'sibling_search', 'serial')}
    header |= {
        'version': VERSION,
        'byteorder': sys.byteorder,
        'capacity': len(packed['handles']),
        'fat': len(packed['tight']) > 0,
        'state': packed['state'].tolist(),
        'counters': packed['counters'],
    }
    arrays = [packed[name] for name in ARRAYS]
    crc = functools.reduce(_crc, arrays, 0)
    text = json.dumps(header | {'crc': crc}).encode()
    with put_in_place(path) as file:
        file.write(HEAD.pack(MAGIC, len(text), zlib.crc32(text)) + text)
        for array in arrays:
            file.write(bytes(-file.tell() % PAGE))
            file.write(_bytes_of(array))


def load(path: Path) -> dict[str, Any]:
    """Read what `save` wrote, and compare its CRC-32; ValueError if it is anything else."""
    with open(path, 'rb') as file:
        header = _read_header(path, file)
        packed = {'state': np.array(header['state'], np.int64)}
        for name, (dtype, count, offset) in _places(header, file.tell())[0].items():
            file.seek(offset)
            packed[name] = np.fromfile(file, dtype, count)
    if functools.reduce(_crc, (packed[name] for name in ARRAYS), 0) != header['crc']:
        raise ValueError(f'{path} is damaged: the CRC-32 of its arrays is not what it says')
    return header | packed


def attach(path: Path, verify: bool) -> tuple[dict[str, Any], Tree]:
    """Map what `save` wrote: its header, and its arrays; ValueError if it is no such file. A write
    to the arrays would stay in this process. `verify` compares the CRC-32 of the arrays.
    """
    if not is_mapped(path):
        raise ValueError(f'{path} cannot be mapped: it was not saved with mapped=True')
    with open(path, 'rb') as file:
        header = _read_header(path, file)
        places, size = _places(header, file.tell())
        status = os.fstat(file.fileno())
        if status.st_size != size:
            raise ValueError(f'{path} is damaged: it is not {size} bytes long')
        memory = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    arrays = {name: _array_at(memory, *place) for name, place in places.items()}
    tree = Tree(**arrays, state=np.array(header['state'], np.int64))
    version = status.st_dev, status.st_ino, size, status.st_mtime_ns, status.st_ctime_ns
    if version not in _linked:
        kind, node = check_structure(tree.nodes, tree.handles, tree.state)
        if kind != SOUND:
            raise ValueError(f'{path} is damaged: {COMPLAINTS[kind]} (node {node})')
        _linked[version] = None
        if len(_linked) > MOST_REMEMBERED:
            del _linked[next(iter(_linked))]
    if verify and functools.reduce(_crc, arrays.values(), 0) != header['crc']:
        raise ValueError(f'{path} is damaged: the CRC-32 of its arrays is not what it says')
    return header, tree


def map_array(path: Path, count: int) -> NDArray[np.int64]:
    """Map an .npy file of so many integers; ValueError if it is anything else."""
    with open(path, 'rb') as file:
        try:
            dtype, shape = form_of(file, os.fstat(file.fileno()).st_size)
        except Exception as error:  # numpy raises errors of many kinds
            raise ValueError(f'{path} is damaged: {error}') from None
        if (dtype, shape) != (np.dtype(np.int64), (count,)):
            what = f'it holds {dtype} of shape {shape}, not int64 of shape ({count},)'
            raise ValueError(f'{path} is damaged or of another tree: {what}')
        memory = mmap.mmap(file.fileno(), 0, access=mmap.ACCESS_READ)
        return _array_at(memory, dtype, count, file.tell())


def form_of(file: Any, size: int) -> tuple[np.dtype[Any], tuple[int, ...]]:
    """Type and shape of an .npy file of so many bytes, from its header; the file stands behind it
    then. Any exception if the header is damaged; ValueError if the size is not what it says.
    """
    readers = {(1, 0): npy.read_array_header_1_0, (2, 0): npy.read_array_header_2_0}
    shape, _, dtype = readers[npy.read_magic(file)](file)
    if file.tell() + math.prod(shape) * dtype.itemsize != size:
        raise ValueError('it is not of the size that it claims')
    return dtype, shape


def _array_at(memory: mmap.mmap, dtype: np.dtype[Any], count: int, start: int) -> NDArray[Any]:
    return np.frombuffer(memory, dtype, count, start) if count else np.empty(0, dtype)


def _crc(crc: int, array: NDArray[Any]) -> int:
    """The CRC-32 of what came before and an array."""
    return zlib.crc32(_bytes_of(array), crc)


def checksum(path: Path) -> int:
    """The CRC-32 that `save` noted of the arrays; ValueError if it is no such file."""
    with open(path, 'rb') as file:
        crc: int = _read_header(path, file)['crc']
    return crc


def _bytes_of(array: NDArray[Any]) -> memoryview:
    return np.ascontiguousarray(array).view(np.uint8).data


def _read_header(path: Path, file: BinaryIO) -> dict[str, Any]:
    """The header, every value of its kind; the file stands behind it then."""
    head = file.read(HEAD.size)
    magic, length, crc = HEAD.unpack(head) if len(head) == HEAD.size else (b'', 0, 0)
    text = file.read(length) if magic == MAGIC and length <= LONGEST_HEADER else b''
    try:
        if not text or len(text) != length or zlib.crc32(text) != crc:
            raise ValueError('its header is damaged')
        header = json.loads(text)
        if header.get('version') != VERSION:
            raise ValueError(
                f'it has mapped format version {header.get("version")}; this is for {VERSION}'
            )
        wrong = [k for k, kind in KINDS.items() if type(header.get(k)) is not kind]
        if wrong:
            raise ValueError(f'it lacks {wrong}')
        if header['byteorder'] != sys.byteorder:
            raise ValueError(f'it was written on a {header["byteorder"]}-endian machine')
        if header['ndim'] not in (2, 3) or not 1 <= header['capacity'] <= SLOT_MASK + 1:
            raise ValueError('no tree has its ndim or its capacity')
        _check_state(header)
    except ValueError as error:
        raise ValueError(f'{path} is no mapped tree: {error}') from None
    return header


def _check_state(header: dict[str, Any]) -> None:
    """What every query reads first."""
    state, capacity = header['state'], header['capacity']
    (length,) = array_forms(header['ndim'], capacity, header['fat'])['state'][1]
    whole = all(type(n) is int and abs(n) < 1 << 62 for n in state)
    if len(state) != length or not whole or not 1 <= header['serial'] <= LAST_SERIAL + 1:
        raise ValueError('its state is none')
    empty = state[COUNT] == 0 and state[ROOT] == NONE
    if not empty and not (0 < state[COUNT] <= capacity and 0 <= state[ROOT] < 2 * capacity):
        raise ValueError('its root lies outside the tree')


def _places(
    header: dict[str, Any], start: int
) -> tuple[dict[str, tuple[np.dtype[Any], int, int]], int]:
    """Type, length and offset of each array in the file, and how long the file is."""
    forms = array_forms(header['ndim'], header['capacity'], header['fat'])
    places = {}
    for name in ARRAYS:
        dtype, (count,) = forms[name]
        start += -start % PAGE
        places[name] = dtype, count, start
        start += count * dtype.itemsize
    return places, start
