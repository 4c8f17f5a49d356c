# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Which sources a kernel's machine code depends on.

A kernel reads globals of its module, and what it calls becomes part of it. A global is defined in
its module or imported there. So the code depends on the kernel's own file and on all files of this
package that this one imports, that those import, and so on: by any import statement, wherever it
stands. The `__init__` of a package counts where a name comes from it; that those on the way to a
module run, too, changes no global of it.
"""

import functools
import hashlib
import re
from collections.abc import Iterator
from pathlib import Path

PACKAGE = Path(__file__).resolve().parents[2]

# Import statements, as this package writes them. Parsing all files would take a quarter of a
# second at every start; a test sees to it that nothing is overlooked.
_FROM = re.compile(
    r'^[ \t]*from[ \t]+(?P<dots>\.*)(?P<module>[\w.]*)[ \t]+import[ \t]+'
    r'(?:\((?P<several>[^)]*)\)|(?P<names>[^\n]*))',
    re.MULTILINE,
)
_IMPORT = re.compile(r'^[ \t]*import[ \t]+(?P<names>[^\n]*)', re.MULTILINE)
_NAME = re.compile(r'[\w.]+')  # also of what follows `as` and of comments: these are no files


def digest(source: Path) -> str:
    """Hash of a file of this package and of all that it imports from it."""
    return _digest(frozenset(depends_on(source)))


@functools.cache
def digest_of_all() -> str:
    """Hash of every file of this package."""
    return _digest(frozenset(_package()[0].values()))


def depends_on(source: Path) -> set[Path]:
    """Return the file and those of its package that it imports, at any depth."""
    found, todo = {source}, [source]
    while todo:
        new = imported_by(todo.pop()) - found
        found |= new
        todo += new
    return found


@functools.cache
def _digest(sources: frozenset[Path]) -> str:
    total = hashlib.sha256()
    for source in sorted(sources, key=_place):
        total.update(f'{_place(source)}\n'.encode())
        total.update(_hash_of(source))
    return total.hexdigest()


@functools.cache
def _hash_of(source: Path) -> bytes:
    return hashlib.sha256(source.read_bytes()).digest()


@functools.cache
def _place(source: Path) -> str:
    return source.relative_to(PACKAGE).as_posix()


@functools.cache
def _package() -> tuple[dict[str, Path], set[str]]:
    """All files by their places, and the folders that they are in. Looking for each at every
    import statement would take a fourteenth of a start.
    """
    files = {_place(path): path for path in PACKAGE.rglob('*.py')}
    return files, {place.rpartition('/')[0] for place in files}


@functools.cache
def imported_by(source: Path) -> frozenset[Path]:
    """The files of this package that the import statements of one file name."""
    found: set[Path] = set()
    text = source.read_text(encoding='utf-8')
    for match in _FROM.finditer(text):
        dots, module = match['dots'], match['module'].split('.') if match['module'] else []
        for name in _NAME.findall(match['several'] or match['names']):
            found.update(named_files(source, len(dots), [*module, name]))
    for match in _IMPORT.finditer(text):
        for name in _NAME.findall(match['names']):
            found.update(named_files(source, 0, name.split('.')))
    return frozenset(found)


def named_files(source: Path, level: int, words: list[str]) -> Iterator[Path]:
    """The file that a name comes from, if it is of this package."""
    if level:
        return _files(_place(source).split('/')[:-level], words)
    return _files([], words[1:]) if words[0] == PACKAGE.name else iter(())


def _files(above: list[str], words: list[str]) -> Iterator[Path]:
    """The file that a name along these words comes from: a module, or the package it is in."""
    files, folders = _package()
    folder = '/'.join(above)
    for count, word in enumerate(words, 1):
        inner = f'{folder}/{word}'.lstrip('/')
        if f'{inner}.py' in files:
            yield files[f'{inner}.py']
            return  # what follows is a name in it
        if inner not in folders:
            yield files[f'{folder}/__init__.py'.lstrip('/')]
            return
        folder = inner
        if count == len(words):
            yield files[f'{folder}/__init__.py']
