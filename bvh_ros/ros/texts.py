# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Texts of others in ours: names, frames and values may be of any length, and hold anything."""

from __future__ import annotations

LONGEST_NAME = 80  # characters
LONGEST_LINE = 500


def shortened(text: str, most: int = LONGEST_NAME) -> str:
    """Return a text that fits into a line: its beginning, and how long it was, if it is longer.

    >>> shortened('a' * 1000, 4)
    'aaaa... (1000 characters)'
    """
    begin = text[:most]
    if not begin.isprintable():
        begin = repr(begin)[1:-1]
    return begin if len(text) <= most else f'{begin}... ({len(text)} characters)'


def as_line(error: Exception) -> str:
    """Return what an exception says, in one line."""
    return shortened(' '.join(str(error)[: 2 * LONGEST_LINE].split()), LONGEST_LINE)


def seconds(ns: int) -> str:
    """Return a time of at least 0 in seconds, to the last nanosecond: what is too late by one is.

    >>> seconds(1_500_000_001), seconds(1_500_000_000), seconds(0)
    ('1.500000001', '1.5', '0')
    """
    whole, rest = divmod(ns, 1_000_000_000)
    return f'{whole}.{rest:09d}'.rstrip('0').rstrip('.')
