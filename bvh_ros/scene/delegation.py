# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Methods of an object that its parts have."""

from collections.abc import Callable
from functools import wraps
from typing import Any, Concatenate, ParamSpec, TypeVar

P = ParamSpec('P')
R = TypeVar('R')


def method_of(
    part: str, method: Callable[Concatenate[Any, P], R]
) -> Callable[Concatenate[Any, P], R]:
    """A part's method as one of the whole; `part` is the attribute that holds the part. Signature
    and docstring are the part's own.

    While a change is unfinished it raises a RuntimeError; so every method does that needs what the
    scene holds.
    """

    @wraps(method)
    def ask(whole: Any, /, *arguments: P.args, **named: P.kwargs) -> R:
        whole._store.change.require_none()
        return method(getattr(whole, part), *arguments, **named)

    return ask
