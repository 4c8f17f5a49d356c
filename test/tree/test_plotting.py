# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""`DynamicBVH.plot` draws the boxes, levels, rays and hits that there are, and nothing else."""

import numpy as np
import pytest

from bvh_ros import DynamicBVH

pytestmark = pytest.mark.usefixtures('pyplot')
LO = np.array([[0.0, 0.0], [4.0, 1.0], [2.0, 5.0]])
HI = LO + np.array([[1.0, 2.0], [3.0, 1.0], [0.5, 0.5]])


def drawn(axes):
    """Corners of the polygons, and ends of the lines."""
    polygons, *lines = axes.collections
    return [path.vertices[:-1] for path in polygons.get_paths()], [
        path.vertices for several in lines for path in several.get_paths()
    ]


def test_boxes_in_the_plane():
    boxes, lines = drawn(DynamicBVH.from_boxes(LO, HI).plot())
    assert lines == []
    np.testing.assert_array_equal([box.min(axis=0) for box in boxes], LO)
    np.testing.assert_array_equal([box.max(axis=0) for box in boxes], HI)


@pytest.mark.parametrize(('levels', 'boxes'), [(0, 1), ((0, 1), 3), ((1, 9), 4), (7, 0)])
def test_levels(levels, boxes):
    lines = drawn(DynamicBVH.from_boxes(LO, HI).plot(levels=levels))[1]
    assert len(lines) == 4 * boxes  # edges


def test_rays_end_at_their_hits_which_are_marked():
    """One ray meets the second box, one goes past all; one more hit is given."""
    rays = [[(0.0, 1.5), (9.0, 1.5)], [(0.0, 9.0), (9.0, 9.0)]]
    axes = DynamicBVH.from_boxes(LO[1:], HI[1:]).plot(rays=rays, hits=[(2.0, 2.0)])
    assert [line.tolist() for line in drawn(axes)[1]] == [
        [[0.0, 1.5], [4.0, 1.5]],
        [*map(list, rays[1])],
    ]
    (dots,) = axes.lines
    assert dots.get_xydata().tolist() == [[2.0, 2.0], [4.0, 1.5]]
    named = [text.get_text() for text in axes.get_legend().get_texts()]
    assert named == ['box', 'free ray', 'ray to its hit', 'hit']


def test_levels_have_no_colour_of_rays():
    axes = DynamicBVH.from_boxes(LO, HI).plot(levels=(0, 9), rays=[[(0.0, 1.5), (9.0, 1.5)]])
    levels, rays = (lines.get_colors()[:, :3].tolist() for lines in axes.collections[1:])
    assert rays[0] not in levels


def test_a_picture_in_space_shows_all_and_its_text_is_whole():
    lo, hi = np.hstack((LO, [[0]] * 3)), np.hstack((HI, [[2]] * 3))
    axes = DynamicBVH.from_boxes(lo, hi).plot(rays=[[(-3.0, 1.0, 1.0), (5.0, 1.0, 1.0)]], levels=0)
    assert axes.get_xlim()[0] <= -3.0
    assert axes.get_zlim()[1] >= 2.0
    (dots,) = axes.lines
    assert [float(place[0]) for place in dots.get_data_3d()] == [0.0, 1.0, 1.0]
    axes.set_title('A title')
    assert_seen(axes, (0.34, 0.71, 0.91))
    inside = axes.get_tightbbox(axes.figure.canvas.get_renderer())
    assert inside.x0 >= 0.0
    assert inside.y0 >= 0.0
    assert inside.x1 <= axes.figure.bbox.x1
    assert inside.y1 <= axes.figure.bbox.y1


def assert_seen(axes, colour):
    """The picture has some hundred pixels of this colour, in whatever light."""
    axes.figure.canvas.draw()
    pixels = np.asarray(axes.figure.canvas.buffer_rgba())[..., :3] / 255.0
    length = np.linalg.norm(pixels, axis=2) * np.linalg.norm(colour)
    alike = (pixels @ colour) / np.maximum(length, 1e-9)
    assert (alike > 0.9995).sum() > 300


def test_an_empty_tree_and_axes_of_ones_own(pyplot):
    axes = pyplot.figure().add_subplot(projection='3d')
    assert DynamicBVH().plot(axes) is axes


@pytest.mark.parametrize(
    ('given', 'said'),
    [
        ({'levels': -1}, 'levels'),
        ({'levels': 0.5}, 'levels'),
        ({'rays': [(0, 0)]}, r'rays must have shape \(n, 2, 2\)'),
        ({'hits': [(0, 0, 0)]}, r'hits must have shape \(n, 2\)'),
        ({'hits': [(0, np.nan)]}, 'hits must be finite'),
    ],
)
def test_wrong_arguments(given, said):
    with pytest.raises(ValueError, match=said):
        DynamicBVH.from_boxes(LO, HI).plot(**given)


def test_axes_of_the_wrong_kind(pyplot):
    with pytest.raises(ValueError, match='axes must have 3 dimensions'):
        DynamicBVH().plot(pyplot.figure().add_subplot())
