# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What was refused, how often and why: counted, logged without flooding, shown in diagnostics."""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from itertools import islice
from typing import Protocol

from bvh_ros.ros.seldom import Seldom
from bvh_ros.ros.texts import LONGEST_LINE, shortened
from bvh_ros.scene import Refusal

LISTED = 100  # refused rows that are kept with their reasons, the latest


def explain(error: Exception) -> str:
    """Return what went wrong inside; never raises."""
    if isinstance(error, MemoryError):
        return 'there is not enough memory'
    try:
        return f'internal error: {error!r}'
    except Exception:  # from its own text
        return f'internal error: {type(error).__name__}'


class Logger(Protocol):
    """The part of a rclpy logger that is used here."""

    def warning(self, message: str) -> object:
        """Log a warning."""


class Refused:
    """Counts refusals of one kind and remembers the last reason.

    Parameters
    ----------
    what : str
        Who was refused, as the log says it: `query`, `source 'markers'`.
    """

    def __init__(self, logger: Logger, what: str) -> None:
        self.count = 0
        self.last = ''
        self._rows: deque[str] = deque(maxlen=LISTED)
        self._row_count = 0
        self._seldom = Seldom(lambda reason: logger.warning(f'{what} refused: {reason}'))

    def add(self, reason: str, count: int = 1) -> None:
        """Count `count` refusals for one reason; never raises."""
        self.count += count
        self.last = shortened(reason, LONGEST_LINE)
        self._seldom.add(self.last, count)

    def log(self) -> None:
        """Log what is not logged yet; to be called now and then."""
        self._seldom.log()

    def add_rows(self, refusals: Sequence[Refusal]) -> None:
        """Count the rows of an update that were refused."""
        if refusals:
            self._row_count += len(refusals)
            told = [_in_words(refusal) for refusal in islice(refusals, LISTED)]
            self._rows.extend(told)
            self.add(told[0], len(refusals))

    def rows(self) -> dict[str, object]:
        """Return the latest rows with their reasons, and how many are not among them."""
        return {
            'refused rows': '\n'.join(self._rows),
            'refused rows not listed': self._row_count - len(self._rows),
        }


def _in_words(refusal: Refusal) -> str:
    who = f"'{shortened(refusal.name)}'" if refusal.name else f'row {refusal.row}'
    return shortened(f'{who}: {refusal.reason}', LONGEST_LINE)
