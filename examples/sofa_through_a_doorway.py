#!/usr/bin/env python3
# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A robot drives a sofa, on its end, through a doorway that is too narrow for the sofa's box.

The wall with the opening is one mesh that is not convex, read from a file, and so is the sofa. It
gets through as movers do it: the seat goes first, then the back turns round the door post. The
search goes breadth-first through a grid of poses; each step between two of them is checked all the
way. Hulls of the sofa or of the wall, which other libraries ask for, leave no way.

python examples/sofa_through_a_doorway.py [--picture sofa.png]
"""

import tempfile
import time
from pathlib import Path

import numpy as np
from needs import command_line, require_picture
from scipy.spatial import ConvexHull

from bvh_ros import Mesh, Scene, Shapes, quaternions

# The wall across x, and the sofa on its end: planes between cells, m, and which cells are filled.
DOOR, HIGH = 0.72, 2.2
WALL = [-0.06, 0.06], [-3.0, -DOOR / 2, DOOR / 2, 3.0], [0.0, HIGH, 2.6]
OPENING = np.array([[[True, True], [False, True], [True, True]]])
SOFA = [-0.45, 0.2, 0.45], [-0.42, 0.0, 0.43], [0.05, 2.1]  # seat and back meet where both are
SEAT_AND_BACK = np.array([[[True], [False]], [[True], [True]]])
# The grid of poses: x, y, yaw.
XS, YS = np.linspace(-1.2, 1.2, 25), np.linspace(-0.6, 0.6, 13)
WHOLE = 6  # sofas that the picture fills
YAWS = np.radians(np.arange(0, 360, 15))
SIDES = [(1, 0, 0), (-1, 0, 0), (0, 1, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)]


def write_obj(file, planes, filled):
    """The surface of filled cells (i, j, k) of a grid, in squares."""
    filled = np.pad(filled, 1)
    counts = [len(one) for one in planes]
    lines = [f'v {x} {y} {z}' for x in planes[0] for y in planes[1] for z in planes[2]]
    for axis in range(3):
        one, other = (step for step in np.eye(3, dtype=int)[[k for k in range(3) if k != axis]])
        for cell in np.argwhere(np.diff(filled, axis=axis)):
            low = cell - 1 + np.eye(3, dtype=int)[axis]
            square = low + np.array([0 * one, one, one + other, other])
            rows = np.ravel_multi_index(square.T, counts) + 1
            lines.append('f ' + ' '.join(map(str, rows)))
    file.write_text('\n'.join(lines))


def hull(mesh):
    points = ConvexHull(mesh.vertices)
    return Mesh(points.points, points.simplices)


def poses(cells):
    """Positions (n, 3) and quaternions (n, 4) of cells (n, 3) of the grid."""
    x, y, yaw = cells.T
    places = np.column_stack((XS[x], YS[y], np.zeros(len(cells))))
    return places, quaternions(yaw=YAWS[yaw % len(YAWS)])


def search(scene, sofa):
    """Cells (n, 3) from one side of the wall to the other, or none, and how many steps were
    checked.
    """
    shape = len(XS), len(YS), len(YAWS)
    free = ~scene.overlap_shape_many(sofa, *poses(np.argwhere(np.ones(shape)))).reshape(shape)
    before = np.full(shape, -2)  # the number of the side from which a cell was reached
    front = np.argwhere(free[:1])  # it may begin turned in any way
    before[tuple(front.T)] = -1
    count = 0
    while len(front):
        near = (front[:, None] + SIDES).reshape(-1, 3)
        near[:, 2] %= shape[2]
        side = np.tile(np.arange(len(SIDES)), len(front))
        new = ((near >= 0) & (near < shape)).all(axis=1)
        new[new] = free[tuple(near[new].T)] & (before[tuple(near[new].T)] == -2)
        near, side, start = near[new], side[new], np.repeat(front, len(SIDES), axis=0)[new]
        count += len(near)
        hit = scene.sweep_shape_many(sofa, *poses(start), *poses(near), want='any')
        near, side = near[~hit], side[~hit]
        near, first = np.unique(near, axis=0, return_index=True)
        before[tuple(near.T)] = side[first]
        front = near
        there = front[front[:, 0] == shape[0] - 1]
        if len(there):
            path = [there[0]]
            while before[tuple(path[-1])] >= 0:
                step = path[-1] - SIDES[before[tuple(path[-1])]]
                path.append(step % (10**9, 10**9, shape[2]))
            return np.array(path[::-1]), count
    return np.empty((0, 3), int), count


def draw(file, path):
    """The way from above: the sofa at each cell in outline, and at some of them whole, from dark
    to light.
    """
    from matplotlib import colormaps
    from matplotlib.figure import Figure
    from matplotlib.patches import Polygon, Rectangle

    figure = Figure(figsize=(6.4, 4.6), layout='constrained')
    axis = figure.subplots()
    for low, high in (WALL[1][:2], WALL[1][2:]):
        axis.add_patch(Rectangle((WALL[0][0], low), 0.12, high - low, fc='0.3'))
    (back, inner, front), (foot, seat, top), _ = SOFA
    outline = np.array([(back, foot), (front, foot), (front, top), (inner, top), (inner, seat),
                        (back, seat)])  # fmt: skip
    places, _ = poses(path)
    last = len(path) - 1
    whole = {*np.linspace(0, last, WHOLE).round().astype(int).tolist()}
    for k, (place, yaw) in enumerate(zip(places, YAWS[path[:, 2]], strict=True)):
        turn = np.array(((np.cos(yaw), np.sin(yaw)), (-np.sin(yaw), np.cos(yaw))))
        there, colour = outline @ turn + place[:2], colormaps['viridis'](0.9 * k / last)
        if k in whole:
            axis.add_patch(Polygon(there, fc=(*colour[:3], 0.35), ec=colour, lw=1.8, zorder=3))
        else:
            axis.add_patch(Polygon(there, fill=False, ec=colour, lw=0.6, alpha=0.5))
    axis.set(
        aspect='equal', xlim=(-1.9, 1.9), ylim=(-1.3, 1.3), xlabel='x, m', ylabel='y, m',
        title=f'a sofa through a door of {DOOR:g} m, in {len(path) - 1} steps',
    )  # fmt: skip
    figure.savefig(file, dpi=150)


def main():
    parser = command_line(__doc__)
    parser.add_argument('--picture', default='', help='PNG of the way, from above')
    options = parser.parse_args()
    require_picture(options.picture)
    deep, thick = SOFA[0][-1] - SOFA[0][0], SOFA[1][-1] - SOFA[1][0]
    print(
        f'A sofa of {deep:.2f} x {thick:.2f} m, on its end, is driven through a door of {DOOR} m.'
    )
    with tempfile.TemporaryDirectory() as folder:
        for name, *cells in (('wall', WALL, OPENING), ('sofa', SOFA, SEAT_AND_BACK)):
            write_obj(Path(folder, f'{name}.obj'), *cells)
        wall, sofa = (Mesh.from_file(Path(folder, f'{name}.obj')) for name in ('wall', 'sofa'))
    print(f'the wall: {wall}; the sofa: {sofa}')
    found = {}
    for name, post, load in (
        ('the meshes', wall, sofa),
        ('the hull of the sofa', wall, hull(sofa)),
        ('the hull of the wall', hull(wall), sofa),
    ):
        scene = Scene()
        scene.update('plan', ['wall'], Shapes.of_meshes([post], [[0.0, 0.0, 0.0]]))
        shape = Shapes.of_meshes([load], [[0.0, 0.0, 0.0]])
        two = np.eye(2, 3, dtype=int)  # what they need is compiled or loaded
        scene.sweep_shape_many(shape, *poses(two[:1]), *poses(two[1:]), want='any')
        scene.overlap_shape_many(shape, *poses(two))
        began = time.perf_counter()
        path, count = search(scene, shape)
        took = time.perf_counter() - began
        found[name] = path
        way = f'a way of {len(path) - 1} steps' if len(path) else 'no way'
        print(f'{name}: {way}; {count:,} steps were checked in {took:.1f} s')
    path = found['the meshes']
    if options.picture:
        draw(options.picture, path)
        print(f'{options.picture} shows the way.')
    turned = np.degrees(np.abs(np.diff(np.unwrap(YAWS[path[:, 2]]))).sum())
    print(f'The sofa gets through the doorway: on the way it turns by {turned:.0f} degrees.')


if __name__ == '__main__':
    main()
