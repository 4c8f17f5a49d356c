# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames: the node's own, transformed ones, and those that nobody knows."""

import itertools
import sys
from types import SimpleNamespace

import numpy as np
import pytest
from ros.messages import marker
from scipy.spatial.transform import Rotation

from bvh_ros.ros.access import (
    ConfigurationError,
    FrameError,
    Frames,
    TransformSettings,
    listen_to_tf2,
)


class FakeBuffer:
    """The part of tf2_ros.Buffer that is used; knows one transform."""

    def lookup_transform(self, target, source, time):
        if (target, source) != ('map', 'base'):
            raise FakeTransformError(f'{source} does not exist at {time.nanoseconds}')
        return SimpleNamespace(
            transform=SimpleNamespace(
                translation=SimpleNamespace(x=1.0, y=2.0, z=3.0),
                rotation=SimpleNamespace(
                    x=0.0, y=0.0, z=1.0, w=1.0
                ),  # a quarter, not of unit length
            )
        )


class FakeTransformError(Exception):
    """As tf2_ros.TransformException."""


@pytest.fixture
def tf2(monkeypatch):
    listened = []
    module = SimpleNamespace(
        Buffer=FakeBuffer,
        TransformListener=lambda buffer, node: listened.append(node),
        TransformException=FakeTransformError,
    )
    monkeypatch.setitem(sys.modules, 'tf2_ros', module)
    return listened


def test_own_frame_needs_no_transform():
    frames = Frames('map')
    assert frames.into_node('') is None
    assert frames.into_node('map') is None


def test_without_tf2_other_frames_are_refused(monkeypatch):
    monkeypatch.setitem(sys.modules, 'tf2_ros', None)  # import fails
    assert listen_to_tf2(None) is None
    with pytest.raises(FrameError, match="'base' is not 'map'"):
        Frames('map').into_node('base')


def test_transform_by_tf2(tf2):
    frames = Frames('map', listen_to_tf2('node'))
    assert tf2 == ['node']
    transform = frames.into_node('base', 5)
    assert np.allclose(transform.points([[1, 0, 0], [0, 1, 5]]), [[1, 3, 3], [0, 2, 8]])
    half = np.sqrt(0.5)
    assert np.allclose(transform.orientations([0, 0, 0, 0]), [0, 0, half, half])
    with pytest.raises(FrameError, match='mars does not exist'):
        frames.into_node('mars')


# ---- fixed transforms

QUARTER = (0.0, 0.0, 1.0, 1.0)  # about z, of any length
HALF_ABOUT_X = (1.0, 0.0, 0.0, 0.0)
TURNS = {
    (0.0, 0.0, 0.0, 2.0): np.eye(3),
    QUARTER: np.array([[0, -1, 0], [1, 0, 0], [0, 0, 1]]),
    HALF_ABOUT_X: np.diag([1, -1, -1]),
    (0.5, 0.5, 0.5, 0.5): np.array([[0, 0, 1], [1, 0, 0], [0, 1, 0]]),  # x to y to z
}


def placed(frame_id, parent, xyz=(0.0, 0.0, 0.0), xyzw=(0.0, 0.0, 0.0, 1.0)):
    return TransformSettings(frame_id, parent, xyz, xyzw)


@pytest.mark.parametrize(('lower', 'upper'), [*itertools.product(TURNS, repeat=2)])
def test_chains_of_fixed_transforms(lower, upper):
    """Right angles and whole metres: known without rounding."""
    base, lidar = np.array([1.0, 2.0, 3.0]), np.array([-4.0, 0.0, 8.0])
    fixed = [placed('lidar', 'base', lidar, upper), placed('base', 'map', base, lower)]
    points = np.array([[0.0, 0.0, 0.0], [1.0, 2.0, -3.0]])
    transform = Frames('map', None, fixed).into_node('lidar')
    expected = (points @ TURNS[upper].T + lidar) @ TURNS[lower].T + base
    assert np.allclose(transform.points(points), expected, rtol=0, atol=1e-14)
    quarter = np.array(QUARTER) / np.linalg.norm(QUARTER)
    turned = Rotation.from_quat(transform.orientations(quarter)).as_matrix()
    assert np.allclose(turned, TURNS[lower] @ TURNS[upper] @ TURNS[QUARTER], rtol=0, atol=1e-14)


def test_a_fixed_transform_on_top_of_tf2(tf2):
    fixed = [placed('lidar', 'base', (0.0, 0.0, 1.0)), placed('mast', 'mars')]
    frames = Frames('map', listen_to_tf2('node'), fixed)
    assert np.allclose(frames.into_node('lidar').points([1, 0, 0]), [1, 3, 4])
    with pytest.raises(FrameError, match='mars does not exist'):
        frames.into_node('mast')


@pytest.mark.parametrize(
    ('fixed', 'complaint'),
    [
        ([placed('a', 'a')], "'a' stands on itself"),
        ([placed('a', 'b'), placed('b', 'c'), placed('c', 'a')], "'a' stands on itself"),
        ([placed('a', 'b'), placed('b', 'c'), placed('c', 'b')], "'b' stands on itself"),
        ([placed('a', 'map'), placed('a', 'b')], "'a' is placed twice"),
        ([placed('map', 'a')], "'map' is the node's own frame"),
        ([placed('a', 'b')], "'a' stands on 'b', which is not 'map', and tf2_ros is not"),
    ],
)
def test_fixed_transforms_that_cannot_be(fixed, complaint):
    with pytest.raises(ConfigurationError, match=complaint):
        Frames('map', None, fixed)


def test_fixed_transforms_over_ros(start_node):
    world = start_node(
        {
            'use_tf': False,
            'transforms': ['lidar', 'base_link'],
            'lidar.parent': 'base_link',
            'lidar.xyz': [0, 0, 1],
            'base_link.xyz': [10.0, 0.0, 0.0],
            'base_link.xyzw': [0.0, 0.0, 0.7071, 0.7071],
        }
    )
    world.show(marker(1, at=(5, 0, 0), frame='lidar'), marker(2))
    place = world.place('raycast', (0, 0, 0), (9, 0, 0), frame='lidar')
    assert np.allclose(place, (10.0, 4.5, 1.0), rtol=0, atol=1e-12)
    assert world.names('raycast', (10, 0, 1), (10, 9, 1)) == ['a/1']
    (error,) = world.names('raycast', (0, 0, 0), (9, 0, 0), frame='camera')
    assert error.startswith("error: frame 'camera' is not 'map'")
