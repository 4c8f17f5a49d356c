# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The page that a report writes: text, tables and pictures."""

import csv
import os
import platform
from collections.abc import Iterable, Sequence
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

# ---- Tables in Markdown


Cell = str | int | float | None  # None is an empty cell


def show(cell: Cell) -> str:
    """Text of a cell: three significant digits, thousands grouped."""
    if isinstance(cell, float):
        return f'{cell:,.0f}' if 100 <= abs(cell) < 1e7 else f'{cell:.3g}'
    return '' if cell is None else f'{cell:,}' if isinstance(cell, int) else cell


def markdown(header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> str:
    """A table whose columns are padded, so that it reads well as text, too."""
    columns = []
    for name, *cells in zip(header, *rows, strict=True):
        texts = [str(name), *map(show, cells)]
        width = max(map(len, texts))
        if any(isinstance(cell, str) for cell in cells):
            padded, rule = [text.ljust(width) for text in texts], '-' * width
        else:
            padded, rule = [text.rjust(width) for text in texts], '-' * (width - 1) + ':'
        columns.append([padded[0], rule, *padded[1:]])
    return '\n'.join(f'| {" | ".join(line)} |' for line in zip(*columns, strict=True))


# ---- The page


TITLE = '# bvh_ros: report\n'
LIBRARIES = ('numpy', 'numba', 'embreex', 'coal', 'open3d', 'python-fcl', 'rapier3d', 'scipy')
# Okabe and Ito's colours, which the colour-blind can tell apart, and purple.
BLUE, RED, PINK, PURPLE = '#0072B2', '#D55E00', '#CC79A7', '#7353AD'
ORANGE, BLACK, GREY = '#E69F00', '#000000', '0.4'


class Page:
    """Prints what is added, and writes `report.md` with tables and pictures beside it.

    Parameters
    ----------
    folder : Path
        Where `report.md`, the CSV files and the pictures go; made if it is not there.
    data : Path, optional
        Folder of recorded input, for the parts that use some.
    """

    def __init__(self, folder: Path, data: Path | None = None) -> None:
        folder.mkdir(parents=True, exist_ok=True)
        self.folder, self.data = folder, data or Path()
        self._parts: dict[str, list[str]] = {}  # paragraphs by the title of the part

    def begin(self, title: str, text: str) -> None:
        """Begin a part."""
        self._parts[f'## {title}'] = []
        for paragraph in (f'## {title}', machine(), text):
            self.add(paragraph)

    def add(self, text: str) -> None:
        """Add a heading or a paragraph to the last part."""
        from tqdm import tqdm

        tqdm.write(f'{text}\n')  # above the bar
        next(reversed(self._parts.values())).append(text)

    def misses(self, files: Iterable[Path]) -> bool:
        """Whether one of the recordings is not there; the page then says which."""
        absent = next((file for file in files if not file.is_file()), None)
        if absent is not None:
            self.add(f'Left out: there is no file {absent} (see --data).')
        return absent is not None

    def table(self, name: str, header: Sequence[str], rows: Sequence[Sequence[Cell]]) -> None:
        """Add a table, and write it as `<name>.csv` with all digits."""
        with open(self.folder / f'{name}.csv', 'w', newline='', encoding='utf-8') as file:
            csv.writer(file).writerows([header, *rows])
        self.add(markdown(header, rows))

    def picture(self, name: str, caption: str, figure: Any) -> None:
        """Add a figure of matplotlib, and write it as `<name>.png`."""
        figure.savefig(self.folder / f'{name}.png', dpi=200)
        self.add(f'![{caption}]({name}.png)')

    def write(self) -> Path:
        """Write the page; the parts of an earlier run that are not in this one stay."""
        path = self.folder / 'report.md'
        earlier = path.read_text(encoding='utf-8').split('\n## ')[1:] if path.is_file() else []
        parts = {f'## {text.partition(chr(10))[0]}': f'## {text}' for text in earlier}
        parts |= {title: '\n\n'.join(texts) for title, texts in self._parts.items()}
        pieces = (TITLE, *(f'{parts[title].rstrip()}\n' for title in sorted(parts)))
        path.write_text('\n'.join(pieces), encoding='utf-8')
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
    """How wide the kernels' vectors are, or for which other processor they are compiled.

    A name alone leaves them this processor's vectors: numba takes those from NUMBA_CPU_FEATURES.
    """
    from numba import config

    from ..tree.compiler import host_features

    if config.CPU_NAME and config.CPU_FEATURES is not None:
        return f'kernels compiled for {config.CPU_NAME}'
    features = host_features()
    width = 512 if features.get('avx512f') else 256 if features.get('avx2') else 128
    return f'vectors of {width} bits'


def processor() -> str:
    """Name of the processor, as well as this system knows it."""
    try:
        text = Path('/proc/cpuinfo').read_text(encoding='utf-8')
    except OSError:
        text = ''
    model = text.partition('model name')[2].partition('\n')[0].partition(':')[2].strip()
    return model or platform.processor() or platform.machine()
