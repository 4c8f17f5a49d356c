# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages that were lost: counted, and logged without flooding."""

from __future__ import annotations

import math
import time
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bvh_ros.ros.parts.refusals import Logger

LOG_EVERY = 2.0  # seconds


class Losses:
    """Counts lost messages of a topic.

    Parameters
    ----------
    logger : Logger
    topic : str
    """

    def __init__(self, logger: Logger, topic: str) -> None:
        self.count = 0
        self._logger = logger
        self._topic = topic
        self._logged = 0
        self._log_again = -math.inf

    def add(self, count: int) -> None:
        """Count so many."""
        self.count += count
        self.log()

    def log(self) -> None:
        """Log what is not logged yet, if the last warning is long enough ago.

        To be called now and then: what was lost last is to be in the log, too.
        """
        now, lost = time.monotonic(), self.count - self._logged
        if not lost or now < self._log_again:
            return
        self._logger.warning(
            f'{self._topic}: {lost} messages were lost, {self.count} in all; they came faster '
            'than they were taken, or on a connection that loses some'
        )
        self._logged, self._log_again = self.count, now + LOG_EVERY
