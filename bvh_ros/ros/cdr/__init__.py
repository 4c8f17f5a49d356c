# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Messages read from their serialised bytes. Imports no ROS.

rclpy makes a Python object of every marker of a message, and of every vector in it: 45 us a
marker. Here a kernel finds what is wanted in the bytes and skips the rest.
"""
