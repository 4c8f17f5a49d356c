# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The rooms of the scene import one way."""

import ast
from pathlib import Path

import bvh_ros.scene

SCENE = Path(bvh_ros.scene.__file__).parent
# Each folder or file imports from those before it only; '' is all else of the scene.
ROOMS = ['tree', 'shapes', 'results', 'names', 'rows', 'store', 'distance', 'cast', '']


def imported(path):
    """(line, room) of what a file imports of the package."""
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom) and node.level:
            depth = len(path.relative_to(SCENE).parts) - node.level  # of the folder, below scene
            first = (node.module or '').split('.')[0]
            if depth < 0:
                yield node.lineno, first
            elif depth == 0:
                names = [first] if first else [name.name for name in node.names]
                for name in names:
                    yield node.lineno, name
            else:
                yield node.lineno, path.parent.name


def test_rooms_import_one_way():
    wrong, seen = [], set()
    for path in SCENE.rglob('*.py'):
        room = path.parent.name if path.parent != SCENE else path.stem
        room = room if room in ROOMS else ''
        for line, other in imported(path):
            rank = ROOMS.index(other) if other in ROOMS else ROOMS.index('')
            seen.add((room, other))
            if rank > ROOMS.index(room):
                wrong.append(f'{path.relative_to(SCENE)}:{line} imports from {other}')
    assert not wrong
    assert {('cast', 'distance'), ('distance', 'shapes'), ('store', 'shapes')} <= seen
