# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Frames: the node's own, transformed ones, and those that nobody knows."""

import sys
from types import SimpleNamespace

import numpy as np
import pytest

from bvh_ros.ros.frames import FrameError, Frames, listen_to_tf2


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
    pytest.importorskip('rclpy', reason='rclpy is not installed', exc_type=ImportError)
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
