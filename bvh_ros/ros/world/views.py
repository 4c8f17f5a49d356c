# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views: named parts of the world, chosen by patterns of obstacle names."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.config.parameters import ConfigurationError, ViewSettings
from bvh_ros.ros.texts import shortened
from bvh_ros.scene import Families
from bvh_ros.scene.names import BARE
from bvh_ros.tree.access import ALL

# Glob patterns against very many names at once that differ only in their number.
#
# A regular expression a name takes seconds for 10^5 names and some views. So the pattern becomes
# an automaton, and all numbers go through it together, digit by digit.

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


# Views: named parts of the world, chosen by patterns of obstacle names, each a bit of a mask.
#
# An obstacle's bits are found once, when it appears. A query of a view carries the view's bit as
# its mask, and the unions of masks in the tree's inner nodes prune everything else.

Masks = NDArray[np.uint32]
FEW = 100  # names that are matched one by one
EVERYTHING = 1  # bit 0: the mask of an obstacle that no view has


@dataclass(frozen=True)
class View:
    """What a query sees, and under which names its services and topics are offered."""

    name: str = ''  # '': everything
    mask: int = ALL
    skip_inside: bool = False

    def topic(self, name: str) -> str:
        """Return the name of a service or topic of this view: `~/raycast`, `~/arm/raycast`."""
        return f'~/{self.name}/{name}' if self.name else f'~/{name}'


WHOLE = View()


def create_views(settings: Sequence[ViewSettings]) -> list[View]:
    """Return the view of everything and the configured ones; the k-th of these has bit k."""
    named = (View(given.name, 1 << k, given.skip_inside) for k, given in enumerate(settings, 1))
    return [WHOLE, *named]


def view_of_scan(views: Sequence[View], name: str) -> View:
    """Return the view that the virtual scan is configured with; ConfigurationError if there is
    none.
    """
    for view in views:
        if view.name == name:
            return view
    raise ConfigurationError(
        f"parameter 'virtual_scan.view' is '{shortened(name)}', no view of this node"
    )


class Patterns:
    """Whether a name matches one of some glob patterns; `*` matches slashes too."""

    def __init__(self, patterns: Sequence[str]) -> None:
        self._patterns = patterns
        together = '|'.join(fnmatch.translate(pattern) for pattern in patterns)
        self._matches = re.compile(together).match if patterns else None
        self._automata = [Automaton(pattern) for pattern in patterns]

    def match(self, name: str) -> bool:
        """Whether one of the patterns matches all of the name."""
        return self._matches is not None and self._matches(name) is not None

    def match_all(self, prefix: str, digits: Digits) -> NDArray[np.bool_]:
        """Whether one of the patterns matches all of each name, see `digits_of`."""
        matched = np.zeros(len(digits), bool)
        for automaton in self._automata:
            matched |= automaton.match(prefix, digits)
        return matched

    def same_for_all_numbers(self, prefix: str) -> bool:
        """Whether every name `prefix` + number is answered alike, as far as can be seen."""
        return all(_same_for_all_numbers(pattern, prefix) for pattern in self._patterns)


def _same_for_all_numbers(pattern: str, prefix: str) -> bool:
    """Whether the number after `prefix` cannot matter to this pattern.

    It cannot where the pattern's literal head contradicts the prefix. Else the head has to lie
    within the prefix, and the rest to have no digit, no ? and no [: then only a * can match a
    digit, and it matches any number of them.
    """
    head = re.split(r'[*?\[]', pattern, maxsplit=1)[0]
    common = min(len(head), len(prefix))
    if head[:common] != prefix[:common]:
        return True
    return common == len(head) and not re.search(r'[0-9?\[]', pattern[common:])


class Categoriser:
    """Gives obstacles the bits of the views that show them.

    Parameters
    ----------
    settings : sequence of ViewSettings
        In the order of their bits, see `create_views`.
    """

    def __init__(self, settings: Sequence[ViewSettings]) -> None:
        self._views = [
            (np.uint32(1 << bit), Patterns(given.include), Patterns(given.exclude))
            for bit, given in enumerate(settings, 1)
        ]

    def __call__(self, names: Families) -> Masks:
        """Return the masks of n names, shape (n,)."""
        masks = np.empty(len(names), np.uint32)
        if not len(names):
            return masks
        kind = 2 * names.family + (names.numbers == BARE)
        order = np.argsort(kind, kind='stable')
        changes = np.flatnonzero(np.diff(kind[order])) + 1
        for rows in np.split(order, changes):
            prefix, numbers = names.prefixes[names.family[rows[0]]], names.numbers[rows]
            masks[rows] = (
                self._mask(prefix) if numbers[0] == BARE else self._masks(prefix, numbers)
            )
        return masks

    def _mask(self, name: str) -> int:
        mask = EVERYTHING
        for bit, include, exclude in self._views:
            if include.match(name) and not exclude.match(name):
                mask |= int(bit)
        return mask

    def _masks(self, prefix: str, numbers: NDArray[np.int64]) -> Masks:
        """Masks of the names `prefix` + number: where no pattern asks for the number, by one."""
        masks = np.full(len(numbers), EVERYTHING, np.uint32)
        digits = None
        for bit, include, exclude in self._views:
            if include.same_for_all_numbers(prefix) and exclude.same_for_all_numbers(prefix):
                one = f'{prefix}0'
                if include.match(one) and not exclude.match(one):
                    masks |= bit
                continue
            if len(numbers) < FEW:
                names = (f'{prefix}{number}' for number in numbers.tolist())
                matched = np.array(
                    [include.match(one) and not exclude.match(one) for one in names]
                )
            else:
                digits = digits_of(numbers) if digits is None else digits
                matched = include.match_all(prefix, digits) & ~exclude.match_all(prefix, digits)
            masks[matched] |= bit
        return masks
