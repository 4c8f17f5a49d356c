#!/usr/bin/env python3
# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A long load is turned through a doorway into a corridor by a sampling planner, without ROS.

The planner grows a tree of poses (RRT, LaValle 1998). Once it checks the poses alone, as many
planners do, and cuts corners; once it checks the ways between them.

python examples/load_through_a_door.py [--picture door.png]
"""

import time

import numpy as np
from needs import command_line, require_picture

from bvh_ros import Scene, Shapes, quaternions

LOAD = Shapes.boxes([0.0, 0.0, 0.0], [2.2, 0.3, 0.5])
# Walls with a door of 1.1 m into a corridor of 1.7 m: middles and edges, m.
MIDDLES = [
    [-1.6, 0, 0],
    [4.05, 0, 0],
    [1.5, 1.85, 0],
    [1.5, -5.1, 0],
    [-3.2, -2.4, 0],
    [6.2, -2.4, 0],
]
EDGES = [[3.1, 0.3, 2], [6.0, 0.3, 2], [9.7, 0.3, 2], [9.7, 0.3, 2], [0.3, 5.5, 2], [0.3, 5.5, 2]]
START, GOAL = np.array((1.0, -3.0, 0.0)), np.array((4.0, 0.85, 0.0))  # x, y, yaw
LOW, HIGH = np.array((-2.5, -4.5, -np.pi)), np.array((5.5, 1.4, np.pi))
SAMPLES, STEP, TURN = 256, 0.5, 0.7  # at once; m; m that a radian counts
NEAR, MOST_ROUNDS = 0.3, 400


def poses(nodes):
    """Positions (n, 3) and quaternions (n, 4) of x, y, yaw."""
    return np.column_stack((nodes[:, :2], 0.0 * nodes[:, 2])), quaternions(yaw=nodes[:, 2])


def difference(nodes, others):
    """From nodes to others; angles the short way round."""
    step = others - nodes
    step[..., 2] = (step[..., 2] + np.pi) % (2.0 * np.pi) - np.pi
    return step


def lengths(steps):
    return np.linalg.norm(steps * (1.0, 1.0, TURN), axis=-1)


def free_poses(scene, nodes, goals):
    """Whether the load is free at each goal."""
    return ~scene.overlap_shape_many(LOAD, *poses(goals))


def free_ways(scene, nodes, goals):
    """Whether it is free all the way."""
    return ~scene.sweep_shape_many(LOAD, *poses(nodes), *poses(goals), want='any')


def plan(scene, is_free, seed):
    """Poses from START to GOAL, (n, 3)."""
    rng, nodes, parents = np.random.default_rng(seed), START[None], [-1]
    for _ in range(MOST_ROUNDS):
        samples = rng.uniform(LOW, HIGH, (SAMPLES, 3))
        samples[:8] = GOAL
        steps = difference(nodes[:, None], samples)
        nearest = lengths(steps).argmin(axis=0)
        steps = steps[nearest, np.arange(SAMPLES)]
        length = lengths(steps)
        steps *= np.minimum(1.0, STEP / np.maximum(length, 1e-9))[:, None]
        new = nodes[nearest] + steps
        good = is_free(scene, nodes[nearest], new) & (length > 0.05)
        nodes = np.concatenate((nodes, new[good]))
        parents += nearest[good].tolist()
        close = lengths(difference(nodes, GOAL)) < NEAR
        if close.any():
            row, path = int(close.argmax()), []
            while row >= 0:
                path.append(nodes[row])
                row = parents[row]
            return np.array(path[::-1]), len(nodes)
    raise SystemExit('no path was found')


def draw(axis, scene, path, hits, title):
    """The load at 12 poses of each edge; red where the way is not free."""
    from matplotlib.patches import Polygon, Rectangle

    for middle, edges in zip(MIDDLES, EDGES, strict=True):
        axis.add_patch(
            Rectangle(
                np.subtract(middle, edges)[:2] + np.divide(edges, 2)[:2], *edges[:2], fc='0.3'
            )
        )
    corners = np.array(((1.1, 0.15), (-1.1, 0.15), (-1.1, -0.15), (1.1, -0.15)))
    for node, step, hit in zip(path, difference(path[:-1], path[1:]), hits, strict=False):
        for share in np.linspace(0.0, 1.0, 12):
            x, y, yaw = node + share * step
            c, s = np.cos(yaw), np.sin(yaw)
            outline = corners @ ((c, s), (-s, c)) + (x, y)
            colour = '#D55E00' if hit else '#0072B2'
            axis.add_patch(Polygon(outline, fill=False, ec=colour, lw=0.6, zorder=1 + hit))
    axis.set(
        title=title,
        aspect='equal',
        xlim=(-1.5, 6.0),
        ylim=(-3.4, 2.1),
        xlabel='x, m',
        ylabel='y, m',
    )


def main():
    parser = command_line(__doc__)
    parser.add_argument('--picture', default='', help='PNG of both ways')
    options = parser.parse_args()
    require_picture(options.picture)
    print('A load of 2.2 m is turned through a door of 1.1 m: checked at the poses, and between.')
    scene = Scene(planar=True)
    names = [f'wall {k}' for k in range(len(MIDDLES))]
    scene.update('plan', names, Shapes.boxes(MIDDLES, EDGES), stamp=0)
    for is_free in (free_poses, free_ways):  # what they need is compiled or loaded
        is_free(scene, START[None], GOAL[None])
    drawn = []
    for name, is_free in (('the poses', free_poses), ('the ways between', free_ways)):
        began = time.perf_counter()
        path, count = plan(scene, is_free, seed=4)
        took = time.perf_counter() - began
        found = scene.sweep_shape_many(LOAD, *poses(path[:-1]), *poses(path[1:]))
        hits = np.isfinite(found.t)
        print(
            f'checking {name}: {len(path) - 1} edges in {1e3 * took:.0f} ms ({count} poses); '
            f'{hits.sum()} of them hit a wall'
        )
        drawn.append((path, hits, f'checking {name}: {hits.sum()} of {len(path) - 1} edges hit'))
    if options.picture:
        from matplotlib.figure import Figure

        figure = Figure(figsize=(10.0, 4.2), layout='constrained')
        for axis, given in zip(figure.subplots(1, 2), drawn, strict=True):
            draw(axis, scene, *given)
        figure.savefig(options.picture, dpi=150)
        print(f'{options.picture} shows both paths.')


if __name__ == '__main__':
    main()
