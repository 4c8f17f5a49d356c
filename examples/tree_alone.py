# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree alone, without ROS: insert, move, ask.

pip install bvh_ros && python examples/tree_alone.py
"""

import numpy as np

from bvh_ros import DynamicBVH

rng = np.random.default_rng(0)
lo = rng.uniform(0.0, 100.0, (10_000, 3))  # m
tree = DynamicBVH.from_boxes(lo, lo + 1.0)  # a bulk build
handles = tree.ids()  # in row order

# Which box does this ray meet first?
hit = tree.raycast([-5.0, 50.0, 50.0], [1.0, 0.0, 0.0])
assert hit is not None
row = np.searchsorted(handles, hit.id)
print(f'row {row} after {hit.t:.3f} m, at {hit.point.round(3)}, normal {hit.normal}')

# Everything moves by up to 10 cm; the tree follows.
moved = lo + rng.uniform(-0.1, 0.1, lo.shape)
print(tree.move_many(handles, moved, moved + 1.0), 'boxes moved, height', tree.height)

# A thousand rays in one call.
origins, directions = np.zeros((1_000, 3)), rng.uniform(0.0, 1.0, (1_000, 3))
hits = tree.raycast_many(origins, directions)
print(f'{np.count_nonzero(hits.ids >= 0)} of 1000 rays meet a box')

# Which boxes touch this box, are nearest to this point, or touch each other?
print(len(tree.overlap([40, 40, 40], [50, 50, 50])), 'boxes touch a cube of 10 m')
ids, distances = tree.nearest([50.0, 50.0, 120.0], k=3)
print('the nearest three are', distances.round(2), 'm away')
print(len(tree.overlap_pairs()), 'pairs of boxes touch')
