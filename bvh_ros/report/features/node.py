# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the parts of the node cost: how soon it serves, and its memory, with each configuration."""

import statistics
import time
from importlib.util import find_spec
from pathlib import Path

from ..page import Page
from ..tables import Cell, Table
from ..timing import memory

LEAN = 'no batch, no tf, no source'
NODES: dict[str, dict[str, object]] = {
    LEAN: {'batch': False, 'use_tf': False, 'sources': ['']},
    'markers': {'batch': False, 'use_tf': False},
    'markers, planar': {'batch': False, 'use_tf': False, 'planar': True},
    'markers, a view': {'batch': False, 'use_tf': False, 'views': ['ahead']},
    'markers, batch': {'use_tf': False},
    'markers, batch, tf: the default': {},
}


def node_parts(page: Page, brief: bool) -> None:
    """Start nodes, in turns."""
    page.add('### The node')
    if find_spec('rclpy') is None:
        page.add("Left out: there is no rclpy (pip install 'bvh_ros[ros]').")
        return
    nodes = {LEAN: NODES[LEAN]} if brief else NODES
    # The first of each is not timed: it compiles what is not compiled yet.
    took = _start_all(nodes, 2 if brief else 3, page.folder / 'features_node.log')
    page.add(
        'Processes of their own over ROS 2, compiled before: from the start of the process until '
        'it serves, and its memory then.'
    )
    rows: list[list[Cell]] = [
        [name, *(statistics.median(column) for column in zip(*runs, strict=True))]
        for name, runs in took.items()
    ]
    page.table(Table('features_node', ('configuration', 's until it serves', 'MB, memory'), rows))


def _start_all(
    nodes: dict[str, dict[str, object]], times: int, log: Path
) -> dict[str, list[tuple[float, float]]]:
    import rclpy

    from bvh_ros.client import BvhClient
    from bvh_ros.ros import running

    took: dict[str, list[tuple[float, float]]] = {name: [] for name in nodes}
    namespace = running.keep_apart()
    running.init()
    try:
        with log.open('wb') as output:
            for turn in range(times):
                for number, (name, parameters) in enumerate(nodes.items()):
                    own = f'{namespace}_{turn}_{number}'
                    began = time.perf_counter()
                    with running.running_node(own, parameters, log=output) as process:
                        node = rclpy.create_node('features', namespace=own)
                        running.wait_until_ready(BvhClient(node), process)
                        ready = time.perf_counter() - began
                        if turn:
                            took[name].append((ready, memory(process.pid)))
                        node.destroy_node()
    finally:
        rclpy.try_shutdown()
    return took
