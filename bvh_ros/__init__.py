# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A dynamic bounding volume hierarchy of moving obstacle boxes, alone and as a ROS 2 node.

Importing this imports no ROS, and the compiler only with the first name that is taken from here:
clients of a node need none.
"""

from __future__ import annotations

from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .tree import ALL, DynamicBVH, RayHit, RayHits

__version__ = '0.1.0'
__all__ = ['ALL', 'DynamicBVH', 'RayHit', 'RayHits', '__version__']


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    from . import tree

    return getattr(tree, name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
