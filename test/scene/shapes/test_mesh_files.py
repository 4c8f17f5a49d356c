# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Mesh files: what trimesh writes is read as it was, and what is not sound is refused."""

import json
import os
import socket
import struct
import subprocess
import sys
import zipfile

import numpy as np
import pytest
from scene.reference import box_of_triangles

from bvh_ros.scene import Mesh
from bvh_ros.scene.shapes import mesh_file

BOX = box_of_triangles((2.0, 3.0, 5.0))
LIMITS = 10**6, 10**8
STL_HEAD = bytes(80)
FACET = struct.Struct('<12fH')


def read(data, kind, *limits):
    return mesh_file.triangles_of(data, kind, *(limits or LIMITS))


def in_order(triangles):
    return sorted(np.asarray(triangles, np.float64).reshape(-1, 9).tolist())


def is_same(triangles, others):
    one, other = in_order(triangles), in_order(others)
    return len(one) == len(other) and np.allclose(one, other, rtol=0.0, atol=1e-6)


@pytest.fixture(scope='module')
def trimesh():
    pytest.importorskip('collada', reason='extra [meshes] is not installed')
    return pytest.importorskip('trimesh', reason='extra [meshes] is not installed')


FORMS = {
    'stl': ('stl', {}),
    'text stl': ('stl_ascii', {}),
    'obj': ('obj', {}),
    'ply': ('ply', {}),
    'text ply': ('ply', {'encoding': 'ascii'}),
    'glb': ('glb', {}),
    'dae': ('dae', {}),
}


@pytest.fixture(scope='module', params=FORMS)
def written(request, trimesh):
    """The bytes of a ring in a file of each kind, the kind, and the ring's triangles."""
    ring = trimesh.creation.annulus(0.5, 1.0, 0.5, sections=12)
    kind, options = FORMS[request.param]
    data = ring.export(file_type=kind, **options)
    data = data.encode() if isinstance(data, str) else data
    return data, kind.partition('_')[0], ring.triangles


# ---- What is sound


def test_each_kind_is_read_as_it_was_written(written, tmp_path):
    data, kind, triangles = written
    assert is_same(read(data, kind), triangles)
    file = tmp_path / f'ring.{kind.upper()}'
    file.write_bytes(data)
    mesh = Mesh.from_file(file, scale=(2.0, 2.0, -4.0))
    assert (mesh.solid, mesh.convex, len(mesh.rows)) == (True, False, len(triangles))
    assert np.allclose(mesh.size, (4.0, 4.0, 2.0))
    assert not Mesh.from_file(file, 0.001, solid=False).solid


def obj(*lines):
    return '\n'.join(lines).encode()


def square(*, depth=0.0):
    return [f'v {x} {y} {depth}' for x, y in ((0, 0), (1, 0), (1, 1), (0, 1))]


TWO = [[[0, 0, 0], [1, 0, 0], [1, 1, 0]], [[0, 0, 0], [1, 1, 0], [0, 1, 0]]]


@pytest.mark.parametrize(
    'lines',
    [
        [*square(), 'f 1 2 3', 'f 1 3 4'],
        [*square(), 'f 1 2 3 4'],
        [*square(), 'f -4 -3 -2 -1'],
        [*square(), 'f -4//1 2/1/1 -2 4/7'],
        ['# a square', 'mtllib /etc/passwd', '', *square(), 'vn 0 0 1', 's 1', 'f 1 2 \\', '3 4'],
        ['\tv\t0 0 0 1 1 1', ' v 1 0 0', *square()[2:], ' f\t1 2 3 4 # that is all', 'l 1 2'],
        ['\r'.join([*square(), 'f 1 2 3 4'])],
        ['v 9 9 9', 'f -1 -1 -1', *square(), 'f -4 -3 -2 -1'],
    ],
)
def test_statements_of_an_obj_file(lines):
    found = read(obj(*lines), 'obj')
    assert is_same(found[-2:], TWO)


def ply(elements, body, kind='ascii'):
    head = ['ply', f'format {kind} 1.0', 'comment of nobody, no end_header']
    for name, count, properties in elements:
        head += [f'element {name} {count}', *(f'property {one}' for one in properties)]
    return '\n'.join([*head, 'end_header', '']).encode() + body


PLACES = [(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (0, 0, 1)]
FACES = [(0, 1, 2, 3), (0, 1, 4)]


@pytest.mark.parametrize('kind', ['ascii', 'binary_little_endian', 'binary_big_endian'])
def test_polygons_and_more_columns_of_a_ply_file(kind):
    elements = [
        ('camera', 1, ['float x', 'list uchar int parts']),
        ('vertex', 5, ['double x', 'double y', 'uchar red', 'double z']),
        ('face', 2, ['uchar red', 'list uchar int vertex_indices']),
    ]
    if kind == 'ascii':
        rows = ['7 2 3 4', *(f'{x} {y} 255 {z}' for x, y, z in PLACES)]
        rows += [' '.join(map(str, (9, len(face), *face))) for face in FACES]
        body = '\n'.join(rows).encode()
    else:
        order = '<' if 'little' in kind else '>'
        body = struct.pack(f'{order}fBii', 7, 2, 3, 4)
        body += b''.join(struct.pack(f'{order}ddBd', x, y, 255, z) for x, y, z in PLACES)
        for face in FACES:
            body += struct.pack(f'{order}BB{len(face)}i', 9, len(face), *face)
    third = [PLACES[k] for k in FACES[1]]
    assert is_same(read(ply(elements, body, kind), 'ply'), [*TWO, third])
    with pytest.raises(ValueError, match='goes on after'):
        read(ply(elements, body + b' 1', kind), 'ply')
    with pytest.raises(ValueError, match='ends before'):
        read(ply(elements, body[:-2], kind), 'ply')


def glb(tree, blob=b''):
    text = json.dumps(tree).encode()
    text += b' ' * (-len(text) % 4)
    chunks = struct.pack('<II', len(text), 0x4E4F534A) + text
    if blob:
        chunks += struct.pack('<II', len(blob), 0x004E4942) + blob
    return b'glTF' + struct.pack('<II', 2, 12 + len(chunks)) + chunks


BLOB = np.array(TWO, '<f4').tobytes()


def square_glb(**changes):
    """A square of two triangles."""
    tree = {
        'asset': {'version': '2.0'},
        'scenes': [{'nodes': [0]}],
        'nodes': [{'mesh': 0}],
        'meshes': [{'primitives': [{'attributes': {'POSITION': 0}}]}],
        'accessors': [{'bufferView': 0, 'componentType': 5126, 'count': 6, 'type': 'VEC3'}],
        'bufferViews': [{'buffer': 0, 'byteLength': len(BLOB)}],
        'buffers': [{'byteLength': len(BLOB)}],
    }
    return glb(tree | changes, BLOB)


def test_nodes_of_a_glb_file(trimesh):
    nodes = [
        {'children': [1, 2], 'translation': [10, 0, 0], 'scale': [1, 1, 2]},
        {'mesh': 0, 'rotation': [0, 0, 0.5**0.5, 0.5**0.5]},
        {'mesh': 0, 'matrix': [1, 0, 0, 0, 0, 1, 0, 0, 0, 0, 1, 0, 0, 0, 3, 1]},
    ]
    turned = np.array(TWO)[:, :, [1, 0, 2]] * (-1, 1, 1) + (10, 0, 0)
    lifted = np.add(TWO, (10, 0, 6))
    found = read(square_glb(nodes=nodes), 'glb')
    assert is_same(found, np.concatenate((turned, lifted)))
    del trimesh


def dae(body='', *, unit='', scene='<instance_geometry url="#g"/>', nodes='', images=''):
    return f"""<?xml version="1.0" encoding="utf-8"?>
    <COLLADA xmlns="http://www.collada.org/2005/11/COLLADASchema" version="1.4.1">{body}
    <asset>{unit}<up_axis>Y_UP</up_axis></asset>{images}
    <library_geometries><geometry id="g"><mesh>
      <source id="p"><float_array id="a" count="12">0 0 0 1 0 0 1 1 0 0 1 0</float_array>
        <technique_common><accessor source="#a" count="4" stride="3">
          <param name="X" type="float"/><param name="Y" type="float"/>
          <param name="Z" type="float"/></accessor></technique_common></source>
      <vertices id="v"><input semantic="POSITION" source="#p"/></vertices>
      <triangles count="2"><input semantic="VERTEX" source="#v" offset="0"/>
        <p>0 1 2 0 2 3</p></triangles>
    </mesh></geometry></library_geometries>{nodes}
    <library_visual_scenes><visual_scene id="s"><node id="n"><translate>0 0 4</translate>{scene}
    </node></visual_scene></library_visual_scenes>
    <scene><instance_visual_scene url="#s"/></scene></COLLADA>""".encode()


def test_the_unit_of_a_dae_file_counts_and_its_axes_stay(trimesh):
    lifted = np.add(TWO, (0, 0, 4))
    assert is_same(read(dae(), 'dae'), lifted)
    assert is_same(read(dae(unit='<unit name="inch" meter="0.0254"/>'), 'dae'), 0.0254 * lifted)
    del trimesh


# ---- What is not


def test_no_cut_file_is_read(written):
    """OBJ files have no end mark: a cut between two statements cannot be seen."""
    data, kind, triangles = written
    for end in range(0, len(data) - 2, max(1, len(data) // 300)):
        try:
            found = read(data[:end], kind)
        except ValueError:
            continue
        assert kind == 'obj' or is_same(found, triangles), end


@pytest.mark.filterwarnings('ignore')
def test_changed_bytes_make_a_mesh_or_a_value_error(written):
    data, kind, _ = written
    rng = np.random.default_rng(5)
    for _ in range(200):
        changed = bytearray(data)
        for place in rng.integers(0, len(data), rng.integers(1, 6)):
            changed[place] = rng.integers(256)
        try:
            found = read(bytes(changed), kind)
        except ValueError:
            continue
        assert found.shape[1:] == (3, 3)


def test_limits(written, tmp_path):
    data, kind, triangles = written
    with pytest.raises(ValueError, match='more than 20'):
        read(data, kind, 20, 10**8)
    assert len(read(data, kind, len(triangles), len(data))) == len(triangles)
    with pytest.raises(ValueError, match='more than 1,000 bytes'):
        read(data + bytes(10**4), kind, 10**6, 1000)
    file = tmp_path / f'a.{kind}'
    file.write_bytes(data)
    with pytest.raises(ValueError, match='more than 20'):
        Mesh.from_file(file, max_triangles=20)
    with pytest.raises(ValueError, match='bytes'):
        Mesh.from_file(file, max_bytes=len(data) - 1)


def stl(count, *facets):
    return STL_HEAD + struct.pack('<I', count) + b''.join(FACET.pack(*f) for f in facets)


ONE = (0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0, 1.0, 0.0, 0)
TEXT_STL = (
    'solid endsolid of facets\n'
    + 'facet normal 0 0 1\nouter loop\n'
    + 'vertex 0 0 {}\n' * 3
    + 'endloop\nendfacet\nendsolid'
)
SOUP = (
    ('vertex', 3, ['float x', 'float y', 'float z']),
    ('face', 1, ['list uchar int vertex_index']),
)
BAD = {
    'no triangles': (stl(0), 'stl', 'no triangles'),
    'fewer than it says': (stl(2**32 - 1, ONE), 'stl', '4,294,967,295 triangles has'),
    'more than it says': (stl(1, ONE, ONE), 'stl', 'has 134 bytes, not 184'),
    'words': (TEXT_STL.format(*'1x2').encode(), 'stl', 'could not convert'),
    'no end': (TEXT_STL.format(1, 2, 3)[:-8].encode(), 'stl', '1 solids begin and 0 end'),
    'four corners': (TEXT_STL.replace('0 {}', '0 {} 1').encode(), 'stl', '1 facets begin and 0'),
    'no statement': (b'\xff\xfe\x00', 'obj', 'is not understood'),
    'vertex 0': (obj(*square(), 'f 0 1 2'), 'obj', 'statement 5: .* from 1'),
    'beyond': (obj(*square(), 'f 1 2 5'), 'obj', 'polygon 0 names vertices beyond the 4'),
    'before': (obj(*square(), 'f 1 2 -5'), 'obj', 'polygon 0 names'),
    'two corners': (obj(*square(), 'f 1 2'), 'obj', 'polygon 0 has 2 corners'),
    'no number': (obj(*square(), 'v 1 2 a'), 'obj', 'statement 5: could not convert'),
    'two numbers': (obj(*square(), 'v 1 2'), 'obj', 'three coordinates'),
    'curved': (obj(*square(), 'surf 0 1 0 1 1 2 3'), 'obj', 'surf is not understood'),
    'no face': (obj(*square(), 'F 1 2 3', 'f 1 2 3'), 'obj', 'statement 5: F is not understood'),
    'python': (obj(*square(), 'v 1_0 0 0', 'f 1 2 3'), 'obj', 'statement 5: .* underscore'),
    'python stl': (TEXT_STL.format('1_0', 2, 3).encode(), 'stl', 'is no number'),
    'misspelt': (TEXT_STL.format(1, 2, 3).replace('\nfacet', '\nfacets\nfacet').encode(), 'stl',
                 "b'facets' stands between"),
    'after the end': (TEXT_STL.format(1, 2, 3).encode() + b'\nlater', 'stl', "b'later' stands"),
    'many vertices': (ply([('vertex', 10**15, ['float x'])], b'0', 'binary_little_endian'), 'ply',
                      'ends before'),
    'many faces': (ply([SOUP[0], ('face', 10**15, SOUP[1][2])], b'0 ' * 9), 'ply', 'more than'),
    'many corners': (ply(SOUP, b'0 ' * 9 + b'4000000000 0 1 2'), 'ply', 'ends before'),
    'minus one corner': (ply(SOUP, b'0 ' * 9 + b'-1'), 'ply', 'no number of a vertex'),
    'half a vertex': (ply(SOUP, b'0 ' * 9 + b'3 0 1 1.5'), 'ply', 'no number of a vertex'),
    'minus rows': (ply([('vertex', -3, ['float x'])], b''), 'ply', '-3 rows'),
    'strips': (ply([('tristrips', 1, ['list int int vertex_indices'])], b'1 0'), 'ply', 'strips'),
    'nameless': (ply([SOUP[0], ('face', 1, ['list uchar int x'])], b'0 ' * 10), 'ply', 'faces'),
    'no list of corners': (ply([SOUP[0], ('face', 1, ['int vertex_index'])], b'0 ' * 10), 'ply',
                           'its faces need one list'),
    'faces twice': (ply([*SOUP, SOUP[1]], b'0 ' * 9 + b'3 0 1 2 3 0 1 2'), 'ply',
                    'has face twice'),
    'x twice': (ply([('vertex', 1, ['int x', 'int x'])], b'0 1'), 'ply', 'header has x twice'),
    'no z': (ply([('vertex', 1, ['int x', 'int y'])], b'0 1'), 'ply', 'for x, y and z'),
    'lists of x': (ply([('vertex', 1, ['list int int x', 'int y', 'int z'])], b'1 0 0 0'), 'ply',
                   'for x, y and z'),
    'version': (ply(SOUP, b'0 ' * 9 + b'3 0 1 2').replace(b'1.0', b'2.0'), 'ply', 'ascii 2.0'),
    'type': (ply([('vertex', 1, ['quad x'])], b'0'), 'ply', 'header says property quad x'),
    'a page': (b'<html>', 'ply', 'does not begin'),
    'short': (b'glTF', 'glb', 'does not begin'),
    'length': (square_glb() + b'\0', 'glb', 'bytes, and says'),
    'elsewhere': (square_glb(buffers=[{'byteLength': 9, 'uri': 'http://a/b'}]), 'glb', 'http://a/b'),
    'file': (square_glb(buffers=[{'byteLength': 9, 'uri': '../b.bin'}]), 'glb', 'another file'),
    'packed': (square_glb(extensionsUsed=['KHR_draco_mesh_compression']), 'glb', 'KHR_draco'),
    'sparse': (square_glb(accessors=[{'componentType': 5126, 'count': 10**12, 'type': 'VEC3'}]),
               'glb', 'accessor 0 is sparse'),
    'skin': (square_glb(nodes=[{'mesh': 0, 'skin': 0}]), 'glb', 'a skin'),
    'fan': (square_glb(meshes=[{'primitives': [{'attributes': {'POSITION': 0}, 'mode': 6}]}]),
            'glb', 'a fan'),
    'loop': (square_glb(nodes=[{'mesh': 0, 'children': [0]}]), 'glb', 'two parents'),
    'no list': (glb([1, 2]), 'glb', 'as GLB: AttributeError'),
    'deep': (glb({}).replace(b'{}  ', b'[[[['), 'glb', 'Expecting'),
    'entities': (dae('<!DOCTYPE a [<!ENTITY b "c">]>'), 'dae', 'DOCTYPE'),
    'skinned': (dae(scene='<instance_controller url="#g"/>'), 'dae', 'instance_controller'),
    'nobody': (dae(scene='<instance_geometry url="#x"/>'), 'dae', 'DAE: DaeBrokenRefError'),
    'no mesh': (square_glb(nodes=[{'mesh': 0}, {'mesh': 1}]), 'glb', 'node 1 has a mesh that'),
    'undeclared': (square_glb(nodes=[{'mesh': 0, 'extensions': {'EXT_mesh_gpu_instancing': {}}}]),
                   'glb', 'EXT_mesh_gpu_instancing'),
    'from the end': (dae().replace(b'0 2 3', b'0 2 -1'), 'dae', 'index is negative'),
    'holes': (dae().replace(b'<triangles', b'<polygons><ph/></polygons><triangles'), 'dae', '<ph'),
    'unit': (dae(unit='<unit meter="-1"/>'), 'dae', 'unit is -1.0 m'),
    'wide text': (dae().decode().encode('utf-16'), 'dae', 'no text in UTF-8'),
    'cut': (dae()[:-9], 'dae', 'as DAE: DaeMalformedError'),
}  # fmt: skip


@pytest.mark.parametrize('case', BAD)
def test_what_is_not_sound_is_refused(case, request):
    data, kind, reason = BAD[case]
    if kind in ('glb', 'dae'):
        request.getfixturevalue('trimesh')
    with pytest.raises(ValueError, match=reason) as caught:
        read(data, kind, 10**9, 10**9)
    assert len(str(caught.value)) < 300


@pytest.mark.parametrize('word', ['nan', 'NaN', '-nan', 'INF'])
def test_a_corner_of_a_dae_file_that_is_no_number(trimesh, tmp_path, word):
    path = tmp_path / 'a.dae'
    path.write_bytes(dae().replace(b'count="12">0 ', f'count="12">{word} '.encode()))
    with pytest.raises(ValueError, match='not finite'):
        Mesh.from_file(path)


def test_a_unit_in_a_comment_counts_for_nothing(trimesh):
    wanted = read(dae(unit='<unit meter="0.01"/>'), 'dae')
    for comment in ('<!-- <unit meter="7"/> -->', '<extra><![CDATA[<unit meter="7"/>]]></extra>'):
        found = read(dae(unit=comment + '<unit meter="0.01"/>'), 'dae')
        assert np.array_equal(found, wanted)


def test_an_archive_that_looks_like_a_dae_file(tmp_path):
    """pycollada would unpack it, however large it becomes."""
    file = tmp_path / 'bomb.dae'
    with zipfile.ZipFile(file, 'w', zipfile.ZIP_DEFLATED) as archive:
        archive.writestr('a.dae', bytes(10**7))
    for data in (file.read_bytes(), dae() + file.read_bytes()):
        file.write_bytes(data)
        with pytest.raises(ValueError, match='archive'):
            Mesh.from_file(file)


def test_a_mesh_at_many_places_counts_as_often(trimesh):
    nodes = [{'children': [*range(1, 1001)]}, *({'mesh': 0} for _ in range(1000))]
    assert len(read(square_glb(nodes=nodes), 'glb', 2000, 10**6)) == 2000
    with pytest.raises(ValueError, match='2,000 triangles, more than 1,999'):
        read(square_glb(nodes=nodes), 'glb', 1999, 10**6)
    del trimesh


def test_nothing_else_is_opened_or_fetched(trimesh, tmp_path):
    """Files that name pictures and materials: at a server, and beside them."""
    with socket.create_server(('127.0.0.1', 0)) as server:
        server.setblocking(False)
        address = f'http://127.0.0.1:{server.getsockname()[1]}/a.png'
        for name in (address, 'a.png'):
            picture = {'images': [{'uri': name}], 'textures': [{'source': 0}]}
            material = {'pbrMetallicRoughness': {'baseColorTexture': {'index': 0}}}
            image = f'<image id="i"><init_from>{name}</init_from></image>'
            files = {
                'a.glb': square_glb(materials=[material], **picture),
                'a.dae': dae(images=f'<library_images>{image}</library_images>'),
                'a.obj': obj(f'mtllib {name}', *square(), 'f 1 2 3 4'),
            }
            os.mkfifo(tmp_path / 'a.png') if name == 'a.png' else None  # to open it would block
            for file, data in files.items():
                (tmp_path / file).write_bytes(data)
                assert len(Mesh.from_file(tmp_path / file).rows) == 2
        with pytest.raises(BlockingIOError):
            server.accept()
    del trimesh


def test_what_is_no_file(tmp_path):
    with pytest.raises(FileNotFoundError):
        Mesh.from_file(tmp_path / 'none.stl')
    (tmp_path / 'folder.stl').mkdir()
    os.mkfifo(tmp_path / 'pipe.stl')
    for name in ('folder.stl', 'pipe.stl'):
        with pytest.raises(ValueError, match='is not a file'):
            Mesh.from_file(tmp_path / name)
    for name in ('a.step', 'stl', 'a.zip', 'a.gltf'):
        with pytest.raises(ValueError, match='path must end with one of'):
            Mesh.from_file(name)


def test_a_corner_that_is_not_finite_and_a_scale(tmp_path):
    file = tmp_path / 'a.stl'
    file.write_bytes(stl(1, (*ONE[:3], float('nan'), *ONE[4:])))
    with pytest.raises(ValueError, match=r"a\.stl': triangle 0 is not finite"):
        Mesh.from_file(file)
    file.write_bytes(stl(1, ONE))
    with pytest.raises(
        ValueError, match=r'times scale 1e\+308: the mesh is too small or too large'
    ):
        Mesh.from_file(file, 1e308)
    for scale in (0.0, [1.0, np.nan, 1.0], [1.0, 2.0], 'm'):
        with pytest.raises(ValueError, match='scale'):
            Mesh.from_file(file, scale)


@pytest.mark.parametrize(('missing', 'kind'), [('trimesh', 'glb'), ('collada', 'dae')])
def test_without_the_extra_the_error_says_how_to_get_it(missing, kind, monkeypatch):
    monkeypatch.setitem(sys.modules, missing, None)
    data = square_glb() if kind == 'glb' else dae()
    with pytest.raises(ImportError, match=r"pip install 'bvh_ros\[meshes\]'"):
        read(data, kind)
    assert len(read(obj(*square(), 'f 1 2 3 4'), 'obj')) == 2


def test_the_file_is_a_program_that_reads_one():
    command = [sys.executable, mesh_file.__file__]
    done = subprocess.run([*command, 'stl', '9', '999'], input=stl(1, ONE), capture_output=True)
    assert (done.returncode, done.stderr) == (0, b'')
    assert np.frombuffer(done.stdout).tolist() == [*map(float, ONE[3:12])]
    done = subprocess.run([*command, 'stl', '9', '99'], input=stl(1, ONE), capture_output=True)
    assert (done.returncode, done.stdout) == (
        mesh_file.REFUSED,
        b'the file has more than 99 bytes',
    )


EATS = """
import runpy, sys
reader = runpy.run_path(sys.argv.pop(1))
reader['main'].__globals__['MOST_MEMORY'] = 400_000_000
sys.exit(reader['main']())
"""


def test_a_file_that_grows_without_end_ends_the_program_alone(trimesh):
    """Each of 40 nodes holds the next one twice."""
    two = '<instance_node url="#m{0}"/>' * 2
    nodes = ''.join(f'<node id="m{k}">{two.format(k + 1)}</node>' for k in range(40))
    nodes += '<node id="m40"><instance_geometry url="#g"/></node>'
    data = dae(scene=two.format(0), nodes=f'<library_nodes>{nodes}</library_nodes>')
    done = subprocess.run(
        [sys.executable, '-c', EATS, mesh_file.__file__, 'dae', '9', '99999'],
        input=data,
        capture_output=True,
        env=os.environ | {'OPENBLAS_NUM_THREADS': '1'},
    )
    assert done.returncode == mesh_file.REFUSED
    assert done.stdout.startswith(b'it ')  # takes too much memory; or what Python makes of that
    del trimesh
