# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What a page shows before anybody has touched it."""

import numpy as np
import pytest

pytest.importorskip('viser', reason='viser is not installed')

from view import pages

from bvh_ros.scene import NodeScene, Shapes


@pytest.fixture
def page():
    """Three obstacles of one source along y, in two namespaces."""
    scene = NodeScene()
    places = np.array([(0.0, -5.0, 1.0), (0.0, 2.0, 1.0), (0.0, 5.0, 1.0)])
    scene.update('us', ['a/1', 'b/1', 'a/2'], Shapes.boxes(places, 1.0), stamp=0)
    shown = pages.page_of('three', scene, 8400)
    shown.show()
    yield shown
    shown.server.stop()


def test_it_asks_with_a_segment_through_the_middle_lengthwise(page):
    start, goal = page.probe.ends()
    np.testing.assert_allclose(start, (0.0, -6.6, 1.0))
    np.testing.assert_allclose(goal, (0.0, 6.6, 1.0))
    assert page.probe.answer.startswith('<b>a/1</b> at (0.000, -5.500, 1.000) m')
    assert page.probe.milliseconds > 0.0


def test_namespaces_keep_their_colours(page):
    assert page.numbers == {'a': 0, 'b': 1}
    page.world.scene.remove('us', ['a/1', 'a/2'])
    page.show()
    assert page.numbers == {'a': 0, 'b': 1}
