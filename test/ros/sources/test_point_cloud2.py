# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Clouds of every layout, and clouds that lie."""

import math
from functools import partial
from types import SimpleNamespace

import numpy as np
import pytest
from ros.clouds import cloud, field

from bvh_ros.ros.conversions.query_clouds import Boxes, Points, QueryCloud, Rays
from bvh_ros.ros.sources import point_cloud2

plain = partial(cloud, kind='f4')


def boxes_of(message, *, voxel):
    """All boxes of a cloud; in parts they are the same."""
    cloud = point_cloud2.BoxCloud(message, voxel=voxel)
    (whole,) = cloud.parts(max(cloud.total, 1))
    for length in (1, 2, 5):
        parts = list(cloud.parts(length))
        assert sum(part.skipped for part in parts) == whole.skipped
        for name in ('numbers', 'deleted'):
            joined = np.concatenate([getattr(part, name) for part in parts])
            assert np.array_equal(joined, getattr(whole, name))
        for number, column in enumerate(whole.shapes[:4]):  # a cloud has no meshes
            joined = np.concatenate([part.shapes[number] for part in parts])
            assert np.array_equal(joined, column, equal_nan=True)
    return SimpleNamespace(**whole._asdict(), by_id=cloud.by_id, refusals=cloud.refusals)


XYZ = {'x': [1, 2, 3, 4, 5, 6], 'y': [-1, -2, -3, -4, -5, -6], 'z': [7, 8, 9, 10, 11, 12]}


@pytest.mark.parametrize('kind', ['i1', 'i2', 'i4', 'f4', 'f8'])
@pytest.mark.parametrize('big', [False, True])
@pytest.mark.parametrize(('padding', 'row_padding', 'height'), [(0, 0, 1), (3, 0, 2), (5, 11, 3)])
def test_every_layout(kind, big, padding, row_padding, height):
    message = plain(
        XYZ, kind=kind, big=big, padding=padding, row_padding=row_padding, height=height
    )
    boxes = boxes_of(message, voxel=0.25)
    assert np.array_equal(boxes.shapes.position, np.column_stack(list(XYZ.values())))
    assert (boxes.shapes.size == 0.25).all()
    assert not boxes.shapes.orientation.any()
    assert boxes.numbers.tolist() == list(range(6))
    assert not boxes.by_id


def test_sizes_and_orientations_of_mixed_types():
    sizes = {'sx': [1, 2], 'sy': [3, 4], 'sz': [5, 6]}
    turns = {'qx': [0, 1], 'qy': [0, 0], 'qz': [1, 0], 'qw': [0, 0]}
    message = plain(
        {'x': [0, 1], 'y': [0, 1], 'z': [0, 1], **sizes, **turns},
        kinds={'x': 'f8', 'sx': 'u1', 'sy': 'i2', 'qz': 'i1'},
    )
    shapes = boxes_of(message, voxel=0.25).shapes
    assert np.array_equal(shapes.size, [[1, 3, 5], [2, 4, 6]])
    assert np.array_equal(shapes.orientation, [[0, 0, 1, 0], [1, 0, 0, 0]])


def test_nan_points_are_skipped_and_counted():
    message = plain({'x': [1, math.nan, 3], 'y': [1, 1, 1], 'z': [1, 1, math.nan]})
    boxes = boxes_of(message, voxel=0.1)
    assert boxes.skipped == 2
    assert boxes.numbers.tolist() == [0]  # rows keep their numbers


def test_ids_update_and_delete():
    sizes = {'sx': [1, math.nan, 1], 'sy': [1, 1, 1], 'sz': [1, 1, 1]}
    columns = {'x': [0, math.nan, 2], 'y': [0, 0, 0], 'z': [0, 0, 0], **sizes, 'id': [7, 8, 9]}
    boxes = boxes_of(plain(columns, kinds={'id': 'u4'}), voxel=0.1)
    assert boxes.by_id
    assert boxes.numbers.tolist() == [7, 9]
    assert boxes.deleted.tolist() == [8]
    assert boxes.skipped == 0


@pytest.mark.parametrize('kind', ['u1', 'i4', 'u4', 'f4', 'f8'])
def test_the_last_of_equal_ids_counts(kind):
    columns = {'x': [0, 1, 2], 'y': [0, 0, 0], 'z': [0, 0, 0], 'id': [5, 6, 5]}
    boxes = boxes_of(plain(columns, kinds={'id': kind}), voxel=0.1)
    assert boxes.numbers.tolist() == [6, 5]
    assert boxes.shapes.position[:, 0].tolist() == [1, 2]
    assert [refusal.row for refusal in boxes.refusals] == [0]


def test_ids_that_are_no_whole_numbers_are_refused():
    ids = [0.5, math.nan, math.inf, -3.0, 1e300]
    columns = {'x': range(5), 'y': range(5), 'z': range(5), 'id': ids}
    boxes = boxes_of(plain(columns, kind='f8'), voxel=0.1)
    assert boxes.numbers.tolist() == [-3]
    assert [refusal.row for refusal in boxes.refusals] == [0, 1, 2, 4]


def changed(**values):
    message = plain(XYZ, height=2)
    for name, value in values.items():
        setattr(message, name, value)
    return message


@pytest.mark.parametrize(
    ('message', 'reason'),
    [
        (changed(data=b'\0' * 71), 'data has 71 bytes'),
        (changed(data=b'\0' * 73), 'data has 73 bytes'),
        (changed(data=b''), 'data has 0 bytes'),
        (changed(width=4), 'row_step 36 is less than'),
        (changed(height=3), 'data has 72 bytes'),
        (changed(width=0), '72 bytes of data'),
        (changed(width=2**32 - 1, height=2**32 - 1), 'row_step'),
        (changed(point_step=11), 'outside its point'),
        (changed(point_step=0), 'outside its point'),
        (changed(row_step=35), 'row_step'),
        (changed(fields=[field('x', 0, 7), field('y', 4, 7)]), 'x, y but not z'),
        (changed(fields=[]), 'no fields x, y, z'),
        (changed(fields=[field('intensity', 0, 7)]), 'no fields x, y, z'),
        (changed(fields=[field(n, 0, 7) for n in ('x', 'y', 'z', 'sx')]), 'sx but not sy, sz'),
        (changed(fields=[field(n, 0, 7) for n in ('x', 'y', 'z', 'qw')]), 'qw but not qx, qy, qz'),
        (changed(fields=[field(n, 0, 7) for n in ('x', 'y', 'z', 'x')]), "'x' is there twice"),
        (changed(fields=[field('x', 0, 9)]), 'unknown datatype 9'),
        (changed(fields=[field('x', 0, 0)]), 'unknown datatype 0'),
        (changed(fields=[field('x', 0, 7, count=3)]), 'count 3'),
        (changed(fields=[field('x', 2**32 - 1, 8)]), 'outside its point'),
    ],
)
def test_a_cloud_that_contradicts_itself_is_refused(message, reason):
    with pytest.raises(ValueError, match=reason):
        boxes_of(message, voxel=0.1)


@pytest.mark.parametrize('fields', [[], [field('x', 0, 7)]])
def test_an_empty_cloud_has_no_boxes(fields):
    message = changed(width=0, data=b'', row_step=0, fields=fields)
    assert len(boxes_of(message, voxel=0.1).numbers) == 0


def test_other_fields_do_not_matter():
    message = changed()
    message.fields = [*message.fields, field('rgb', 10_000, 99, count=7), field('rgb', 0, 7)]
    assert len(boxes_of(message, voxel=0.1).numbers) == 6


def test_the_fields_of_questions():
    """Rays, boxes and points alike: answers are as wide as the widest field, and what a field
    has to be is said of the one that is not.
    """
    for kind_of_rows, names, optional in (
        (Rays, ('x', 'y', 'z', 'dx', 'dy', 'dz'), 't_max'),
        (Boxes, ('x', 'y', 'z', 'sx', 'sy', 'sz'), 'tolerance'),
        (Points, ('x', 'y', 'z'), 'max_distance'),
    ):
        columns = {name: [1.0] for name in (*names, optional)} | {'mask': [1]}
        for kinds, real in (({}, 'f4'), ({optional: 'f8'}, 'f8'), ({'x': 'f8'}, 'f8')):
            for mask in ('u1', 'u2', 'u4'):
                asked = plain(columns, kinds={'mask': mask, **kinds})
                questions = QueryCloud(asked, kind_of_rows)
                assert questions.real == np.dtype(real)
                assert len(questions.rows(0, 1).masks) == 1
        for wrong, kind, needed in (
            ('mask', 'i4', "'mask' is int32; it has to be an unsigned integer"),
            (optional, 'i2', f"'{optional}' is int16; it has to be float32 or float64"),
        ):
            with pytest.raises(ValueError, match=needed):
                QueryCloud(plain(columns, kinds={'mask': 'u4', wrong: kind}), kind_of_rows)
