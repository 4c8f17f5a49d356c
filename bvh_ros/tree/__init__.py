# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The pure module: a dynamic bounding volume hierarchy of boxes, in numpy and numba alone."""

from .dynamic_bvh import DynamicBVH
from .nodes import ALL
from .results import RayHit, RayHits

__all__ = ['ALL', 'DynamicBVH', 'RayHit', 'RayHits']
