# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Interruptions at one bytecode after the other: wherever a signal handler could raise, and
wherever memory could be short.
"""

import contextlib
import dis
import sys
from collections.abc import Callable, Iterator
from pathlib import Path
from types import FrameType
from typing import Any

import bvh_ros

PACKAGE = str(Path(bvh_ros.__file__).parent)


# Where an `except` returns, CPython 3.10 loses its stack if a trace function raises before this
# bytecode. No signal handler runs there.
NEVER_BEFORE = dis.opmap['POP_EXCEPT'] if sys.version_info < (3, 11) else -1


class InterruptError(BaseException):
    """As a KeyboardInterrupt, which pytest would take for one."""


@contextlib.contextmanager
def at_each_bytecode(rooms: tuple[str, ...], call: Callable[[FrameType], Any]) -> Iterator[None]:
    """Call something before each bytecode that runs in some rooms of the package."""
    places = tuple(f'{PACKAGE}/{room}/' for room in rooms)

    def trace(frame: FrameType, event: str, _: Any) -> Any:
        if not frame.f_code.co_filename.startswith(places):
            return None
        frame.f_trace_opcodes = True
        if event == 'opcode':
            call(frame)
        return trace

    before = sys.gettrace()
    # CPython 3.12 tells of bytecodes if this frame wants them when the function is set.
    sys._getframe().f_trace_opcodes = True
    sys.settrace(trace)
    try:
        yield
    finally:
        sys.settrace(before)


def interrupted(
    change: Callable[[], Any],
    at: int,
    rooms: tuple[str, ...] = ('tree',),
    error: type[BaseException] = InterruptError,
) -> bool:
    """Raise at the bytecode of this number in some rooms of the package; whether there was one."""
    left = at

    def count_down(frame: FrameType) -> None:
        nonlocal left
        left -= 1
        if left == 0 and frame.f_code.co_code[frame.f_lasti] == NEVER_BEFORE:
            left = 1
        if left == 0:
            raise error

    with at_each_bytecode(rooms, count_down), contextlib.suppress(error):
        change()
    return left <= 0
