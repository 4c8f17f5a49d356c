# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Vector operations of the kernels, written in LLVM."""
