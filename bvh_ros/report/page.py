# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page that a run of the report writes, section by section."""

import os
import platform
from collections.abc import Callable, Iterable
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from .tables import Table

LIBRARIES = ('numpy', 'numba', 'embreex', 'coal', 'python-fcl', 'scipy')


class Page:
    """Collects Markdown, prints it, and writes tables and plots beside it.

    Parameters
    ----------
    folder : Path
        Where `report.md`, the CSV files and the plots go; made if it is not there.
    say : callable
        Prints what is added.
    data : Path
        Folder of recorded input, for the parts that use some.
    """

    def __init__(
        self, folder: Path, say: Callable[[str], None], data: Path = Path('data')
    ) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder = folder
        self.data = data
        self._say = say
        self._parts: list[str] = []
        self.add('# bvh_ros: report')
        self.add(machine())

    def add(self, text: str) -> None:
        """Add a heading or a paragraph."""
        self._say(f'{text}\n')
        self._parts.append(text)

    def misses(self, files: Iterable[Path]) -> bool:
        """Whether one of the recordings is not there; the page then says which."""
        for file in files:
            if not file.is_file():
                self.add(f'Left out: there is no file {file} (see --data).')
                return True
        return False

    def table(self, table: Table) -> None:
        """Add a table, and write it as CSV."""
        table.write_csv(self.folder)
        self.add(table.markdown())

    def plot(self, name: str, caption: str) -> Path:
        """Add a picture; the caller writes it to the returned path."""
        self._parts.append(f'![{caption}]({name}.png)')
        return self.folder / f'{name}.png'

    def write(self) -> Path:
        """Write the page."""
        path = self.folder / 'report.md'
        path.write_text('\n\n'.join(self._parts) + '\n', encoding='utf-8')
        return path


def machine() -> str:
    """One paragraph about where this was measured."""
    found = []
    for name in LIBRARIES:
        try:
            found.append(f'{name} {version(name)}')
        except PackageNotFoundError:
            continue
    cores = len(os.sched_getaffinity(0)) if hasattr(os, 'sched_getaffinity') else os.cpu_count()
    return (
        f'Measured on {processor()} ({vectors()}), {cores} cores, {platform.system()}, '
        f'CPython {platform.python_version()}, {", ".join(found)}.'
    )


def vectors() -> str:
    """How wide the kernels' vectors are, or for which other processor they are compiled. A name
    alone leaves them this processor's vectors: numba takes those from NUMBA_CPU_FEATURES.
    """
    from numba import config

    from ..tree.compiler import host_features

    if config.CPU_NAME and config.CPU_FEATURES is not None:
        return f'kernels compiled for {config.CPU_NAME}'
    features = host_features()
    width = 512 if features.get('avx512f') else 256 if features.get('avx2') else 128
    return f'vectors of {width} bits'


def processor() -> str:
    """Name of the processor, as well as this system tells."""
    try:
        for line in Path('/proc/cpuinfo').read_text(encoding='utf-8').splitlines():
            if line.startswith('model name'):
                return line.partition(':')[2].strip()
    except OSError:
        pass
    return platform.processor() or platform.machine()
