# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ways to answer rays at boxes, and their error against run time: this tree, the same with rounded
decisions or in float32, and brute force."""

from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from functools import cache, partial
from string import ascii_lowercase, ascii_uppercase
from typing import Any, NamedTuple
from unittest.mock import patch

import numpy as np

from ... import DynamicBVH, RayHits
from ...tree.access import OpenTree
from ...tree.batch import streams
from ...tree.compiler.compiling import inlined, rewired
from ...tree.nodes import View
from ...tree.query import ray, ray_queries, slab
from ..page import BLACK, BLUE, GREY, ORANGE, PINK, PURPLE, RED, Page
from ..scenes import Boxes, Rays
from ..timing import Job, interleaved
from .truth import HEADER, NOTHING, Answer, Score, Truth, brute_force, cells, score

# ---- The tree's own kernels with the exact decision taken out, and with float32 for float64


@inlined
def _plain_slabs(lo, hi, ray, t_max):
    """(hit, t, axis) by rounded arithmetic."""
    entry, leave, entered = slab.rounded_slabs(lo, hi, ray, t_max)
    return entry <= leave, entry, entered


@inlined
def _plain_precedes(path, hit, other):
    handles = path.tree.handles
    return hit.t < other.t or (hit.t == other.t and handles[hit.slot] < handles[other.slot])


@inlined
def _plain_verdict(lo, hi, ray, best_t):
    hit, t, axis = _plain_slabs(lo, hi, ray, best_t)
    return streams.MEETS if hit else streams.MISSES, t, axis


@inlined
def _plain_axis(lo, hi, ray, t_max, t, entered):
    return entered


@cache
def binary_kernel() -> Any:
    """`ray.raycast_rows` without the exact decision."""
    decide = rewired(ray.decide_box, intersect_exact=_plain_slabs)
    one = rewired(ray.raycast, decide_box=decide, precedes=_plain_precedes)
    return rewired(ray.raycast_rows, raycast_row=rewired(ray.raycast_row, raycast=one))


@cache
def wide_kernel() -> Any:
    """`streams.cast_rows` without the exact decision."""
    better = rewired(streams.is_better, quick_decision=_plain_verdict)
    pile = rewired(
        streams.cast_pile,
        visit_box=rewired(streams.visit_box, is_first=rewired(streams.is_first, is_better=better)),
        write_hit=rewired(streams.write_hit, exact_entry_axis=_plain_axis),
    )
    return rewired(streams.cast_rows, cast_pile=pile)


class BinaryTree(OpenTree):
    """A tree whose batches go through the binary tree, too: no wide snapshot."""

    def _snapshot_for(self, count: int, view: View) -> None:
        return None


def single_precision(tree: OpenTree) -> Callable[..., Any]:
    """The same of boxes and rays that are rounded to float32."""
    arrays, kernel = tree.view().tree, binary_kernel()
    rounded = arrays._replace(nodes=_rounded(arrays.nodes), tight=_rounded(arrays.tight))

    def rows(_: Any, version: int, batch: Any, hits: RayHits) -> Any:
        origins, directions, t_max = (part.astype(np.float32) for part in batch[:3])
        batch = batch._replace(origins=origins, directions=directions, t_max=t_max)
        return kernel(rounded, version, batch, hits)

    return rows


def _rounded(records: Any) -> Any:
    """Records with the planes of their boxes in float32."""
    fields = [
        (name, np.float32 if name in ('lo', 'hi') else kind.base, kind.shape)
        for name, (kind, _) in records.dtype.fields.items()
    ]
    with np.errstate(all='ignore'):  # free places hold anything
        return records.astype(fields)


# One colour and one letter a method in all pictures; methods of one kind share the colour.
COLOURS = {
    'bvh_ros, batch': BLUE,
    'bvh_ros, one call a ray': BLUE,
    'bvh_ros, binary tree': BLUE,
    'batch, plain float64 leaves': RED,
    'binary tree, plain float64 leaves': RED,
    'binary tree, float32': PINK,
    'brute force, float64': BLACK,
    'bvh_ros, true shapes': BLUE,
    'AABB of each shape': ORANGE,
    'sphere as its box': ORANGE,
    'cylinder as its box': ORANGE,
    'sweep between two poses': BLUE,
    'poses on the way': PURPLE,
    'float64 watertight': RED,
    'convex hull of the mesh': ORANGE,
    'Embree 4, float32': PINK,
}
LETTERS = dict(zip(COLOURS, ascii_uppercase + ascii_lowercase, strict=False))


class Method(NamedTuple):
    """One method of answering the rays of a world."""

    run: Callable[[], Any]  # what is timed
    answer: Callable[[Any], Answer]  # of what `run` returned


# ---- Rays among axis-aligned boxes


REPEATS = 9
SLOW_RAYS = 200  # the first ones, for a method that takes milliseconds each


def tree_rows(tree: DynamicBVH, ids: Any, ts: Any) -> Answer:
    """Rows of a tree that was built at once: its handles are in their order."""
    return Answer(np.where(ids >= 0, np.searchsorted(tree.ids(), ids), NOTHING), ts)


def batch(tree: DynamicBVH, rays: Rays, **kernels: Callable[..., Any]) -> Method:
    """First hits in one batch; through other kernels, if there are some, as one of many rays."""
    entries: dict[str, Any] = {'FEW_RAYS': 0} if kernels else {}
    for name, kernel in kernels.items():
        entries[name] = lambda ndim, kernel=kernel: kernel

    def run() -> RayHits:
        with patch.multiple(ray_queries, **entries) if entries else nullcontext():
            return tree.raycast_many(*rays)

    return Method(run, lambda hits: tree_rows(tree, hits.ids, hits.t))


def one_by_one(tree: DynamicBVH, rays: Rays) -> Method:
    """First hits by a call each."""

    def answer(hits: list[Any]) -> Answer:
        ids = np.array([hit.id if hit else NOTHING for hit in hits])
        return tree_rows(tree, ids, np.array([hit.t if hit else np.inf for hit in hits]))

    return Method(lambda: [tree.raycast(*ray) for ray in zip(*rays, strict=True)], answer)


def box_methods(boxes: Boxes, rays: Rays) -> dict[str, Method]:
    """Methods of casting rays at axis-aligned boxes."""
    tree, binary = DynamicBVH.from_boxes(*boxes), BinaryTree.from_boxes(*boxes)
    few = Rays(rays.origins[:SLOW_RAYS], rays.directions[:SLOW_RAYS])
    plain = {'rows_entry': binary_kernel(), 'cast_entry': wide_kernel()}
    return {
        'bvh_ros, batch': batch(tree, rays),
        'bvh_ros, one call a ray': one_by_one(tree, rays),
        'bvh_ros, binary tree': batch(binary, rays),
        'batch, plain float64 leaves': batch(tree, rays, **plain),
        'binary tree, plain float64 leaves': batch(binary, rays, **plain),
        'binary tree, float32': batch(binary, rays, rows_entry=single_precision(binary)),
        'brute force, float64': Method(lambda: brute_force(boxes, few), lambda answer: answer),
    }


# ---- The table of all methods


class Panel(NamedTuple):
    """One kind of error."""

    label: str
    error: Callable[[Score], float]
    least: float  # below this the axis is linear down to zero; 0: below one ray
    most: float  # upper end of the axis, if nothing is above


WRONG = Panel('wrong answers, share of the rays', lambda s: s.wrong, 0.0, 1.0)
RELATIVE = Panel(
    'largest relative error of the distance\n(where the object is right)',
    lambda s: s.relative,
    1e-17,
    1e-2,
)
MEAN = Panel('mean error of the distance, m', lambda s: s.mean, 1e-6, 10.0)


class World(NamedTuple):
    """Methods of answering the rays of one world, and what is right."""

    methods: Mapping[str, Method]
    truth: Truth


def compare(
    page: Page,
    name: str,
    title: str,
    worlds: Sequence[World],
    brief: bool,
    panels: Sequence[Panel] = (WRONG, RELATIVE),
) -> None:
    """Score every method in all worlds, let the methods take turns, show both."""
    scores, jobs = {}, {}
    for method in worlds[0].methods:
        each = [world.methods[method] for world in worlds]
        answers = [one.answer(run) for one, run in zip(each, _run_all(each), strict=True)]
        scores[method] = score(answers, [world.truth for world in worlds])
        jobs[method] = Job(partial(_run_all, each), scores[method].rays)
    times = interleaved(jobs, 2 if brief else REPEATS)
    points = [Point(method, times[method].microseconds, scores[method]) for method in scores]
    header = ['', 'method', 'us a ray', 'rays', *HEADER]
    rows = [[LETTERS[p.name], p.name, p.time, p.score.rays, *cells(p.score)] for p in points]
    page.table(f'error_{name}', header, rows)
    figure = tradeoff(points, panels, title)
    page.picture(f'error_{name}', f'Error against run time: {title}', figure)


def _run_all(methods: Sequence[Method]) -> list[Any]:
    return [method.run() for method in methods]


# ---- The picture: error against run time, and the front that no method beats in both


class Point(NamedTuple):
    """What a method reached."""

    name: str
    time: float  # microseconds a ray
    score: Score


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


def tradeoff(points: Sequence[Point], panels: Sequence[Panel], title: str) -> Any:
    """A figure with a panel for each kind of error, and a key; the front is filled."""
    from matplotlib.figure import Figure
    from matplotlib.lines import Line2D

    figure = Figure(figsize=(3.6 * len(panels) + 2.8, 3.8), layout='constrained')
    every = figure.subplots(1, len(panels), squeeze=False)[0]
    fronts = [_panel(*both, points) for both in zip(every, panels, strict=True)]
    key = []
    for point in points:
        colour, best = COLOURS[point.name], any(point.name in names for names in fronts)
        label, face = f'{LETTERS[point.name]}  {point.name}', colour if best else 'white'
        key.append(Line2D([], [], marker='o', ls='', ms=8, color=colour, mfc=face, label=label))
    key.append(Line2D([], [], color=GREY, lw=1.2, label='Pareto front (filled)'))
    figure.legend(handles=key, loc='outside right center', frameon=False, fontsize=8)
    figure.suptitle(title, x=0.01, ha='left', fontsize=10)
    figure.draw_without_rendering()  # now it is known where points lie in the picture
    for axes, panel, names in zip(every, panels, fronts, strict=True):
        most = axes.get_ylim()[1]  # where an infinite error is drawn
        shown = [(p.name, p.time, min(panel.error(p.score), most)) for p in points]
        _draw_letters(axes, shown, names)
    return figure


def _panel(axes: Any, panel: Panel, points: Sequence[Point]) -> list[str]:
    """Draw axes and the front; return the names of the methods on it.

    A method that answered fewer rays than others is not on it.
    """
    most = max(point.score.rays for point in points)
    judged = [point for point in points if point.score.rays == most]
    pairs = [(point.time, panel.error(point.score)) for point in judged]
    best = front(pairs)
    times, errors = [p.time for p in points], [panel.error(p.score) for p in points]
    least = panel.least or 1.0 / most
    top = max(panel.most, 3 * max(e for e in errors if np.isfinite(e)))
    axes.set(xlabel='run time a ray, µs', ylabel=panel.label)
    scale(axes, times, least, top)
    corners = [(pairs[best[0]][0], top), *(pairs[i] for i in best)]
    corners.append((axes.get_xlim()[1], corners[-1][1]))
    axes.plot(*zip(*corners, strict=True), drawstyle='steps-post', color=GREY, lw=1.2, zorder=1)
    return [judged[i].name for i in best]


def scale(axes: Any, times: Sequence[float], least: float, top: float) -> None:
    """Logarithmic axes of run times, and of errors up to `top`, with a true zero below `least`."""
    from matplotlib.ticker import LogLocator

    axes.set_xscale('log')
    axes.set_yscale('symlog', linthresh=least, linscale=0.5)
    axes.set(xlim=(min(times) / 3, max(times) * 3), ylim=(-0.6 * least, top))
    low, high = (int(np.floor(np.log10(x))) for x in (least, top))
    step = -(-(high - low + 1) // 6)
    axes.set_yticks([0.0, *(10.0**k for k in range(high, low, -step))])
    axes.xaxis.set_major_locator(LogLocator(subs=(1,) if max(times) > 30 * min(times) else (1, 3)))
    axes.grid(alpha=0.25, linewidth=0.6)
    axes.minorticks_off()
    axes.xaxis.set_major_formatter('{x:g}')
    axes.yaxis.set_major_formatter(_digits)
    axes.spines[['top', 'right']].set_visible(False)


def _digits(value: float, _place: int) -> str:
    exponent = round(np.log10(value)) if value else 0
    return f'{value:g}' if exponent >= -3 else f'$10^{{{exponent}}}$'


APART = 15.0  # points, between the middles of two letters


def _draw_letters(axes: Any, points: list[tuple[str, float, float]], filled: list[str]) -> None:
    """A letter at each point; one that would cover another is shifted, with a line."""
    pixel = 72.0 / axes.figure.dpi
    bottom = pixel * axes.bbox.y0
    drawn: list[tuple[float, float]] = []
    for name, time, error in sorted(points, key=lambda point: point[1]):
        colour, (x, y) = COLOURS[name], pixel * axes.transData.transform((time, error))
        shift = next(
            step
            for step in sorted(range(-200, 201), key=abs)
            if y + step > bottom and all(np.hypot(x - a, y + step - b) >= APART for a, b in drawn)
        )
        drawn.append((x, y + shift))
        style = (colour, 'white') if name in filled else ('white', colour)
        box = {'boxstyle': 'circle,pad=0.25', 'fc': style[0], 'ec': colour}
        axes.plot(time, error, '.', ms=3, color=colour, zorder=2)
        axes.annotate(
            LETTERS[name], (time, error), (0.0, shift), textcoords='offset points', ha='center',
            va='center', fontsize=7, weight='bold', color=style[1], bbox=box, zorder=3,
            arrowprops={'arrowstyle': '-', 'color': colour, 'lw': 0.8},
        )  # fmt: skip
