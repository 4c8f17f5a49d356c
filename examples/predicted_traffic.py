# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How much prediction helps: will a robot be hit by traffic within 3 s?

The robot drives at 1.5 m/s from a place beside the road. The scene gets updates at 1 to 20 Hz. It
answers with all vehicles at rest at their last update, with the velocity between the last two
updates, and with the velocity that `predict: constant_velocity` tracks.

python examples/predicted_traffic.py [TRACKS.csv] [--plot FILE.png]

Without TRACKS some traffic is made. TRACKS is a recording, and has columns t_s, id, cx, cy, cz,
sx, sy, sz, qx, qy, qz, qw, in frames of 0.1 s. Between two frames the true vehicles move straight,
without turning.
"""

import itertools
import time

import numpy as np
from needs import command_line, end_with, require_picture

from bvh_ros import quaternions
from bvh_ros.scene import NO_NODE, Numbered, Scene, Shapes
from bvh_ros.scene.tracking import Tracks

RATES = 1, 2, 5, 10, 20  # Hz
MEMORY = 1.5  # s of updates before the last one, of which a track consists
SMOOTHING = 0.0, 0.3  # s: the last step alone, and what a node's source takes
SPEED, HORIZON, FRAME = 1.5, 3.0, 0.1  # m/s, s, s
ROBOTS, MOMENTS = 400, 60
NAMES = 'm off', 'missed', 'false alarms', 'us a robot'
METHODS = 'at rest', 'last step', 'tracked'
# Green and blue of Okabe and Ito, which the colour-blind can tell apart, and black.
STYLES = ('#009E73', 'o-'), ('#56B4E9', 's--'), ('#000000', '^:')

parser = command_line(__doc__)
parser.add_argument('tracks', nargs='?')
parser.add_argument('--plot', default='')
options = parser.parse_args()
require_picture(options.plot)
print(f'{ROBOTS} robots at {MOMENTS} moments: which are hit by traffic within {HORIZON:g} s?')


def made_traffic():
    """Forty seconds of cars on four lanes of 200 m, which brake, speed up and change lanes."""
    made = np.random.default_rng(1)
    names = ['t_s', 'id', 'cx', 'cy', 'cz', 'sx', 'sy', 'sz', 'qx', 'qy', 'qz', 'qw']
    rows, moments = [], np.round(np.arange(0.0, 40.0, FRAME), 6)
    for number in range(48):
        begin, rate = made.uniform(-10.0, 35.0), made.uniform(0.3, 0.8)
        speed = made.uniform(6.0, 14.0) + 3.0 * np.sin(rate * moments + made.uniform(0.0, 6.0))
        x = np.cumsum(speed) * FRAME
        x -= np.interp(begin, moments, x, left=x[0] + 10.0 * begin)
        changes = made.uniform(-3.7, 3.7) / (1.0 + np.exp(-(moments - begin - 6.0)))
        y = 3.7 * (number % 4) + changes
        on_the_road = (x >= 0.0) & (x <= 200.0)
        turns = quaternions(yaw=np.arctan2(np.gradient(y), np.gradient(x)))
        for k in np.flatnonzero(on_the_road):
            rows.append((moments[k], number, x[k], y[k], 0.8, 4.5, 1.9, 1.6, *turns[k]))
    return np.array(rows, [(name, np.int64 if name == 'id' else float) for name in names])


def recorded(file):
    """The table of a file."""
    try:
        found = np.genfromtxt(file, delimiter=',', names=True, dtype=None, encoding='utf-8')
    except OSError as error:
        end_with(f'{file} cannot be read ({error.strerror or error}): without it traffic is made')
    return found


table = recorded(options.tracks) if options.tracks else made_traffic()
numbers, last = np.unique(table['id']), float(table['t_s'].max())
rng = np.random.default_rng(0)


def columns(rows, names):
    return np.column_stack([rows[name] for name in names.split()]).astype(float)


tracks = {n: table[table['id'] == n] for n in numbers.tolist()}


def world(moment):
    """Numbers, positions, quaternions and sizes of the vehicles at a moment."""
    there = [n for n, t in tracks.items() if t['t_s'][0] <= moment <= t['t_s'][-1]]
    places = [
        [
            np.interp(moment, tracks[n]['t_s'], column)
            for column in columns(tracks[n], 'cx cy cz').T
        ]
        for n in there
    ]
    rows = [tracks[n][np.searchsorted(tracks[n]['t_s'], moment + 1e-9) - 1] for n in there]
    rows = np.array(rows, table.dtype)
    places = np.array(places).reshape(-1, 3)
    return np.array(there), places, columns(rows, 'qx qy qz qw'), columns(rows, 'sx sy sz')


def nanoseconds(moment):
    return round(moment * 1e9)


class Remembered(Tracks):
    """Tracks that remember the velocities of the last update."""

    def __call__(self, slots, handles, before, now):
        velocities = super().__call__(slots, handles, before, now)
        self.velocities = dict(zip(handles.tolist(), velocities, strict=True))
        return velocities


def updated_scene(moment, interval, smoothing):
    """A scene with all updates until a moment, and the last position and velocity by vehicle."""
    scene, tracks = Scene(), Remembered(smoothing)
    updates = max(round(MEMORY / interval), 1)
    for then in moment - interval * np.arange(min(updates, moment // interval), -1, -1):
        ids, places, turns, sizes = world(then)
        car, shapes = Numbered('car', ids), Shapes.boxes(places, sizes, turns)
        tracks.velocities = {}
        scene.replace('radar', '', car, shapes, stamp=nanoseconds(then), velocities=tracks)
    names = {scene.name_of(handle): v for handle, v in tracks.velocities.items()}
    speeds = [names.get(f'car{n}', np.zeros(3)) for n in ids.tolist()]
    return scene, dict(zip(ids.tolist(), zip(places, speeds, strict=True), strict=True))


def truly_hit(moment, starts, segments):
    """Whether each robot is hit, frame by frame, by the vehicles at the beginning of the frame."""
    hit = np.zeros(len(starts), bool)
    stop = moment + HORIZON
    frames = FRAME * np.arange(np.ceil(moment / FRAME), np.ceil(stop / FRAME))
    for begin, end in itertools.pairwise(np.unique(np.round([moment, *frames, stop], 6))):
        ids, places, turns, sizes = world(begin)
        later_ids, later, _, _ = world(end)
        velocities = np.zeros_like(places)
        _, here, there = np.intersect1d(ids, later_ids, return_indices=True)
        velocities[here] = (later[there] - places[here]) / (end - begin)
        scene, times = Scene(), (nanoseconds(begin), nanoseconds(end))
        shapes, car = Shapes.boxes(places, sizes, turns), Numbered('car', ids)
        scene.replace('truth', '', car, shapes, stamp=times[0], velocities=velocities)
        left = np.flatnonzero(~hit)
        share = (begin - moment) / HORIZON, (end - begin) / HORIZON
        rays = starts[left] + share[0] * segments[left], share[1] * segments[left], 1.0
        hits = scene.raycast_many(*rays, at=times[0], until=times[1])
        hit[left] = hits.handles != NO_NODE
    return hit


places = columns(table, 'cx cy cz')
moments = np.sort(rng.uniform(2.0, last - HORIZON - 0.1, MOMENTS))
starts = places[rng.integers(0, len(places), (MOMENTS, ROBOTS))]
starts = starts + rng.normal(0, 4, starts.shape) * [1, 1, 0]
angles = rng.uniform(0, 2 * np.pi, (MOMENTS, ROBOTS))
segments = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=-1) * SPEED * HORIZON
truth = [truly_hit(*row) for row in zip(moments, starts, segments, strict=True)]
print(f'{len(tracks)} vehicles; {np.mean(truth):.1%} of {MOMENTS * ROBOTS:,} robots are hit.')
titles = [f'{name}, {method}' for name in NAMES for method in METHODS]
print('| updates | ' + ' | '.join(titles) + ' |')
print('|--:|' + '--:|' * len(NAMES) * len(METHODS))

results = []
for rate in RATES:
    errors, missed, alarms, spent = np.zeros((len(NAMES), len(METHODS), MOMENTS))
    for i, moment in enumerate(moments):
        update, begun = np.floor(moment * rate) / rate, nanoseconds(moment)
        ids, true_places, _, _ = world(moment)
        for k in range(len(METHODS)):
            scene, known = updated_scene(update, 1 / rate, SMOOTHING[max(k - 1, 0)])
            there = zip(ids.tolist(), true_places, strict=True)
            both, ahead = [(place, *known[n]) for n, place in there if n in known], moment - update
            errors[k, i] = np.mean(
                [np.linalg.norm(v * ahead * (k > 0) + p - t) for t, p, v in both]
            )
            when = {'at': begun, 'until': begun + nanoseconds(HORIZON)} if k else {}
            scene.raycast_many(starts[i], segments[i], 1.0, **when)
            start = time.perf_counter()
            hit = scene.raycast_many(starts[i], segments[i], 1.0, **when).handles != NO_NODE
            spent[k, i] = (time.perf_counter() - start) / ROBOTS * 1e6
            missed[k, i], alarms[k, i] = (truth[i] & ~hit).mean(), (hit & ~truth[i]).mean()
    found = errors.mean(axis=1), missed.mean(axis=1), alarms.mean(axis=1), np.median(spent, axis=1)
    results.append(found)
    forms = '.3f', '.1%', '.1%', '.2f'
    cells = [f'{x:{form}}' for row, form in zip(found, forms, strict=True) for x in row]
    print(f'| {rate} Hz | ' + ' | '.join(cells) + ' |')

slow = results[0][1]
print(
    f'With {RATES[0]} update a second {slow[0]:.1%} of the robots are hit without a warning if '
    f'nothing is predicted, and {slow[2]:.1%} if vehicles are tracked.'
)
if options.plot:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout='constrained')
    labels = ('mean error of a position, m', 'missed, share of robots', 'false alarms, share')
    for panel, label, k in zip(axes, labels, range(3), strict=True):
        for method, (name, (colour, line)) in enumerate(zip(METHODS, STYLES, strict=True)):
            rows = [result[k][method] for result in results]
            panel.plot(RATES, rows, line, color=colour, label=name)
        panel.set(xlabel='updates a second', ylabel=label, xscale='log')
        panel.set_xticks(RATES, RATES)
        panel.minorticks_off()
        panel.grid(alpha=0.3)
    axes[0].set_yscale('log')
    for panel in axes[1:]:
        panel.set_ylim(bottom=0.0)
    axes[0].legend(frameon=False)
    figure.suptitle('Is a robot at 1.5 m/s hit within 3 s?')
    figure.savefig(options.plot, dpi=100)
    print(f'{options.plot} shows it for all rates.')
