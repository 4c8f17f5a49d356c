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
from concurrent.futures import ThreadPoolExecutor

import numpy as np

from bvh_ros.client import UNANSWERED, BvhError
from bvh_ros.report.soak import publishing
from bvh_ros.ros import large_messages, running

SIDE, RADIUS, LONG, SIZE = 40.0, 0.2, 5.0, [0.9, 0.6, 0.5]  # m, of the world and the questions
ON_THE_WAY, PATIENCE = 2, 300.0  # messages; s


def questions(client, rows):
    """By name: a call of the client that asks them."""
    rng = np.random.default_rng(0)
    places, ways = rng.uniform(0.0, SIDE, (rows, 3)), rng.normal(size=(rows, 3))
    ways /= np.linalg.norm(ways, axis=1)[:, None]
    turns = rng.normal(size=(rows, 4))
    rays = places.astype(np.float32), ways.astype(np.float32), LONG
    return {
        'thin rays of 5 m': lambda: client.raycast_many(*rays, timeout=PATIENCE),
        'balls along them': lambda: client.raycast_many(*rays, radius=RADIUS, timeout=PATIENCE),
        'turned boxes': lambda: client.overlap_many(places, SIZE, turns, 0.1, timeout=PATIENCE),
        'points': lambda: client.nearest_many(places, LONG, timeout=PATIENCE),
    }


def rate(ask, seconds):
    """Rows a second, and how many were not answered."""
    began = time.monotonic()

    def ask_for_a_while(_):
        answers = []
        while time.monotonic() - began < seconds or not answers:
            answers.append(ask().obstacles)
        return np.concatenate(answers)

    with ThreadPoolExecutor(ON_THE_WAY) as threads:
        answers = np.concatenate([*threads.map(ask_for_a_while, range(ON_THE_WAY))])
    return len(answers) / (time.monotonic() - began), int(np.sum(answers == UNANSWERED))


def until_answered(ask):
    """Wait while what this takes is compiled; a few rows are enough to see it."""
    while True:
        try:
            if not (ask().obstacles == UNANSWERED).all():
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
        few = questions(client, 10)
        for name, ask in questions(client, given.rows).items():
            until_answered(few[name])
            found, unanswered = rate(ask, given.seconds)
            print(f'{name}: {found:,.0f} rows a second, {unanswered} not answered', flush=True)


if __name__ == '__main__':
    main()
