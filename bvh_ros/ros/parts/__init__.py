# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Parts of the node: each opens topics or services and answers on them."""
