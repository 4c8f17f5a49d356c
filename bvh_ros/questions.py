# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the demo asks a running node, and the table of the answers."""

from __future__ import annotations

import statistics
import time
from collections.abc import Callable
from typing import NamedTuple

from bvh_ros.client import BvhClient, BvhError, Hit


class Question(NamedTuple):
    """One call of the client, and how the table names it."""

    text: str
    ask: Callable[[BvhClient], Hit | list[Hit] | None]


class Table:
    """Prints some answers and keeps the time of all."""

    def __init__(self) -> None:
        self.times: list[float] = []
        self.errors = 0

    def head(self) -> None:
        """Print the column names."""
        print(f'\n{"t [s]":>6}  {"question":34} {"answer":26} {"at x, y, z [m]":24} {"ms":>6}')

    def ask(self, client: BvhClient, question: Question, t: float, *, show: bool) -> None:
        """Ask one question."""
        began = time.perf_counter()
        try:
            answer = question.ask(client)
        except BvhError as error:
            self.errors += 1
            print(f'{t:6.1f}  {question.text:34} error: {error}')
            return
        took = 1e3 * (time.perf_counter() - began)
        self.times.append(took)
        if show:
            names, where = in_words(answer)
            print(f'{t:6.1f}  {question.text:34} {names:26} {where:24} {took:6.2f}')

    def summary(self) -> str:
        """Say how it went."""
        if not self.times:
            return 'no question was answered'
        return (
            f'{len(self.times)} questions answered, {self.errors} errors; round trip over ROS 2: '
            f'median {statistics.median(self.times):.2f} ms, slowest {max(self.times):.2f} ms'
        )


def in_words(answer: Hit | list[Hit] | None) -> tuple[str, str]:
    """Names of the hits, and the place of the first one."""
    hits = [] if answer is None else [answer] if isinstance(answer, Hit) else answer
    if not hits:
        return 'free', ''
    names = ', '.join(hit.name for hit in hits[:2])
    if len(hits) > 2:
        names += f', +{len(hits) - 2}'
    return names, '({:.2f}, {:.2f}, {:.2f})'.format(*hits[0].point)
