# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a source has told all: what messages that only tell changes leave open.

All is told by a message that says everything (a cloud without ids, a grid, markers after a
DELETEALL of all namespaces), by publishers that are heard from their first message on, and by
those that keep messages for late joiners. It is no longer once a message is lost, or a publisher
turns up that spoke before it was heard, until everything is said again.
"""

from __future__ import annotations

import time

from bvh_ros.ros.sources.numbering import Heard

SETTLED = 0.2  # seconds without a further message: a late joiner has got what was kept for it


class Completeness:
    """Keeps account of what was told but not heard."""

    def __init__(self) -> None:
        self._unheard = ''
        self._forgotten = ''
        self._settles = 0.0  # on the monotonic clock; 0: not waited for

    def note(self, heard: Heard, *, kept: bool) -> None:
        """Take notice of how a message follows the others.

        Parameters
        ----------
        kept : bool
            Whether its publisher keeps messages for late joiners.
        """
        if heard.lost:
            self._unheard = f'{heard.lost} of its messages were lost'
        elif kept and (heard.is_new or self._settles):
            self._settles = time.monotonic() + SETTLED
        elif heard.unheard:
            self._unheard = 'it had spoken before it was heard'

    def note_all_told(self) -> None:
        """A message said everything."""
        self._unheard = self._forgotten = ''
        self._settles = 0.0

    def forget(self, reason: str) -> None:
        """What was told is no longer known, or may have changed unheard."""
        self._forgotten = reason

    def missing(self) -> str:
        """Say why not all is known, or return an empty text."""
        if self._settles and time.monotonic() > self._settles:
            self._settles, self._forgotten = 0.0, ''
        settling = 'what it keeps for late joiners is still coming' if self._settles else ''
        return self._unheard or settling or self._forgotten
