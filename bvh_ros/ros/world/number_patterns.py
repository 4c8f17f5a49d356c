# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Glob patterns against very many names at once that differ only in their number.

A regular expression a name takes seconds for 10^5 names and some views. So the pattern becomes an
automaton, and all numbers go through it together, digit by digit.
"""

from __future__ import annotations

import fnmatch
import re

import numpy as np
from numpy.typing import NDArray

SYMBOLS = '-0123456789'
END = len(SYMBOLS)  # behind the last digit
# * or one character, which a set in brackets may stand for, as fnmatch reads it.
TOKEN = re.compile(r'\[!?\]?[^\]]*\]|.', re.DOTALL)

Digits = NDArray[np.uint8]
State = frozenset[int]  # tokens that may come next


def digits_of(numbers: NDArray[np.int64]) -> Digits:
    """The decimal digits of n numbers as indices into SYMBOLS, shape (n, width), then END."""
    text = numbers.astype('S20')
    octets = text.view(np.uint8).reshape(len(text), -1)
    codes = np.full(256, END, np.uint8)
    for index, symbol in enumerate(SYMBOLS):
        codes[ord(symbol)] = index
    return codes[octets[:, octets.any(axis=0)]]


class Automaton:
    """One glob pattern."""

    def __init__(self, pattern: str) -> None:
        self._tokens = TOKEN.findall(pattern)

    def match(self, prefix: str, digits: Digits) -> NDArray[np.bool_]:
        """Whether the pattern matches all of `prefix` + number, shape (n,)."""
        state = self._with_stars({0})
        for character in prefix:
            state = self._after(state, character)
        states, known = [state], {state: 0}
        steps = np.full((1, END + 1), -1)
        steps[0, END] = 0
        at = np.zeros(len(digits), np.int64)
        for column in digits.T:
            for pair in np.unique((at * END + column)[steps[at, column] < 0]):
                begin, symbol = divmod(int(pair), END)
                after = self._after(states[begin], SYMBOLS[symbol])
                if after not in known:
                    known[after] = len(states)
                    states.append(after)
                    steps = np.vstack((steps, np.full((1, END + 1), -1)))
                    steps[-1, END] = known[after]
                steps[begin, symbol] = known[after]
            at = steps[at, column]
        ends = np.array([len(self._tokens) in state for state in states])
        matched: NDArray[np.bool_] = ends[at]
        return matched

    def _after(self, state: State, character: str) -> State:
        reached = set()
        for place in state:
            if place < len(self._tokens) and fnmatch.fnmatchcase(character, self._tokens[place]):
                reached.add(place if self._tokens[place] == '*' else place + 1)
        return self._with_stars(reached)

    def _with_stars(self, state: set[int]) -> State:
        """These tokens, and those behind a * that may match nothing."""
        todo = list(state)
        while todo:
            place = todo.pop()
            if self._tokens[place : place + 1] == ['*'] and place + 1 not in state:
                state.add(place + 1)
                todo.append(place + 1)
        return frozenset(state)
