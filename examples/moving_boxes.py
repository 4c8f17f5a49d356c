# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rays that take a second among moving boxes: how many meet one, and would at rest?

python examples/moving_boxes.py [--boxes 10000] [--speed 1.5]
"""

import numpy as np
from needs import command_line

from bvh_ros import DynamicBVH

QUESTIONS = 1000

rng = np.random.default_rng(0)
parser = command_line(__doc__)
parser.add_argument('--boxes', type=int, default=10_000)
parser.add_argument('--speed', type=float, default=1.5, help='m/s, standard deviation an axis')
options = parser.parse_args()
print(f'{QUESTIONS:,} robots drive 5 m in a second among {options.boxes:,} boxes that move.')
count, side = options.boxes, 3.0 * options.boxes**0.5  # one box on 9 m2
lo = rng.uniform(0, [side, side, 3], (count, 3))
hi = lo + rng.uniform(0.3, 1.5, (count, 3))
velocities = options.speed * rng.normal(size=(count, 3)) * [1, 1, 0]
still, moving = DynamicBVH.from_boxes(lo, hi), DynamicBVH.from_boxes(lo, hi)
ids = moving.ids()
moving.set_velocities(ids, velocities)

starts = rng.uniform(0, [side, side, 2], (QUESTIONS, 3))
angles = rng.uniform(0, 2 * np.pi, QUESTIONS)
segments = 5.0 * np.column_stack((np.cos(angles), np.sin(angles), 0 * angles))
hits = moving.raycast_many(starts, segments, 1.0, pace=1.0)
at_rest = still.raycast_many(starts, segments, 1.0)
differ = (hits.ids != at_rest.ids).sum()
print(f'{(hits.ids >= 0).sum()} of {QUESTIONS} meet a moving box within the second.')
print(f'If all boxes stood still, {(at_rest.ids >= 0).sum()} would meet one.')
print(f'So {differ} of {QUESTIONS} answers would be wrong without the velocities.')
