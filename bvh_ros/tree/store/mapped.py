# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A tree as a file that is mapped into memory: opened at once, whatever its size, and shared by
all processes of a machine.

The file: MAGIC, length and CRC-32 of the header (uint32 each, little-endian), the header as JSON,
then the arrays of the tree, each on a page of its own.

A file that is mapped is not read before it is used, so it is trusted: only its header and its
length are checked. Who reads it without mapping it gets the checks that any file gets.
"""

import json
import mmap
import os
import struct
import sys
import zlib
from pathlib import Path
from typing import Any, BinaryIO

import numpy as np
from numpy.typing import NDArray

from ..nodes import COUNT, LAST_SERIAL, NONE, ROOT, SLOT_MASK
from ..validation import array_forms
from .drafts import put_in_place

MAGIC = b'BVHTREE\n'
VERSION = 1
HEAD = struct.Struct('<8sII')  # magic, length and CRC-32 of the header
PAGE = 4096
LONGEST_HEADER = 1 << 16
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
    """Write `files.pack` of a tree. Whoever has mapped an older file of this name keeps it."""
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
    crc = 0
    for array in arrays:
        crc = zlib.crc32(_bytes_of(array), crc)
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
        crc, packed = 0, {'state': np.array(header['state'], np.int64)}
        for name, (dtype, count, offset) in _places(header, file.tell())[0].items():
            file.seek(offset)
            packed[name] = np.fromfile(file, dtype, count)
            crc = zlib.crc32(_bytes_of(packed[name]), crc)
    if crc != header['crc']:
        raise ValueError(f'{path} is damaged: the CRC-32 of its arrays is not what it says')
    return header | packed


def attach(path: Path) -> tuple[dict[str, Any], dict[str, NDArray[Any]]]:
    """Map what `save` wrote: its header, and its arrays by name; ValueError if it is no such
    file. A write to the arrays would stay in this process.
    """
    if not is_mapped(path):
        raise ValueError(f'{path} cannot be mapped: it was not saved with mapped=True')
    with open(path, 'rb') as file:
        header = _read_header(path, file)
        places, size = _places(header, file.tell())
        if os.fstat(file.fileno()).st_size != size:
            raise ValueError(f'{path} is damaged: it is not {size} bytes long')
        memory = mmap.mmap(file.fileno(), size, access=mmap.ACCESS_COPY)
    return header, {
        name: np.frombuffer(memory, dtype, count, offset) if count else np.empty(0, dtype)
        for name, (dtype, count, offset) in places.items()
    }


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
