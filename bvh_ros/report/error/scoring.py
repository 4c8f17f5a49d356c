# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What is wrong with answers: counted against the truth, and measured in metres and in ulp."""

import math
from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ..scenes import Floats
from ..tables import Cell
from .truth import NOTHING, Rows, Truth


class Answer(NamedTuple):
    """First objects on n rays."""

    rows: Rows
    """(n,) NOTHING where nothing is met."""
    ts: Floats
    """(n,) computed distances."""


class Score(NamedTuple):
    """What is wrong with an answer."""

    rays: int
    wrong_hits: int
    """Something is met where there is nothing."""
    wrong_misses: int
    """Nothing is met where there is something."""
    wrong_first: int
    """An object is met first that is not: farther, or not met at all."""
    wrong_by: float
    """How much farther at most, m; inf if it is not met at all."""
    distances: Floats
    """|t - exact t| in metres, of all rays that meet something and should."""
    relative: float
    """Largest relative error of t where the first object is right."""
    ulps: float
    """The same in units in the last place of the exact t."""

    @property
    def wrong(self) -> float:
        """Share of the rays with a wrong answer."""
        return (self.wrong_hits + self.wrong_misses + self.wrong_first) / self.rays

    @property
    def mean(self) -> float:
        """Mean error of the distance."""
        return float(self.distances.mean()) if len(self.distances) else 0.0


HEADER = (
    'wrong hits', 'wrong misses', 'wrong first', 'by at most, m', 'wrong, % of rays',
    'distance: mean error, m', '95 %, m', 'largest, m', 'right object: largest, relative',
    'largest, ulp',
)  # fmt: skip


def cells(score: Score) -> list[Cell]:
    """The score as cells under `HEADER`."""
    far = float(np.percentile(score.distances, 95)) if len(score.distances) else 0.0
    largest = float(score.distances.max(initial=0.0))
    counts: list[Cell] = [score.wrong_hits, score.wrong_misses, score.wrong_first]
    counts.append(score.wrong_by if score.wrong_first else None)
    return [*counts, 100 * score.wrong, score.mean, far, largest, score.relative, score.ulps]


def score(answer: Answer, truth: Truth) -> Score:
    """Compare. Of objects entered at exactly the same distance any may be called the first."""
    hits = misses = firsts = 0
    distances: list[float] = []
    relative = ulps = by = 0.0
    pairs = zip(answer.rows.tolist(), answer.ts.tolist(), truth.rows.tolist(), strict=True)
    for ray, (row, t, true_row) in enumerate(pairs):
        exact = truth.ts[ray]
        if exact is None or row == NOTHING:
            hits += exact is None and row != NOTHING
            misses += exact is not None and row == NOTHING
            continue
        error = abs(Fraction(t) - exact)
        distances.append(float(error) * float(truth.lengths[ray]))
        entry = exact if row == true_row else truth.entry(row, ray)
        if entry != exact:
            firsts += 1
            by = max(by, _farther(entry, exact) * float(truth.lengths[ray]))
        elif error and not exact:
            relative = ulps = math.inf
        elif error:
            relative = max(relative, float(error / exact))
            ulps = max(ulps, float(error / Fraction(math.ulp(float(exact)))))
    count = len(answer.rows)
    return Score(count, hits, misses, firsts, by, np.array(distances), relative, ulps)


def _farther(entry: Fraction | None, first: Fraction) -> float:
    return math.inf if entry is None else float(entry - first)
