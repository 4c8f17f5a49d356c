# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""One ray, or one moving box, through the binary tree."""
