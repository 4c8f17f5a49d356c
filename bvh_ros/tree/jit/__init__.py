# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The one door to numba: compiling, caching, intrinsics."""
