# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The commands end quietly when Ctrl-C comes while their modules are imported."""

import subprocess
import sys

import pytest

import bvh_ros
from bvh_ros import commands

# The first import of numpy, rclpy or numba interrupts, as a signal would.
INTERRUPTED = """
import signal, sys
class Interrupting:
    def find_spec(self, name, path=None, target=None):
        if name.partition('.')[0] in ('numpy', 'rclpy', 'numba', 'matplotlib'):
            signal.raise_signal(signal.SIGINT)
sys.meta_path.insert(0, Interrupting())
import bvh_ros
from bvh_ros import commands
sys.exit(commands.{command}())
"""
COMMANDS = [name for name in vars(commands) if name.startswith('bvh_')]


@pytest.mark.parametrize('command', COMMANDS)
def test_an_interrupted_import_prints_no_traceback(command):
    program = INTERRUPTED.format(command=command)
    ended = subprocess.run(
        [sys.executable, '-c', program], capture_output=True, text=True, timeout=1000, check=False
    )
    assert ended.returncode in (0, commands.INTERRUPTED)
    assert ended.stderr == ''


def test_every_command_is_there():
    assert len(COMMANDS) == 6


@pytest.mark.parametrize('command', COMMANDS)
def test_every_command_tells_its_version(monkeypatch, capsys, command):
    monkeypatch.setattr(sys, 'argv', [f'/usr/bin/{command}', '--version'])
    assert getattr(commands, command)() == 0
    assert capsys.readouterr().out == f'{command} {bvh_ros.__version__}\n'


def test_the_package_lists_its_commands():
    def said(*arguments):
        command = [sys.executable, '-m', 'bvh_ros', *arguments]
        return subprocess.run(command, capture_output=True, text=True, check=False)

    first, *lines = said().stdout.splitlines()
    assert first == f'bvh_ros {bvh_ros.__version__}' == said('--version').stdout.strip()
    listed = [line.split(maxsplit=1) for line in lines if line.startswith('  bvh_')]
    assert [name for name, _ in listed] == COMMANDS
    assert all(text.endswith('.') for _, text in listed)
    assert said('bvh_node').returncode == 2  # it runs none of them
