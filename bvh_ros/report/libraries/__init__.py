# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The libraries that the report compares, each in the form that serves it best."""

from .base import Library, Work
from .embree import Embree
from .fcl import Coal, Fcl
from .kd_tree import KdTree
from .ours import Ours

LIBRARIES: list[Library] = [Ours(), Embree(), Coal(), Fcl(), KdTree()]

__all__ = ['LIBRARIES', 'Library', 'Work']
