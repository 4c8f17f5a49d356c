# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Boxes that move: imported by a tree when its first box gets a velocity."""
