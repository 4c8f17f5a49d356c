# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A stale world: recorded traffic that is known at a rate only, while rays are cast all the time.

The true world at any time lies on straight lines between the recorded frames (10 Hz). The known
world is the one of the last refresh, as it is or as the scene predicts it.
"""

from pathlib import Path
from typing import Any, NamedTuple

import numpy as np

from ...scene import NO_NODE, Numbered, Scene, Shapes
from ...scene.tracking import Tracks
from ..page import Page
from ..scenes import Floats, Rays
from .methods import MEAN, RATES, WRONG, Method, compare
from .truth import NOTHING, Answer, Rows, Truth, shapes_truth
from .worlds import columns, table

MOMENTS_PER_SECOND, RAYS_PER_MOMENT = 25, 40
HEIGHT = 0.75  # m, of rays: half that of the vehicles
PREFIX = 'vehicle'


class Track(NamedTuple):
    """One vehicle, k frames in order of time."""

    times: Floats  # (k,) s
    poses: Floats  # (k, 7): position, m, and quaternion, neighbours on one side of the sphere
    size: Floats  # (3,) m


Traffic = dict[int, Track]  # by the number of the vehicle


class Vehicles(NamedTuple):
    """Those of one moment."""

    ids: Rows
    shapes: Shapes


class Moment(NamedTuple):
    """When rays are cast, and which."""

    time: float
    rays: Rays


def tracks(path: Path) -> Traffic:
    """The vehicles of a recording."""
    every, found = table(path), {}
    for number in np.unique(every['id']).tolist():
        rows = every[every['id'] == number]
        poses = columns(rows, 'cx cy cz qx qy qz qw')
        turns = poses[:, 3:]
        for i in range(1, len(turns)):
            turns[i] *= np.copysign(1.0, turns[i] @ turns[i - 1])
        found[number] = Track(rows['t_s'], poses, columns(rows, 'sx sy sz')[0])
    return found


def world_at(traffic: Traffic, time: float) -> Vehicles:
    """Vehicles on straight lines between their frames."""
    there = {n: t for n, t in traffic.items() if t.times[0] <= time <= t.times[-1]}
    poses = np.array(
        [[np.interp(time, t.times, column) for column in t.poses.T] for t in there.values()]
    )
    sizes = np.array([track.size for track in there.values()])
    return Vehicles(np.array([*there]), Shapes.boxes(poses[:, :3], sizes, poses[:, 3:]))


def moments_of(traffic: Traffic, seconds: float, rng: np.random.Generator) -> list[Moment]:
    """Moments at random from the second second on; rays from free places near the vehicles."""
    places = np.concatenate([track.poses[:, :3] for track in traffic.values()])
    found = []
    for time in np.sort(rng.uniform(2.0, 2.0 + seconds, round(seconds * MOMENTS_PER_SECOND))):
        origins = places[rng.integers(0, len(places), RAYS_PER_MOMENT)]
        origins = origins + rng.normal(0.0, 2.0, origins.shape)
        angles = rng.uniform(0, 2 * np.pi, len(origins))
        origins[:, 2] = HEIGHT
        directions = np.stack([np.cos(angles), np.sin(angles), np.zeros(len(angles))], axis=1)
        found.append(Moment(float(time), Rays(origins, directions)))
    return found


def observer(
    traffic: Traffic, moments: list[Moment], rate: float | None, predicted: bool = False
) -> Method:
    """Cast every moment's rays in the world as it was last known.

    Parameters
    ----------
    traffic
        Vehicles by number.
    moments
        In order of time.
    rate : float or None
        Refreshes a second; None: at every moment.
    predicted : bool
        Cast `at` the moment: the scene follows the vehicles from refresh to refresh.
    """
    times = [moment.time for moment in moments]
    if rate is not None:  # one more before the first moment, to see how fast they are
        times = [k / rate for k in range(int(times[0] * rate) - 1, int(times[-1] * rate) + 1)]
    refreshes = [(time, world_at(traffic, time)) for time in times]
    numbers = dict[int, int]()  # of vehicles, by handle

    def run() -> list[Any]:
        scene, found, waiting = Scene(), [], refreshes[::-1]
        numbers.clear()
        known: set[int] = set()
        velocities = Tracks(smoothing=0.0) if predicted else None
        for moment in moments:
            while waiting and waiting[-1][0] <= moment.time:
                time, world = waiting.pop()
                names, stamp = Numbered(PREFIX, world.ids), _nanoseconds(time)
                scene.replace('radar', '', names, world.shapes, stamp=stamp, velocities=velocities)
                if not known.issuperset(ids := set(world.ids.tolist())):
                    known |= ids
                    for handle, name in scene.names():
                        numbers[handle] = int(name[len(PREFIX) :])
            at = _nanoseconds(moment.time) if predicted else None
            found.append(scene.raycast_many(*moment.rays, at=at))
        return found

    def answers(found: list[Any]) -> list[Answer]:
        """Rows in the true world of each moment; a vehicle that is not in it comes after all."""
        several = []
        for moment, hits in zip(moments, found, strict=True):
            ids = world_at(traffic, moment.time).ids.tolist()
            row_of = {number: row for row, number in enumerate(ids)}
            row_of[NOTHING] = NOTHING
            vehicles = [NOTHING if h == NO_NODE else numbers[h] for h in hits.handles.tolist()]
            rows = np.array([row_of.get(number, len(ids)) for number in vehicles])
            several.append(Answer(rows, hits.t))
        return several

    return Method(run, answers)


def _nanoseconds(seconds: float) -> int:
    return round(seconds * 1e9)


def traffic_truths(traffic: Traffic, moments: list[Moment]) -> list[Truth]:
    """What the rays of each moment hit."""
    return [shapes_truth(world_at(traffic, time).shapes, rays) for time, rays in moments]


def stale_traffic(page: Page, brief: bool) -> None:
    """22 recorded vehicles, 198 moments of 40 level rays from places on the road in all
    directions. Time is that of the refreshes and of the rays, over the rays. *Predicted*: rays are
    cast `at` the moment, and every vehicle goes on as between the last two refreshes. Between two
    frames (10 Hz) the true vehicles go straight: above 10 Hz the recording flatters prediction.
    """
    path = page.data / 'commonroad_ngsim' / 'USA_US101-4_1_T-1.csv'
    if page.misses([path]):
        return
    traffic = tracks(path)
    moments = moments_of(traffic, 0.4 if brief else 7.9, np.random.default_rng(6))
    methods = {'true world at every query': observer(traffic, moments, None)}
    for predicted, more in ((False, ''), (True, ', predicted')):
        for rate in RATES:
            methods[f'{rate} Hz{more}'] = observer(traffic, moments, rate, predicted)
    title = f'US-101, stale world: {len(moments) * RAYS_PER_MOMENT:,} rays'
    truths = traffic_truths(traffic, moments)
    compare(page, 'traffic', title, methods, truths, brief, (WRONG, MEAN))
