# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ways of answering, measured by error and run time, in a table and a picture."""

from collections.abc import Callable, Mapping, Sequence
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ... import DynamicBVH, RayHits
from ..page import Page, Table
from ..scenes import Boxes, Rays
from ..timing import Job, Timing, interleaved
from . import plain
from .truth import HEADER, NOTHING, Answer, Score, Truth, brute_force, cells, score

# ---- Error against run time: a point a way, and the front of those that nothing beats in both.


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


# ---- Ways of answering: what each does, and a run of all of them that measures error and time.


Way = Callable[[], Answer]  # one way to answer the rays of a scene


WRONG = Panel('wrong answers, share of the rays', lambda s: s.wrong, 0.0, 1.0)
RELATIVE = Panel(
    'largest relative error of the distance\n(where the object is right)',
    lambda s: s.relative,
    1e-18,
    1e-2,
)
MEAN = Panel('mean error of the distance, m', lambda s: s.mean, 1e-6, 10.0)
REPEATS = 9
SLOW_RAYS = 200  # the first ones, for a way that takes milliseconds each


def tree_answer(tree: DynamicBVH, rays: Rays) -> Answer:
    """First hits in one batch."""
    return as_answer(tree, tree.raycast_many(*rays))


def as_answer(tree: DynamicBVH, hits: RayHits) -> Answer:
    """Rows of a tree that was built at once: its handles are in their order."""
    return Answer(np.where(hits.ids >= 0, np.searchsorted(tree.ids(), hits.ids), NOTHING), hits.t)


def rounded_answer(tree: DynamicBVH, rays: Rays) -> Answer:
    """The same by the same kernels without the exact decision."""
    with plain.rounded_decisions():
        return tree_answer(tree, rays)


def one_by_one(tree: DynamicBVH, rays: Rays) -> Answer:
    """First hits by a call each."""
    hits = [tree.raycast(*ray) for ray in zip(*rays, strict=True)]
    return Answer(
        np.array([tree.slot(hit.id) if hit else NOTHING for hit in hits]),
        np.array([hit.t if hit else np.inf for hit in hits]),
    )


def box_ways(boxes: Boxes, rays: Rays) -> dict[str, Way]:
    """Ways to cast rays at axis-aligned boxes."""
    tree = DynamicBVH.from_boxes(*boxes)
    few = Rays(rays.origins[:SLOW_RAYS], rays.directions[:SLOW_RAYS])

    binary = plain.BinaryTree.from_boxes(*boxes)
    single = plain.single_precision(boxes, rays)
    return {
        'bvh_ros, batch': lambda: tree_answer(tree, rays),
        'bvh_ros, one call a ray': lambda: one_by_one(tree, rays),
        'bvh_ros, binary tree': lambda: tree_answer(binary, rays),
        'batch, plain float64 leaves': lambda: rounded_answer(tree, rays),
        'binary tree, plain float64 leaves': lambda: rounded_answer(binary, rays),
        'binary tree, float32': lambda: as_answer(tree, single()),
        f'brute force, float64 ({len(few.origins)} rays)': lambda: Answer(
            *brute_force(boxes, few)
        ),
    }


def compare(
    ways: Mapping[str, Way],
    truth: Truth,
    brief: bool,
    timed: Mapping[str, Callable[[], Any]] | None = None,
) -> tuple[dict[str, Score], dict[str, Timing]]:
    """Score every way against the truth, and let them take turns.

    `timed`: what is timed, where getting the answers together is not part of it.
    """
    scores = {}
    for name, way in ways.items():
        answer = way()
        scores[name] = score(answer, truth._replace(rows=truth.rows[: len(answer.rows)]))
    jobs = {
        name: Job(timed[name] if timed else way, scores[name].rays) for name, way in ways.items()
    }
    return scores, interleaved(jobs, 2 if brief else REPEATS, warm=not brief)


def show(
    page: Page,
    name: str,
    title: str,
    ways: Mapping[str, Way],
    found: tuple[dict[str, Score], dict[str, Timing]],
    shown: Sequence[Panel] = (WRONG, RELATIVE),
) -> None:
    """Table and picture of one scene."""
    scores, times = found
    rows = [
        [way, times[way].nanoseconds / 1e3, scores[way].rays, *cells(scores[way])] for way in ways
    ]
    page.table(Table(f'error_{name}', ['way', 'us a ray', 'rays', *HEADER], rows))
    asked = max(result.rays for result in scores.values())
    points = [
        Point(
            way,
            times[way].nanoseconds / 1e3,
            [kind.error(scores[way]) for kind in shown],
            scores[way].rays == asked,
        )
        for way in ways
    ]
    path = page.plot(f'error_{name}', f'Error against run time: {title}')
    panels = [kind._replace(floor=kind.floor or 0.1 / asked) for kind in shown]
    tradeoff(path, points, panels, title)
