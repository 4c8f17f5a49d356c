# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Velocities of obstacles, estimated from successive reports of their positions.

Of each obstacle two sums are kept, the way and the time between its updates, in which older ones
count ever less; one divided by the other is its velocity (a ratio of exponentially weighted means,
Brown 1963). Where stamps jitter, what one step is too short the next one is too long, so that most
of it cancels.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from ..tree.access import checks
from .shapes.shape import Floats
from .updates import Sighting

Ids = NDArray[np.int64]
JITTER = 0.02  # s that a stamp may be wrong by: no jump is seen in what that explains
LATE = 1.0  # s that an older update may come too late; what is older still begins anew


class State(NamedTuple):
    """What is known of the slots that were ever seen, a row each."""

    owners: Ids
    """Node handles plus 1, or 0: another obstacle may have a slot now than before."""
    stamps: Ids
    places: Floats
    steps: Floats
    """Sums of ways, m, (n, 3); of times, s, (n,)."""
    times: Floats


class Tracks:
    """Velocities from successive updates, for `Scene.update` and `replace` as `velocities`.

    An obstacle that is new, or has jumped, is at rest until its next update.
    An update with the stamp of the one before changes no velocity, unless it is a jump, nor does
    one that comes up to 1 s too late; one that is older begins anew, as after a clock that was set
    back. A jump is farther than `max_speed` allows in the time between, and 0.02 s more, as stamps
    jitter, or makes the estimated velocity larger than that.

    Parameters
    ----------
    smoothing : float
        A step counts 1/e after so many seconds; 0: only the last one counts.
    max_speed : float
        m/s; faster ones are jumps.
    """

    def __init__(self, smoothing: float = 0.3, max_speed: float = 50.0) -> None:
        self._smoothing = checks.limit('smoothing', smoothing)
        self.max_speed = checks.limit('max_speed', max_speed)
        self._state, self._known = _room_for(0), 0
        self._rows = np.zeros(0, np.int32)
        """By slot: its row in the state, plus 1; 0 if it was never seen. The scene may have far
        more slots than one source.
        """

    def __call__(self, slots: Ids, handles: Ids, before: Sighting, now: Sighting) -> Floats:
        """Return velocities, (n, 3) m/s, of n known obstacles, each once: their
        slots, node handles, reported positions before and now.
        """
        rows = self._rows_of(slots)
        columns: Any = (column[rows] for column in self._state)
        known = State(*columns)
        owners = handles.astype(np.int64) + 1
        new = known.owners != owners
        known.owners[:] = owners
        known.stamps[new], known.places[new] = before.stamps[new], before.places[new]
        known.steps[new], known.times[new] = 0.0, 0.0
        with np.errstate(all='ignore'):  # what overflows is a jump
            velocities = self._note(known, now)
        for state, column in zip(self._state, known, strict=True):
            state[rows] = column
        return velocities

    def _rows_of(self, slots: Ids) -> Ids:
        """Rows of slots, new ones where they have none."""
        most = int(slots.max(initial=-1)) + 1
        if most > len(self._rows):
            rows = np.zeros(max(most, 2 * len(self._rows)), np.int32)
            rows[: len(self._rows)] = self._rows
            self._rows = rows
        fresh = slots[self._rows[slots] == 0]
        self._rows[fresh] = np.arange(self._known + 1, self._known + 1 + len(fresh))
        self._known += len(fresh)
        self._grow(self._known)
        return self._rows[slots].astype(np.int64) - 1

    def _note(self, known: State, now: Sighting) -> Floats:
        """Update what is known; return velocities."""
        elapsed = (now.stamps.astype(np.float64) - known.stamps) * 1e-9
        near = np.abs(elapsed) < 1e6  # s: so far the difference is exact
        elapsed[near] = (now.stamps[near] - known.stamps[near]) * 1e-9
        step = now.places - known.places
        late = (elapsed < 0.0) & (elapsed >= -LATE)
        faded = np.exp(-elapsed / self._smoothing) if self._smoothing else 0.0 * elapsed
        on = elapsed > 0.0
        known.steps[on] = (known.steps * faded[:, None] + step)[on]
        known.times[on] = (known.times * faded + elapsed)[on]
        velocities = known.steps / np.where(known.times > 0.0, known.times, 1.0)[:, None]
        reach = self.max_speed * (elapsed + JITTER)
        jumps = ~(np.linalg.norm(step, axis=1) <= reach)
        jumps |= ~(np.linalg.norm(velocities, axis=1) <= self.max_speed)
        jumps &= ~late
        known.steps[jumps], known.times[jumps], velocities[jumps] = 0.0, 0.0, 0.0
        known.stamps[~late], known.places[~late] = now.stamps[~late], now.places[~late]
        return velocities

    def _grow(self, count: int) -> None:
        old = self._state
        if count <= len(old.owners):
            return
        self._state = _room_for(max(count, 2 * len(old.owners)))
        for new, column in zip(self._state, old, strict=True):
            new[: len(column)] = column


def _room_for(count: int) -> State:
    ids = np.zeros(count, np.int64), np.zeros(count, np.int64)
    return State(*ids, np.zeros((count, 3)), np.zeros((count, 3)), np.zeros(count))
