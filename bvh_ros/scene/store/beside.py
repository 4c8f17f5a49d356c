# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Long work in another thread, while others have their turn."""

from collections.abc import Callable, Generator
from concurrent.futures import ThreadPoolExecutor, wait
from functools import cache
from typing import ParamSpec, TypeVar

P = ParamSpec('P')
R = TypeVar('R')
PATIENCE = 0.002  # seconds between two looks whether the other thread is done


def beside(
    call: Callable[P, R], *arguments: P.args, **named: P.kwargs
) -> Generator[None, None, R]:
    """Return what a call returns that changes nothing others see; pause until it does, at least
    once.
    """
    work = _helper().submit(call, *arguments, **named)
    try:
        done = False
        while not done:
            wait((work,), PATIENCE)
            done = work.done()
            yield
    finally:
        if not work.cancel():
            wait((work,))
    return work.result()


@cache
def _helper() -> ThreadPoolExecutor:
    return ThreadPoolExecutor(1, 'beside')
