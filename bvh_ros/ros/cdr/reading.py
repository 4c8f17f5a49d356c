# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The primitives of CDR (OMG CORBA 3.4, part 2, 9.3; as DDS sends it, DDSI-RTPS 2.5, 10).

A reader goes through the body, that is the bytes after the 4-byte encapsulation header, to which
alignment is relative. Every function takes the place where it begins and returns the one where
it ends, or, below zero, why it cannot: nothing is read past the end, whatever lengths are claimed.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from bvh_ros.tree.compiler import inlined

TRUNCATED, UNTERMINATED, HIDDEN_END = -1, -2, -3
REASONS = {
    TRUNCATED: 'goes on beyond the end of the message',
    UNTERMINATED: 'has a text without the zero byte at its end',
    HIDDEN_END: 'has a text with a zero byte inside',
}
HEADER_SIZE = 4
BYTE_ORDERS = {0: '>', 1: '<'}  # of the plain encodings CDR_BE and CDR_LE


def body_of(message: bytes) -> tuple[NDArray[np.uint8], str]:
    """Return the body of a serialised message as a read-only array, and its byte order.

    Raises
    ------
    ValueError
        If it is not in plain CDR.
    """
    whole = np.frombuffer(message, np.uint8)
    if len(whole) < HEADER_SIZE:
        raise ValueError(f'the message has {len(whole)} bytes, too few for a header')
    encoding = int(whole[0]) << 8 | int(whole[1])
    if encoding not in BYTE_ORDERS:
        raise ValueError(f'the message is encoded as 0x{encoding:04x}, not in plain CDR')
    body = whole[HEADER_SIZE:]
    body.flags.writeable = False  # the kernels are compiled for read-only bytes
    return body, BYTE_ORDERS[encoding]


def time_type(order: str) -> np.dtype[np.void]:
    """A Time or Duration of this byte order."""
    return np.dtype([('sec', f'{order}i4'), ('nanosec', f'{order}u4')])


def nanoseconds(times: NDArray[np.void]) -> NDArray[np.int64]:
    """Return such times in ns."""
    return times['sec'].astype(np.int64) * 1_000_000_000 + times['nanosec']


@inlined
def aligned(at, size):
    """The first place from `at` on that is a multiple of `size`, a power of two."""
    return (at + size - 1) & -size


@inlined
def whole_number(data, at, big_endian):
    """The uint32 at a place that is known to hold one."""
    first, second = np.int64(data[at]), np.int64(data[at + 1])
    third, fourth = np.int64(data[at + 2]), np.int64(data[at + 3])
    if big_endian:
        return first << 24 | second << 16 | third << 8 | fourth
    return fourth << 24 | third << 16 | second << 8 | first


@inlined
def skip(data, at, size, alignment):
    """Skip a value of so many bytes."""
    end = aligned(at, alignment) + size
    return end if end <= data.shape[0] else TRUNCATED


@inlined
def sequence(data, at, element_size, alignment, big_endian):
    """Where the elements of a sequence begin, how many there are, and where they end."""
    first = aligned(at, 4) + 4
    if first > data.shape[0]:
        return 0, 0, TRUNCATED
    count = whole_number(data, first - 4, big_endian)
    if count == 0:  # then nothing is aligned either
        return first, 0, first
    begin = aligned(first, alignment)
    end = begin + count * element_size  # 2^32 elements fit an int64
    return begin, count, end if end <= data.shape[0] else TRUNCATED


@inlined
def text(data, at, big_endian):
    """Where a string begins, its length without the zero byte at its end, and where it ends.

    The length may be 0, without a zero byte: Fast CDR reads that as an empty string too.
    """
    begin, length, end = sequence(data, at, 1, 1, big_endian)
    if end < 0 or length == 0:
        return begin, 0, end
    if data[end - 1] != 0:
        return begin, 0, UNTERMINATED
    return begin, length - 1, end


@inlined
def visible_text(data, at, big_endian):
    """As `text`, of a string that is shown to people: it must not end early."""
    begin, length, end = text(data, at, big_endian)
    for place in range(begin, begin + length):
        if data[place] == 0:
            return begin, length, HIDDEN_END
    return begin, length, end


@inlined
def same_bytes(data, first, second, length):
    """Whether the bytes at two places are the same."""
    place = 0
    while place < length and data[first + place] == data[second + place]:
        place += 1
    return place == length
