# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Damage to files: bytes that change, ends that are cut off, and what comes of it."""

import os
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import numpy as np

PATHS = str(Path(__file__).parent), os.environ.get('PYTHONPATH', '')
WITH_TESTS = {**os.environ, 'PYTHONPATH': os.pathsep.join(PATHS)}


def damaged(rng: np.random.Generator, whole: bytes, count: int) -> Iterator[bytes]:
    """Versions of a file with up to three bytes that differ, one in twenty cut off. Bytes that are
    not zero are changed more often than others, as those are mostly padding.
    """
    written = np.flatnonzero(np.frombuffer(whole, np.uint8))
    for number in range(count):
        content = bytearray(whole)
        for _ in range(1 + number % 3):
            place = int(rng.choice(written) if number % 4 else rng.integers(len(whole)))
            content[place] ^= 0xFF if number % 5 == 0 else 1 << int(rng.integers(8))
        if number % 20 == 7:
            content = content[: int(rng.integers(len(content)))]
        yield bytes(content)


def outcome(ask: Callable[[], list[Any]], wanted: list[Any]) -> str:
    """What a question about a damaged file gives: 'same', 'other' answers, or 'refused'."""
    try:
        given = ask()
    except ValueError:
        return 'refused'
    except Exception as error:
        return f'{type(error).__name__}: {error}'
    same = all(np.array_equal(a, b) for a, b in zip(given, wanted, strict=True))
    return 'same' if same else 'other'
