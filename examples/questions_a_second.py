# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How many questions a second a node answers in large messages while a thousand boxes move at
30 Hz: thin rays and balls on ~/rays, turned boxes on ~/boxes, points on ~/points.

python examples/questions_a_second.py [--rows 100000] [--seconds 5] [--threads 1]

The node, the publisher of the boxes, and this program, which asks and reads the answers, are
processes of their own. Two messages are on the way at any time.
"""

import argparse
import time
from collections import deque

import numpy as np

from bvh_ros.client import UNANSWERED, BvhError, volumes
from bvh_ros.client.batch import as_rays
from bvh_ros.client.waiting import results
from bvh_ros.report.soak import publishing
from bvh_ros.ros import large_messages, running
from bvh_ros.ros.conversions import query_clouds, ray_clouds

SIDE, RADIUS, LONG, SIZE = 40.0, 0.2, 5.0, [0.9, 0.6, 0.5]  # m, of the world and what is asked
REAL = np.dtype(np.float32)
ON_THE_WAY, PATIENCE = 2, 300.0  # messages; s


def questions(rows):
    """By name: the topic, and the cloud that asks."""
    rng = np.random.default_rng(0)
    places, ways = rng.uniform(0.0, SIDE, (rows, 3)), rng.normal(size=(rows, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    boxes = volumes.boxes(places, SIZE, rng.normal(size=(rows, 4)), 0.1, 1)
    floats = places.astype(REAL), ways.astype(REAL)
    return {
        'thin rays of 5 m': ('rays', ray_clouds.rays_cloud(as_rays(*floats, LONG, 1))),
        'balls along them': ('rays', ray_clouds.rays_cloud(as_rays(*floats, LONG, 1, RADIUS))),
        'turned boxes': ('boxes', query_clouds.questions_cloud(boxes, REAL)),
        'points': ('points', query_clouds.questions_cloud(volumes.points(places, 5.0, 1), REAL)),
    }


def rate(client, topic, cloud, seconds):
    """Rows a second, and how many were not answered."""
    pending, rows, unanswered, began = deque(), 0, 0, time.monotonic()
    while time.monotonic() - began < seconds or not rows:
        while len(pending) < ON_THE_WAY:
            pending.append(client.channels.begin(topic, cloud, PATIENCE))
        (told,) = results([pending.popleft()], time.monotonic() + PATIENCE)
        unanswered += int(np.count_nonzero(told.obstacles == UNANSWERED))
        rows += len(told.obstacles)
    took = time.monotonic() - began
    results(pending, time.monotonic() + PATIENCE)
    return rows / took, unanswered


def until_answered(client, topic, cloud):
    """Wait while what this takes is compiled; a few rows are enough to see it."""
    while True:
        try:
            (told,) = results(
                [client.channels.begin(topic, cloud, PATIENCE)], time.monotonic() + PATIENCE
            )
            if not (told.obstacles == UNANSWERED).all():
                return
        except BvhError:
            pass
        time.sleep(0.2)


def main():
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument('--rows', type=int, default=100_000)
    parser.add_argument('--seconds', type=float, default=5.0)
    parser.add_argument('--threads', type=int, default=1)
    given = parser.parse_args()
    large_messages.enable()
    with (
        running.served('questions', {'threads': given.threads}) as (client, _),
        publishing(client.node.get_namespace()),
    ):
        few = questions(10)
        for name, (topic, cloud) in questions(given.rows).items():
            until_answered(client, *few[name])
            found, unanswered = rate(client, topic, cloud, given.seconds)
            print(f'{name}: {found:,.0f} rows a second, {unanswered} not answered', flush=True)


if __name__ == '__main__':
    main()
