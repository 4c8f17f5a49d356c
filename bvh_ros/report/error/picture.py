# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Error against run time: a point a way, and the front of those that nothing beats in both."""

import math
from collections.abc import Sequence
from pathlib import Path
from typing import Any, NamedTuple

# Okabe and Ito's colours, which the colour-blind can tell apart.
COLOURS = ('#0072B2', '#D55E00', '#009E73', '#CC79A7', '#E69F00', '#56B4E9', '#000000')
MARKERS = 'osD^vP*'
FAMILIES = (
    'exact',
    'float64',
    'float32',
    'brute force',
    'simpler shapes',
    'stale',
    'extrapolated',
)
LETTERS = 'ABCDEFGHIJKLMNOPQRSTUVWXYZ'
# Where a letter may stand round its point: points of length, and angle; above first.
LEADER = {'arrowstyle': '-', 'color': '0.5', 'lw': 0.6, 'shrinkA': 4, 'shrinkB': 4}
AROUND = [(away, turn * math.pi / 8) for away in (11, 15, 20, 26, 33) for turn in range(1, 16, 2)]


class Panel(NamedTuple):
    """One kind of error."""

    label: str
    floor: float
    """Where zero, and what is below this, is drawn on the logarithmic axis."""
    top: float
    """Upper end of the axis, if nothing is above."""


class Point(NamedTuple):
    """One way of answering."""

    name: str
    time: float
    """Microseconds a ray."""
    errors: Sequence[float]
    """One a panel."""
    family: str
    """One of `FAMILIES`: its colour and marker."""
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
    """Write a PNG with a panel for each kind of error, and a key of the letters at the points."""
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.figure import Figure

    figure = Figure(figsize=(3.5 * len(panels) + 2.6, 3.6), layout='constrained')
    FigureCanvasAgg(figure)
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    ranked = sorted(points, key=lambda point: point.time)
    chosen: set[int] = set()
    for k, (axes, panel) in enumerate(zip(every, panels, strict=True)):
        chosen.update(_panel(axes, ranked, [point.errors[k] for point in ranked], panel))
    _key(figure, ranked, chosen)
    figure.suptitle(title, x=0.01, ha='left', fontsize=10)
    figure.draw_without_rendering()
    for k, (axes, panel) in enumerate(zip(every, panels, strict=True)):
        _place_letters(axes, ranked, [max(point.errors[k], panel.floor) for point in ranked])
    figure.savefig(path, dpi=220)


def _look(point: Point) -> dict[str, Any]:
    """Colour and marker of a point: those of its family."""
    kind = FAMILIES.index(point.family)
    return {'color': COLOURS[kind], 'marker': MARKERS[kind], 'ms': 7, 'linestyle': 'none'}


def _panel(
    axes: Any, points: Sequence[Point], errors: Sequence[float], panel: Panel
) -> Sequence[int]:
    """Points and front; returns which are on the front."""
    shown = [max(error, panel.floor) for error in errors]
    judged = [i for i, point in enumerate(points) if point.judged]
    best = [judged[i] for i in front([(points[i].time, shown[i]) for i in judged])]
    for i, (point, y) in enumerate(zip(points, shown, strict=True)):
        look = _look(point)
        face = look['color'] if i in best else 'white'
        axes.plot(point.time, y, markerfacecolor=face, zorder=3, **look)
    axes.set(xscale='log', yscale='log', xlabel='run time a ray, µs', ylabel=panel.label)
    axes.set_xlim(points[0].time / 3, points[-1].time * 3)
    axes.set_ylim(panel.floor / 5, max(panel.top, max(shown) * 3))
    _front_line(axes, [(points[i].time, shown[i]) for i in best])
    axes.axhline(panel.floor, color='0.4', linewidth=0.9, linestyle=(0, (2, 3)), zorder=0)
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.spines[['top', 'right']].set_visible(False)
    _ticks(axes, panel.floor, any(0 < error < panel.floor for error in errors))
    return best


def _front_line(axes: Any, steps: list[tuple[float, float]]) -> None:
    right, top = axes.get_xlim()[1], axes.get_ylim()[1]
    corners = [(steps[0][0], top), *steps, (right, steps[-1][1])]
    axes.plot(
        *zip(*corners, strict=True), drawstyle='steps-post', color='0.4', linewidth=1.2, zorder=1
    )


def _ticks(axes: Any, floor: float, below: bool) -> None:
    """At most eight decades a vertical axis, and its floor: zero, or what is `below` it too."""
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    first, last = math.ceil(math.log10(floor * 5)), math.floor(math.log10(axes.get_ylim()[1]))
    every = max(1, math.ceil((last - first) / 8))
    axes.set_yticks([floor, *(10.0**k for k in range(last, first - 1, -every))])
    axes.minorticks_off()
    lowest = f'< {_power(floor)}' if below else '0'
    axes.yaxis.set_major_formatter(FuncFormatter(lambda v, _: lowest if v == floor else _power(v)))
    left, right = axes.get_xlim()
    short = right < 100 * left
    axes.xaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0) if short else (1.0,), numticks=5))
    axes.xaxis.set_major_formatter(FuncFormatter(lambda v, _: f'{v:,.10g}'))
    axes.xaxis.set_minor_formatter(NullFormatter())


def _power(value: float) -> str:
    exponent = round(math.log10(value))
    return f'{value:g}' if -4 < exponent < 4 else f'$10^{{{exponent}}}$'


def _key(figure: Any, points: Sequence[Point], chosen: set[int]) -> None:
    """What the letters mean; bold is on a front."""
    from matplotlib.lines import Line2D

    entries = []
    for i, point in enumerate(points):
        look = _look(point)
        face = look['color'] if i in chosen else 'white'
        entries.append(Line2D([], [], label=f'{LETTERS[i]}  {point.name}', mfc=face, **look))
    line = Line2D([], [], color='0.4', linewidth=1.2, label='Pareto front (filled points)')
    floor = Line2D(
        [],
        [],
        color='0.4',
        linewidth=0.9,
        linestyle=(0, (2, 3)),
        label='no error, or below the scale',
    )
    legend = figure.legend(
        handles=[*entries, line, floor], loc='outside right center', frameon=False, fontsize=8
    )
    for i, text in enumerate(legend.get_texts()[: len(points)]):
        text.set_fontweight('bold' if i in chosen else 'normal')


def _place_letters(axes: Any, points: Sequence[Point], shown: Sequence[float]) -> None:
    """Write each letter beside its point, where no other point or letter is."""
    places = [(point.time, y) for point, y in zip(points, shown, strict=True)]
    inches = 72 / axes.figure.dpi
    spots = [(x * inches, y * inches) for x, y in axes.transData.transform(places)]
    taken = list(spots)
    for i, (x, y) in enumerate(spots):
        spot = max(
            ((x + away * math.cos(turn), y + away * math.sin(turn)) for away, turn in AROUND),
            key=lambda s: (
                min(12.0, min(math.dist(s, t) for t in taken)) - 0.3 * math.dist(s, (x, y))
            ),
        )
        taken.append(spot)
        axes.annotate(
            LETTERS[i],
            places[i],
            xytext=(spot[0] - x, spot[1] - y),
            textcoords='offset points',
            fontsize=8.5,
            fontweight='bold',
            ha='center',
            va='center',
            zorder=4,
            arrowprops=LEADER if math.dist(spot, (x, y)) > 14 else None,
        )
