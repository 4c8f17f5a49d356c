# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What sources make of messages whose packages need not be installed."""

import math

import numpy as np
import pytest
from ros.messages import write

pytest.importorskip('moveit_msgs.msg', reason='pip install ./test/ros/sources/messages')
pytest.importorskip('octomap_msgs.msg', reason='pip install ./test/ros/sources/messages')
pytest.importorskip('vision_msgs.msg', reason='pip install ./test/ros/sources/messages')

import rclpy
from geometry_msgs.msg import Point, Pose
from moveit_msgs.msg import AttachedCollisionObject, CollisionObject, PlanningScene
from octomap_msgs.msg import Octomap
from rclpy.serialization import serialize_message
from scipy.spatial.transform import Rotation
from shape_msgs.msg import Mesh, MeshTriangle, Plane, SolidPrimitive
from vision_msgs.msg import Detection3D, Detection3DArray, ObjectHypothesisWithPose

from bvh_ros.ros.access import (
    SOURCE_TYPES,
    Frames,
    SourceSettings,
    TransformSettings,
    create_source,
)
from bvh_ros.scene import NodeScene, ShapeKind

TYPES = 'Detection3DArray', 'CollisionObject', 'PlanningScene', 'Octomap'
BOX, SPHERE, CYLINDER, CONE, PRISM = range(1, 6)
ADD, REMOVE, APPEND, MOVE = range(4)
LIDAR = (1.0, 2.0, 3.0), (0.0, 0.0, math.sqrt(0.5), math.sqrt(0.5))
UNTURNED = 0.0, 0.0, 0.0, 1.0
CORNERS = np.array([(0, 0, 0), (1, 0, 0), (0, 1, 0), (0, 0, 1)], float)
FACES = [(0, 1, 2), (0, 1, 3), (0, 2, 3), (1, 2, 3)]
RNG = np.random.default_rng(5)


@pytest.fixture(scope='module')
def node(ros_context):
    found = rclpy.create_node('packages')
    yield found
    found.destroy_node()


class Heard:
    """A source, its scene, and what it refused."""

    def __init__(self, node, kind, *, planar=False, most=1000, **options):
        given = {option.name: option.default for option in SOURCE_TYPES[kind].options} | options
        settings = SourceSettings('s', kind, 't', 'p.', False, 0.0, given)
        self.scene = NodeScene(planar=planar, max_obstacles=most)
        lidar = TransformSettings('lidar', 'map', *LIDAR)
        self.source = create_source(node, settings, self.scene, Frames('map', fixed=[lidar]))
        self.now = 0

    def hear(self, message):
        """Apply a message; return the rows that it refused, with the reasons."""
        before = len(self.refused_rows())
        self.now += 10**9
        self.source.apply_now(serialize_message(message), self.now)
        return self.refused_rows()[before:]

    def refused_rows(self):
        return self.source.refused.rows()['refused rows'].splitlines()

    @property
    def names(self):
        return {name for _, name in self.scene.names()}


@pytest.fixture
def heard(node):
    return lambda *args, **options: Heard(node, *args, **options)


def pose(at=(0, 0, 0), turn=UNTURNED):
    found = Pose()
    write(found.position, at)
    write(found.orientation, turn)
    return found


def random_pose(rng=RNG):
    return rng.uniform(-5, 5, 3), Rotation.random(random_state=rng).as_quat()


def after(second, first):
    """The motion that does `first` and then `second`."""
    turn = Rotation.from_quat(second[1])
    both = turn * Rotation.from_quat(first[1])
    return turn.apply(first[0]) + second[0], both.as_quat()


def inverse(place):
    """The way back."""
    turn = Rotation.from_quat(place[1]).inv()
    return -turn.apply(place[0]), turn.as_quat()


def stands(obstacle, place, size):
    """Whether an obstacle has this place (position and quaternion) and size."""
    np.testing.assert_allclose(obstacle.position, place[0], atol=1e-9)
    np.testing.assert_allclose(obstacle.size, size, rtol=1e-12)
    if obstacle.kind != ShapeKind.SPHERE:
        turned = Rotation.from_quat(obstacle.orientation).inv() * Rotation.from_quat(place[1])
        assert turned.magnitude() < 1e-6


# ---- Detection3DArray


def detections(*boxes, frame='map', stamp=0):
    message = Detection3DArray(detections=[*boxes])
    message.header.frame_id, message.header.stamp.sec = frame, stamp
    return message


def detection(name='', place=((0, 0, 0), UNTURNED), size=(1, 1, 1), frame='', stamp=0):
    found = Detection3D(id=name, results=[ObjectHypothesisWithPose()])
    found.header.frame_id, found.header.stamp.sec = frame, stamp
    found.bbox.center = pose(*place)
    write(found.bbox.size, size)
    return found


def test_detections_are_turned_boxes_with_names_frames_and_stamps(heard):
    it, places = heard('Detection3DArray'), [random_pose() for _ in range(4)]
    message = detections(
        detection('car', places[0], (1, 2, 3)),
        detection('', places[1]),
        detection('car', places[2]),
        detection('far', places[3], frame='lidar', stamp=7),
        stamp=4,
    )
    assert it.hear(message) == []
    assert it.names == {'p.car', 'p.s#1', 'p.s#2', 'p.far'}
    stands(it.scene.get('p.car'), places[0], (1, 2, 3))
    stands(it.scene.get('p.s#1'), places[1], (1, 1, 1))
    stands(it.scene.get('p.s#2'), places[2], (1, 1, 1))
    stands(it.scene.get('p.far'), after(LIDAR, places[3]), (1, 1, 1))
    stamps = [it.scene.get(f'p.{name}').stamp for name in ('car', 's#1', 'far')]
    assert stamps == [4 * 10**9, 4 * 10**9, 7 * 10**9]


def test_each_message_replaces_all_detections(heard):
    it = heard('Detection3DArray')
    it.hear(detections(detection('a'), detection('b'), detection()))
    it.hear(detections(detection('b'), detection('c')))
    assert it.names == {'p.b', 'p.c'}
    it.hear(detections())
    assert it.names == set()


def test_a_detection_that_cannot_be_used_keeps_its_box(heard):
    it = heard('Detection3DArray')
    it.hear(detections(detection('a', ((1, 0, 0), UNTURNED)), detection('b'), detection('c')))
    wrong = detections(
        detection('a', ((9, 0, 0), UNTURNED), frame='nowhere'),
        detection('b', size=(-1, 1, 1)),
        detection('d', ((5, 0, 0), UNTURNED)),
    )
    reasons = it.hear(wrong)
    assert "frame 'nowhere'" in reasons[0]
    assert 'size is negative' in reasons[1]
    assert it.names == {'p.a', 'p.b', 'p.d'}
    assert it.scene.get('p.a').position.tolist() == [1, 0, 0]
    it.hear(detections(detection('e'), frame='nowhere'))  # none of it can be used
    assert it.names == {'p.a', 'p.b', 'p.d'}
    assert "frame 'nowhere'" in it.source.refused.last


def test_detections_that_are_followed_have_velocities(heard):
    following = {'predict': 'constant_velocity', 'smoothing': 0.0, 'max_speed': 50.0}
    it = heard('Detection3DArray', **following)
    for second in (1, 2):
        place = (3.0 * second, 0, 0), UNTURNED
        it.hear(detections(detection('a', place), stamp=second))
    assert it.scene.raycast((9, -1, 0), (9, 1, 0)) is None
    assert it.scene.raycast((9, -1, 0), (9, 1, 0), at=3 * 10**9).name == 'p.a'


# ---- CollisionObject


def collision_object(name='a', operation=ADD, *, place=None, frame='map', **fields):
    found = CollisionObject(id=name, operation=bytes([operation]), **fields)
    found.header.frame_id = frame
    if place is not None:
        found.pose = pose(*place)
    return found


def solid(kind, *dimensions):
    return SolidPrimitive(type=kind, dimensions=[float(each) for each in dimensions])


def mesh(vertices=CORNERS, faces=FACES):
    triangles = [MeshTriangle(vertex_indices=np.array(face, np.uint32)) for face in faces]
    return Mesh(triangles=triangles, vertices=[Point(x=x, y=y, z=z) for x, y, z in vertices])


KINDS = {
    BOX: ((1, 2, 3), (1, 2, 3), ShapeKind.BOX),
    SPHERE: ((0.5,), (1, 1, 1), ShapeKind.SPHERE),
    CYLINDER: ((4, 0.5), (1, 1, 4), ShapeKind.CYLINDER),
}


@pytest.mark.parametrize('frame', ['map', 'lidar'])
def test_the_parts_of_an_object_stand_in_its_pose(heard, frame):
    it, place, places = heard('CollisionObject'), random_pose(), [random_pose() for _ in range(4)]
    message = collision_object(
        'table',
        place=place,
        frame=frame,
        primitives=[solid(kind, *given) for kind, (given, _, _) in KINDS.items()],
        primitive_poses=[pose(*each) for each in places[:3]],
        meshes=[mesh()],
        mesh_poses=[pose(*places[3])],
    )
    assert it.hear(message) == []
    assert it.names == {f'p.table/{k}' for k in range(4)}
    place = after(LIDAR, place) if frame == 'lidar' else place
    for part, (_, size, kind) in enumerate(KINDS.values()):
        obstacle = it.scene.get(f'p.table/{part}')
        assert obstacle.kind == kind
        stands(obstacle, after(place, places[part]), size)
    at, turn = after(place, places[3])
    inside = Rotation.from_quat(turn).apply((0.2, 0.2, 0.2)) + at
    outside = Rotation.from_quat(turn).apply((0.4, 0.4, 0.4)) + at
    touched = [[hit.name for hit in it.scene.overlap(p, p)] for p in (inside, outside)]
    assert 'p.table/3' in touched[0]
    assert 'p.table/3' not in touched[1]


def test_a_cone_is_the_pyramid_around_it(heard):
    it, height, radius = heard('CollisionObject'), 2.0, 0.5
    it.hear(collision_object(primitives=[solid(CONE, height, radius)]))
    rng = np.random.default_rng(1)
    for point in rng.uniform((-0.6, -0.6, -1.1), (0.6, 0.6, 1.1), (400, 3)):
        # How much wider than the cone the point is at its height: 1 is the surface.
        wide = np.hypot(*point[:2]) / (radius * (height / 2 - point[2]) / height)
        found = bool(it.scene.overlap(point, point))
        if abs(point[2]) > height / 2:
            assert not found
        elif wide <= 1.0 or wide >= 1.0 / math.cos(math.pi / 32) + 1e-6:
            assert found == (wide <= 1.0)


def box(at=(0, 0, 0), **given):
    sides = given.pop('size', (1, 1, 1))
    return {'primitives': [solid(BOX, *sides)], 'primitive_poses': [pose(at)], **given}


def two(name='a', operation=ADD, **given):
    """An object of two cubes, one above the other."""
    solids, poses = [solid(BOX, 1, 1, 1)] * 2, [pose(), pose((0, 0, 2))]
    return collision_object(name, operation, primitives=solids, primitive_poses=poses, **given)


def places(it):
    """Where all obstacles are."""
    return {name: tuple(it.scene.get(name).position.round(9).tolist()) for name in it.names}


def test_the_pose_of_the_only_part_is_the_objects_as_for_moveit(heard):
    it = heard('CollisionObject')
    it.hear(collision_object('a', **box((3, 0, 0))))
    it.hear(collision_object('a', MOVE, place=((0, 7, 0), UNTURNED)))
    assert places(it) == {'p.a/0': (0, 7, 0)}


def test_a_move_may_tell_where_the_parts_are_in_the_object(heard):
    it = heard('CollisionObject')
    it.hear(two())
    given = {'primitive_poses': [pose((1, 0, 0)), pose((2, 0, 0))]}
    it.hear(collision_object('a', MOVE, place=((0, 0, 5), UNTURNED), **given))
    assert places(it) == {'p.a/0': (1, 0, 5), 'p.a/1': (2, 0, 5)}
    (reason,) = it.hear(collision_object('a', MOVE, primitive_poses=[pose()]))
    assert 'it has 1 poses for 2 parts' in reason
    assert places(it) == {'p.a/0': (1, 0, 5), 'p.a/1': (2, 0, 5)}


NAN = float('nan')
OPEN = {'meshes': [mesh(faces=FACES[:1])]}
BEYOND = {'meshes': [mesh(faces=[(0, 1, 9)])]}
WRONG = {
    'which goes on for ever': {'planes': [Plane(coef=[0.0, 0.0, 1.0, 0.0])]},
    'it has no parts': {},
    'part 0: it is a PRISM, not a BOX, SPHERE, CYLINDER or CONE': {
        'primitives': [solid(PRISM, 1)]
    },
    'part 1: it is of type 9': {'primitives': [solid(BOX, 1, 1, 1), solid(9)]},
    'part 0: it has 1 dimensions, not 3': {'primitives': [solid(BOX, 1)]},
    'part 0: its size is negative': {'primitives': [solid(BOX, -1, 1, 1)]},
    'part 0: its size is not finite': {'primitives': [solid(BOX, NAN, 1, 1)]},
    'needs sizes above zero': {'primitives': [solid(SPHERE, 0)]},
    'part 0: a sphere, cylinder or capsule needs': {'primitives': [solid(CONE, 1, 0)]},
    'it has 2 poses for 1 parts': box(primitive_poses=[pose(), pose()]),
    'part 0: its position is not finite': box((NAN, 0, 0), place=((1, 0, 0), UNTURNED)),
    'part 0: the length of its orientation': box(
        primitive_poses=[pose(turn=(0, 0, 0, 2))], place=((1, 0, 0), UNTURNED)
    ),
    'its pose is not finite': box(place=((NAN, 0, 0), UNTURNED)),
    'triangle 0 has vertex 9 of 4': BEYOND,
    "frame 'nowhere'": box(frame='nowhere'),
    'unknown operation 7': box(operation=7),
}


@pytest.mark.parametrize('reason', WRONG)
def test_an_object_that_cannot_be_used_is_refused_and_the_old_one_stays(heard, reason):
    it = heard('CollisionObject')
    it.hear(two())
    (given,) = it.hear(collision_object('a', **WRONG[reason]))
    assert given.startswith("'p.a': ")
    assert reason in given
    assert places(it) == {'p.a/0': (0, 0, 0), 'p.a/1': (0, 0, 2)}


def test_a_mesh_that_the_scene_cannot_hold_is_refused(heard):
    it = heard('CollisionObject')
    if reasons := it.hear(collision_object('a', meshes=[mesh(faces=[(0, 0, 1)])])):
        assert reasons[0].startswith("'p.a': part 0: ")
    assert it.names == set()


def test_objects_without_an_id_and_moves_of_nothing_are_refused(heard):
    it = heard('CollisionObject')
    assert "'' is no id" in it.hear(collision_object('', **box()))[0]
    assert "'<octomap>' is no id" in it.hear(collision_object('<octomap>', **box()))[0]
    assert 'no such object to move' in it.hear(collision_object('b', MOVE))[0]
    assert it.hear(collision_object('b', REMOVE, frame='nowhere')) == []


def test_after_the_scene_was_cleared_there_is_nothing_to_move(heard):
    it = heard('CollisionObject')
    it.hear(two())
    it.scene.clear()
    it.source.forget()
    assert 'no such object to move' in it.hear(collision_object('a', MOVE))[0]


def test_in_a_planar_node_objects_are_footprints(heard):
    it = heard('CollisionObject', planar=True)
    parts = {'primitives': [solid(BOX, 1, 1, 1), solid(CONE, 1, 1)], 'meshes': [mesh()]}
    assert it.hear(collision_object(**parts, primitive_poses=[pose((5, 0, 9))])) == []
    assert it.scene.raycast((5, -9, 0), (5, 9, 0)).name == 'p.a/0'
    assert it.scene.raycast((0.47, -9, 0), (0.47, -0.01, 0)).name == 'p.a/1'


# ---- PlanningScene and Octomap

LEAF = b'\x02\x00'  # a root whose child 0 is occupied


def octomap(data=LEAF, *, binary=True, frame='map', kind='OcTree', resolution=2.0**-14):
    found = Octomap(binary=binary, id=kind, resolution=resolution)
    found.data = np.frombuffer(data, np.int8).tolist()
    found.header.frame_id = frame
    return found


def planning_scene(*objects, diff=False, attached=(), tree=None, origin=(0, 0, 0)):
    found = PlanningScene(is_diff=diff)
    found.robot_state.is_diff = True
    found.world.collision_objects = [*objects]
    found.robot_state.attached_collision_objects = [
        AttachedCollisionObject(link_name='hand', object=each) for each in attached
    ]
    if tree is not None:
        found.world.octomap.octomap, found.world.octomap.origin = tree, pose(origin)
        found.world.octomap.header.frame_id = tree.header.frame_id
    return found


def test_a_scene_replaces_or_changes_the_world(heard):
    it = heard('PlanningScene')
    assert it.hear(planning_scene(two('a'), collision_object('b', **box((1, 0, 0))))) == []
    assert it.names == {'p.a/0', 'p.a/1', 'p.b/0'}
    change = [collision_object('a', REMOVE), collision_object('c', **box((4, 0, 0)))]
    assert it.hear(planning_scene(*change, diff=True)) == []
    assert it.names == {'p.b/0', 'p.c/0'}
    handles = {name: it.scene.get(name).handle for name in it.names}
    assert it.hear(planning_scene(diff=True)) == []
    assert it.hear(planning_scene(collision_object('b', **box()))) == []
    assert it.names == {'p.b/0'}
    assert it.scene.get('p.b/0').handle == handles['p.b/0']
    assert it.hear(planning_scene()) == []
    assert it.names == set()


@pytest.mark.parametrize('seed', range(5))
@pytest.mark.parametrize('kind', ['PlanningScene', 'CollisionObject'])
def test_any_operations_leave_what_one_after_another_leaves(heard, seed, kind):
    it, world, rng = heard(kind), {}, np.random.default_rng(seed)
    for _ in range(30):
        steps = []
        for _ in range(rng.integers(4)):
            name, operation, place = 'abc'[rng.integers(3)], int(rng.integers(4)), random_pose(rng)
            if operation == REMOVE and rng.random() < 0.2:
                name = ''  # all of them
                world.clear()
            count = rng.integers(1, 4)
            parts = [(random_pose(rng), rng.uniform(0.1, 2, 3)) for _ in range(count)]
            if operation == REMOVE:
                world.pop(name, None)
            elif operation == ADD or (operation == APPEND and name not in world):
                world[name] = place, parts
            elif operation == APPEND:
                back = after(inverse(world[name][0]), place)
                world[name][1].extend((after(back, local), size) for local, size in parts)
            elif name in world:
                world[name], parts = (place, world[name][1]), []
            else:
                continue
            solids = [solid(BOX, *size) for _, size in parts]
            poses = [pose(*local) for local, _ in parts]
            given = {'primitives': solids, 'primitive_poses': poses, 'place': place}
            steps.append(collision_object(name, operation, **given))
        whole = [planning_scene(*steps, diff=True)]
        for message in whole if kind == 'PlanningScene' else steps:
            assert it.hear(message) == []
        expected = {
            f'p.{name}/{k}': (after(place, local), size)
            for name, (place, parts) in world.items()
            for k, (local, size) in enumerate(parts)
        }
        assert it.names == expected.keys()
        for name, (place, size) in expected.items():
            stands(it.scene.get(name), place, size)


def test_what_cannot_be_used_stays_even_if_the_scene_is_whole(heard):
    it = heard('PlanningScene')
    it.hear(planning_scene(two('a'), two('b'), two('c')))
    (reason,) = it.hear(planning_scene(collision_object('a', **WRONG['which goes on for ever'])))
    assert reason.startswith("'p.a': ")
    assert it.names == {'p.a/0', 'p.a/1'}


@pytest.mark.parametrize('name', ['a', ''])
@pytest.mark.parametrize('seconds', [5, 0])
def test_a_removal_is_data_of_its_stamp(heard, name, seconds):
    it = heard('CollisionObject')
    it.hear(collision_object('a', **box()))
    removal = collision_object(name, REMOVE)
    removal.header.stamp.sec = seconds
    it.hear(removal)
    assert (it.names, it.scene.newest) == (set(), seconds * 10**9 or it.now)


def test_an_empty_scene_is_data_of_when_it_came(heard):
    it = heard('PlanningScene')
    it.hear(planning_scene(collision_object('a', **box())))
    it.hear(planning_scene())
    assert (it.names, it.scene.newest) == (set(), it.now)


def test_what_is_attached_to_the_robot_leaves_the_world(heard):
    it = heard('PlanningScene')
    it.hear(planning_scene(two('a'), two('b')))
    assert it.hear(planning_scene(diff=True, attached=[collision_object('a')])) == []
    assert it.names == {'p.b/0', 'p.b/1'}
    left = collision_object('a', REMOVE)
    (reason,) = it.hear(planning_scene(diff=True, attached=[left]))
    assert 'it leaves the robot' in reason
    back = collision_object('a', **box((0, 3, 0)))
    assert it.hear(planning_scene(back, diff=True, attached=[left])) == []
    assert it.names == {'p.a/0', 'p.b/0', 'p.b/1'}


def test_the_octomap_of_a_scene(heard):
    it, leaf = heard('PlanningScene'), {'p.<octomap>/0'}
    # One leaf, 2 m long: from the lowest corner of the map, at -2 m, to its middle.
    given = {'tree': octomap(frame='lidar'), 'origin': (10, 0, 0)}
    assert it.hear(planning_scene(two('a'), **given)) == []
    assert it.names == leaf | {'p.a/0', 'p.a/1'}
    place = after(LIDAR, ((9, -1, -1), UNTURNED))
    obstacle = it.scene.get('p.<octomap>/0')
    np.testing.assert_allclose(obstacle.position, place[0], atol=1e-12)
    assert obstacle.size.tolist() == [2, 2, 2]
    assert it.hear(planning_scene(diff=True)) == []
    assert it.hear(planning_scene(diff=True, tree=octomap(LEAF * 2))) != []
    assert it.names == leaf | {'p.a/0', 'p.a/1'}
    assert it.hear(planning_scene(diff=True, tree=octomap(b'\x0a\x00'))) == []
    assert it.names == {'p.<octomap>/0', 'p.<octomap>/1', 'p.a/0', 'p.a/1'}
    assert it.hear(planning_scene(diff=True, tree=octomap(b'', kind='cleared'))) == []
    assert it.names == {'p.a/0', 'p.a/1'}
    it.hear(planning_scene(diff=True, tree=octomap()))
    assert it.hear(planning_scene()) == []
    assert it.names == set()


def test_each_octomap_replaces_the_one_before(heard):
    it = heard('Octomap')
    assert it.hear(octomap(b'\xaa\xaa', frame='lidar')) == []  # eight occupied children
    assert it.names == {f'p.s#{k}' for k in range(8)}
    middle = np.array(LIDAR[0])
    found = it.scene.overlap(middle - 2, middle + 2)
    assert len(found) == 8
    beside = [middle + np.array((2.01, y, 0)) for y in (-9, 9)]
    assert it.scene.raycast(*beside) is None
    it.hear(octomap(b'\x03\0'))
    assert 'beyond the end' in it.source.refused.last
    assert len(it.names) == 8
    assert it.hear(octomap(b'')) == []
    assert it.names == set()


def test_a_full_octomap_is_as_occupied_as_asked_for(heard):
    full = np.array([(0.0, 3), (1.0, 0), (-1.0, 0)], [('odds', '<f4'), ('children', 'u1')])
    given = {'data': full.tobytes(), 'binary': False}
    counts = []
    for share in (0.2, 0.5, 0.8):
        it = heard('Octomap', occupied_at=share)
        assert it.hear(octomap(**given)) == []
        counts.append(len(it.names))
    assert counts == [2, 1, 0]


def test_more_leaves_than_obstacles_may_be_are_refused(heard):
    it = heard('Octomap', most=7)
    it.hear(octomap(b'\xaa\xaa'))
    assert 'has 8 occupied leaves, more than 7' in it.source.refused.last
    assert it.names == set()


# ---- Bytes from anywhere.


def samples():
    """A message of each type, with all that it may have."""
    parts = {'primitives': [solid(CONE, 1, 1), solid(BOX, 1, 1, 1)], 'meshes': [mesh()]}
    thing = collision_object('a', **parts, primitive_poses=[pose((5, 0, 9))])
    full = np.array([(0.0, 3), (1.0, 0), (-1.0, 0)], [('odds', '<f4'), ('children', 'u1')])
    tree = octomap(full.tobytes(), binary=False)
    scene = planning_scene(thing, two('b'), diff=True, attached=[two('c')], tree=tree)
    return {
        'Detection3DArray': detections(detection('a'), detection('b', frame='lidar')),
        'CollisionObject': thing,
        'PlanningScene': scene,
        'Octomap': tree,
    }


@pytest.mark.parametrize(
    'kind', ['Detection3DArray', 'CollisionObject', 'PlanningScene', 'Octomap']
)
def test_damaged_bytes_are_refused_or_understood(heard, kind):
    it, whole, rng = heard(kind), serialize_message(samples()[kind]), np.random.default_rng(2)
    for now in range(1, 400):
        data = bytearray(whole)
        for _ in range(rng.integers(1, 4)):
            at = int(rng.integers(4, len(data)))
            data[at : at + 4] = rng.bytes(4) if rng.random() < 0.5 else bytes(4)
        it.source.apply_now(bytes(data[: rng.integers(4, 2 * len(data))]), now)
        assert not it.source.refused.last.startswith('internal error'), it.source.refused.last
    assert it.source.refused.count > 40
    it.scene.validate()


# ---- All of them in a node.


@pytest.mark.slow
def test_a_node_that_hears_all_of_them(start_node):
    sources = {name: {'type': name, 'topic': name} for name in TYPES}
    sources['PlanningScene'] |= {'required': True}
    world = start_node({'sources': [*TYPES], **sources})
    said = world.names('raycast', (0, 0, 0), (1, 0, 0))
    assert "'PlanningScene' has not spoken yet" in said[0]
    world.publish('Detection3DArray', detections(detection('car', ((0, 9, 0), UNTURNED))))
    world.publish('CollisionObject', collision_object('cup', **box((5, 0, 0))))
    world.publish('CollisionObject', collision_object('cup', **WRONG['it has no parts']))
    world.publish('PlanningScene', planning_scene(two('table', place=((0, 5, 0), UNTURNED))))
    world.publish('Octomap', octomap())
    expected = {'car', 'cup/0', 'table/0', 'table/1', 'Octomap#0'}
    world.until(lambda: world.everything() == expected)
    assert world.names('raycast', (5, -9, 0), (5, 9, 0)) == ['cup/0']
    world.publish('CollisionObject', collision_object('cup', MOVE, place=((7, 0, 0), UNTURNED)))
    world.until(lambda: world.names('raycast', (7, -9, 0), (7, 9, 0)) == ['cup/0'])
    assert world.names('raycast', (5, -9, 0), (5, 9, 0)) == []
    values = world.status('source CollisionObject').values
    assert values['refused'] == '1'
    assert values['last reason'] == "'cup': it has no parts"
