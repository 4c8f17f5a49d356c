# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Obstacles whose meshes are files: which files may be read, and what is known meanwhile."""

import os
import struct
import time
from functools import partial
from urllib.parse import quote

import numpy as np
import pytest
from rclpy.serialization import serialize_message
from ros.messages import marker
from ros.patience import PATIENCE
from ros.sources.changes import change_of, source_of
from ros.sources.generators import ended
from scene.reference import box_of_triangles
from visualization_msgs.msg import MarkerArray

from bvh_ros.scene import AS_CONVEX, AS_SOLID, NodeScene, ShapeKind

MOST_SECONDS = 'bvh_ros.ros.sources.mesh_resources.MOST_SECONDS'
MESH_RESOURCE, DELETE = 10, 2
ONE = np.ones(3)
NOW = 10**12
FACET = struct.Struct('<12fH')
CORNERS = [(0, 0, 0), (2, 0, 0), (0, 2, 0), (0, 0, 2)]
TETRAHEDRON = np.array(CORNERS)[[(0, 1, 2), (0, 3, 1), (0, 2, 3), (1, 3, 2)]]


def stl(triangles):
    facets = [FACET.pack(0, 0, 0, *one, 0) for one in np.reshape(triangles, (-1, 9))]
    return bytes(80) + struct.pack('<I', len(facets)) + b''.join(facets)


def slow_obj(lines):
    """A tetrahedron after so many lines, which take a while to read."""
    places = [f'v {x} {y} {z}' for x, y, z in CORNERS]
    faces = 'f 1 2 3', 'f 1 4 2', 'f 1 3 4', 'f 2 4 3'
    return '\n'.join([*('vn 0 0 1',) * lines, *places, *faces]).encode()


def write(folder, name, data):
    file = folder / name
    file.parent.mkdir(parents=True, exist_ok=True)
    file.write_bytes(data)
    return file


@pytest.fixture(scope='module')
def files(tmp_path_factory):
    """Folders with meshes, one of them of a package, and what lies outside."""
    root = tmp_path_factory.mktemp('files')
    tetrahedron = stl(TETRAHEDRON)
    write(root, 'meshes/a.stl', tetrahedron)
    write(root, 'meshes/a b%41#?.stl', tetrahedron)
    write(root, 'meshes/two.stl', stl([*TETRAHEDRON, *(TETRAHEDRON + 9)]))
    write(root, 'meshes/cut.stl', tetrahedron[:-1])
    write(root, 'meshes/nan.stl', stl(TETRAHEDRON * np.nan))
    write(root, 'meshes/many.stl', stl(np.tile(box_of_triangles((1, 1, 1)), (10, 1, 1))))
    write(root, 'meshes/large.stl', bytes(60_000))
    write(root, 'meshes/a.txt', tetrahedron)
    write(root, 'meshes/inner/a.stl', tetrahedron)
    write(root, 'meshes_too/a.stl', tetrahedron)
    write(root, 'outside.stl', tetrahedron)
    share = root / 'prefix/share'
    write(share, 'robot/meshes/a.stl', tetrahedron)
    write(share, 'other/a.stl', tetrahedron)
    write(share, 'ament_index/resource_index/packages/robot', b'')
    links = {
        'meshes/out.stl': '../outside.stl',
        'meshes/in.stl': 'inner/a.stl',
        'meshes/up': '..',
        'meshes/loop.stl': 'loop.stl',
        'prefix/share/robot/out.stl': '../other/a.stl',
        'prefix/share/robot/source.stl': '../../../meshes/a.stl',
    }
    for name, target in links.items():
        (root / name).symlink_to(target)
    os.mkfifo(root / 'meshes/pipe.stl')
    return root


@pytest.fixture
def finder(files, monkeypatch, configure):
    monkeypatch.setenv('AMENT_PREFIX_PATH', str(files / 'prefix'))
    monkeypatch.setattr(MOST_SECONDS, PATIENCE)
    return finder_in(configure, files / 'meshes')


def finder_in(configure, folder):
    """What sources of a node read mesh files by: at most 100 meshes, and 50 kB a file."""
    limits = {'mesh_limit': 100, 'mesh_megabytes': 0.05}
    (source,) = configure({'mesh_paths': [str(folder)], **limits}).world.sources
    return source.mesh_files()


FOUND = [
    ('file://{root}/meshes/a.stl', 'meshes/a.stl'),
    ('file://localhost{root}/meshes/a.stl', 'meshes/a.stl'),
    ('file://{root}/meshes/%61%2Estl', 'meshes/a.stl'),
    ('file://{root}/meshes/inner/../a.stl', 'meshes/a.stl'),
    ('file://{root}/meshes/../meshes//a.stl', 'meshes/a.stl'),
    ('file://{root}/meshes/' + quote('a b%41#?.stl'), 'meshes/a b%41#?.stl'),
    ('file://{root}/meshes/in.stl', 'meshes/inner/a.stl'),
    ('package://robot/meshes/a.stl', 'prefix/share/robot/meshes/a.stl'),
    ('package://robot//meshes/../meshes/a.stl', 'prefix/share/robot/meshes/a.stl'),
    ('package://robot/source.stl', 'meshes/a.stl'),
]


@pytest.mark.parametrize(('name', 'path'), FOUND)
def test_files_that_may_be_read(finder, files, name, path):
    assert finder.find(name.format(root=files)).path == os.path.realpath(files / path)


OUTSIDE = "in no folder of 'mesh_paths'"
REFUSED = [
    ('', 'only file:// and package://'),
    ('{root}/meshes/a.stl', 'only file:// and package://'),
    ('http://localhost{root}/meshes/a.stl', 'only file:// and package://'),
    ('FILE://{root}/meshes/a.stl', 'only file:// and package://'),
    ('embedded://a.stl', 'only file:// and package://'),
    ('file://meshes/a.stl', 'three slashes'),
    ('file://host{root}/meshes/a.stl', 'three slashes'),
    ('file://', 'three slashes'),
    ('file://{root}/outside.stl', OUTSIDE),
    ('file://{root}/meshes/../outside.stl', OUTSIDE),
    ('file://{root}/meshes/%2e%2e/outside.stl', OUTSIDE),
    ('file://{root}/meshes/..%2Foutside.stl', OUTSIDE),
    ('file://{root}/meshes_too/a.stl', OUTSIDE),
    ('file://{root}/meshes/out.stl', OUTSIDE),
    ('file://{root}/meshes/up/outside.stl', OUTSIDE),
    ('file://{root}/prefix/share/robot/meshes/a.stl', OUTSIDE),
    ('file:///etc/passwd', OUTSIDE),
    ('file://{root}/meshes', 'path must end with'),
    ('file://{root}/meshes/a.txt', 'path must end with'),
    ('file://{root}/meshes/none.stl', 'No such file'),
    ('file://{root}/meshes/loop.stl', 'Too many levels'),
    ('file://{root}/meshes/pipe.stl', 'not a file'),
    ('file://{root}/meshes/a.stl%00', 'names no path'),
    ('file://{root}/meshes/%ff.stl', 'names no path'),
    ('package://robot/out.stl', OUTSIDE),
    ('package://robot/../other/a.stl', OUTSIDE),
    ('package://robot/%2e%2e/other/a.stl', OUTSIDE),
    ('package://robot/meshes/none.stl', 'No such file'),
    ('package://other/a.stl', "no package 'other'"),
    ('package://../a.stl', "'..' is no name of a package"),
    ('package://%2e%2e/a.stl', "'..' is no name of a package"),
    ('package:///a.stl', "'' is no name of a package"),
]


@pytest.mark.parametrize(('name', 'reason'), REFUSED)
def test_files_that_may_not_be_read(finder, files, name, reason):
    with pytest.raises(ValueError, match=reason):
        finder.find(name.format(root=files))


def test_no_package_is_found_without_a_prefix(finder, monkeypatch):
    monkeypatch.delenv('AMENT_PREFIX_PATH')
    with pytest.raises(ValueError, match="no package 'robot'"):
        finder.find('package://robot/meshes/a.stl')


@pytest.mark.parametrize(
    ('name', 'reason'),
    [
        ('cut.stl', '4 triangles has 284 bytes, not 283'),
        ('nan.stl', 'triangle 0 is not finite'),
        ('many.stl', '120 triangles, more than 100'),
        ('large.stl', 'more than 50,000 bytes'),
        ('two.stl', 'not the surface of one convex solid'),
    ],
)
def test_a_file_without_a_mesh_is_read_once(finder, files, name, reason, monkeypatch):
    file = finder.find(f'file://{files}/meshes/{name}')
    for _ in range(2):
        with pytest.raises(ValueError, match=reason):
            ended(finder.mesh('uri', file, ONE, AS_CONVEX, planar=False))
        monkeypatch.setattr('bvh_ros.ros.sources.mesh_resources._read', None)  # not again


def test_meshes_are_shared_and_read_again_when_the_file_changes(finder, files):
    name = f'file://{files}/meshes/changes.stl'
    path = write(files, 'meshes/changes.stl', stl(TETRAHEDRON))

    def mesh(scale=1.0, form=AS_CONVEX):
        return ended(finder.mesh(name, finder.find(name), ONE * scale, form, planar=False))

    first = mesh()
    assert mesh() is first
    assert mesh(form=AS_SOLID) is first
    assert np.allclose(mesh(3.0).size, 6.0)
    assert np.allclose(mesh(-1.0).size, 2.0)
    path.write_bytes(stl(box_of_triangles((1, 2, 3))))
    assert np.allclose(mesh().size, (1, 2, 3))


def test_a_folder_that_becomes_a_link_is_not_followed(finder, files, configure):
    """Between the look and the reading."""
    write(files, 'meshes/moves/a.stl', stl(TETRAHEDRON))
    write(files, 'away/a.stl', stl(TETRAHEDRON))
    file = finder.find(f'file://{files}/meshes/moves/a.stl')
    (files / 'meshes/moves').rename(files / 'meshes/moved')
    (files / 'meshes/moves').symlink_to('moved')
    with pytest.raises(ValueError, match='changed while'):
        ended(finder.mesh('uri', file, ONE, AS_CONVEX, planar=False))
    (files / 'meshes/moves').unlink()
    (files / 'meshes/moves').symlink_to('../away')
    away = finder_in(configure, files / 'away').find(f'file://{files}/away/a.stl')
    other = file._replace(version=away.version)
    with pytest.raises(ValueError, match='changed while'):
        ended(finder.mesh('uri', other, ONE, AS_CONVEX, planar=False))


def test_a_reader_that_takes_too_long_is_killed(finder, files, monkeypatch):
    monkeypatch.setattr(MOST_SECONDS, 0.01)
    file = finder.find(f'file://{files}/meshes/inner/a.stl')
    with pytest.raises(ValueError, match=r'takes longer than 0\.01 s'):
        ended(finder.mesh('uri', file, ONE, AS_CONVEX, planar=False))


# ---- What markers ask for


def resource(number, name, scale=(1, 1, 1), kind=MESH_RESOURCE):
    return marker(number, (number, 0, 0), scale, type=kind, frame='', mesh=name)


def change(*array, **given):
    given = {'now': NOW, 'into_node': lambda _frame, _stamp: None} | given
    return change_of(array, **given)


def test_markers_become_meshes_or_say_why_not(finder, files):
    name = f'file://{files}/meshes/a.stl'
    found = change(
        *(resource(k, name) for k in (1, 2)),
        resource(3, name, (2, 1, 1)),
        resource(4, 'file:///etc/a.stl'),
        resource(5, name, kind=1),
        resource(6, name, (0, 0, 0)),
        files=lambda: finder,
    )
    assert [*found.names.texts()] == ['a/1', 'a/2', 'a/3', 'a/5']
    one, two, three, none = found.shapes.mesh
    assert one is two
    assert (three.size.tolist(), none) == ([4, 2, 2], None)
    assert found.shapes.kind.tolist() == [ShapeKind.MESH] * 3 + [ShapeKind.BOX]
    outside, flat = found.refusals
    assert (outside.name, flat.name) == ('a/4', 'a/6')
    assert outside.reason.startswith('MESH_RESOURCE file:///etc/a.stl: it is in no folder')
    assert flat.reason.startswith(f'MESH_RESOURCE {name[:80]}')


def test_without_files_they_are_refused():
    found = change(resource(1, 'file:///a.stl'), resource(2, '', kind=1))
    assert [*found.names.texts()] == ['a/2']
    assert [refusal.reason for refusal in found.refusals] == [
        'MESH_RESOURCE: no mesh files are read here'
    ]


def test_it_is_unknown_until_the_scene_holds_it(finder, files):
    """A source is asked at every pause."""
    scene = NodeScene()
    source = source_of(scene, meshes=AS_SOLID)
    source.mesh_files = lambda: finder
    array = [resource(1, f'file://{files}/meshes/a.stl')]
    array += [marker(k, (k, 0, 0)) for k in range(2, 20_000)]
    message = [serialize_message(MarkerArray(markers=array))]
    for _ in source.apply(message, NOW):
        assert source.problem(NOW).startswith("source 's' loads file:///")
    assert (source.problem(NOW), len(scene)) == ('', 19_999)
    for _ in source.apply(message, NOW):
        assert source.problem(NOW) == ''  # it is known


# ---- In a node


@pytest.fixture(scope='module')
def world(start_node, files):
    write(files, 'meshes/slow.obj', slow_obj(200_000))
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv('AMENT_PREFIX_PATH', str(files / 'prefix'))
        return start_node({'mesh_paths': [str(files / 'meshes')]})


@pytest.fixture
def clean(world):
    """The node, emptied, and the maker of markers that name files."""
    world.trigger('clear')

    return world, partial(marker, type=MESH_RESOURCE)


def test_a_file_is_an_obstacle(clean, files):
    world, maker = clean
    name = f'file://{files}/meshes/a.stl'
    other = maker(2, (30, 0, 0), (2, 2, 2), mesh='package://robot/meshes/a.stl')
    world.show(maker(1, (20, 0, 0), mesh=name), other)
    for x, side in ((20, 1.0), (30, 2.0)):  # the far face: x + y + z = 2 * side
        place = world.place('raycast', (x + 0.5, 0.5, 9), (x + 0.5, 0.5, 0.1))
        assert abs(place[2] - (2 * side - 1)) < 1e-9


def test_a_refused_file_keeps_the_obstacle_and_says_why(clean, files):
    world, maker = clean
    world.show(maker(1, mesh=f'file://{files}/meshes/a.stl'))
    world.markers(maker(1, mesh=f'file://{files}/meshes/cut.stl'), marker(2, (9, 0, 0)))
    world.holds('a/1', 'a/2')
    reason = world.status('source markers').values['last reason']
    assert f'{files}/meshes'[:40] in reason
    assert reason.endswith('4 triangles has 284 bytes, not 283')


def test_until_a_file_is_read_nothing_looks_free(clean, files):
    """A question is answered meanwhile, by an error."""
    world, maker = clean
    where = (0.5, 0.5, 9), (0.5, 0.5, -9)
    world.show(marker(1, (-50, 0, 0)))
    world.markers(maker(2, mesh=f'file://{files}/meshes/slow.obj'))
    answers = []
    deadline = time.monotonic() + PATIENCE
    while answers[-1:] != ['a/2']:
        assert time.monotonic() < deadline
        answer = ''.join(world.names('raycast', *where))
        if answer not in answers[-1:]:
            answers.append(answer)
        time.sleep(0.002)
    *first, loads, last = answers
    assert first in ([], [''])  # it was on its way
    named = f'file://{files}/meshes/slow.obj'[:80]  # a long one is cut off there
    assert loads.startswith(f"error: source 'markers' loads {named}")
    assert loads.endswith(': what it shows is unknown yet')
    assert last == 'a/2'
