# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Ways of answering: what each does, and a run of all of them that measures error and time."""

from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np

from ... import DynamicBVH, RayHits
from ..page import Page
from ..scenes import Boxes, Rays
from ..tables import Table
from ..timing import Job, Timing, interleaved
from . import plain
from .picture import Panel, Point, tradeoff
from .scoring import HEADER, Answer, Score, cells, score
from .truth import NOTHING, Truth, brute_force

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
