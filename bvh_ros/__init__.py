# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A dynamic bounding volume hierarchy of moving obstacle boxes, alone and as a ROS 2 node.

Importing this imports no ROS.
"""

from .tree import ALL, DynamicBVH, RayHit, RayHits

__version__ = '0.1.0'
__all__ = ['ALL', 'DynamicBVH', 'RayHit', 'RayHits', '__version__']
