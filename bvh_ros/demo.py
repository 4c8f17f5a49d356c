# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_demo`: start the node, move obstacles, ask for obstacles, print the answers, end.

Everything goes over real ROS 2: the node runs in a process of its own, obstacles are published
as markers, questions are service calls.
"""

from __future__ import annotations

import argparse
import contextlib
import math
import os
import sys
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial
from pathlib import Path

import rclpy
from rclpy.node import Node
from rclpy.publisher import Publisher
from visualization_msgs.msg import MarkerArray

from bvh_ros import scenarios
from bvh_ros.client import BvhClient, BvhTimeoutError
from bvh_ros.ros import large_messages
from bvh_ros.ros.compilation import CLEAR
from bvh_ros.ros.running import init, keep_apart, running_node, wait_until_ready
from bvh_ros.scenarios import Table, in_words

MOST_DOMAIN = 232  # of ROS_DOMAIN_ID: beyond, there are no ports
PRINT_EVERY = 1.0  # seconds between the answers that are printed; all are counted
EVERYWHERE = ((-1e6, -1e6, -1e6), (1e6, 1e6, 1e6))
Play = Callable[[Node, BvhClient], Table]


def play(frames: Iterable[scenarios.Frame], speed: float, node: Node, client: BvhClient) -> Table:
    """Publish the frames when they are due, and ask after each."""
    publisher = _publisher(node, client)
    table = Table()
    table.head()
    known: set[tuple[str, int]] = set()
    began, printed, updates = time.monotonic(), -1, 0
    for frame in frames:
        time.sleep(max(0.0, began + frame.t / speed - time.monotonic()))
        present = {(thing.namespace, thing.number) for thing in frame.things}
        array = scenarios.markers(frame.things, known - present, begin=not known)
        publisher.publish(array)
        while not (known or client.overlap(*EVERYWHERE)):  # the first frame has to arrive
            time.sleep(0.01)
        known, updates = present, updates + len(frame.things)
        second = int(frame.t / speed / PRINT_EVERY + 1e-6)
        for question in frame.questions:
            table.ask(client, question, frame.t, show=second > printed)
        printed = second
    node.destroy_publisher(publisher)
    print(f'\n{updates} obstacle updates in {time.monotonic() - began:.1f} s; {table.summary()}')
    return table


def _publisher(node: Node, client: BvhClient) -> Publisher:
    """Return what the bvh node hears obstacles from."""
    publisher = node.create_publisher(MarkerArray, f'{client.name}/obstacles', 10)
    while publisher.get_subscription_count() == 0:
        time.sleep(0.01)
    return publisher


def ask_first(node: Node, client: BvhClient, began: float) -> None:
    """Say what the ray meets among the boxes that are not turned: that is answered before all
    that other questions and shapes need is compiled.
    """
    frame = next(scenarios.warehouse())
    ray = frame.questions[0]
    publisher = _publisher(node, client)
    boxes = (thing for thing in frame.things if thing.kind == 'box' and not thing.yaw)
    publisher.publish(scenarios.markers(boxes, ()))
    while (answer := ray.ask(client)) is None:
        time.sleep(0.01)
    names, where = in_words(answer)
    bar = CLEAR if sys.stdout.isatty() else ''  # the node's, on the same terminal
    after = f'{time.monotonic() - began:.1f} s'
    print(f'{bar}first answer after {after}: {ray.text}: {names} {where}', flush=True)
    publisher.publish(scenarios.markers((), (), begin=True))
    while ray.ask(client) is not None:  # `play` waits for its own first frame
        time.sleep(0.01)
    node.destroy_publisher(publisher)


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_demo', description=(__doc__ or '').split('\n')[0])
    parser.add_argument(
        '--replay',
        type=Path,
        metavar='PATH',
        help='play a ROS 2 bag (folder, .mcap or .db3) or a track file (.csv)',
    )
    parser.add_argument(
        '--topic', default='', help='only this one of the bag; default: all that bring obstacles'
    )
    parser.add_argument(
        '--view', action='store_true', help='open a view in a browser, and play until Ctrl-C'
    )
    parser.add_argument(
        '--picture', type=Path, metavar='FILE', help='draw the middle of it (.png, .svg), and end'
    )
    parser.add_argument('--speed', type=float, default=1.0, help='times real time (default 1)')
    parser.add_argument(
        '--domain', type=int, help='ROS_DOMAIN_ID (default: $ROS_DOMAIN_ID, else one of its own)'
    )
    options = parser.parse_args(args)
    if not (math.isfinite(options.speed) and options.speed > 0.0):
        parser.error('--speed must be more than 0')
    if options.domain is not None and not 0 <= options.domain <= MOST_DOMAIN:
        parser.error(f'--domain must be 0 to {MOST_DOMAIN}')
    if options.replay is not None and not options.replay.exists():
        parser.error(f'there is no file or folder {options.replay}')
    if options.view and options.picture is not None:
        parser.error('--view and --picture are two things')
    if options.picture is not None and not options.picture.parent.is_dir():
        parser.error(f'--picture {options.picture}: there is no folder {options.picture.parent}')
    if options.topic and (options.replay is None or options.replay.suffix == '.csv'):
        parser.error('--topic is for bags')
    return options


def _show(options: argparse.Namespace, namespace: str) -> tuple[dict[str, object], Play]:
    """The node's parameters, and what to play to it."""
    path, speed = options.replay, options.speed
    if path is None or path.suffix == '.csv':
        frames = list(scenarios.warehouse() if path is None else scenarios.tracks(path))
        return {}, partial(play, frames, speed)
    from bvh_ros import bags, replay

    recording = bags.find(path, options.topic)
    return replay.parameters(recording, namespace), partial(replay.play, recording, speed)


def main(args: Sequence[str] | None = None) -> int:
    """Run the demo; return 0 if every question was answered."""
    options = _arguments(args)
    if options.picture is not None:
        return _draw(options)
    namespace = keep_apart(options.domain)
    try:
        with _view(f'{namespace}/bvh') if options.view else contextlib.nullcontext():
            table = _run(options, namespace)
    except KeyboardInterrupt:
        return 130
    except (BvhTimeoutError, RuntimeError) as error:
        print(f'bvh_demo: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    return 1 if table.errors or not table.times else 0


def _run(options: argparse.Namespace, namespace: str) -> Table:
    parameters, play_to = _show(options, namespace)
    where = f'{namespace}/bvh on ROS_DOMAIN_ID={os.environ["ROS_DOMAIN_ID"]}'
    print(f'starting the node {where}', flush=True)
    large_messages.enable()
    init()
    node = rclpy.create_node('bvh_demo', namespace=namespace)
    client = BvhClient(node)
    with running_node(namespace, parameters) as process:
        began = time.monotonic()
        first = None if options.replay else partial(ask_first, node, client, began)
        wait_until_ready(client, process, first)
        print(f'ready after {time.monotonic() - began:.1f} s', flush=True)
        while True:
            table = play_to(node, client)
            if not options.view:
                return table


@contextlib.contextmanager
def _view(name: str) -> Iterator[None]:
    """Open a view of the node in a process of its own, and say where it is."""
    from .view.main import running_view

    with running_view(name) as address:
        print(f'the view: {address}; Ctrl-C ends it', flush=True)
        yield


def _draw(options: argparse.Namespace) -> int:
    """Draw a picture; nothing is published for that, and no node runs."""
    from bvh_ros.view import recorded

    try:
        recorded.draw(options.picture, options.replay, options.topic)
    except (RuntimeError, ValueError, OSError) as error:
        print(f'bvh_demo: {error}', file=sys.stderr)
        return 1
    finally:
        rclpy.try_shutdown()
    print(options.picture)
    return 0


if __name__ == '__main__':
    sys.exit(main())
