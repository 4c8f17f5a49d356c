# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A table, as text for the terminal, as Markdown for the page and as CSV for other programs."""

import csv
from collections.abc import Iterable, Sequence
from pathlib import Path
from typing import NamedTuple

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
