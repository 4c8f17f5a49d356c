# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Everything that talks to ROS: the node, its sources, its services.

Nothing outside this folder, `client/` and `demo.py` imports rclpy.
"""
