# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Grids: the rectangles cover the occupied cells, each once, and are few."""

import math
import tracemalloc

import numpy as np
import pytest
from ros.messages import grid, write
from ros.sources.generators import ended

from bvh_ros.ros.sources import occupancy_grid

OPTIONS = {'occupied_at': 65, 'unknown_occupied': False, 'z_min': 0.0, 'z_max': 2.0, 'most': 1000}


def rectangles(mask, most=100_000):
    return ended(occupancy_grid.rectangles(mask, lambda part: part, most))


def boxes(message, **options):
    return ended(occupancy_grid.boxes(message, **options))


def placed(cells, at=(0, 0, 0), turn=(0, 0, 0, 1)):
    """Cells of half a metre that begin somewhere."""
    message = grid(cells, 0.5)
    write(message.info.origin.position, at)
    write(message.info.origin.orientation, turn)
    return message


def painted(rectangles, shape):
    count = np.zeros(shape, dtype=int)
    for column, row, end_column, end_row in rectangles:
        assert column < end_column
        assert row < end_row
        count[row:end_row, column:end_column] += 1
    return count


@pytest.mark.parametrize('density', [0.0, 0.1, 0.5, 0.9, 1.0])
@pytest.mark.parametrize('shape', [(1, 1), (1, 9), (9, 1), (7, 5), (20, 31)])
def test_rectangles_cover_each_cell_once(density, shape):
    mask = np.random.default_rng(3).random(shape) < density
    assert np.array_equal(painted(rectangles(mask), shape), mask)


def test_bands_are_joined(monkeypatch):
    random = np.random.default_rng(4)
    for shape in ((40, 7), (7, 40), (23, 23)):
        mask = np.repeat(np.repeat(random.random(shape) < 0.4, 3, axis=0), 2, axis=1)
        whole = sorted(rectangles(mask).tolist())
        for band in (1, 30, 100):
            monkeypatch.setattr(occupancy_grid, 'BAND', band)
            assert sorted(rectangles(mask).tolist()) == whole
            assert sorted(rectangles(mask, len(whole)).tolist()) == whole
            with pytest.raises(ValueError, match='more than'):
                rectangles(mask, len(whole) - 1)
        monkeypatch.undo()


def test_what_is_only_announced_costs_nothing():
    for shape in ((0, 2**32 - 1), (2**32 - 1, 0)):
        message = placed(np.zeros((1, 0)))
        message.info.width, message.info.height = shape
        tracemalloc.start()
        assert len(boxes(message, **OPTIONS).kind) == 0
        assert tracemalloc.get_traced_memory()[1] < 100_000
        tracemalloc.stop()


@pytest.mark.parametrize(
    ('mask', 'expected'),
    [
        (np.ones((8, 9)), [[0, 0, 9, 8]]),
        (np.eye(2), [[0, 0, 1, 1], [1, 1, 2, 2]]),
        ([[1, 1, 1], [1, 0, 0]], None),
        (np.zeros((3, 3)), []),
        (np.zeros((0, 0)), []),
    ],
)
def test_rectangles_of_simple_masks(mask, expected):
    found = rectangles(np.asarray(mask, dtype=bool))
    if expected is None:
        assert len(found) == 2
    else:
        assert found.tolist() == expected


def test_rows_apart_are_not_merged():
    mask = np.array([[1, 1], [0, 0], [1, 1]], dtype=bool)
    assert sorted(rectangles(mask).tolist()) == [[0, 0, 2, 1], [0, 2, 2, 3]]


def test_values_that_are_occupied():
    cells = [[0, 64, 65, 100, 127, -1, -2]]
    assert boxes(placed(cells), **OPTIONS).size[:, 0].tolist() == [1.5]
    both = boxes(placed(cells), **{**OPTIONS, 'unknown_occupied': True})
    assert both.size[:, 0].tolist() == [2.5]


def test_boxes_lie_along_the_yaw_of_the_origin():
    yaw = math.radians(90)
    turn = (0, 0, math.sin(yaw / 2), math.cos(yaw / 2))
    shapes = boxes(
        placed([[0, 100, 100]], at=(10, 20, 3), turn=turn), **{**OPTIONS, 'z_min': -1.0}
    )
    # x from 0.5 to 1.5 and y from 0 to 0.5 in the grid; x of the grid is y of the world.
    assert np.allclose(shapes.position, [[10 - 0.25, 20 + 1.0, 3 + 0.5]])
    assert np.allclose(shapes.size, [[1.0, 0.5, 3.0]])
    assert np.allclose(shapes.orientation, [turn])


def lying(**values):
    message = placed([[0, 100], [100, 0]])
    for name, value in values.items():
        setattr(message.info if hasattr(message.info, name) else message, name, value)
    return message


@pytest.mark.parametrize(
    ('message', 'reason'),
    [
        (lying(width=3), 'data has 4 cells'),
        (lying(height=0), 'data has 4 cells'),
        (lying(resolution=0.0), 'resolution'),
        (lying(resolution=-0.1), 'resolution'),
        (lying(resolution=math.nan), 'resolution'),
        (lying(resolution=math.inf), 'resolution'),
        (placed([[100]], at=(math.nan, 0, 0)), 'not finite'),
        (placed([[100]], turn=(0, 0, math.inf, 1)), 'not finite'),
        (placed([[100]], turn=(0.1, 0, 0, 1)), 'tilted'),
    ],
)
def test_a_grid_that_contradicts_itself_is_refused(message, reason):
    with pytest.raises(ValueError, match=reason):
        boxes(message, **OPTIONS)


def test_willow_garage(shared_data):
    """Half a real building: 3,486 occupied cells, less than half as many boxes."""
    cells = np.loadtxt(
        shared_data / 'willow_garage_map' / 'occupied_cells.csv', delimiter=',', skiprows=1
    )
    columns, rows = np.floor(cells[:, :2] / 0.1 + 1e-6).astype(int).T
    mask = np.zeros((rows.max() + 1, columns.max() + 1), dtype=bool)
    mask[rows, columns] = True
    found = rectangles(mask)
    assert np.array_equal(painted(found, mask.shape), mask)
    assert len(found) < len(cells) / 2
