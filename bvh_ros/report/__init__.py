# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report`: measures the package on this machine, and writes a page, tables and plots."""
