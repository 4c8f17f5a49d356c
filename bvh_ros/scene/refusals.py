# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which rows of an update are refused, and why.

A message may have millions of rows, all of them bad. So a refused row is a number in an array, and
becomes a Python object only when somebody looks at it.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, Sequence
from typing import Any, NamedTuple, overload

import numpy as np
from numpy.typing import NDArray

FINE = 0  # instead of the number of a reason


class Refusal(NamedTuple):
    """A row that was not taken over; the obstacle of that name, if any, is as before."""

    row: int
    name: str
    reason: str


class Block(NamedTuple):
    """Refused rows of one part of a message."""

    rows: NDArray[np.int64]  # ascending, within the part
    name: Callable[[int], str]  # of a row of the part
    reason: Callable[[int], str]
    first: int = 0  # number of the part's first row in the message

    def refusal(self, place: int) -> Refusal:
        """One of them."""
        row = int(self.rows[place])
        return Refusal(self.first + row, self.name(row), self.reason(row))


class Refusals(Sequence[Refusal]):
    """Refused rows in order; each is made when it is asked for. Equal to a list of the same."""

    def __init__(self, *blocks: Block) -> None:
        self._blocks = [block for block in blocks if len(block.rows)] if blocks else []

    def extend(self, others: Refusals, first: int = 0) -> None:
        """Add those of a later part, which begins at row `first` of the message."""
        self._blocks += [block._replace(first=first + block.first) for block in others._blocks]

    def __len__(self) -> int:
        return sum(len(block.rows) for block in self._blocks)

    def __iter__(self) -> Iterator[Refusal]:
        for block in self._blocks:
            yield from map(block.refusal, range(len(block.rows)))

    @overload
    def __getitem__(self, place: int) -> Refusal: ...
    @overload
    def __getitem__(self, place: slice) -> list[Refusal]: ...
    def __getitem__(self, place: int | slice) -> Refusal | list[Refusal]:
        if isinstance(place, slice):
            return [self[k] for k in range(*place.indices(len(self)))]
        rest = place + len(self) if place < 0 else place
        if rest >= 0:
            for block in self._blocks:
                if rest < len(block.rows):
                    return block.refusal(rest)
                rest -= len(block.rows)
        raise IndexError(place)

    def __eq__(self, other: object) -> bool:
        return isinstance(other, (list, Refusals)) and list(self) == list(other)

    __hash__ = None  # type: ignore[assignment]

    def __repr__(self) -> str:
        more = f', and {len(self) - 9} more' if len(self) > 9 else ''
        return f'{self[:9]}{more}'


class Reasons:
    """Why rows are refused, as it is found out; of several reasons the last holds."""

    def __init__(self, count: int) -> None:
        self._count = count
        self._codes: NDArray[np.uint16] | None = None  # none where no row is refused
        self._texts = ['']

    def add(self, rows: NDArray[Any], text: str) -> None:
        """Refuse rows, given by number or as a mask."""
        if self._codes is None:
            self._codes = np.zeros(self._count, np.uint16)
        if text not in self._texts:
            self._texts.append(text)
        self._codes[rows] = self._texts.index(text)

    @property
    def good(self) -> NDArray[np.bool_]:
        """(count,) which rows are not refused."""
        if self._codes is None:
            return np.ones(self._count, np.bool_)
        return np.asarray(self._codes == FINE)

    def refusals(self, name: Callable[[int], str]) -> Refusals:
        """All of them; `name` says what a row is called."""
        codes, texts = self._codes, self._texts
        if codes is None:
            return Refusals()
        return Refusals(Block(np.flatnonzero(codes), name, lambda row: texts[codes[row]]))
