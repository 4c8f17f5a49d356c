# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Two hosts on one machine: network namespaces with a link between them that loses packets."""

import os
import shutil
import subprocess
import time
from contextlib import contextmanager, suppress

from ros.patience import PATIENCE

# Tests that run at once share /dev/shm, where Fast DDS knows a host by its addresses and a port by
# its domain: so each process has a network and a domain of its own.
NETWORK = f'10.77.{os.getpid() % 250}'
DOMAIN = 101 + int(os.environ['ROS_DOMAIN_ID'])  # ours are up to 100


def reason_to_skip():
    """Why there can be no two hosts here; '' if there can."""
    if os.geteuid() != 0:
        return 'only root makes network namespaces'
    if missing := [name for name in ('ip', 'nft') if shutil.which(name) is None]:
        return f'{" and ".join(missing)} not installed'
    try:
        with Hosts() as hosts:
            hosts.lose(5)
            hosts.lose(0)
    except subprocess.CalledProcessError as error:
        return f'no network namespaces or packet filter here: {error.stderr.strip()[-200:]}'
    return ''


def _run(*command):
    return subprocess.run(command, check=True, capture_output=True, text=True).stdout


def _wait_for_link(name):
    """Wait until the link runs: a participant that is made before would not know it. The kernel
    may take a second.
    """
    deadline = time.monotonic() + PATIENCE
    while 'state UP' not in _run('ip', '-n', name, 'link', 'show', 'link0'):
        assert time.monotonic() < deadline, 'the link does not come up'
        time.sleep(0.01)


class Hosts:
    """Hosts 0 and 1, joined by a link; all traffic stays between them."""

    def __init__(self):
        self.names = [f'bvh{os.getpid()}{letter}' for letter in 'ab']

    def __enter__(self):
        try:
            for name in self.names:
                _run('ip', 'netns', 'add', name)
            a, b = self.names
            _run(
                *('ip', '-n', a, 'link', 'add', 'link0', 'type', 'veth'),
                *('peer', 'name', 'link0', 'netns', b),
            )
            for number, name in enumerate(self.names, 1):
                _run('ip', '-n', name, 'addr', 'add', f'{NETWORK}.{number}/24', 'dev', 'link0')
                _run('ip', '-n', name, 'link', 'set', 'link0', 'up')
                _run('ip', '-n', name, 'link', 'set', 'lo', 'up')
            for name in self.names:
                _wait_for_link(name)
        except BaseException:
            self.__exit__()
            raise
        return self

    def __exit__(self, *_):
        for name in self.names:
            with suppress(subprocess.CalledProcessError):
                _run('ip', 'netns', 'del', name)

    def lose(self, percent):
        """Drop so many percent of the packets that come to each host, at random."""
        for name in self.names:
            filtered = ['ip', 'netns', 'exec', name, 'nft']
            with suppress(subprocess.CalledProcessError):
                _run(*filtered, 'delete table inet loss')
            if percent:
                _run(
                    *filtered,
                    'add table inet loss; add chain inet loss come '
                    '{ type filter hook input priority 0; }; add rule inet loss come '
                    f'iifname link0 numgen random mod 100 < {percent} drop',
                )

    def cut(self, apart):
        """Cut the link, or join it."""
        _run('ip', '-n', self.names[1], 'link', 'set', 'link0', 'down' if apart else 'up')

    @contextmanager
    def running(self, number, command, log, **environment):
        """Run a command on a host, and end it."""
        own = {'ROS_AUTOMATIC_DISCOVERY_RANGE': 'SUBNET', 'ROS_DOMAIN_ID': str(DOMAIN)}
        given = {**os.environ, **own, **environment}
        process = subprocess.Popen(
            ['ip', 'netns', 'exec', self.names[number], *command],
            env=given,
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=log,
            text=True,
        )
        try:
            yield process
        finally:
            process.terminate()
            try:
                process.wait(20)
            except subprocess.TimeoutExpired:
                process.kill()
                process.wait()
            process.stdin.close()
            process.stdout.close()
