# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Any message of rclpy as CDR bytes of either byte order, from its definition and the standard.

Shares nothing with the decoder under test. That it is right is shown by letting rclpy read what
it encodes.
"""

import importlib
import re
import struct

PRIMITIVES = {
    'boolean': '?',
    'octet': 'B',
    'int8': 'b',
    'uint8': 'B',
    'int16': 'h',
    'uint16': 'H',
    'int32': 'i',
    'uint32': 'I',
    'int64': 'q',
    'uint64': 'Q',
    'float': 'f',
    'double': 'd',
}


def encode(message, big_endian=False):
    """The message with its encapsulation header."""
    body = bytearray()
    _message(body, message, '>' if big_endian else '<')
    return bytes([0, 0 if big_endian else 1, 0, 0]) + bytes(body)


def _primitive(body, code, value, order):
    body += bytes(-len(body) % struct.calcsize(code)) + struct.pack(order + code, value)


def _value(body, kind, value, order):
    if kind in PRIMITIVES:
        _primitive(body, PRIMITIVES[kind], value, order)
    elif kind == 'string':
        written = value.encode() + b'\0'
        _primitive(body, 'I', len(written), order)
        body += written
    elif match := re.fullmatch('sequence<(.+)>', kind):
        _primitive(body, 'I', len(value), order)
        for element in value:
            _value(body, match[1], element, order)
    else:
        _message(body, value, order)


def _message(body, message, order):
    for field, kind in message.get_fields_and_field_types().items():
        _value(body, kind, getattr(message, field), order)


def offsets(message, wanted):
    """Where, in the little endian bytes, the lengths of strings and sequences stand.

    A list of (path, place): for the tests that lie about them.
    """
    found, body = [], bytearray()

    def note(path, kind, value):
        if kind == 'string' or kind.startswith('sequence'):
            found.append((path, 4 + len(body) + -len(body) % 4))
        if kind in PRIMITIVES or kind == 'string':
            _value(body, kind, value, '<')
        elif match := re.fullmatch('sequence<(.+)>', kind):
            _primitive(body, 'I', len(value), '<')
            for number, element in enumerate(value):
                note(f'{path}[{number}]', match[1], element)
        else:
            for field, inner in value.get_fields_and_field_types().items():
                note(f'{path}.{field}'.lstrip('.'), inner, getattr(value, field))

    package, name = wanted.split('/')
    assert isinstance(message, getattr(importlib.import_module(f'{package}.msg'), name))
    note('', wanted, message)
    return found
