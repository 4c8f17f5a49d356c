# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Plots of the report: one look for all of them."""

from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple


class Line(NamedTuple):
    """One curve."""

    x: Sequence[float]
    y: Sequence[float]


def lines(path: Path, curves: Mapping[str, Line], x_label: str, y_label: str, title: str) -> None:
    """Write a PNG of curves over logarithmic axes."""
    figure, axes = _figure(title)
    for name, curve in curves.items():
        axes.plot(curve.x, curve.y, marker='o', label=name)
    _logarithmic(axes, 'x')
    _logarithmic(axes, 'y')
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.legend(frameon=False)
    figure.savefig(path, dpi=160)


def _figure(title: str) -> tuple[Any, Any]:
    # Imported here, so that --help works without it. The Agg canvas needs no display.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, 4.5), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(title, loc='left', fontsize=10)
    axes.grid(alpha=0.3)
    axes.set_axisbelow(True)
    axes.spines[['top', 'right']].set_visible(False)
    return figure, axes


def _logarithmic(axes: Any, direction: str) -> None:
    """Make an axis logarithmic, with plain numbers at 1, 2, 5, 10 where they have room."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter, NullLocator

    axes.set(**{f'{direction}scale': 'log'})
    axis = getattr(axes, f'{direction}axis')
    low, high = axis.get_data_interval()
    short = high < 1e3 * low
    axis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,), numticks=15))
    axis.set_major_formatter(FuncFormatter(lambda value, _: f'{value:,.10g}'))
    axis.set_minor_locator(NullLocator())
    axis.set_minor_formatter(NullFormatter())
