# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a scene does not use is neither imported nor compiled nor allocated."""

import pytest

from bvh_ros.report.workload import Configuration, run_apart

BOXES = 200


@pytest.fixture(scope='module')
def lean():
    """Axis-aligned boxes that move, thin rays and overlaps."""
    return run_apart(Configuration(BOXES, turns=1))


def names(figures):
    return {kernel.rpartition('.')[2] for kernel in figures['kernels']}


def test_a_lean_scene_imports_no_library_it_does_not_need(lean):
    assert lean['libraries'] == []


@pytest.mark.parametrize(
    'part', ['gjk', 'narrow_phase', 'ball_casting', 'mesh', 'footprint', 'wide', 'boxcasting']
)
def test_a_lean_scene_compiles_no_kernel_of(part, lean):
    assert [kernel for kernel in lean['kernels'] if part in kernel] == []


def test_a_lean_scene_keeps_no_exact_boxes_beside_its_nodes(lean):
    fat = run_apart(Configuration(BOXES, margin=0.1, turns=1))
    assert fat['tree'] - lean['tree'] >= 48 * BOXES  # two corners of three doubles


def test_what_batches_bring_is_not_there_without_them(lean):
    batches = run_apart(Configuration(BOXES, batch=2, turns=1))
    assert {'cast_few', 'cast_rows'} & (names(batches) - names(lean))  # by the number of rays
    assert batches['tree'] > lean['tree']  # the snapshot
