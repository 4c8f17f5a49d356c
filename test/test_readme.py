# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The examples of README, guide and docstrings do what they say."""

import doctest
import importlib
import pkgutil
from pathlib import Path

import pytest

import bvh_ros

ROOT = Path(__file__).resolve().parent.parent


@pytest.mark.parametrize(
    ('page', 'least'),
    [
        ('README.md', 5),
        ('docs/guide.md', 20),
        ('docs/machines.md', 10),
        ('docs/quickstart.md', 4),
        ('docs/tutorials.md', 40),
    ],
)
def test_the_examples_of(page, least):
    result = doctest.testfile(str(ROOT / page), module_relative=False)
    assert result.attempted >= least
    assert result.failed == 0


def test_the_examples_of_docstrings():
    attempted = 0
    for module in pkgutil.walk_packages(bvh_ros.__path__, 'bvh_ros.'):
        if module.name.split('.')[1] in ('tree', 'scene', 'forest'):
            result = doctest.testmod(importlib.import_module(module.name))
            assert result.failed == 0, module.name
            attempted += result.attempted
    assert attempted > 10
