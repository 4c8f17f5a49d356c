# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Machine code is named by all the sources that it depends on."""

import ast
import importlib
import types

import pytest

from bvh_ros.tree.compiler import kernel_sources
from bvh_ros.tree.compiler.kernel_parts import Kernel
from bvh_ros.tree.compiler.kernel_sources import PACKAGE, depends_on

SOURCES = sorted(PACKAGE.rglob('*.py'))
ROOMS = 'tree', 'scene', 'ros/cdr'  # where kernels are


@pytest.fixture
def package(tmp_path, monkeypatch):
    """A small package in place of ours; returns what writes a file of it."""
    root = tmp_path / 'bvh_ros'
    monkeypatch.setattr(kernel_sources, 'PACKAGE', root)

    def write(name, text):
        path = root / name
        path.parent.mkdir(parents=True, exist_ok=True)
        for folder in path.relative_to(root).parents:
            (root / folder / '__init__.py').touch()
        path.write_text(text)
        forget()
        return path

    yield write
    forget()


def forget():
    """What was read of the package before."""
    for kept in vars(kernel_sources).values():
        if hasattr(kept, 'cache_clear'):
            kept.cache_clear()


@pytest.mark.parametrize(
    'statement',
    [
        'from ..inner.callee import work',
        'from ..inner.callee import work as other  # (of a kind)',
        'from ..inner import callee',
        'from bvh_ros.inner.callee import work',
        'from bvh_ros.inner import callee as other',
        'import bvh_ros.inner.callee',
        'import os, bvh_ros.inner.callee as other',
        'from ..inner import (\n    more,  # not this one\n    callee,\n)',
        'def late():\n    from ..inner.callee import work',
        'if True:\n\tfrom  ..inner.callee  import work',
    ],
)
def test_an_edit_in_what_is_imported_at_any_depth_is_another_name(package, statement):
    package('inner/more.py', '')
    package('inner/callee.py', 'from .deeper import deepest\n')
    package('inner/deeper.py', 'from .. import limits\n')
    package('limits.py', 'LIMIT = 1\n')
    package('room/beside.py', '')
    kernel = package('room/kernels.py', f'{statement}\n')
    seen = {kernel_sources.digest(kernel)}
    for count, name in enumerate(('inner/callee.py', 'inner/deeper.py', 'limits.py'), 2):
        package(name, (root_of(kernel) / name).read_text() + '# edited\n')
        seen.add(kernel_sources.digest(kernel))
        assert len(seen) == count, name
    package('room/beside.py', 'edited = True\n')
    assert kernel_sources.digest(kernel) in seen


def root_of(kernel):
    return kernel.parents[1]


def test_a_name_of_a_package_itself_comes_from_its_first_file(package):
    kernel = package('room/kernels.py', 'from ..inner import LIMIT\n')
    package('inner/callee.py', '')
    before = kernel_sources.digest(kernel)
    package('inner/__init__.py', 'LIMIT = 1\n')
    assert kernel_sources.digest(kernel) != before


def test_a_file_that_moves_is_another_name(package):
    kernel = package('room/kernels.py', 'X = 1\n')
    before = kernel_sources.digest(kernel)
    assert kernel_sources.digest(package('moved/kernels.py', 'X = 1\n')) != before


def parsed(source):
    """What Python's own parser says is imported."""
    for node in ast.walk(ast.parse(source.read_bytes())):
        if isinstance(node, ast.Import):
            for alias in node.names:
                yield from kernel_sources.named_files(source, 0, alias.name.split('.'))
        elif isinstance(node, ast.ImportFrom):
            module = node.module.split('.') if node.module else []
            for alias in node.names:
                yield from kernel_sources.named_files(source, node.level, [*module, alias.name])


def test_no_import_statement_is_overlooked():
    found = 0
    for source in SOURCES:
        wanted = {*parsed(source)}
        found += len(wanted)
        assert wanted <= kernel_sources.imported_by(source), source
    assert found > len(SOURCES)


def kernels():
    for room in ROOMS:
        for source in sorted((PACKAGE / room).rglob('*.py')):
            name = '.'.join(('bvh_ros', *source.relative_to(PACKAGE).with_suffix('').parts))
            module = importlib.import_module(name.removesuffix('.__init__'))
            for value in vars(module).values():
                if isinstance(value, Kernel) and value.py_func.__module__ == module.__name__:
                    yield source, value.py_func


def test_what_kernels_name_is_in_the_files_that_they_depend_on():
    """As imported: every function, type and module that a kernel's own names stand for."""
    checked = 0
    for source, function in kernels():
        inside = depends_on(source)
        for name in function.__code__.co_names:
            value = function.__globals__.get(name)
            if isinstance(value, types.ModuleType):
                where = value.__name__
            else:
                where = getattr(getattr(value, 'py_func', value), '__module__', None) or ''
            if where.startswith('bvh_ros'):
                path = PACKAGE.joinpath(*where.split('.')[1:])
                assert {path.with_suffix('.py'), path / '__init__.py'} & inside, (source, name)
                checked += 1
    assert checked > 500


def test_kernels_are_in_modules_that_are_imported_by_statements():
    """Nothing there imports by name at run time, or hides a module behind another thing."""
    for room in ROOMS:
        for source in (PACKAGE / room).rglob('*.py'):
            text = source.read_text()
            if source != PACKAGE / 'ros/cdr/definitions.py':  # of message types
                assert 'import_module(' not in text, source
            assert '__import__' not in text, source
            if source.name == '__init__.py':
                inside = {path.stem for path in source.parent.iterdir()}
                imports = (i for i in ast.walk(ast.parse(text)) if not is_of_modules(i))
                given = {n.asname or n.name for i in imports for n in names(i)}
                assert not given & inside, source


def is_of_modules(node):
    """Whether it is `from . import module`: those stand for themselves."""
    return isinstance(node, ast.ImportFrom) and node.module is None


def names(node):
    return node.names if isinstance(node, ast.Import | ast.ImportFrom) else []
