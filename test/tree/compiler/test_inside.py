# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What numba does not document is used in one place, is not needed, and is left as it is."""

import ast
import json
from collections.abc import Iterator
from pathlib import Path

import pytest
from tree.compiler.alone import run_alone

import bvh_ros

PACKAGE = Path(bvh_ros.__file__).parent
PUBLIC = ('numba', 'numba.extending', 'llvmlite', 'llvmlite.ir')
OPTIONS = ('_nrt', 'forceinline', 'no_cfunc_wrapper')
BEHIND_THE_GATE = ('kernel_files.py', 'kernel_parts.py')

ANSWERS = """
import json
import numba
import numpy as np
from bvh_ros import DynamicBVH
from bvh_ros.scene.cast.arguments import triangles_in
from bvh_ros.tree import checks
from bvh_ros.tree.compiler import address_of, called_at

rows = np.array([[1.0, 2.0], [np.inf, 3.0]])
address, there = address_of(checks.first_not_finite, rows), called_at(checks.first_not_finite)
row = numba.njit(lambda address, rows: there(address, (rows,)))(address, rows)
chosen = numba.njit(lambda solid, rows: triangles_in((solid, None), rows) is None)
random = np.random.default_rng(0)
tree = DynamicBVH(2)
for corner in random.uniform(0, 100, (60, 2)):
    tree.insert(corner, corner + 5)
origins, directions = random.uniform(0, 100, (200, 2)), random.normal(size=(200, 2))
hits = tree.raycast_many(origins, directions)
assert tree.stats()['wide_snapshot']
print(json.dumps([
    type(checks.first_not_finite).__name__,
    [array.tolist() for array in hits],
    tree.overlap([10, 10], [40, 40]).tolist(),
    tree.cost(),
    int(row),
    [chosen(None, 1), chosen((1, 2), 1)],
]))
"""
HIDING = """
import builtins, sys

found = builtins.__import__

def hide(name, globals=None, locals=None, names=(), level=0):
    asks = (globals or {}).get('__name__', '')
    if asks.startswith('bvh_ros') and level == 0 and name.startswith(('numba', 'llvmlite')):
        if name not in sys.argv[1:]:
            raise ImportError(f'there is no {name}')
    return found(name, globals, locals, names, level)

builtins.__import__ = hide
"""
WATCHING = """
import sys
import numba, numba.core.registry

def state():
    return {
        (cls, name): id(value)
        for module in [*sys.modules.values()]
        if getattr(module, '__name__', '').startswith(('numba', 'llvmlite'))
        for cls in vars(module).values()
        if isinstance(cls, type) and cls.__module__.startswith(('numba', 'llvmlite'))
        for name, value in vars(cls).items()
        if callable(value) or isinstance(value, property)
    }

before = state()
"""
UNTOUCHED = """
after = state()
changed = [place for place, value in before.items() if after.get(place) != value]
assert len(before) > 500 and not changed, changed
"""


def run(code: str, *arguments: str, **environment: str) -> tuple[list, str]:
    ended = run_alone(code, *arguments, **environment)
    return json.loads(ended.stdout), ended.stderr


@pytest.mark.slow
def test_without_what_is_not_documented_answers_are_the_same():
    (name, *expected), said = run(ANSWERS)
    assert (name, said) == ('Kernel', '')
    assert expected[-1] == [True, False]
    # Is compiled anew. Checks of bounds, which CI asks for in another run, are in no public name.
    plain = {'NUMBA_OPT': '0', 'NUMBA_BOUNDSCHECK': '0'}
    (name, *answers), said = run(HIDING + ANSWERS, *PUBLIC, **plain)
    assert name == 'CPUDispatcher'
    assert answers == expected
    assert said.count('RuntimeWarning') == 1
    assert 'every process compiles them' in said


OTHER_VERSION = """
import json, numba

numba.version_info = numba.version_info._replace(short=(0, 999))
from bvh_ros.tree import checks
from bvh_ros.tree.compiler import kernel_cache

folder = kernel_cache.cache_folder()
print(json.dumps([type(checks.first_not_finite).__name__, folder, kernel_cache.is_noted('')]))
"""


def test_with_another_version_nothing_of_it_is_used():
    found, said = run(OTHER_VERSION)
    assert found == ['CPUDispatcher', None, False]
    assert said.count('is not one that bvh_ros was tested with') == 1


def test_classes_of_numba_are_as_they_were():
    """Also after compiling: other users of numba in this process get what they know."""
    run(WATCHING + ANSWERS + UNTOUCHED)


def imported(source: Path) -> Iterator[tuple[str, bool]]:
    """Names that a file imports, and whether it does so when it is imported itself."""
    tree = ast.parse(source.read_bytes())
    for node in ast.walk(tree):
        if isinstance(node, ast.Import):
            yield from ((alias.name, node in tree.body) for alias in node.names)
        elif isinstance(node, ast.ImportFrom) and not node.level:
            yield node.module, node in tree.body


def test_private_names_are_imported_in_one_place():
    behind = 0
    for source in sorted(PACKAGE.rglob('*.py')):
        inside = source.parent in (PACKAGE / 'tree' / 'compiler', PACKAGE / 'tree' / 'simd')
        for name, at_once in imported(source):
            if name.split('.')[0] not in ('numba', 'llvmlite') or name in PUBLIC:
                continue
            assert inside, (source, name)
            assert not at_once or source.name in BEHIND_THE_GATE, (source, name)
            behind += source.name in BEHIND_THE_GATE
        assert inside or not any(option in source.read_text() for option in OPTIONS), source
    assert behind > 5
