# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What callers may pass by mistake, for every argument of every public method."""

from decimal import Decimal
from fractions import Fraction
from pathlib import Path
from typing import Any

import numpy as np

ONE = [1.0, 1.0, 1.0]


def a_list_in_itself() -> list[Any]:
    loop: list[Any] = []
    loop.append(loop)
    return loop


def masked(shape: tuple[int, ...]) -> Any:
    values = np.ma.ones(shape)
    values[(1,) * len(shape)] = np.ma.masked
    return values


class Raises:
    """What raises whatever it is asked for (as a tensor that will not be an array does)."""

    def __init__(self, error: type[Exception]) -> None:
        self.error = error

    def fail(self, *_: Any, **__: Any) -> Any:
        raise self.error('not for you')

    __array__ = __float__ = __index__ = __repr__ = __str__ = fail


NUMBERS = [0, -1, 0.5, 2**26 + 1, 2**63, 2**64, 2**70, 10**400, -(10**400), 1e308, 1j, True]
NUMBERS += [float('inf'), -float('inf'), float('nan'), Fraction(10**400, 3), Decimal('NaN')]
NUMBERS += [Decimal('Infinity'), Decimal('sNaN'), Decimal('1e999999'), np.bool_(True)]
NUMBERS += [np.longdouble('1e4000'), np.uint64(2**64 - 1), np.int8(-1), np.float32('nan')]
THINGS = [None, '', '1', 'nan', b'1', 'x\0y', object(), object, {}, {1: 2}, {1, 2}, slice(3), ...]
THINGS += [len, (x for x in ONE), range(3), memoryview(b'abc'), NotImplemented, Path('/none/a')]
TIMES = [np.datetime64('NaT'), np.datetime64('2026-01-01'), np.timedelta64(1, 's')]
TIMES += [np.timedelta64('NaT'), np.array(['NaT'] * 3, 'M8[s]'), np.full((5, 3), 'NaT', 'm8[ns]')]
ARRAYS = [[], [[]], [[[]]], [[1], [1, 2]], [1, [2]], [None] * 3, ['1'] * 3, [b'1'] * 3, [1j] * 3]
ARRAYS += [
    np.array(5),
    np.array(5.0),
    np.array('x'),
    np.array(None),
    np.array([5.0]),
    [10**400] * 3,
]
ARRAYS += [np.zeros((0, 3)), np.zeros((3, 0)), np.zeros((5, 3, 1)), np.array([{}] * 3, object)]
ARRAYS += [np.full((5, 3), '1', object), np.full((5, 3), 10**400, object), np.zeros(3, 'V4')]
ARRAYS += [np.zeros(3, [('x', float)]), masked((3,)), masked((5, 3)), list(masked((5, 3)))]
ARRAYS += [np.ma.masked, [np.ma.masked, 1, 1], [[np.ma.masked, 1, 1]] * 5, a_list_in_itself()]
ARRAYS += [np.full((5, 3), np.nan), [ONE, ONE, [1, 1, np.inf], ONE, ONE], np.zeros(5), [1, 2]]
ARRAYS += [
    np.broadcast_to(0.0, (2**40, 3)),
    np.broadcast_to(0.0, (3, 2**40)),
]  # views of one number
ERRORS = (
    RuntimeError,
    KeyError,
    IndexError,
    AttributeError,
    OverflowError,
    BufferError,
    UserWarning,
)
ARRAYS += [Raises(error) for error in ERRORS] + [[Raises(RuntimeError)] * 3]
VALUES = NUMBERS + THINGS + TIMES + ARRAYS
