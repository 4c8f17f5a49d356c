# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""An arm of 60 balls moves along 500 trajectories at a shelf: which are free, and how far is each
from the shelf?

python examples/arm_at_a_shelf.py [--scenes scenes.csv] [--picture arm.png]

The shelf is made here. SCENES is a table of recorded ones instead, with columns scene, object,
shape (box or cylinder), cx, cy, cz, qx, qy, qz, qw, sx, sy, sz.
"""

import csv
import time
from pathlib import Path

import numpy as np
from needs import command_line, end_with, require_picture

from bvh_ros.scene import NO_NODE, Scene, ShapeKind, Shapes

TRAJECTORIES, WAYPOINTS, BALLS = 500, 20, 60
LINKS, RADIUS = np.array([0.40, 0.36, 0.30, 0.16, 0.10, 0.08]), 0.06  # m
BASE = np.array([0.0, 0.0, 0.75])
KINDS = {'box': ShapeKind.BOX, 'cylinder': ShapeKind.CYLINDER}

rng = np.random.default_rng(6)


def made_shelf():
    """A shelf of five boards between two sides, with twelve tins: names and shapes."""
    names, centres, sizes = ['left', 'right'], [[-0.9, -0.55, 1.1], [-0.9, 0.55, 1.1]], []
    sizes += [[0.4, 0.03, 1.8]] * 2
    for board in range(5):
        names.append(f'board {board}')
        centres.append([-0.9, 0.0, 0.3 + 0.4 * board])
        sizes.append([0.4, 1.1, 0.03])
    names += [f'tin {k}' for k in range(12)]
    centres += [[-0.9, -0.4 + 0.25 * (k % 4), 0.815 + 0.4 * (k // 4)] for k in range(12)]
    sizes += [[0.1, 0.1, 0.2]] * 12
    kinds = [ShapeKind.BOX] * 7 + [ShapeKind.CYLINDER] * 12
    return names, Shapes(kinds, centres, [0.0, 0.0, 0.0, 1.0], sizes)


def recorded_shelf(file, name):
    """Names and shapes of one scene of a table."""
    with file.open(newline='') as table:
        rows = [row for row in csv.DictReader(table) if row['scene'] == name]
    if not rows:
        end_with(f'{file} has no rows of the scene {name}')
    numbers = [
        [[float(row[k]) for k in keys.split()] for row in rows]
        for keys in ('cx cy cz', 'qx qy qz qw', 'sx sy sz')
    ]
    kinds = np.array([KINDS[row['shape']] for row in rows], np.uint8)
    return [row['object'] for row in rows], Shapes(kinds, *map(np.array, numbers))


def balls(joints):
    """Centres (..., BALLS, 3) of an arm whose links turn about z, then each about an axis across
    it; joints (..., 7).
    """
    yaw, pitch = joints[..., :1], np.cumsum(joints[..., 1:], axis=-1)
    along = np.stack(
        (np.cos(yaw) * np.cos(pitch), np.sin(yaw) * np.cos(pitch), np.sin(pitch)), axis=-1
    )
    ends = np.cumsum(along * LINKS[:, None], axis=-2)
    ends = np.concatenate((np.zeros_like(ends[..., :1, :]), ends), axis=-2)
    reach = np.linspace(0.0, LINKS.sum(), BALLS)
    link = np.minimum(np.searchsorted(np.cumsum(LINKS), reach), len(LINKS) - 1)
    rest = reach - np.concatenate(([0.0], np.cumsum(LINKS)))[link]
    return BASE + ends[..., link, :] + along[..., link, :] * rest[:, None]


def draw(file, shapes, arms, free):
    """The shelf and the last pose of some trajectories."""
    import matplotlib as mpl

    mpl.use('Agg')
    from matplotlib import pyplot as plt

    scene = Scene()
    scene.update('shelf', [str(i) for i in range(len(shapes.kind))], shapes, stamp=0)
    axes = scene.plot()
    for some, colour in ((~free, 'tab:red'), (free, 'tab:green')):
        for arm in arms[some][:12]:
            axes.plot(*arm[-1].T, color=colour, marker='o', markersize=3, linewidth=1)
    axes.set(xlim=(-1.2, 1.4), ylim=(-2.0, 0.6), zlim=(0.2, 2.2), box_aspect=(2.6, 2.6, 2.0))
    axes.view_init(elev=25, azim=50)
    axes.figure.savefig(file, dpi=110, bbox_inches='tight')
    plt.close(axes.figure)


def main():
    parser = command_line(__doc__)
    parser.add_argument('--scenes', type=Path, help='a table of recorded scenes')
    parser.add_argument('--scene', default='robowflex_vicon_shelf_01', help='one of these')
    parser.add_argument('--picture', default='')
    given = parser.parse_args()
    require_picture(given.picture)
    if given.scenes and not given.scenes.is_file():
        end_with(f'there is no {given.scenes}: without --scenes a shelf is made')
    print(f'An arm of {BALLS} balls moves along {TRAJECTORIES} trajectories at a shelf.')
    names, shapes = recorded_shelf(given.scenes, given.scene) if given.scenes else made_shelf()
    scene = Scene()
    scene.update('shelf', names, shapes)
    middle = shapes.position.mean(axis=0) - BASE
    facing = np.arctan2(middle[1], middle[0])
    ends = rng.normal(size=(2, TRAJECTORIES, 7)) * [0.9, 0.5, 0.6, 0.6, 0.6, 0.6, 0.6]
    ends += [facing, 0.5, -0.4, 0.0, 0.0, 0.0, 0.0]
    share = np.linspace(0.0, 1.0, WAYPOINTS)[:, None]
    joints = ends[0][:, None] * (1.0 - share) + ends[1][:, None] * share
    arms = balls(joints)  # (trajectories, waypoints, balls, 3)
    starts, goals = arms[:, :-1].reshape(-1, 3), arms[:, 1:].reshape(-1, 3)
    scene.sweep_many(starts[:1], goals[:1], RADIUS)  # compiles, or loads, the kernels
    scene.nearest_many(starts[:1])
    began = time.perf_counter()
    hits = scene.sweep_many(starts, goals, RADIUS)
    swept = time.perf_counter()
    free = (hits.handles == NO_NODE).reshape(TRAJECTORIES, -1).all(axis=1)
    gaps = scene.nearest_many(arms.reshape(-1, 3))[1].reshape(TRAJECTORIES, -1).min(axis=1)
    ended = time.perf_counter()
    print(
        f'{len(starts):,} swept balls took {1e3 * (swept - began):.0f} ms, '
        f'{(swept - began) / len(starts) * 1e6:.2f} us each; '
        f'{arms.size // 3:,} distances took {1e3 * (ended - swept):.0f} ms.'
    )
    print(
        f'{free.sum()} of {TRAJECTORIES} trajectories are free. '
        f'The widest keeps {gaps[free].max(initial=0.0) - RADIUS:.2f} m away from the shelf.'
    )
    if given.picture:
        draw(given.picture, shapes, arms, free)
        print(f'{given.picture} shows the last pose of some of both kinds.')


if __name__ == '__main__':
    main()
