# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A dynamic bounding volume hierarchy of moving obstacle boxes, alone and as a ROS 2 node.

Importing this imports no ROS, and the compiler and the scene only with the first name that needs
them: clients of a node need none.
"""

from __future__ import annotations

from importlib import import_module
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from .orientations import quaternions
    from .scene import NO_NODE, Mesh, Scene, ShapeKind, Shapes
    from .tree import ALL, DynamicBVH, RayHit, RayHits

__version__ = '1.0.0'
ROOMS = dict.fromkeys(('NO_NODE', 'Mesh', 'Scene', 'ShapeKind', 'Shapes'), 'scene')
ROOMS['quaternions'] = 'orientations'  # all others are of the tree
__all__ = [
    'ALL',
    'NO_NODE',
    'DynamicBVH',
    'Mesh',
    'RayHit',
    'RayHits',
    'Scene',
    'ShapeKind',
    'Shapes',
    '__version__',
    'quaternions',
]


def __getattr__(name: str) -> Any:
    if name not in __all__:
        raise AttributeError(f'module {__name__!r} has no attribute {name!r}')
    room = ROOMS.get(name, 'tree')
    return getattr(import_module(f'.{room}', __name__), name)


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
