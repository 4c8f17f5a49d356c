# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Properties that are computed when they are first read."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any, Generic, TypeVar, overload

T = TypeVar('T')


class LazyProperty(Generic[T]):
    """As `functools.cached_property`, without its lock.

    Before CPython 3.12 all objects of a class share that lock. A child that is forked while
    another thread has it would wait for ever. Here two threads may compute the same; what the
    first one found stays.
    """

    def __init__(self, compute: Callable[[Any], T]) -> None:
        self._compute, self._name = compute, compute.__name__
        self.__doc__ = compute.__doc__

    @overload
    def __get__(self, owner: None, kind: type) -> LazyProperty[T]: ...
    @overload
    def __get__(self, owner: object, kind: type) -> T: ...
    def __get__(self, owner: Any, kind: type) -> LazyProperty[T] | T:
        if owner is None:
            return self
        value: T = owner.__dict__.setdefault(self._name, self._compute(owner))
        return value
