# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Several subscriptions to one topic, each message taken once and in its publisher's order.

A subscription that asks for less hears publishers that offer more, too. Who of two subscriptions
a message is for, rclpy does not tell. So what comes by the one that asks for less is held for a
moment: if it comes by the other as well, that one's word counts, which is complete and in order.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any, NamedTuple

HOLD = 0.05  # seconds: on the way, both copies are one packet
REMEMBERED = 10_000  # messages


class Told(NamedTuple):
    """A message as it came."""

    message: Any
    number: int | None  # by its publisher's count
    kept: bool  # its publisher keeps messages for late joiners


class Merger:
    """Passes each message on once.

    Parameters
    ----------
    deliver : callable
        Takes a `Told`.
    hold : float
        Seconds; 0 where the order does not matter.
    """

    def __init__(self, deliver: Callable[[Told], None], hold: float = HOLD) -> None:
        self._deliver = deliver
        self._hold = hold
        self._known: dict[tuple[Any, Any], None] = {}
        self._held: dict[tuple[Any, Any], tuple[float, Told]] = {}

    @property
    def is_holding(self) -> bool:
        """Whether something waits for `release`."""
        return bool(self._held)

    def take(self, told: Told, sent: int, *, others_hear: bool, better_hear: bool) -> None:
        """Take a message.

        Parameters
        ----------
        sent : int
            When its publisher sent it, ns: together with the number, whose it is.
        others_hear : bool
            Whether it may come by another subscription, too, or has come by one.
        better_hear : bool
            Whether it is likely to come by one that asks for more.
        """
        if not others_hear:
            self._deliver(told)
            return
        key = sent, told.number
        if key in self._known:
            return
        if better_hear and self._hold:
            self._held.setdefault(key, (time.monotonic() + self._hold, told))
            return
        self._held.pop(key, None)
        self._pass_on(key, told)

    def release(self) -> None:
        """Pass on what was held for long enough: nobody else hears it."""
        now = time.monotonic()
        for key, (due, told) in [*self._held.items()]:
            if due > now:
                return
            del self._held[key]
            self._pass_on(key, told)

    def _pass_on(self, key: tuple[Any, Any], told: Told) -> None:
        self._known[key] = None
        if len(self._known) > REMEMBERED:
            del self._known[next(iter(self._known))]
        self._deliver(told)
