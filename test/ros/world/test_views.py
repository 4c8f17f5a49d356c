# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views: bits by patterns of names, and the same questions about a part of the world."""

import fnmatch

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from ros.messages import marker

from bvh_ros.client import BvhTimeoutError
from bvh_ros.ros.parameters import ViewSettings
from bvh_ros.ros.world.views import Categoriser, Patterns, create_views
from bvh_ros.scene import NodeScene, Numbered, Shapes
from bvh_ros.scene.names import as_families

PATTERNS = st.text(alphabet='ab#/01*?[!]-', max_size=6)
PREFIXES = st.text(alphabet='ab#/01', max_size=4).filter(lambda text: text[-1:] not in '01')


def expected(name, views):
    """Bit 0, and that of each view that shows the name."""
    mask = 1
    for bit, view in enumerate(views, 1):
        shown = any(fnmatch.fnmatchcase(name, pattern) for pattern in view.include)
        hidden = any(fnmatch.fnmatchcase(name, pattern) for pattern in view.exclude)
        mask |= (shown and not hidden) << bit
    return mask


def view(name='v', include=('*',), exclude=(), skip_inside=False):
    return ViewSettings(name, tuple(include), tuple(exclude), skip_inside)


@given(
    st.lists(
        st.tuples(st.lists(PATTERNS, max_size=3), st.lists(PATTERNS, max_size=2)), max_size=4
    ),
    PREFIXES,
    st.lists(st.integers(0, 10**18 - 1) | st.integers(0, 120), max_size=8),
)
def test_bits_of_numbered_names_are_those_of_their_strings(patterns, prefix, numbers):
    views = [view(f'v{i}', *both) for i, both in enumerate(patterns)]
    categorise = Categoriser(views)
    names = [f'{prefix}{number}' for number in numbers]
    masks = [expected(name, views) for name in names]
    numbered = as_families(Numbered(prefix, np.array(numbers, np.int64)))
    assert categorise(as_families(names)).tolist() == masks
    assert categorise(numbered).tolist() == masks


@pytest.mark.parametrize(
    'pattern', ['cloud#*', '*', '*#*', 'robot1/*', 'x?[0-9]', 'cloud', 'cloud#', 'a*9', '']
)
def test_a_cloud_is_matched_once_for_all_numbers(pattern, monkeypatch):
    """72,000 new names cost one match where the number cannot matter."""
    asked = []
    categorise = Categoriser([view(include=[pattern])])
    match = Patterns.match
    monkeypatch.setattr(
        Patterns, 'match', lambda patterns, name: asked.append(name) or match(patterns, name)
    )
    masks = categorise(as_families(Numbered('cloud#', np.arange(72_000))))
    assert (masks == expected('cloud#7', [view(include=[pattern])])).all()
    assert len(asked) <= 2  # included, and excluded


def test_names_of_many_kinds_at_once():
    names = ['a/1', 'a', 'wall', 'a/01', 'a/2', 'wall7', 'a/1x', 'a/12345678901234567890', 'a/']
    views = [view(include=['a/*']), view(include=['a/?', 'wall']), view(exclude=['*1*'])]
    masks = Categoriser(views)(as_families(names))
    assert masks.tolist() == [expected(name, views) for name in names]


def test_a_pattern_that_asks_for_the_number_gets_every_name():
    views = [view(include=['cloud#1*', '*77'], exclude=['cloud#?'])]
    masks = Categoriser(views)(as_families(Numbered('cloud#', np.arange(2000))))
    assert masks.tolist() == [expected(f'cloud#{n}', views) for n in range(2000)]
    assert (masks > 1).any()
    assert (masks == 1).any()


def test_a_scene_asks_for_categories_when_an_obstacle_appears():
    asked = []

    def categorise(names):
        asked.append([names.text(row) for row in range(len(names))])
        return np.full(len(names), 6, np.uint32)

    scene = NodeScene(categorise=categorise)
    boxes = Shapes.boxes([[0, 0, 0], [5, 0, 0]], [1, 1, 1])
    scene.update('s', ['a', 'b'], boxes, stamp=1)
    scene.update('s', ['b', 'a'], boxes, stamp=2)
    assert asked == [['a', 'b']]
    assert {hit.name for hit in scene.overlap((-9, -9, -9), (9, 9, 9), mask=4)} == {'a', 'b'}
    assert scene.overlap((-9, -9, -9), (9, 9, 9), mask=1) == []
    scene.update('s', ['a'], boxes.take(np.array([0])), stamp=3, categories=1)
    scene.update('s', ['a'], boxes.take(np.array([1])), stamp=4)
    assert [hit.name for hit in scene.overlap((-9, -9, -9), (9, 9, 9), mask=4)] == ['b']


def test_each_view_has_a_bit_of_its_own():
    views = create_views([view(f'v{k}') for k in range(31)])
    assert [v.mask for v in views] == [0xFFFFFFFF, *(1 << k for k in range(1, 32))]
    assert [v.topic('raycast') for v in views[:2]] == ['~/raycast', '~/v0/raycast']


# ---- over ROS 2

VIEWED = {
    'views': ['arm', 'people', 'nobody'],
    'arm.exclude': ['arm/*'],
    'people.include': ['person/*', 'guest/*'],
    'people.skip_inside': True,
    'nobody.include': ['no such name'],
}


@pytest.fixture(scope='module')
def viewed(start_node):
    """Three boxes in a row: part of the arm, a person, a crate."""
    world = start_node(VIEWED)
    world.markers(
        *(
            marker(i, at=(x, 0, 0), ns=ns)
            for i, (ns, x) in enumerate([('arm', 0), ('person', 3), ('crate', 6)])
        )
    )
    world.until(lambda: len(world.everything()) == 3)
    return world


@pytest.mark.parametrize(
    ('name', 'seen'),
    [
        ('raycast', ['arm/0']),
        ('raycast_all', ['arm/0', 'person/1', 'crate/2']),
        ('arm/raycast', ['person/1']),
        ('arm/raycast_all', ['person/1', 'crate/2']),
        ('people/raycast', ['person/1']),
        ('people/raycast_all', ['person/1']),
        ('nobody/raycast', []),
        ('nobody/raycast_all', []),
    ],
)
@pytest.mark.parametrize('tolerance', [0.0, 0.25])
def test_rays_see_their_view(viewed, name, seen, tolerance):
    assert viewed.names(name, (0, 0, 0), (9, 0, 0), tolerance=tolerance) == seen


@pytest.mark.parametrize(
    ('name', 'seen'),
    [
        ('overlap', {'arm/0', 'person/1', 'crate/2'}),
        ('arm/overlap', {'person/1', 'crate/2'}),
        ('people/overlap', {'person/1'}),
        ('nobody/overlap', set()),
    ],
)
def test_overlaps_see_their_view(viewed, name, seen):
    assert set(viewed.names(name, (-9, -9, -9), (9, 9, 9))) == seen


def test_only_a_view_that_skips_it_ignores_the_box_around_the_start(viewed):
    assert viewed.names('arm/raycast', (3, 0, 0), (9, 0, 0)) == ['person/1']
    assert viewed.names('people/raycast', (3, 0, 0), (9, 0, 0)) == []
    assert viewed.names('people/raycast_all', (3, 0, 0), (0, 0, 0)) == []


@pytest.mark.parametrize('name', ['arm/raycast', 'people/raycast_all', 'nobody/overlap'])
def test_a_view_refuses_like_the_whole(viewed, name):
    (pose,) = viewed.plan(name, (0, 0, float('nan')), (1, 0, 0)).poses
    assert pose.header.frame_id == 'error: start.pose.position is not finite'


@pytest.mark.parametrize('name', ['raycast', 'raycast_all', 'overlap'])
@pytest.mark.parametrize('view_name', ['', 'part/'])
def test_a_missing_required_source_is_an_error_in_every_view(incomplete, view_name, name):
    (pose,) = incomplete.plan(view_name + name, (0, 0, 0), (1, 0, 0)).poses
    assert pose.header.frame_id == "error: required source 'markers' has not spoken yet"


@pytest.fixture(scope='module')
def incomplete(start_node):
    return start_node({'markers.required': True, 'views': ['part']})


def test_a_client_of_a_view_learns_names_from_the_node(viewed, client_of):
    client = client_of(f'{viewed.name}/arm')
    hits = client.raycast_many([[-90.0, 0, 0]], [[1.0, 0, 0]])
    (name,) = client.names(hits.obstacles).values()
    assert name == client.raycast((-90, 0, 0), (1e6, 0, 0)).name
    with pytest.raises(BvhTimeoutError, match='nobody publishes the names'):
        client_of('/nobody/bvh').names([1], timeout=0.1)
