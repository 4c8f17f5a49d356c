# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`bvh_view`: a live node, a recording or a saved tree in a browser."""

from __future__ import annotations

import argparse
import html
import importlib.util
import ipaddress
import signal
import subprocess
import sys
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from bvh_ros.view.worlds import ShownWorld

HOST, PORT = '127.0.0.1', 8080
GET_IT = "the view needs viser: pip install 'bvh_ros[view]'"
MOST_PORT = 65535
RECORDED = ('.csv', '.mcap', '.db3')  # any other file is a saved tree


def _arguments(args: Sequence[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(prog='bvh_view', description=__doc__)
    parser.add_argument(
        'what',
        nargs='?',
        default='/bvh',
        help='name of a node (default /bvh), a bag (folder, .mcap, .db3), a track file (.csv) '
        'or a saved tree (.npz or mapped)',
    )
    parser.add_argument('--topic', default='', help='only this one of the bag')
    parser.add_argument('--host', default=HOST, help=f'address to serve at (default {HOST})')
    parser.add_argument(
        '--port', type=int, default=PORT, help=f'or the first free one after it (default {PORT})'
    )
    options = parser.parse_args(args)
    if not 1 <= options.port <= MOST_PORT:
        parser.error(f'--port must be 1 to {MOST_PORT}')
    path = Path(options.what)
    if not path.exists() and (not options.what.startswith('/') or path.suffix):
        none = f'there is no file or folder {path}; names of nodes begin with /'
        parser.exit(2, f'bvh_view: {none}\n')
    return options


def _is_local(host: str) -> bool:
    try:
        return ipaddress.ip_address(host).is_loopback
    except ValueError:
        return host == 'localhost'


def _open(what: str, topic: str, ended: threading.Event) -> ShownWorld:
    """Open what is to be shown; what is not needed for that is not imported."""
    path = Path(what)
    if path.is_file() and path.suffix not in RECORDED:
        from bvh_ros.view.worlds import SavedTree

        return SavedTree(path)
    if path.exists():
        from bvh_ros.view.recorded import open_recording

        return open_recording(path, topic)
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    from bvh_ros.ros import large_messages
    from bvh_ros.view.live import Live

    def give_up() -> None:
        if ended.is_set():
            raise KeyboardInterrupt

    large_messages.enable()
    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    return Live(what, give_up)


def main(args: Sequence[str] | None = None) -> int:
    """Show until Ctrl-C or SIGTERM; return the exit code."""
    options = _arguments(args)
    ended = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, lambda *_: ended.set())
    try:
        from bvh_ros.view.page import Page
        from bvh_ros.view.stage import LocalServer
    except ModuleNotFoundError as error:
        if error.name not in ('viser', 'trimesh'):
            raise
        print(f'bvh_view: {GET_IT}', file=sys.stderr)
        return 1
    server = LocalServer(options.host, options.port)
    world = None
    try:
        print(f'bvh_view: http://{options.host}:{server.get_port()}', flush=True)
        if not _is_local(options.host):
            print(
                f'bvh_view: {options.host} can be reached from other machines: all who '
                'reach it see everything and may query; nothing is encrypted',
                file=sys.stderr,
            )
        waiting = server.gui.add_html(html.escape(f'opening {options.what} ...'))
        world = _open(options.what, options.topic, ended)
        waiting.remove()
        Page(server, world).run(ended.is_set)
    except KeyboardInterrupt:
        pass
    except (RuntimeError, ValueError, OSError) as error:
        print(f'bvh_view: {error}', file=sys.stderr)
        return 1
    finally:
        if world is not None:
            world.close()
        server.stop()
        _end_ros()
    return 0


def _end_ros() -> None:
    if 'rclpy' in sys.modules:
        import rclpy

        rclpy.try_shutdown()


# ---- `bvh_view` as a process beside the program that runs the node


@contextmanager
def running_view(name: str) -> Iterator[str]:
    """Show a node, which need not run yet; give the address of the page.

    Raises
    ------
    RuntimeError
        Without viser, or if the view does not start.
    """
    from bvh_ros.ros.running import started

    if importlib.util.find_spec('viser') is None:
        raise RuntimeError(GET_IT)
    command = [sys.executable, '-m', 'bvh_ros.view.main', name]
    with started(command, stdout=subprocess.PIPE) as process:
        assert process.stdout is not None
        address = process.stdout.readline().decode().partition('http://')[2].strip()
        if not address:
            raise RuntimeError('the view did not start')
        yield f'http://{address}'


if __name__ == '__main__':
    sys.exit(main())
