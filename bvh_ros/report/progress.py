# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The progress bar."""

from types import TracebackType
from typing import Any


class Progress:
    """A bar of known length on the terminal; silent where tqdm is not installed.

    Parameters
    ----------
    total : int
        How many steps there will be.
    """

    def __init__(self, total: int) -> None:
        self._bar: Any = None
        try:
            from tqdm import tqdm
        except ImportError:
            return
        self._bar = tqdm(total=total, unit='turn', dynamic_ncols=True, leave=False)

    def __enter__(self) -> 'Progress':
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        if self._bar is not None:
            self._bar.close()

    def say(self, what: str) -> None:
        """Tell what is being done."""
        if self._bar is not None:
            self._bar.set_description(what)

    def write(self, text: str) -> None:
        """Print above the bar."""
        if self._bar is not None:
            self._bar.write(text)
        else:
            print(text)

    def step(self) -> None:
        """Move the bar on."""
        if self._bar is not None:
            self._bar.update()
