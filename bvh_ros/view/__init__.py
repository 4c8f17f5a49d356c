# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_view`: a live node, a recording or a saved tree in a browser.

`worlds`, `recorded` and `live` are what can be looked at, without a browser; `page` shows it with
viser, and `panel`, `stage`, `drawing` and `picking` are its parts.
"""
