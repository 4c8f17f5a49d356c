# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""TRIANGLE_LIST markers as exporters write them, in space and in a planar node."""

import math

import numpy as np
import pytest
from ros.messages import LATCHED, coordinates, marker, xyz
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import MarkerArray

TRIANGLE_LIST = 11
CORNERS = np.float32([(1, 0, 0), (0, 1, 0), (-1, 0, 0), (0, -1, 0), (0, 0, 1), (0, 0, -1)])
FACES = [(a, (a + 1) % 4, tip) for a in range(4) for tip in (4, 5)]  # an octahedron, wound anyhow
POINTS = [CORNERS[i] for face in FACES for i in face]
NO_AREA = [CORNERS[i] for i in (0, 0, 1)]


@pytest.mark.parametrize('planar', [False, pytest.param(True, marks=pytest.mark.slow)])
def test_a_scaled_coloured_mesh_with_triangles_without_area(start_node, planar):
    """An octahedron, 2 m x 4 m x 6 m, turned by a quarter about z: 4 m along x, 2 m along y."""
    world = start_node({'planar': planar})
    quarter = (0, 0, math.sqrt(0.5), math.sqrt(0.5))
    solid = marker(
        1, (5, 0, 0), (1, 2, 3), turn=quarter, type=TRIANGLE_LIST, points=POINTS + NO_AREA
    )
    solid.colors = [ColorRGBA(r=1.0, a=1.0)] * len(solid.points)
    world.markers(solid, marker(2, (5, 9, 0), type=TRIANGLE_LIST, points=POINTS[:6]))
    world.holds('a/1')
    assert 'not closed' in world.said() or 'flat' in world.said()

    (pose,) = world.plan('raycast', (0, 0.5, 0), (9, 0.5, 0)).poses
    assert coordinates(pose) == pytest.approx((4.0, 0.5, 0.0))
    # The edge from (3, 0) to (5, 1): outwards (-1, 2), that is x turned by 116.6 degrees; in
    # space the ray meets the edge of the octahedron, and the normal is one of its two faces.
    if planar:
        assert pose.pose.orientation.z == pytest.approx(math.sin(math.atan2(2, -1) / 2))
    ball = world.place('raycast', (5, 9, 0), (5, -9, 0), tolerance=0.5)
    assert ball == pytest.approx((5.0, 1.0, 0.0), abs=1e-6)

    corner = (6.6, 0.6, 0.0)  # in its box, beside it
    assert world.names('raycast', corner, corner) == []
    assert world.names('overlap', corner, corner, tolerance=0.5) == ['a/1']
    high = (5.0, 0.9, 2.0)  # above its slope: only seen from above it is there
    assert world.names('raycast', high, high) == (['a/1'] if planar else [])
    assert world.names('overlap', (4.9, -0.1, -0.1), (5.1, 0.1, 0.1)) == ['a/1']

    solid.pose.position.x = 25.0
    world.markers(solid)
    world.until(lambda: world.names('raycast', (20, 0, 0), (30, 0, 0)) == ['a/1'])
    assert world.names('raycast', (0, 0, 0), (9, 0, 0)) == []
    world.until(lambda: world.status('world').values['different meshes'] == '1')


# A channel: a floor and two walls, one list of triangles; and a sheet that is open.
FLOOR, WALL = ((-2, -1, -0.1), (2, 1, 0.1)), ((-2, 0.8, 0.1), (2, 1.0, 1.0))
SHEET = [(4, -1, 0), (4, 1, 0), (4, 1, 1), (4, -1, 0), (4, 1, 1), (4, -1, 1)]


@pytest.mark.slow  # it compiles what only nodes with such meshes need
@pytest.mark.parametrize('meshes', ['solid', 'surface'])
def test_meshes_that_are_not_convex(start_node, meshes):
    other = tuple((x, -y, z) for x, y, z in WALL)
    points = [place for ends in (FLOOR, WALL, other) for place in corners_of_box(*ends)]
    source = {'type': 'MarkerArray', 'topic': 'bvh/obstacles', 'meshes': meshes}
    world = start_node({'sources': ['markers'], 'markers': source})
    channel = marker(1, (0, 0, 0), type=TRIANGLE_LIST, points=points)
    sheet = marker(2, (0, 0, 0), type=TRIANGLE_LIST, points=SHEET)
    world.show(channel, sheet)
    assert world.names('raycast', (-3, 0, 0.5), (3, 0, 0.5)) == []  # through the channel
    assert world.names('raycast', (-3, 0, 0.5), (5, 0, 0.5)) == ['a/2']
    assert world.names('raycast', (-3, 0, 0.5), (3, 0, 0.5), tolerance=0.5) == ['a/1']
    assert world.names('overlap', (-1, -0.5, 0.2), (1, 0.5, 0.9)) == []
    inside = (-0.1, -0.1, -0.01), (0.1, 0.1, 0.01)  # the floor
    assert world.names('overlap', *inside) == (['a/1'] if meshes == 'solid' else [])
    point = 0, 0.5, 0.5
    world.until_compiled(lambda: world.names('nearest', point, point, tolerance=0.4) == ['a/1'])
    assert world.place('nearest', point, point, tolerance=0.4)[1] == pytest.approx(0.8, abs=1e-6)
    scene, queries = (world.heard(MarkerArray, of, LATCHED) for of in ('scene', 'queries'))
    world.until(lambda: scene and len(scene[-1].markers) == 3)
    shown = [xyz(marker.points).tolist() for marker in scene[-1].markers[1:]]
    assert shown == [np.array(points).tolist(), np.array(SHEET, float).tolist()]
    world.until(lambda: world.node.count_publishers(f'{world.name}/queries') == 1)

    def lines_to_the_sheet():
        world.names('raycast', (-3, 0.2, 0.5), (5, 0.2, 0.5))
        return queries and [m for m in queries[-1].markers if len(m.points) == 2 * 4]

    world.until(lines_to_the_sheet)
    (lines,) = lines_to_the_sheet()
    ends = xyz(lines.points).reshape(-1, 2, 3)
    assert ends[0].tolist() == [[-3, 0.2, 0.5], [5, 0.2, 0.5]]
    a, b, c = np.array(SHEET[:3], float)
    np.testing.assert_allclose(ends[1:], [(a, b), (b, c), (c, a)], atol=1e-12)
    channel.pose.position.x = 25.0
    world.markers(channel)
    world.until(lambda: world.names('raycast', (25, 0.9, 9), (25, 0.9, 0)) == ['a/1'])


@pytest.mark.slow  # nor do planar nodes
def test_a_planar_node_sees_their_shadows(start_node, client_of):
    """An L and a sheet that stands upright; a footprint at rest beside, and in them."""
    parts = (((0, 0, 0), (9, 3, 2)), ((0, 0, 0), (3, 9, 2)))
    points = [place for ends in parts for place in corners_of_box(*ends)]
    source = {'type': 'MarkerArray', 'topic': 'bvh/obstacles', 'meshes': 'solid'}
    given = {'sources': ['markers'], 'markers': source, 'footprint': [1.0, 1.0, 1.0]}
    world = start_node({'planar': True, **given})
    corner = marker(1, (0, 0, 50), type=TRIANGLE_LIST, points=points)
    sheet = marker(2, (-10, 0, 0), type=TRIANGLE_LIST, points=SHEET)
    world.show(corner, sheet)
    assert world.names('raycast', (8, 4, 0), (4, 8, 0)) == []  # through the nook
    assert world.names('raycast', (8, 8, 0), (1, 1, 0)) == ['a/1']
    assert world.names('raycast', (-9, 0, 0), (-3, 0, 0)) == ['a/2']
    assert world.names('raycast', (8, 4, 0), (4, 8, 0), tolerance=3.0) == ['a/1']
    assert world.names('overlap', (4, 4, 0), (8, 8, 0)) == []
    assert world.names('overlap', (2, 4, 0), (8, 8, 0)) == ['a/1']
    point = 8, 8, 0
    world.until_compiled(lambda: world.names('nearest', point, point, tolerance=5.0) == ['a/1'])
    hits = client_of(world).check_path([[8.0, 8.0, 0.0], [4.0, 1.0, 0.0]])
    assert hits.distances == pytest.approx([4.5, 0.0])  # how deep it is there is not known
    assert not hits.normals[1].any()


def corners_of_box(lo, hi):
    """Three points for each triangle of a box."""
    ends = np.array((lo, hi))
    places = np.array([[ends[b, k] for k, b in enumerate(bits)] for bits in np.ndindex(2, 2, 2)])
    faces = [
        *((0, 1, 3), (0, 3, 2), (4, 6, 7), (4, 7, 5), (0, 4, 5), (0, 5, 1)),
        *((2, 3, 7), (2, 7, 6), (0, 2, 6), (0, 6, 4), (1, 5, 7), (1, 7, 3)),
    ]
    return [tuple(places[i]) for face in faces for i in face]
