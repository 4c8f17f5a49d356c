# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Who drives 5 m in a second among boxes that move meets whom, when; and what asking for a time
costs beside asking about boxes at rest.

python examples/moving_boxes.py [--boxes 10000] [--speed 1.5]
"""

import argparse
import functools
import time

import numpy as np

from bvh_ros import DynamicBVH

QUESTIONS = 1000

rng = np.random.default_rng(0)


def fastest(work):
    """us a question, of five turns."""
    times = []
    for _ in range(5):
        begin = time.perf_counter()
        work()
        times.append(time.perf_counter() - begin)
    return min(times) / QUESTIONS * 1e6


def one_by_one(ask, *columns, **times):
    rows = list(zip(*columns, strict=True))
    return lambda: [ask(*row, **times) for row in rows]


parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument('--boxes', type=int, default=10_000)
parser.add_argument('--speed', type=float, default=1.5, help='m/s, standard deviation an axis')
options = parser.parse_args()
count, side = options.boxes, 3.0 * options.boxes**0.5  # one box on 9 m2
lo = rng.uniform(0, [side, side, 3], (count, 3))
hi = lo + rng.uniform(0.3, 1.5, (count, 3))
velocities = options.speed * rng.normal(size=(count, 3)) * [1, 1, 0]
still, moving = DynamicBVH.from_boxes(lo, hi), DynamicBVH.from_boxes(lo, hi)
ids = moving.ids()
moving.set_velocities(ids, velocities)

starts = rng.uniform(0, [side, side, 2], (QUESTIONS, 3))
angles = rng.uniform(0, 2 * np.pi, QUESTIONS)
ways = 5.0 * np.column_stack((np.cos(angles), np.sin(angles), 0 * angles))
hits = moving.raycast_many(starts, ways, 1.0, pace=1.0)
told = still.raycast_many(starts, ways, 1.0)
print(f'{(hits.ids >= 0).sum()} of {QUESTIONS} meet a moving box within a second;', end=' ')
print(f'if all stood still, {(told.ids >= 0).sum()}, and {(hits.ids != told.ids).sum()} others')

body, corner = [0.3, 0.3, 0.3], [1.0, 1.0, 1.0]
low, high = starts - body, starts + body
near_low, near_high = starts - corner, starts + corner
asked = {
    'raycast': ((starts, ways), {'at': 0.0, 'pace': 1.0}),
    'boxcast': ((low, high, ways), {'at': 0.0, 'pace': 1.0}),
    'overlap': ((near_low, near_high), {'at': 1.0}),
    'nearest': ((starts,), {'at': 1.0}),
    'raycast_many': ((starts, ways), {'at': 0.0, 'pace': 1.0}),
    'overlap_many': ((near_low, near_high), {'at': 1.0}),
    'nearest_many': ((starts,), {'at': 1.0}),
}
for name, (columns, times) in asked.items():
    figures = []
    for tree, when in ((still, {}), (moving, times)):
        ask = getattr(tree, name)
        more = {'t_max': 1.0} if 'raycast' in name else {}
        if name.endswith('many'):
            work = functools.partial(ask, *columns, **more, **when)
        else:
            work = one_by_one(ask, *columns, **more, **when)
        figures.append(fastest(work))
    rest, then = figures
    print(
        f'{name:14s} at rest {rest:6.2f} us, in a second {then:6.2f} us, ratio {then / rest:.2f}'
    )

numbers = iter(range(1, 1000))


def refresh(tree, velocities):
    seconds = 0.1 * (next(numbers) % 10)
    tree.move_many(ids, lo + seconds, hi + seconds)
    if velocities is not None:
        tree.set_velocities(ids, velocities, reference=seconds)


rest = fastest(lambda: refresh(still, None)) * QUESTIONS
then = fastest(lambda: refresh(moving, velocities)) * QUESTIONS
print(
    f'all boxes told anew: {rest:.0f} us, with velocities {then:.0f} us, ratio {then / rest:.2f}'
)
