# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The README's examples do what it says."""

import doctest
from pathlib import Path

README = Path(__file__).resolve().parent.parent / 'README.md'


def test_the_examples_of_the_tree():
    result = doctest.testfile(str(README), module_relative=False)
    assert result.attempted > 10
    assert result.failed == 0
