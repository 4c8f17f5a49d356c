# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report features`: what each part costs when it is on, and that it is not there when off."""

from . import node, parts, times

INTRODUCTION = '## Features'
SECTIONS = {
    'on': parts.parts_on,
    'off': parts.parts_off,
    'other times': times.times,
    'the node': node.node_parts,
}
