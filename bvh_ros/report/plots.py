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


def lines(
    path: Path,
    curves: Mapping[str, Line],
    x_label: str,
    y_label: str,
    title: str,
    log_y: bool = True,
) -> None:
    """Write a PNG of curves over a logarithmic x axis."""
    figure, axes = _figure(title)
    for name, curve in curves.items():
        axes.plot(curve.x, curve.y, marker='o', label=name)
    axes.set_xscale('log')
    if log_y:
        axes.set_yscale('log')
    axes.set_xlabel(x_label)
    axes.set_ylabel(y_label)
    axes.legend(frameon=False)
    _write(figure, path)


def bars(path: Path, groups: Mapping[str, Mapping[str, float]], x_label: str, title: str) -> None:
    """Write a PNG of horizontal bars on a logarithmic axis, in named groups."""
    figure, axes = _figure(
        title, height=1.0 + 0.22 * sum(len(group) + 1 for group in groups.values())
    )
    colours = {
        name: f'C{k}'
        for k, name in enumerate(dict.fromkeys(n for g in groups.values() for n in g))
    }
    place, ticks = 0, []
    for group in groups.values():
        ticks.append(place + (len(group) - 1) / 2)
        for name, value in group.items():
            axes.barh(place, value, color=colours[name])
            axes.annotate(f' {value:,.0f}', (value, place), va='center', fontsize=7)
            place += 1
        place += 1
    handles = [axes.barh([0], [0], color=colour, label=name) for name, colour in colours.items()]
    axes.legend(
        handles=handles,
        frameon=False,
        fontsize=8,
        loc='lower right',
        bbox_to_anchor=(1.0, 1.0),
        ncols=3,
    )
    axes.set_yticks(ticks, list(groups))
    axes.invert_yaxis()
    axes.set_xscale('log')
    axes.set_xlabel(x_label)
    _write(figure, path)


def _figure(title: str, height: float = 4.5) -> tuple[Any, Any]:
    # Imported here, so that --help works without it. The Agg canvas needs no display.
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(7.5, height), layout='constrained')
    FigureCanvasAgg(figure)
    axes = figure.add_subplot()
    axes.set_title(title, loc='left', fontsize=10)
    axes.grid(alpha=0.3)
    axes.spines[['top', 'right']].set_visible(False)
    return figure, axes


def _write(figure: Any, path: Path) -> None:
    figure.savefig(path, dpi=160)
