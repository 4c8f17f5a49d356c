# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A world larger than memory: a folder of trees that are mapped from disk, asked by as many
processes or machines as there are. Every answer is that of one tree of all boxes.
"""

from .forest import Forest

__all__ = ['Forest']
