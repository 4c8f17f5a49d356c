# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A planner at 20 Hz: the robot takes the free heading closest to the goal, among moving carts.

python examples/planner_loop.py
"""

import numpy as np
from needs import command_line

from bvh_ros.scene import Numbered, Scene, Shapes

command_line(__doc__).parse_args()
rng = np.random.default_rng(3)
COUNT, RADIUS, SPACE = 40, 0.4, 0.1  # m
STEP, TICK = 0.05, 0.05  # m, s: the robot drives at 1 m/s
AHEAD = 2.0  # m that must be free

print(f'A robot drives 28 m among {COUNT} moving carts, and looks {AHEAD:g} m ahead at 20 Hz.')
place = np.column_stack([rng.uniform(2.0, 18.0, (COUNT, 2)), np.full(COUNT, 0.5)])
speed = np.column_stack([rng.normal(0.0, 0.3, (COUNT, 2)), np.zeros(COUNT)])
scene, names = Scene(planar=True), Numbered('cart/', np.arange(COUNT))
robot, goal = np.array([0.0, 0.0, 0.0]), np.array([20.0, 20.0, 0.0])
waited = evaded = 0
for tick in range(2_000):
    place += TICK * speed
    scene.update('carts', names, Shapes.boxes(place, [0.6, 0.6, 1.0]), stamp=tick)
    to_goal = goal - robot
    if np.linalg.norm(to_goal) < STEP:
        break
    straight = np.arctan2(to_goal[1], to_goal[0])
    ahead = min(AHEAD, float(np.linalg.norm(to_goal)))
    near = scene.overlap(robot, robot, tolerance=RADIUS + SPACE)
    if near:  # a cart is too near: drive away from it
        heading = robot - near[0].point
        robot = robot + STEP * heading / np.linalg.norm(heading)
        evaded += 1
        continue
    for turn in sorted(np.radians(np.arange(-120, 121, 15)), key=abs):
        heading = np.array([np.cos(straight + turn), np.sin(straight + turn), 0.0])
        if scene.raycast(robot, robot + ahead * heading, RADIUS + SPACE) is None:
            robot = robot + STEP * heading
            break
    else:
        waited += 1  # surrounded: stand still
left = float(np.linalg.norm(goal - robot))
print(
    f'The robot is at the goal after {tick * TICK:.1f} s.'
    if left < STEP
    else f'The robot is {left:.1f} m from the goal after {tick * TICK:.1f} s: carts block it.'
)
print(f'It stood still for {waited * TICK:.1f} s, and evaded a cart for {evaded * TICK:.1f} s.')
