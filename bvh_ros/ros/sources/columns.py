# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Sources whose messages are read as columns of the fields that matter."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import Any, ClassVar

from bvh_ros.ros.cdr import any_message
from bvh_ros.ros.cdr.any_message import Columns, plan_of
from bvh_ros.ros.compile_jobs import Job
from bvh_ros.ros.config.parameters import ConfigurationError
from bvh_ros.ros.sources.source import Source


class ColumnsSource(Source):
    """Reads the bytes of messages by a kernel."""

    fields: ClassVar[tuple[str, ...]]  # paths, as `plan_of` takes them

    def __init__(self, *args: Any) -> None:
        super().__init__(*args)
        self.raw = True
        try:
            self._plan = plan_of(self.message_type, self.fields)
        except ValueError as error:
            raise ConfigurationError(f"source '{self.name}': {error}") from error

    def to_compile(self) -> Iterable[Job]:
        """Return the reader."""
        name = 'decode messages'
        return [Job(name, name, 2.0, any_message.exercise, early=True)]

    def _columns(self, messages: Sequence[bytes]) -> Columns:
        (message,) = messages
        return Columns(message, self._plan)
