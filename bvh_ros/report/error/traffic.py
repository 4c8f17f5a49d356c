# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stale world: recorded traffic that is known at a rate only, while rays are asked all the time.

The true world at any time lies on straight lines between the recorded frames (10 Hz). The known
world is the one of the last refresh, as it is or as the scene predicts it.
"""

from fractions import Fraction
from typing import NamedTuple

import numpy as np

from ...scene import NO_NODE, Numbered, Scene, Shapes
from ...scene.tracking import Tracks
from ..page import Page
from ..scenes import Rays
from .truth import NOTHING, Answer, Rows, Truth, shapes_truth
from .ways import MEAN, WRONG, Way, compare, show
from .worlds import Track, joined_truth, tracks

RATES = (1, 2, 5, 10, 20)  # Hz
MOMENTS_PER_SECOND, RAYS_PER_MOMENT = 25, 40
HEIGHT = 0.75  # m, of rays: half that of the vehicles
PREFIX = 'vehicle'


class Vehicles(NamedTuple):
    """Those of one moment."""

    ids: Rows
    shapes: Shapes


class Moment(NamedTuple):
    """When rays are asked, and which."""

    time: float
    rays: Rays


def world_at(traffic: dict[int, Track], time: float) -> Vehicles:
    """Vehicles on straight lines between their frames."""
    ids, sizes = [], []
    places: list[list[float]] = []
    turns: list[list[float]] = []
    for number, track in traffic.items():
        if not track.times[0] <= time <= track.times[-1]:
            continue
        ids.append(number)
        sizes.append(track.size)
        for values, into in ((track.positions, places), (track.turns, turns)):
            into.append([np.interp(time, track.times, column) for column in values.T])
    shapes = Shapes.boxes(np.array(places), np.array(sizes), np.array(turns))
    return Vehicles(np.array(ids), shapes)


class Observer:
    """Answers every moment's rays from the world as it was last known.

    Parameters
    ----------
    traffic
        Vehicles by number.
    moments
        In order of time.
    rate : float or None
        Refreshes a second; None: at every moment.
    predicted : bool
        Ask the scene where they are at the moment: it follows them from refresh to refresh.
    """

    def __init__(
        self,
        traffic: dict[int, Track],
        moments: list[Moment],
        rate: float | None,
        predicted: bool = False,
    ) -> None:
        self._moments, self._predicted = moments, predicted
        times = [moment.time for moment in moments]
        if rate is not None:  # one more before the first moment, to see how fast they are
            times = [k / rate for k in range(int(times[0] * rate) - 1, int(times[-1] * rate) + 1)]
        self._known = [(time, world_at(traffic, time)) for time in times]

    def __call__(self) -> list[Answer]:
        """Go through all moments with a new scene: handles and distances."""
        scene, answers, known = Scene(), [], self._known[::-1]
        self.names: dict[int, int] = {}
        present: set[int] = set()
        tracks = Tracks(smoothing=0.0) if self._predicted else None
        for moment in self._moments:
            while known and known[-1][0] <= moment.time:
                time, world = known.pop()
                names, stamp = Numbered(PREFIX, world.ids), round(time * 1e9)
                scene.replace('radar', '', names, world.shapes, stamp=stamp, velocities=tracks)
                if not present.issuperset(ids := set(world.ids.tolist())):
                    present |= ids
                    for handle, name in scene.names():
                        self.names[handle] = int(name[len(PREFIX) :])
            at = round(moment.time * 1e9) if self._predicted else None
            handles, ts, _, _ = scene.raycast_many(*moment.rays, at=at)
            answers.append(Answer(handles.astype(np.int64), ts))
        return answers

    def answer(self) -> Answer:
        """The same as one answer whose rows are the vehicles' numbers."""
        answers = self()
        self.names[NO_NODE] = NOTHING
        handles = np.concatenate([answer.rows for answer in answers]).tolist()
        rows = np.array([self.names[handle] for handle in handles])
        return Answer(rows, np.concatenate([answer.ts for answer in answers]))


def moments_of(
    traffic: dict[int, Track], seconds: float, rng: np.random.Generator
) -> list[Moment]:
    """Moments at random from the second second on; rays from free places beside the vehicles."""
    places = np.concatenate([track.positions for track in traffic.values()])
    found = []
    for time in np.sort(rng.uniform(2.0, 2.0 + seconds, round(seconds * MOMENTS_PER_SECOND))):
        origins = places[rng.integers(0, len(places), RAYS_PER_MOMENT)]
        origins = origins + rng.normal(0.0, 2.0, origins.shape)
        angles = rng.uniform(0, 2 * np.pi, len(origins))
        origins[:, 2] = HEIGHT
        ways = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1)
        found.append(Moment(float(time), Rays(origins, ways)))
    return found


def traffic_truth(traffic: dict[int, Track], moments: list[Moment]) -> Truth:
    """What the rays of all moments meet; rows are the vehicles' numbers."""
    worlds = [world_at(traffic, moment.time) for moment in moments]
    truths = [shapes_truth(w.shapes, m.rays) for w, m in zip(worlds, moments, strict=True)]
    counts = [len(world.ids) for world in worlds]
    joined = joined_truth(truths, counts)
    numbers = np.concatenate([world.ids for world in worlds])
    first = np.repeat(np.cumsum([0, *counts[:-1]]), RAYS_PER_MOMENT)
    rows = np.where(joined.rows == NOTHING, NOTHING, numbers[joined.rows])

    def entry(number: int, ray: int) -> Fraction | None:
        here = worlds[ray // RAYS_PER_MOMENT].ids
        place = np.flatnonzero(here == number)
        return joined.entry(int(first[ray] + place[0]), ray) if len(place) else None

    return joined._replace(rows=rows, entry=entry)


def stale_traffic(page: Page, brief: bool) -> None:
    """US-101 at several refresh rates."""
    page.add('### Traffic on US-101: a stale world')
    path = page.data / 'commonroad_ngsim' / 'USA_US101-4_1_T-1.csv'
    if page.misses([path]):
        return
    traffic = tracks(path)
    seconds = 0.4 if brief else 7.9
    moments = moments_of(traffic, seconds, np.random.default_rng(6))
    page.add(
        f'{len(traffic)} recorded vehicles, {len(moments)} moments of {RAYS_PER_MOMENT} level '
        'rays from places on the road in all directions. Time is that of the refreshes and of '
        'the rays, over the rays. *Predicted*: rays are asked `at` the moment, and every vehicle '
        'goes on as between the last two refreshes. Between two frames (10 Hz) the true '
        'vehicles go straight: above 10 Hz the recording flatters prediction.'
    )
    watchers = {'true world at every query': Observer(traffic, moments, None)}
    for rate in RATES:
        watchers[f'{rate} Hz'] = Observer(traffic, moments, rate)
    for rate in RATES:
        watchers[f'{rate} Hz, predicted'] = Observer(traffic, moments, rate, True)
    ways: dict[str, Way] = {name: watcher.answer for name, watcher in watchers.items()}
    found = compare(ways, traffic_truth(traffic, moments), brief, dict(watchers))
    title = f'US-101, stale world: {len(moments) * RAYS_PER_MOMENT:,} rays'
    show(page, 'traffic', title, ways, found, (WRONG, MEAN))
