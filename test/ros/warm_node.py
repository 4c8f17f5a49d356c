# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A node and all that it can be asked, in one process that tells what was compiled too late.

Usage: warm_node.py PARAMETERS, as JSON. Prints a line for each kernel that was not ready when the
services appeared. Not a test: `test_warm_up.py` runs it.
"""

import json
import sys
from pathlib import Path

import numpy as np
import rclpy
from conftest import World
from numba.core.dispatcher import Dispatcher
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.parameter import Parameter
from ros.clouds import cloud
from ros.messages import LATCHED, grid, marker
from sensor_msgs.msg import PointCloud2

from bvh_ros.ros.access import BvhServer

SPHERE, CYLINDER, CUBE_LIST, TRIANGLE_LIST = 2, 3, 6, 11
TURNS = ((0, 0, 0, 0), (0, 0, 0.6, 0.8), (0.1, 0.3, 0.3, 0.9))
TETRAHEDRON = [(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)]
FACES = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
LARGE = 130_000  # boxes: more are applied in slices


def report_late_compilations():
    """Print what is compiled, or loaded from the disk, from now on."""
    compile_kernel = Dispatcher.compile

    def tell(self, signature):
        if tuple(signature) not in self.overloads:
            print(self.py_func.__name__, signature, flush=True)
        return compile_kernel(self, signature)

    Dispatcher.compile = tell


def ask_everything(world, views):
    """Every service, for thin rays and balls, for boxes turned and not, that hit and that miss."""
    for view in ('', *(f'{view}/' for view in views)):
        for ahead in (60.0, -60.0):
            for tolerance in (0.0, 0.5):
                goal = (ahead, ahead, ahead)
                world.plan(f'{view}raycast', (-1, -1, -1), goal, tolerance=tolerance)
                hits = world.names(f'{view}raycast_all', (-1, -1, -1), goal, tolerance=tolerance)
                assert bool(hits) == (ahead > 0.0)
                world.plan(f'{view}raycast', (1, 1, 1), (1, 1, 1), tolerance=tolerance)
                for turn in TURNS:
                    for start in ((0, 0, 0), goal):
                        world.plan(f'{view}overlap', start, goal, turn=turn, tolerance=tolerance)
    for what in ('validate', 'rebuild'):
        assert world.trigger(what).success


def cast_batches(world, replies):
    """Clouds of rays of each size that the tree answers in a way of its own."""
    for count in (1, 3, 100, 5000):
        for kind in ('f4', 'f8'):
            line = np.linspace(0.0, 60.0, count)
            columns = dict.fromkeys(('x', 'y', 'z'), line - 30.0)
            columns |= dict.fromkeys(('dx', 'dy', 'dz'), np.ones(count))
            before = len(replies)
            world.publish('bvh/rays', cloud(columns, kind=kind))
            world.until(lambda before=before: len(replies) > before)


def many(rng, count, numbered):
    places = rng.uniform(0.0, 60.0, (count, 3))
    columns = dict(zip('xyz', places.T, strict=True))
    columns |= dict.fromkeys(('sx', 'sy', 'sz'), np.full(count, 0.3))
    return cloud(columns | ({'id': np.arange(count)} if numbered else {}))


def bring_boxes(world, sources):
    """Every way in which boxes come, move and go."""
    rng = np.random.default_rng(1)
    if 'markers' in sources:
        for count in (1, 30, 30, 5, 1):
            places = rng.uniform(0.0, 60.0, (count, 3))
            world.markers(*(marker(i, at) for i, at in enumerate(places)))
            world.everything()
        world.markers(marker(77, (5, 5, 5), lifetime=0.2), marker(3, action=2))
        world.markers(marker(90, type=CUBE_LIST, points=[(2, 2, 2), (3, 3, 3)]))
        world.until(lambda: 'a/90#1' in world.everything() and 'a/77' not in world.everything())
    if 'numbered' in sources:
        for count in (1, 500, 500, 100):
            world.publish('numbered', many(rng, count, True))
            world.everything()
    if 'cloud' in sources:
        for count in (1, 500, 500, LARGE, LARGE, 100):
            world.publish('cloud', many(rng, count, False))
        # The last of them; a large change is made aside, and seen when it is done.
        world.until(lambda: count_of('cloud#', world) == 100)
    if 'grid' in sources:
        cells = np.reshape([100, 0, 0, 100] * 900, (60, 60))
        world.publish('grid', grid(cells), qos=LATCHED)
        world.until(lambda: count_of('grid#', world))


def count_of(prefix, world):
    """How many obstacles there are whose names begin so."""
    return sum(name.startswith(prefix) for name in world.everything())


def bring_shapes(world):
    """Turned and round shapes, and meshes."""
    mesh = [TETRAHEDRON[corner] for face in FACES for corner in face]
    shapes = [
        marker(100, (8, 8, 8), turn=TURNS[1]),
        marker(101, (12, 12, 12), turn=TURNS[2]),
        marker(102, (16, 16, 16), type=SPHERE),
        marker(103, (20, 20, 20), type=CYLINDER, turn=TURNS[2]),
        marker(104, (24, 24, 24), type=TRIANGLE_LIST, points=mesh),
    ]
    for shape in shapes:
        world.markers(shape)
        world.until(lambda shape=shape: f'a/{shape.id}' in world.everything())
        yield


def main():
    """Serve, and ask."""
    parameters = json.loads(sys.argv[1])
    rclpy.init(args=[])
    overrides = [Parameter(name, value=value) for name, value in parameters.items()]
    served, asking = Node('bvh', parameter_overrides=overrides), Node('asking')
    server = BvhServer(served)
    server.compile(wholly=True)
    report_late_compilations()
    server.serve()
    executor = SingleThreadedExecutor()
    for node in (served, asking):
        executor.add_node(node)
    world = World((asking, executor), None, '', Path('/dev/null'))
    replies = []
    asking.create_subscription(PointCloud2, 'bvh/ray_hits', replies.append, 10)
    views, sources = parameters.get('views', []), parameters.get('sources', ['markers'])
    batch = parameters.get('batch', True)
    bring_boxes(world, sources)
    ask_everything(world, views)
    if batch:
        cast_batches(world, replies)
    for _ in bring_shapes(world) if 'markers' in sources else ():
        ask_everything(world, views)
        if batch:
            cast_batches(world, replies)
    if 'markers' in sources:
        world.markers(marker(0, action=3))
        world.markers(marker(1, (1, 1, 1)))
    world.status('world')
    assert world.trigger('clear').success
    world.everything()
    executor.shutdown()
    rclpy.try_shutdown()


if __name__ == '__main__':
    main()
