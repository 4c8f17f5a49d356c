# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A sampling planner (MPPI) at 20 Hz among 1,000 moving people and forklifts.

Each tick makes 2,000 rollouts of 30 steps. The robot is a turned rectangle. The planner averages
the rollouts by cost; a rollout that touches anything is expensive.

python examples/sampling_planner.py [--ticks 900] [--picture planner.png] [--node]

With --node the planner asks a bvh_node over ROS 2, and publishes the movers as boxes.
"""

import time
from contextlib import contextmanager

import numpy as np
from needs import ROS, command_line, end_with, require_picture

from bvh_ros import quaternions
from bvh_ros.scene import Numbered, Scene, ShapeKind, Shapes

ROLLOUTS, STEPS, TICK, STEP = 2_000, 30, 0.05, 0.1  # s
PEOPLE, FORKLIFTS, SIDE = 900, 100, 120.0  # m
ROBOT, SPACE = [0.9, 0.6, 1.0], 0.1  # m: the rectangle, and how far others have to be
FASTEST, NOISE = 1.5, np.array([0.5, 1.0])  # m/s; of speed (m/s) and turning (rad/s)
HARD, TEMPERATURE = 1e3, 0.5
FAR, CLOSE = 30.0, 1.0  # m: from the start to the goal, and what counts as there

rng = np.random.default_rng(4)
COUNT = PEOPLE + FORKLIFTS
KIND = np.repeat([ShapeKind.CYLINDER, ShapeKind.BOX], [PEOPLE, FORKLIFTS]).astype(np.uint8)
SIZES = np.repeat([[0.5, 0.5, 1.8], [2.4, 1.2, 2.0]], [PEOPLE, FORKLIFTS], axis=0)


def roll_out(pose, controls):
    """Poses (n, STEPS, 3) of a car that drives by controls (n, STEPS, 2): x, y, yaw."""
    yaws = pose[2] + np.cumsum(controls[..., 1], axis=1) * STEP
    steps = controls[..., :1] * STEP * np.stack((np.cos(yaws), np.sin(yaws)), axis=2)
    return np.concatenate((pose[:2] + np.cumsum(steps, axis=1), yaws[..., None]), axis=2)


@contextmanager
def in_this_process():
    """Two functions: one updates the movers, one says which poses touch anything."""
    scene, names = Scene(planar=True), Numbered('mover/', np.arange(COUNT))

    def tell(place, turns):
        scene.update('movers', names, Shapes(KIND, place, turns, SIZES), stamp=0)

    yield tell, scene.overlap_many


@contextmanager
def through_a_node():
    """The same by messages: a cloud of boxes, and a cloud of questions for each answer."""
    try:
        from sensor_msgs.msg import PointCloud2
    except ImportError:
        end_with(ROS)

    from bvh_ros.client import BvhError
    from bvh_ros.ros import large_messages, running
    from bvh_ros.ros.conversions import query_clouds

    large_messages.enable()
    source = {'type': 'PointCloud2', 'topic': '~/movers', 'required': True}
    parameters = {'sources': ['movers'], 'movers': source}
    with running.served('planner', parameters) as (client, _):
        topic = f'{client.node.get_namespace()}/bvh/movers'
        publisher = client.node.create_publisher(PointCloud2, topic, 10)
        while not publisher.get_subscription_count():
            time.sleep(0.01)

        def tell(place, turns):
            # A cloud of questions about boxes has the fields of a cloud of boxes.
            count = len(place)
            boxes = query_clouds.Boxes(
                place, SIZES, turns, np.zeros(count), np.ones(count, np.uint32)
            )
            cloud = query_clouds.questions_cloud(boxes, np.dtype(np.float64))
            cloud.header.frame_id = 'map'
            publisher.publish(cloud)

        def ask(*boxes):
            while True:
                try:
                    return client.overlap_many(*boxes).counts > 0
                except BvhError:  # kernels compile, or the node still waits for the movers
                    time.sleep(0.1)

        yield tell, ask


def plan(ask, pose, goal, nominal):
    """(best controls (STEPS, 2), the poses of all rollouts, which of these are free)."""
    controls = nominal + rng.normal(size=(ROLLOUTS, STEPS, 2)) * NOISE
    controls[0] = nominal
    controls[1] = 0.0  # standing still
    controls[..., 0] = np.clip(controls[..., 0], 0.0, FASTEST)
    controls[..., 1] = np.clip(controls[..., 1], -1.5, 1.5)
    poses = roll_out(pose, controls)
    centres = np.zeros((ROLLOUTS * STEPS, 3))
    centres[:, :2] = poses[..., :2].reshape(-1, 2)
    turns = quaternions(yaw=poses[..., 2].ravel())
    touches = ask(centres, ROBOT, turns, SPACE).reshape(ROLLOUTS, STEPS)
    cost = np.linalg.norm(poses[..., :2] - goal, axis=2).mean(axis=1)
    cost += np.where(touches, HARD * np.linspace(1.0, 0.1, STEPS), 0.0).sum(axis=1)
    weights = np.exp(-(cost - cost.min()) / TEMPERATURE)
    best = np.einsum('n,nsc->sc', weights / weights.sum(), controls)
    return best, poses, ~touches.any(axis=1)


def draw(file, world, track, poses, free, goal):
    """Draw the world from above, the path so far, and the last rollouts."""
    import matplotlib as mpl

    mpl.use('Agg')
    from matplotlib import pyplot as plt

    figure, axes = plt.subplots(figsize=(9, 9))
    place, yaws = world
    for i, (x, y) in enumerate(place[:, :2]):
        if i < PEOPLE:
            axes.add_patch(plt.Circle((x, y), 0.25, color='tab:blue'))
        else:
            box = plt.Rectangle((x - 1.2, y - 0.6), 2.4, 1.2, color='tab:orange')
            box.set_transform(
                mpl.transforms.Affine2D().rotate_around(x, y, yaws[i]) + axes.transData
            )
            axes.add_patch(box)
    for some, colour in ((~free, '0.8'), (free, 'tab:green')):
        for path in poses[some][:150]:
            axes.plot(path[:, 0], path[:, 1], color=colour, linewidth=0.5)
    axes.plot(*np.transpose(track), color='black', linewidth=2)
    axes.plot(*goal, marker='*', color='tab:red', markersize=15)
    axes.set(xlim=(0, SIDE), ylim=(0, SIDE), aspect='equal', xlabel='x [m]', ylabel='y [m]')
    figure.savefig(file, dpi=110, bbox_inches='tight')


def main():
    parser = command_line(__doc__)
    parser.add_argument('--ticks', type=int, default=900, help='at most')
    parser.add_argument('--picture', default='')
    parser.add_argument('--node', action='store_true')
    given = parser.parse_args()
    require_picture(given.picture)
    print(f'A robot drives {FAR:g} m among {COUNT:,} moving people and forklifts, by sampling.')
    with (through_a_node if given.node else in_this_process)() as (tell, ask):
        drive(given, tell, ask)


def drive(given, tell, ask):
    """Plan and drive one step, tick after tick."""
    place = np.column_stack((rng.uniform(5.0, SIDE, (COUNT, 2)), np.full(COUNT, 0.9)))
    yaws, pace = rng.uniform(-np.pi, np.pi, COUNT), rng.uniform(0.2, 1.0, COUNT)
    pose = np.array([1.0, 1.0, np.pi / 4])
    goal = pose[:2] + FAR / 2**0.5
    nominal, track, spent, touching = np.tile([1.0, 0.0], (STEPS, 1)), [pose[:2]], [], 0
    for _ in range(given.ticks):
        yaws += rng.normal(0.0, 0.3 * TICK, COUNT)
        place[:, 0] = np.mod(place[:, 0] + pace * TICK * np.cos(yaws), SIDE)
        place[:, 1] = np.mod(place[:, 1] + pace * TICK * np.sin(yaws), SIDE)
        began = time.perf_counter()
        tell(place, quaternions(yaw=yaws))
        nominal, poses, free = plan(ask, pose, goal, nominal)
        spent.append(time.perf_counter() - began)
        pose = roll_out(pose, nominal[None] * [TICK / STEP, TICK / STEP])[0, 0]
        track.append(pose[:2])
        at = [[*pose[:2], 0.0]]
        touching += int(ask(np.array(at), ROBOT, quaternions(yaw=pose[None, 2]))[0])
        if np.linalg.norm(pose[:2] - goal) < CLOSE:
            break
    left, milliseconds = (
        np.linalg.norm(pose[:2] - goal),
        1e3 * float(np.median(spent[1:] or spent)),
    )
    print(
        f'A tick takes {milliseconds:.0f} ms for {ROLLOUTS * STEPS:,} poses: '
        f'{1e3 / milliseconds:.0f} Hz.'
    )
    seconds, crowded = len(spent) * TICK, not free.any()
    if left < CLOSE:
        print(
            f'The robot is at the goal after {seconds:.1f} s; in {touching} ticks it was touched.'
        )
    else:
        why = 'every rollout touches something' if crowded else '--ticks has ended the drive'
        print(
            f'The robot is {left:.0f} m from the goal after {seconds:.1f} s: {why}; '
            f'in {touching} ticks it was touched.'
        )
    if given.picture:
        draw(given.picture, (place, yaws), track, poses, free, goal)
        print(f'{given.picture} shows its path and the last rollouts.')


if __name__ == '__main__':
    main()
