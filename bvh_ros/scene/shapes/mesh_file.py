# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Triangles of mesh files: STL, OBJ, PLY, GLB and DAE.

A file is not trusted, and its mesh must not lack a part: an obstacle with a hole looks free. So a
file with something that is not understood is refused, and nothing else is opened or fetched.
STL, OBJ and PLY are read here, because trimesh skips lines that it does not understand. GLB and
DAE are read by trimesh, after a check for what it leaves out.

A process of its own that runs this file reads one file, see `main`; it needs numpy alone.
"""

import contextlib
import io
import json
import os
import re
import sys
import zipfile
from collections.abc import Callable, Iterable, Sequence
from itertools import chain, pairwise
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

Floats = NDArray[np.float64]


def read(path: str | os.PathLike[str], max_triangles: int, max_bytes: int) -> Floats:
    """Triangles (m, 3, 3) of a file, in its own frame, m.

    Raises
    ------
    OSError
        If the file cannot be opened.
    ImportError
        If what reads files of its kind is not installed.
    ValueError
        If it is no mesh file, or holds more than so many bytes or triangles.
    """
    kind = kind_of(path)
    if Path(path).exists() and not Path(path).is_file():  # a pipe would block
        raise ValueError('path is not a file')
    with open(path, 'rb') as file:
        _refuse_large(os.fstat(file.fileno()).st_size, max_bytes)
        return triangles_of(file.read(), kind, max_triangles, max_bytes)


def kind_of(path: str | os.PathLike[str]) -> str:
    """The kind of a mesh file, by its name; ValueError if it is none."""
    kind = Path(path).suffix[1:].lower()
    if kind not in READERS:
        known = ', '.join(f'.{name}' for name in READERS)
        raise ValueError(f"path must end with one of {known}, not '.{kind:.20}'")
    return kind


def triangles_of(data: bytes, kind: str, max_triangles: int, max_bytes: int) -> Floats:
    """Triangles (m, 3, 3) of the bytes of a file; raises as `read` does."""
    _refuse_large(len(data), max_bytes)
    try:
        triangles = READERS[kind](data, max_triangles)
    except (ImportError, MemoryError):
        raise
    except ValueError as error:
        raise ValueError(str(error)[:200]) from error  # it may quote what stands in the file
    except Exception as error:  # of libraries, which raise anything at such files
        text = ' '.join(f'{type(error).__name__} {error!s:.200}'.split())
        raise ValueError(f'it cannot be read as {kind.upper()}: {text}') from error
    if not len(triangles):
        raise ValueError('the file has no triangles')
    return triangles


def _refuse_large(size: int, most: int) -> None:
    if size > most:
        raise ValueError(f'the file has more than {most:,} bytes')


def _refuse_many(count: int, most: int) -> None:
    if count > most:
        raise ValueError(f'the file has {count:,} triangles, more than {most:,}')


def _floats(texts: Iterable[bytes]) -> Floats:
    return np.fromiter(map(_float, texts), np.float64)


def _float(text: bytes) -> float:
    if b'_' in text:  # Python reads 1_0 as 10
        raise ValueError(f'{text!r} is no number')
    return float(text)


def _triangles(vertices: Floats, polygons: Sequence[Sequence[int]], most: int) -> Floats:
    """Polygons as fans: for a flat one that is bent inwards, triangles beyond it lie upon each
    other.
    """
    _refuse_many(sum(map(len, polygons)) - 2 * len(polygons), most)
    for number, polygon in enumerate(polygons):
        if len(polygon) < 3:
            raise ValueError(f'polygon {number} has {len(polygon)} corners')
        if not 0 <= min(polygon) <= max(polygon) < len(vertices):
            raise ValueError(f'polygon {number} names vertices beyond the {len(vertices):,} given')
    fans = [(one[0], b, c) for one in polygons for b, c in pairwise(one[1:])]
    triangles: Floats = vertices[np.array(fans, np.int64).reshape(-1, 3)]
    return triangles


# ---- STL

FACET = np.dtype([('normal', '<f4', 3), ('corners', '<f4', (3, 3)), ('attribute', '<u2')])
HEADER = 84  # bytes, the number of triangles last
FACET_TEXT = re.compile(
    rb'\bfacet\s+normal(?:\s+\S+){3}\s+outer\s+loop'
    + rb'\s+vertex\s+(\S+)\s+(\S+)\s+(\S+)' * 3
    + rb'\s+endloop\s+endfacet\b',
    re.IGNORECASE,
)
BETWEEN_FACETS = re.compile(rb'^[ \t]*(end)?solid\b.*$', re.MULTILINE | re.IGNORECASE)


def _read_stl(data: bytes, most: int) -> Floats:
    count = int.from_bytes(data[HEADER - 4 : HEADER], 'little')
    wanted = HEADER + FACET.itemsize * count
    if len(data) == wanted:
        _refuse_many(count, most)
        return np.frombuffer(data, FACET, count, HEADER)['corners'].astype(np.float64)
    if not data.lstrip()[:5].lower() == b'solid':
        raise ValueError(f'an STL of {count:,} triangles has {wanted:,} bytes, not {len(data):,}')
    starts = {
        word: len(re.findall(rb'^[ \t]*' + word + rb'\b', data, re.MULTILINE | re.IGNORECASE))
        for word in (b'solid', b'endsolid', b'facet')
    }
    _refuse_many(starts[b'facet'], most)
    found = FACET_TEXT.findall(data)
    if len(found) != starts[b'facet'] or starts[b'solid'] != starts[b'endsolid']:
        raise ValueError(
            f'{starts[b"facet"]:,} facets begin and {len(found):,} can be read; '
            f'{starts[b"solid"]} solids begin and {starts[b"endsolid"]} end'
        )
    if rest := BETWEEN_FACETS.sub(b'', FACET_TEXT.sub(b'', data)).split():
        raise ValueError(f'{rest[0]!r} stands between the facets')
    return _floats(chain.from_iterable(found)).reshape(-1, 3, 3)


# ---- OBJ

# No polygons, and nothing that changes them: names, materials, texture, lines and points.
NO_POLYGONS = {
    *('vt', 'vn', 'vp', 'l', 'p', 'g', 'o', 's', 'mg', 'usemtl', 'mtllib', 'usemap', 'maplib'),
    *('bevel', 'c_interp', 'd_interp', 'lod', 'shadow_obj', 'trace_obj'),
}


def _read_obj(data: bytes, most: int) -> Floats:
    text = data.decode('utf-8', 'replace').replace('\r\n', '\n').replace('\r', '\n')
    vertices: list[list[float]] = []
    polygons: list[list[int]] = []
    count = 0
    for number, line in enumerate(text.replace('\\\n', ' ').split('\n'), 1):
        key, *words = line.partition('#')[0].split() or ['']
        try:
            if key in ('v', 'f', 'fo') and '_' in line.partition('#')[0]:
                raise ValueError('a number has an underscore')  # Python reads 1_0 as 10
            if key == 'v':
                vertices.append([float(word) for word in words[:3]])
                if len(words) < 3:
                    raise ValueError('a vertex has three coordinates')
            elif key in ('f', 'fo'):
                polygons.append([_obj_row(word, len(vertices)) for word in words])
                count += len(words) - 2
                _refuse_many(count, most)
            elif key and key not in NO_POLYGONS:
                raise ValueError(f'{key[:40]} is not understood')
        except ValueError as error:
            raise ValueError(f'statement {number}: {error}') from None
    return _triangles(np.array(vertices, np.float64).reshape(-1, 3), polygons, most)


def _obj_row(word: str, count: int) -> int:
    """The row of a vertex, which may be counted from the newest of so many, as -1."""
    row = int(word.partition('/')[0])
    if row == 0:
        raise ValueError('vertices are counted from 1')
    return row - 1 if row > 0 else max(count + row, -1)


# ---- PLY

PLY_TYPES = (
    dict.fromkeys(('char', 'int8'), 'i1')
    | dict.fromkeys(('uchar', 'uint8'), 'u1')
    | dict.fromkeys(('short', 'int16'), 'i2')
    | dict.fromkeys(('ushort', 'uint16'), 'u2')
    | dict.fromkeys(('int', 'int32'), 'i4')
    | dict.fromkeys(('uint', 'uint32'), 'u4')
    | dict.fromkeys(('float', 'float32'), 'f4')
    | dict.fromkeys(('double', 'float64'), 'f8')
)
VERTEX_LISTS = {'vertex_indices', 'vertex_index'}
END_OF_HEADER = re.compile(rb'^end_header[ \t]*\r?\n', re.MULTILINE)
BYTE_ORDERS = {'ascii 1.0': '', 'binary_little_endian 1.0': '<', 'binary_big_endian 1.0': '>'}


class _Property(NamedTuple):
    """A column of an element."""

    name: str
    type: str
    length: str  # type of the lengths, where it is one of lists


class _Element(NamedTuple):
    """A table of a PLY file."""

    name: str
    rows: int
    properties: list[_Property]


class _Numbers:
    """The numbers after the header, one after the other."""

    def __init__(self, data: bytes, order: str) -> None:
        self._data, self._order, self._at = data, order, 0
        self._texts = None if order else _floats(data.split())

    def take(self, types: Sequence[str], count: int) -> list[NDArray[Any]]:
        """A column for each type, of so many rows."""
        begin = self._at
        if self._texts is not None:
            self._at += len(types) * count
            if self._at <= len(self._texts):
                return [*self._texts[begin : self._at].reshape(count, len(types)).T]
        else:
            row = np.dtype([(str(k), self._order + kind) for k, kind in enumerate(types)])
            self._at += row.itemsize * count
            if self._at <= len(self._data):
                rows = np.frombuffer(self._data, row, count, begin)
                return [rows[str(k)] for k in range(len(types))]
        raise ValueError('the file ends before its last element')

    def refuse_rest(self) -> None:
        if self._at < len(self._data if self._texts is None else self._texts):
            raise ValueError('the file goes on after its last element')


def _read_ply(data: bytes, most: int) -> Floats:
    end = END_OF_HEADER.search(data)
    head = data[: end.start() if end else 0].decode('ascii', 'replace')
    lines = [line.split() for line in head.splitlines()]
    if not end or len(lines) < 2 or lines[0] != ['ply'] or lines[1][:1] != ['format']:
        raise ValueError('it does not begin as a PLY file')
    order = BYTE_ORDERS.get(' '.join(lines[1][1:]))
    if order is None:
        raise ValueError(f'its format is {" ".join(lines[1][1:])[:80]}')
    elements = _ply_elements(lines[2:])
    if 'tristrips' in (element.name for element in elements):
        raise ValueError('its triangles are strips')
    numbers = _Numbers(data[end.end() :], order)
    places, polygons = np.empty((0, 3)), []
    for element in elements:
        if element.name == 'face':
            _refuse_many(element.rows, most)
        columns = _ply_columns(numbers, element)
        if element.name == 'vertex':
            if not {'x', 'y', 'z'} <= {one.name for one in element.properties if not one.length}:
                raise ValueError('its vertices need a number each for x, y and z')
            places = np.column_stack([np.asarray(columns[axis], np.float64) for axis in 'xyz'])
        elif element.name == 'face':
            names = VERTEX_LISTS & {one.name for one in element.properties if one.length}
            if len(names) != 1:
                raise ValueError('its faces need one list, vertex_indices or vertex_index')
            polygons = [[_whole(x) for x in row.tolist()] for row in columns[names.pop()]]
    numbers.refuse_rest()
    return _triangles(places, polygons, most)


def _ply_elements(lines: Iterable[Sequence[str]]) -> list[_Element]:
    elements: list[_Element] = []
    for words in lines:
        match words:
            case ['element', name, rows]:
                elements.append(_Element(name, int(rows), []))
            case ['property', *types, name] if elements and (column := _ply_types(types)):
                elements[-1].properties.append(_Property(name, *column))
            case [] | ['comment' | 'obj_info', *_]:
                pass
            case _:
                raise ValueError(f'its header says {" ".join(words)[:80]}')
        if elements and elements[-1].rows < 0:
            raise ValueError(f'it has {elements[-1].rows} rows of {elements[-1].name}')
    _refuse_twice([element.name for element in elements])
    for element in elements:
        _refuse_twice([column.name for column in element.properties])
    return elements


def _refuse_twice(names: Sequence[str]) -> None:
    seen: set[str] = set()
    for name in names:
        if name in seen:
            raise ValueError(f'its header has {name[:80]} twice')
        seen.add(name)


def _ply_types(words: Sequence[str]) -> tuple[str, str] | None:
    """(type, type of the lengths) of a property; None if it has another one."""
    match words:
        case ['list', length, kind] if {length, kind} <= PLY_TYPES.keys():
            return PLY_TYPES[kind], PLY_TYPES[length]
        case [kind] if kind in PLY_TYPES:
            return PLY_TYPES[kind], ''
    return None


def _whole(number: float) -> int:
    """A number of corners or of a vertex: what stands in a file as text may be anything."""
    if not 0 <= number < 2**32 or number % 1:
        raise ValueError(f'{number} is no number of a vertex')
    return int(number)


def _ply_columns(numbers: _Numbers, element: _Element) -> dict[str, Sequence[Any]]:
    types = [one.type for one in element.properties]
    columns: dict[str, Sequence[Any]] = {}
    if types and not any(one.length for one in element.properties):
        for one, column in zip(element.properties, numbers.take(types, element.rows), strict=True):
            columns[one.name] = column.tolist()
        return columns
    lists: dict[str, list[Any]] = {one.name: [] for one in element.properties}
    for _ in range(element.rows if types else 0):
        for name, kind, length in element.properties:
            size = _whole(numbers.take([length], 1)[0].item()) if length else 1
            lists[name].append(numbers.take([kind], size)[0])
    columns.update(lists)
    return columns


# ---- GLB and DAE

GET_IT = "pip install 'bvh_ros[meshes]'"
JSON_CHUNK = 0x4E4F534A
TRIANGLE_LIST, TRIANGLE_STRIP, TRIANGLE_FAN = 4, 5, 6
HARMLESS = ('KHR_materials_', 'KHR_texture_', 'EXT_texture_', 'KHR_lights_', 'KHR_xmp')
NO_TRIANGLES = re.compile(
    rb'<!(DOCTYPE|ENTITY)|[<:](instance_controller|tristrips|trifans|ph|convex_mesh|spline|brep)\b'
)
NO_ELEMENTS = rb'<!--.*?(?:-->|\Z)|<!\[CDATA\[.*?(?:\]\]>|\Z)|<\?.*?(?:\?>|\Z)|'
UNIT = re.compile(
    NO_ELEMENTS + rb'<(?:\w+:)?unit\b[^>]*?\bmeter\s*=\s*["\']([^"\']*)["\']', re.DOTALL
)
MINUS = re.compile(rb'<(?:\w+:)?(?:p|vcount)\b[^>]*>[^<]*-')
FLOAT_ARRAY = re.compile(rb'<(?:\w+:)?float_array\b[^>]*>[^<]*')
NAN = re.compile(rb'(?<=[\s>+-])nan(?=\s|$)', re.IGNORECASE)


def _read_glb(data: bytes, most: int) -> Floats:
    head = np.frombuffer(data[:20], '<u4')
    if len(head) < 5 or data[:4] != b'glTF' or head[4] != JSON_CHUNK:
        raise ValueError('it does not begin as a GLB file')
    if head[2] != len(data):
        raise ValueError(f'the file has {len(data):,} bytes, and says {head[2]:,}')
    if reason := _not_in_glb(json.loads(data[20 : 20 + int(head[3])])):
        raise ValueError(reason)
    return _placed('glb', data, most)


def _not_in_glb(tree: dict[str, Any]) -> str:
    """Why not all triangles of such a file are read; empty if all are."""
    used = {*tree.get('extensionsUsed', ()), *tree.get('extensionsRequired', ())}
    meshes, nodes = tree.get('meshes', ()), tree.get('nodes', ())
    for part in (*nodes, *(one for mesh in meshes for one in mesh['primitives'])):
        used |= part.get('extensions', {}).keys()
    for name in sorted(used):
        if not name.startswith(HARMLESS):
            return f'it uses the extension {name}'
    for buffer in tree.get('buffers', ()):
        if not buffer.get('uri', 'data:').startswith('data:'):
            return f'it refers to another file, {buffer["uri"][:80]}'
    for number, accessor in enumerate(tree.get('accessors', ())):
        if 'sparse' in accessor or 'bufferView' not in accessor:
            return f'accessor {number} is sparse'
    for number, node in enumerate(nodes):
        if 'mesh' in node and not 0 <= node['mesh'] < len(meshes):
            return f'node {number} has a mesh that is not there'
        if 'skin' in node or ('camera' in node and node.keys() & {'mesh', 'children'}):
            return 'a node has a skin or a camera'
    for mesh in meshes:
        for part in mesh['primitives']:
            mode = part.get('mode', TRIANGLE_LIST)
            if mode >= TRIANGLE_LIST and (mode > TRIANGLE_STRIP or 'targets' in part):
                return 'a mesh has a fan or morph targets'
    return ''


def _read_dae(data: bytes, most: int) -> Floats:
    if zipfile.is_zipfile(io.BytesIO(data)):  # pycollada would unpack it
        raise ValueError('it is an archive')
    if b'\0' in data:
        raise ValueError('it is no text in UTF-8')
    if found := NO_TRIANGLES.search(data):
        raise ValueError(f'it has {found[0].decode()}')
    if MINUS.search(data):  # pycollada counts such an index from the end
        raise ValueError('an index is negative')
    unit = next((one for one in UNIT.finditer(data) if one[1] is not None), None)
    scale = float(unit[1]) if unit else 1.0
    if not (np.isfinite(scale) and scale > 0.0):
        raise ValueError(f'its unit is {scale} m')
    try:
        import collada  # noqa: F401
    except ImportError as error:
        raise ImportError(f'a DAE file needs pycollada: {GET_IT}') from error
    # pycollada makes zeros of NaN. Infinity stays, and is refused in a corner.
    data = FLOAT_ARRAY.sub(lambda one: NAN.sub(b'inf', one[0]), data)
    return _placed('dae', data, most) * scale


def _placed(kind: str, data: bytes, most: int) -> Floats:
    """Triangles of all meshes, each at its places in the file's frame."""
    try:
        import trimesh
    except ImportError as error:
        raise ImportError(f'a {kind.upper()} file needs trimesh: {GET_IT}') from error
    scene = trimesh.exchange.load.mesh_loaders[kind](
        io.BytesIO(data), file_type=kind, resolver=None, skip_materials=True, ignore_broken=False
    )
    base = scene.get('base_frame', 'world')
    frames, found, count = {base: np.eye(4)}, [np.empty((0, 3, 3))], 0
    for edge in scene['graph']:
        if edge['frame_to'] in frames:
            raise ValueError('a node has two parents')
        matrix = frames[edge.get('frame_from', base)] @ edge['matrix']
        frames[edge['frame_to']] = matrix
        mesh = scene['geometry'].get(edge.get('geometry'), {})
        if 'faces' not in mesh:  # lines and points have no surface
            continue
        count += len(mesh['faces'])
        _refuse_many(count, most)
        faces = np.asarray(mesh['faces'], np.int64)
        vertices = np.asarray(mesh['vertices'], np.float64)
        if faces.size and not 0 <= faces.min() <= faces.max() < len(vertices):
            raise ValueError(f'a triangle names vertices beyond the {len(vertices):,} given')
        with np.errstate(invalid='ignore', over='ignore'):  # what is not finite is refused later
            found.append((vertices @ matrix[:3, :3].T + matrix[:3, 3])[faces])
    return np.concatenate(found)


READERS: dict[str, Callable[[bytes, int], Floats]] = {
    'stl': _read_stl,
    'obj': _read_obj,
    'ply': _read_ply,
    'glb': _read_glb,
    'dae': _read_dae,
}


# ---- In a process of its own, for those who cannot wait, nor share their memory with a bomb.

REFUSED = 3  # exit code
MOST_MEMORY, MOST_TIME = 2**32, 60  # bytes; s of a processor


def main() -> int:
    """Read a file from stdin; write its triangles to stdout, or the reason why not.

    Arguments: the kind of file, the most triangles and bytes.
    """
    import resource

    kind, max_triangles, max_bytes = sys.argv[1:]
    resource.setrlimit(resource.RLIMIT_AS, (MOST_MEMORY, MOST_MEMORY))
    resource.setrlimit(resource.RLIMIT_CPU, (MOST_TIME, MOST_TIME))
    resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
    with contextlib.suppress(OSError):  # where memory ends, this process is the first to go
        Path('/proc/self/oom_score_adj').write_text('1000')
    try:
        data = sys.stdin.buffer.read(int(max_bytes) + 1)
        triangles = triangles_of(data, kind, int(max_triangles), int(max_bytes))
    except MemoryError:
        reason = 'it takes too much memory to read'
    except (ValueError, ImportError) as error:
        reason = str(error)
    else:
        sys.stdout.buffer.write(np.ascontiguousarray(triangles).data)
        return 0
    sys.stdout.buffer.write(reason.encode('utf-8', 'replace'))
    return REFUSED


if __name__ == '__main__':
    sys.exit(main())
