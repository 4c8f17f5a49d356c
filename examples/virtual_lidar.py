# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A virtual lidar: 64 rings of 512 beams from one place, among walking people.

python examples/virtual_lidar.py
"""

import numpy as np
from needs import command_line

from bvh_ros import Scene, Shapes
from bvh_ros.scene import NO_NODE, Numbered

command_line(__doc__).parse_args()
rng = np.random.default_rng(0)
PEOPLE, RANGE = 200, 50.0  # m

print(
    f'A lidar of 64 rings of 512 beams among {PEOPLE} walking people, at 10 Hz for half a second.'
)
azimuth = np.linspace(-np.pi, np.pi, 512, endpoint=False)
elevation = np.radians(np.linspace(-25.0, 15.0, 64))[:, None]
beams = np.stack(
    [np.cos(elevation) * np.cos(azimuth), np.cos(elevation) * np.sin(azimuth),
     np.broadcast_to(np.sin(elevation), (64, 512))], axis=-1,
).reshape(-1, 3)  # fmt: skip

place = np.column_stack([rng.uniform(-40.0, 40.0, (PEOPLE, 2)), np.full(PEOPLE, 0.9)])
speed = np.column_stack([rng.normal(0.0, 1.0, (PEOPLE, 2)), np.zeros(PEOPLE)])  # m/s
scene, names = Scene(), Numbered('person/', np.arange(PEOPLE))
lidar = [0.0, 0.0, 1.5]
for frame in range(5):  # at 10 Hz
    people = Shapes.cylinders(place + 0.1 * frame * speed, radius=0.25, height=1.8)
    scene.update('walking', names, people, stamp=frame * 100_000_000)
    handles, ranges, points, normals = scene.raycast_many(lidar, beams, RANGE)
    returned = handles != NO_NODE
    print(
        f't = {0.1 * frame:.1f} s: {np.count_nonzero(returned)} of {len(beams)} beams return, '
        f'from {len(np.unique(handles[returned]))} people, '
        f'the nearest {ranges[returned].min():.2f} m away'
    )
first = int(ranges.argmin())
print(
    f'At last {scene.name_of(int(handles[first]))} is nearest: {ranges[first]:.2f} m away, '
    f'at {np.degrees(azimuth[first % 512]):.0f} degrees.'
)
