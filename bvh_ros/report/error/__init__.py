# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_report error`: how wrong each way of answering is, against how long it takes."""

from . import pairs, traffic, worlds

INTRODUCTION = """## Error against run time

The truth is computed in whole numbers, by brute force behind a sound filter. *wrong first*: an
object is met, but not the first; of objects entered at exactly the same distance any will do.
*Plain float64 leaves*: the same kernels with the usual slab test in place of the exact decision.
The ways take turns, each after an untimed run; medians. In the pictures the front joins what no
cheaper way betters by more than a tenth."""
SECTIONS = {
    'random boxes': worlds.random_scene,
    'adversarial rays': worlds.adversarial_scene,
    'building': worlds.building_scene,
    'random shapes': worlds.random_shapes,
    'shelves': worlds.shelves,
    'traffic': traffic.stale_traffic,
    'pairs': pairs.against_fcl,
}
