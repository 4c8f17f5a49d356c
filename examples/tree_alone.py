# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree alone, without ROS: insert, move, ask.

pip install bvh_ros && python examples/tree_alone.py
"""

import numpy as np
from needs import command_line

from bvh_ros import DynamicBVH

command_line(__doc__).parse_args()
print('A tree of 10,000 boxes of 1 m in a cube of 100 m: rays, moves, overlaps, nearest boxes.')
rng = np.random.default_rng(0)
lo = rng.uniform(0.0, 100.0, (10_000, 3))  # m
tree = DynamicBVH.from_boxes(lo, lo + 1.0)  # a bulk build
handles = tree.ids()  # in row order

# Which box does this ray meet first?
hit = tree.raycast([-5.0, 50.0, 50.0], [1.0, 0.0, 0.0])
assert hit is not None
row = np.searchsorted(handles, hit.id)
print(f'The ray first meets box {row}, after {hit.t:.3f} m, at {hit.point.round(3)}.')

# Everything moves by up to 10 cm; the tree follows.
moved = lo + rng.uniform(-0.1, 0.1, lo.shape)
print(f'{tree.move_many(handles, moved, moved + 1.0):,} boxes have moved: {tree}.')

# A thousand rays in one call.
origins, directions = np.zeros((1_000, 3)), rng.uniform(0.0, 1.0, (1_000, 3))
hits = tree.raycast_many(origins, directions)
print(f'{np.count_nonzero(hits.ids >= 0)} of 1,000 rays from a corner meet a box.')

# Which boxes touch this box, are nearest to this point, or touch each other?
print(f'{len(tree.overlap([40, 40, 40], [50, 50, 50]))} boxes touch a cube of 10 m.')
ids, distances = tree.nearest([50.0, 50.0, 120.0], k=3)
print(f'The three boxes nearest to a point above are {distances.round(2)} m away.')
print(f'{len(tree.overlap_pairs())} pairs of boxes touch each other.')
