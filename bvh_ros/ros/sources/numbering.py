# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which messages of a topic's publishers were never heard.

Each publisher numbers its messages from 1. rclpy tells the number of a message, but not whose it
is. So a number is given to the publisher that was heard last of those it follows directly; where
it follows none, something is missing. Two publishers that count in step can be mistaken for each
other: a gap is then seen as soon as the other one speaks.
"""

from __future__ import annotations

from typing import NamedTuple

SPARE = 16  # publishers that are gone already, while what they said still waits


class Heard(NamedTuple):
    """What the number of a message says about those before it."""

    is_new: bool = False  # the first that is heard of its publisher
    unheard: int = 0  # told by that publisher before
    lost: int = 0  # of a publisher that was heard before


NEXT = Heard()


class Numbering:
    """Follows the numbers of all publishers of one topic."""

    def __init__(self) -> None:
        self._last: list[int] = []  # of each publisher; who was heard last stands last
        self._counts = True

    def note(self, number: int | None, publishers: int) -> Heard:
        """Take notice of a message.

        Parameters
        ----------
        number : int or None
            As its publisher counts; None where the middleware does not tell.
        publishers : int
            How many there are now.
        """
        if number is None:
            # Nothing is known of what was told before, nor of what is lost later.
            is_new, self._counts = self._counts, False
            return Heard(is_new, unheard=1) if is_new else NEXT
        for place in range(len(self._last) - 1, -1, -1):
            if self._last[place] == number - 1:
                del self._last[place]
                self._last.append(number)
                return NEXT
        heard = self._irregular(number, publishers)
        self._last.append(number)
        del self._last[: max(len(self._last) - publishers - SPARE, 0)]
        return heard

    def _irregular(self, number: int, publishers: int) -> Heard:
        if number == 1:
            return Heard(is_new=True)
        alive = self._last[-publishers:] if publishers else self._last
        before = [last for last in alive if last < number]
        if len(alive) < publishers or not before:
            return Heard(is_new=True, unheard=number - 1)
        last = max(before)
        self._last.remove(last)
        return Heard(lost=number - last - 1)
