# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page that a report writes: text, tables and plots, under a progress bar."""

import csv
import os
import platform
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import NamedTuple, TypeVar

# ---- A table, as text for the terminal, as Markdown for the page and as CSV for other programs.


Cell = str | int | float | None


class Table(NamedTuple):
    """Rows under a header; None is an empty cell."""

    name: str
    """Name of the CSV file, and of the table on the page."""
    header: Sequence[str]
    rows: Sequence[Sequence[Cell]]

    def write_csv(self, folder: Path) -> None:
        """Write `<name>.csv` with all digits."""
        with open(folder / f'{self.name}.csv', 'w', newline='', encoding='utf-8') as file:
            writer = csv.writer(file)
            writer.writerow(self.header)
            writer.writerows(self.rows)

    def markdown(self) -> str:
        """Return the table in Markdown, its columns padded so that it can be read as text, too."""
        body = [[show(cell) for cell in row] for row in self.rows]
        widths = [max(map(len, column)) for column in zip(self.header, *body, strict=True)]
        numeric = [all(_is_number(row[k]) for row in self.rows) for k in range(len(self.header))]
        rule = [
            ('-' * (w - 1) + ':') if n else '-' * w for w, n in zip(widths, numeric, strict=True)
        ]
        padded = [_pad(line, widths, numeric) for line in (self.header, *body)]
        return '\n'.join(map(_bar, (padded[0], rule, *padded[1:])))


def show(cell: Cell) -> str:
    """Text of a cell: three significant digits, thousands grouped."""
    if cell is None:
        return ''
    if isinstance(cell, float) and abs(cell) >= 1e7:
        return f'{cell:.3g}'
    if isinstance(cell, float):
        return f'{cell:,.0f}' if abs(cell) >= 100 else f'{cell:.3g}'
    return f'{cell:,}' if isinstance(cell, int) else cell


def _is_number(cell: Cell) -> bool:
    return cell is None or not isinstance(cell, str)


def _pad(line: Iterable[str], widths: list[int], numeric: list[bool]) -> list[str]:
    return [
        text.rjust(width) if right else text.ljust(width)
        for text, width, right in zip(line, widths, numeric, strict=True)
    ]


def _bar(cells: Iterable[str]) -> str:
    return '| ' + ' | '.join(cells) + ' |'


# ---- The progress bar: on a terminal as it goes, elsewhere a line a minute at most.


Item = TypeVar('Item')


def bar(items: Sequence[Item], name: Callable[[Item], str]) -> Iterator[Item]:
    """Go through the items under a bar that says what is being done; silent without tqdm."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield from items
        return
    interval = 0.1 if sys.stderr.isatty() else 60.0
    with tqdm(total=len(items), mininterval=interval, dynamic_ncols=True, leave=False) as shown:
        for item in items:
            shown.set_description(name(item), refresh=sys.stderr.isatty())
            yield item
            shown.update()


def say(text: str) -> None:
    """Print above the bar."""
    try:
        from tqdm import tqdm
    except ImportError:
        print(text)
    else:
        tqdm.write(text)


# ---- The page that a run of the report writes, section by section.


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
