# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Error against run time: a point a way, and the front of those that nothing beats in both."""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, NamedTuple

from .scoring import Score

# Okabe and Ito's colours, which the colour-blind can tell apart; with the markers, one look a way.
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
MARKERS = 'osD^vP*X<>h'
GREY = '0.4'


class Panel(NamedTuple):
    """One kind of error."""

    label: str
    error: Callable[[Score], float]
    floor: float
    """Where zero, and what is below this, is drawn on the logarithmic axis; 0: at a tenth of one
    ray in all.
    """
    top: float
    """Upper end of the axis, if nothing is above."""


class Point(NamedTuple):
    """One way of answering."""

    name: str
    time: float
    """Microseconds a ray."""
    errors: Sequence[float]
    """One a panel."""
    judged: bool = True
    """Whether it may be on the front; not if it was asked less than others."""


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Places of the points that no other beats or equals in both, by ascending time.

    An error must be smaller by a tenth to be called smaller.
    """
    order = sorted(range(len(points)), key=lambda i: points[i])
    best, chosen = float('inf'), []
    for i in order:
        if points[i][1] < 0.9 * best:
            best = points[i][1]
            chosen.append(i)
    return chosen


def tradeoff(path: Path, points: Sequence[Point], panels: Sequence[Panel], title: str) -> None:
    """Write a PNG with a panel for each kind of error, and a key."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.5 * len(panels) + 2.6, 3.6), layout='constrained')
    FigureCanvasAgg(figure)
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    ranked = sorted(points, key=lambda point: point.time)
    for k, (axes, panel) in enumerate(zip(every, panels, strict=True)):
        _panel(axes, ranked, [point.errors[k] for point in ranked], panel)
    figure.legend(*every[0].get_legend_handles_labels(), loc='outside right center',
                  frameon=False, fontsize=8)  # fmt: skip
    figure.suptitle(title, x=0.01, ha='left', fontsize=10)
    figure.savefig(path, dpi=220)


def _panel(axes: Any, points: Sequence[Point], errors: Sequence[float], panel: Panel) -> None:
    shown = [max(error, panel.floor) for error in errors]
    for i, (point, y) in enumerate(zip(points, shown, strict=True)):
        colour, marker = COLOURS[i % len(COLOURS)], MARKERS[i % len(MARKERS)]
        face = colour if point.judged else 'white'
        axes.plot(point.time, y, marker, ms=8, color=colour, mfc=face, label=point.name, zorder=3)
    axes.set(xscale='log', yscale='log', xlabel='run time a ray, µs', ylabel=panel.label)
    axes.set_xlim(points[0].time / 3, points[-1].time * 3)
    axes.set_ylim(panel.floor / 5, max(panel.top, max(shown) * 3))
    judged = [i for i, point in enumerate(points) if point.judged]
    best = [judged[i] for i in front([(points[i].time, shown[i]) for i in judged])]
    steps = [(points[i].time, shown[i]) for i in best]
    corners = [(steps[0][0], axes.get_ylim()[1]), *steps, (axes.get_xlim()[1], steps[-1][1])]
    line = zip(*corners, strict=True)
    axes.plot(*line, drawstyle='steps-post', color=GREY, lw=1.2, label='front', zorder=1)
    floor = 'no error, or below the scale'
    axes.axhline(panel.floor, color=GREY, lw=0.9, ls=(0, (2, 3)), label=floor, zorder=0)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[['top', 'right']].set_visible(False)
