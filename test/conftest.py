# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What all tests share."""

import fcntl
import os
import signal
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from hypothesis import HealthCheck, settings

ROOT = Path(__file__).resolve().parent.parent


def own_domain() -> int:
    """A ROS domain from 1 to 100 that no other process of tests on this machine has."""
    first = os.getpid()
    for number in range(first, first + 100):
        domain = 1 + number % 100
        try:
            lock = os.open(
                f'{tempfile.gettempdir()}/bvh_ros_domain_{domain}', os.O_CREAT | os.O_RDWR
            )
        except PermissionError:
            continue  # another user's
        try:
            fcntl.flock(lock, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except BlockingIOError:
            os.close(lock)
            continue
        return domain  # locked until this process ends
    return 1 + first % 100


# Nobody else's robots: this machine only, and a domain of our own.
os.environ['ROS_AUTOMATIC_DISCOVERY_RANGE'] = 'LOCALHOST'
os.environ['ROS_DOMAIN_ID'] = str(own_domain())

# A shell's background jobs, such as this suite in some CI, are born deaf to Ctrl-C, and so would
# be the nodes that the tests start and end.
if signal.getsignal(signal.SIGINT) == signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# A loaded machine is no defect of what is tested.
settings.register_profile(
    'any machine', deadline=None, suppress_health_check=[HealthCheck.too_slow]
)
settings.load_profile('any machine')


def pytest_configure(config: pytest.Config) -> None:
    """A worker that dies ends the run: the tests of its files would be waited for, for ever."""
    if getattr(config.option, 'maxworkerrestart', '0') is None:
        config.option.maxworkerrestart = '0'


@pytest.hookimpl(optionalhook=True)
def pytest_xdist_make_scheduler(config: pytest.Config, log: Any) -> Any:
    """With `pytest -n 2` the tests of a file stay together, because they share nodes, and files
    are begun in their order: the longest ones come early.
    """
    from xdist.scheduler import LoadFileScheduling

    config.option.loadscopereorder = False  # would begin with the files of the most tests
    return LoadFileScheduling(config, log)


def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """First those who mostly wait, for a browser: at the end nobody would work beside them."""
    items.sort(key=lambda item: 'view' not in item.path.parts)


@pytest.fixture(scope='session')
def shared_data() -> Path:
    """Folder of recorded input (traffic, scans, a building); it lies beside the clone."""
    folder = ROOT.parent / 'shared' / 'data'
    if not folder.is_dir():
        pytest.skip(f'the recordings are not on this machine: no folder {folder}')
    return folder


@pytest.fixture
def pyplot() -> Iterator[Any]:
    """matplotlib, which draws to memory; its pictures are closed."""
    pyplot = pytest.importorskip('matplotlib.pyplot', reason='matplotlib is not installed')
    pyplot.switch_backend('agg')
    yield pyplot
    pyplot.close('all')


@pytest.fixture(scope='session')
def ros_context() -> Iterator[None]:
    """ROS in this process, from the first test that needs it to the last: `rclpy.init` is legal
    only once, and a test that shut it down would take it from another file's fixtures.
    """
    rclpy = pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
    from rclpy.signals import SignalHandlerOptions

    rclpy.init(args=[], signal_handler_options=SignalHandlerOptions.NO)
    yield
    rclpy.try_shutdown()
