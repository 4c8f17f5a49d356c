# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The arrays of a tree: growth, files, turns of threads."""
