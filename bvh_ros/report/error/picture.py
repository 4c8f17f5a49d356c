# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Error against run time: a point a way, and the front of those that nothing beats in both."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

# Okabe and Ito's colours, which the colour-blind can tell apart.
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
MARKERS = 'osD^vP*'


class Point(NamedTuple):
    """One way of answering."""

    name: str
    time: float
    """Microseconds a ray."""
    errors: Sequence[float]
    """One a panel."""
    family: str = ''
    """Points of one family look alike."""


def front(points: Sequence[tuple[float, float]]) -> list[int]:
    """Places of the points that no other beats or equals in both, by ascending time."""
    order = sorted(range(len(points)), key=lambda i: points[i])
    best, chosen = float('inf'), []
    for i in order:
        if points[i][1] < best:
            best = points[i][1]
            chosen.append(i)
    return chosen


def tradeoff(path: Path, points: Sequence[Point], panels: Sequence[str], title: str) -> None:
    """Write a PNG with a panel for each kind of error."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(5.2 * len(panels), 4.6), layout='constrained')
    FigureCanvasAgg(figure)
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    for k, (axes, label) in enumerate(zip(every, panels, strict=True)):
        _panel(axes, points, [point.errors[k] for point in points], label)
    figure.suptitle(title, x=0.01, ha='left', fontsize=10)
    figure.draw_without_rendering()
    for k, axes in enumerate(every):
        _place_labels(axes, points, [point.errors[k] for point in points])
    figure.savefig(path, dpi=200)


def _floor(errors: Sequence[float]) -> float:
    """Where zero is drawn on the logarithmic axis."""
    positive = [e for e in errors if e > 0]
    return min(positive, default=1.0) / 30


def _panel(axes: Any, points: Sequence[Point], errors: Sequence[float], label: str) -> None:
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    floor = _floor(errors)
    shown = [max(e, floor) for e in errors]
    axes.set(xscale='log', yscale='log', xlabel='run time a ray, µs', ylabel=label)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[['top', 'right']].set_visible(False)
    best = front([(point.time, y) for point, y in zip(points, shown, strict=True)])
    steps = [(points[i].time, shown[i]) for i in best]
    families = list(dict.fromkeys(point.family for point in points))
    for i, (point, y) in enumerate(zip(points, shown, strict=True)):
        look = families.index(point.family) % len(COLOURS)
        face = COLOURS[look] if i in best else 'white'
        axes.plot(
            point.time, y, MARKERS[look], color=COLOURS[look], markerfacecolor=face, ms=7, zorder=3
        )
    low, high = min(p.time for p in points), max(p.time for p in points)
    axes.set_xlim(low / 2.5, high * 2.5)
    axes.set_ylim(floor / 4, max(shown) * 40)
    corner = [(steps[0][0], axes.get_ylim()[1]), *steps, (axes.get_xlim()[1], steps[-1][1])]
    axes.plot(
        *zip(*corner, strict=True), drawstyle='steps-post', color='0.45', linewidth=1.1, zorder=1,
        label='Pareto front',
    )
    axes.axhline(floor, color='0.45', linewidth=0.9, linestyle=(0, (2, 3)), zorder=0)
    decades = [y for y in LogLocator(numticks=9).tick_values(floor, max(shown)) if y > floor * 2]
    axes.set_yticks([floor, *decades])
    plain = FuncFormatter(lambda v, _: '0' if v == floor else _power(v))
    axes.yaxis.set_major_formatter(plain)
    axes.yaxis.set_minor_formatter(NullFormatter())
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f'{v:,.10g}'))
    axes.xaxis.set_minor_formatter(NullFormatter())
    axes.legend(frameon=False, fontsize=8, loc='upper right')


def _power(value: float) -> str:
    from math import log10

    exponent = round(log10(value))
    return f'{value:g}' if -4 < exponent < 4 else f'$10^{{{exponent}}}$'


def _place_labels(axes: Any, points: Sequence[Point], errors: Sequence[float]) -> None:
    """Write each name beside its point where it covers nothing that is there already."""
    from matplotlib.transforms import Bbox

    floor = _floor(errors)
    shown = [max(e, floor) for e in errors]
    spots = axes.transData.transform([(p.time, y) for p, y in zip(points, shown, strict=True)])
    unit = axes.figure.dpi / 72
    taken = [Bbox.from_bounds(x - 5 * unit, y - 5 * unit, 10 * unit, 10 * unit) for x, y in spots]
    taken.append(axes.get_legend().get_window_extent())
    renderer = axes.figure.canvas.get_renderer()
    for point, spot in sorted(zip(points, spots, strict=True), key=lambda pair: -pair[1][0]):
        text = axes.annotate(
            point.name, spot, xycoords='figure pixels', textcoords='offset points', fontsize=7.5,
            arrowprops={'arrowstyle': '-', 'color': '0.6', 'linewidth': 0.5, 'shrinkB': 4},
        )
        text.xy, text.xycoords = (point.time, shown[list(points).index(point)]), 'data'
        best = min(_offsets(), key=lambda o: _cost(text, o, renderer, taken, axes, unit))
        _put(text, best)
        taken.append(text.get_window_extent(renderer))


def _offsets() -> list[tuple[float, float, str]]:
    """Where a label may stand, in points from its point, the nearest first."""
    found = []
    for away in (8, 16, 26, 38, 52, 68, 86, 106, 128, 152):
        for x, y in ((1, 0), (0, 1), (0.8, 0.8), (-1, 0), (-0.8, 0.8), (0, -1), (0.8, -0.8), (-0.8, -0.8)):
            found.append((away * x, away * y, 'left' if x > 0 else 'right' if x < 0 else 'center'))
    return found


def _put(text: Any, offset: tuple[float, float, str]) -> None:
    text.set_position(offset[:2])
    text.set_horizontalalignment(offset[2])
    text.set_verticalalignment('center')


def _cost(
    text: Any, offset: tuple[float, float, str], renderer: Any, taken: list[Any], axes: Any, unit: float
) -> float:
    _put(text, offset)
    text.update_positions(renderer)
    from matplotlib.text import Text

    box = Text.get_window_extent(text, renderer).padded(1.5 * unit)
    inside = axes.get_window_extent()
    out = (
        max(inside.x0 - box.x0, 0) + max(box.x1 - inside.x1, 0)
        + max(inside.y0 - box.y0, 0) + max(box.y1 - inside.y1, 0)
    )
    covered = sum(
        max(min(box.x1, b.x1) - max(box.x0, b.x0), 0) * max(min(box.y1, b.y1) - max(box.y0, b.y0), 0)
        for b in taken
    )
    return 100 * out + 10 * covered + (offset[0] ** 2 + offset[1] ** 2) ** 0.5
