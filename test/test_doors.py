# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The tree is imported through its doors, and no door offers what nobody uses."""

import ast
from pathlib import Path

import bvh_ros

PACKAGE, TESTS = Path(bvh_ros.__file__).parent, Path(__file__).parent
DOORS = 'tree', 'tree.access', 'tree.motion.access', 'tree.compiler'
# Files by which other rooms, examples and tests use a room, beside what the room itself offers.
OPEN = {
    *(*DOORS, 'tree.compiler.kernel_cache', 'tree.compiler.shipped', 'scene.tracking'),
    *('ros.access', 'ros.running', 'ros.large_messages', 'ros.compilation', 'ros.compile_jobs'),
    *('view.worlds', 'view.recorded'),
}
MOST_PRIVATE = 40  # files of tests: of exact arithmetic, kernels, decoders, layouts in memory
# They measure the inside of the tree: they replace parts of kernels, or count kernels.
INSIDERS = {f'report/{name}.py' for name in ('error/methods', 'speed', 'workload')}


def imports(path):
    """(module below the package, name) of each name that a file imports from the package."""
    folder = path.relative_to(PACKAGE).parts[:-1] if path.is_relative_to(PACKAGE) else ()
    for node in ast.walk(ast.parse(path.read_text())):
        if isinstance(node, ast.ImportFrom):
            module = (node.module or '').split('.') if node.module else []
            if node.level:
                module = [*folder[: len(folder) - node.level + 1], *module]
            elif module[:1] == ['bvh_ros']:
                module = module[1:]
            else:
                continue
            for name in node.names:
                yield '.'.join(module), name.name


def offered_by(door):
    path = PACKAGE / f'{door.replace(".", "/")}.py'
    return {(door, name) for _, name in imports(path)}


def test_the_tree_is_imported_through_its_doors():
    wrong, used = [], set()
    for path in PACKAGE.rglob('*.py'):
        place = path.relative_to(PACKAGE).as_posix()
        if place.startswith('tree/') or place in INSIDERS:
            continue
        for module, name in imports(path):
            if module.split('.')[0] == 'tree':
                used.add((module, name))
                if module not in DOORS:
                    wrong.append(f'{place} imports {name} from {module}')
    assert not wrong
    for door in DOORS[1:3]:
        assert not offered_by(door) - used


def test_few_tests_look_behind_the_doors():
    private = set()
    for path in TESTS.rglob('*.py'):
        for module, name in imports(path):
            inner = f'{module}.{name}'.strip('.')
            place = PACKAGE / inner.replace('.', '/')
            asked = inner if place.is_dir() or place.with_suffix('.py').is_file() else module
            if '.' in asked and asked not in OPEN:
                private.add(path.relative_to(TESTS).as_posix())
    assert len(private) <= MOST_PRIVATE, sorted(private)


def test_what_the_node_offers_is_used():
    door, used = 'ros.access', set()
    for path in (*PACKAGE.rglob('*.py'), *TESTS.rglob('*.py')):
        used |= {(module, name) for module, name in imports(path) if module == door}
    assert not offered_by(door) - used
