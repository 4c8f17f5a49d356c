# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How wrong a world is that is told at a rate: recorded traffic as it was told last, and moved on
by the scene itself with each vehicle's velocity between the last two updates. Is a robot that
drives 1.5 m/s from a place beside the road hit within 3 s?

python examples/predicted_traffic.py TRACKS.csv [--plot FILE.png]

TRACKS has columns t_s, id, cx, cy, cz, sx, sy, sz, qx, qy, qz, qw, in frames of 0.1 s. Between two
frames the true vehicles go straight. Who turns is taken to go on straight, as he lies.
"""

import argparse
import itertools
import time

import numpy as np

from bvh_ros.scene import NO_NODE, Numbered, Scene, Shapes

RATES = 1, 2, 5, 10, 20  # Hz
SPEED, HORIZON, FRAME = 1.5, 3.0, 0.1  # m/s, s, s
ROBOTS, MOMENTS = 400, 60

parser = argparse.ArgumentParser(description=__doc__)
parser.add_argument('tracks')
parser.add_argument('--plot')
options = parser.parse_args()
table = np.genfromtxt(options.tracks, delimiter=',', names=True, dtype=None, encoding='utf-8')
numbers, last = np.unique(table['id']), float(table['t_s'].max())
rng = np.random.default_rng(0)


def columns(rows, names):
    return np.column_stack([rows[name] for name in names.split()]).astype(float)


tracks = {n: table[table['id'] == n] for n in numbers.tolist()}


def world(moment):
    """Numbers, places, turns and sizes of who is there."""
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


def told(moment, interval):
    """A scene as told at a moment, and once before, and where it was told each vehicle is."""
    ids, places, turns, sizes = world(moment)
    before_ids, before, _, _ = world(moment - interval)
    velocities = np.zeros_like(places)
    _, here, there = np.intersect1d(ids, before_ids, return_indices=True)
    velocities[here] = (places[here] - before[there]) / interval
    scene, shapes = Scene(), Shapes.boxes(places, sizes, turns)
    stamp = nanoseconds(moment)
    scene.replace('radar', '', Numbered('car', ids), shapes, stamp=stamp, velocities=velocities)
    return scene, dict(zip(ids.tolist(), zip(places, velocities, strict=True), strict=True))


def truly_hit(moment, starts, ways):
    """Frame by frame, with who is there at the beginning of each."""
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
        rays = starts[left] + share[0] * ways[left], share[1] * ways[left], 1.0
        met = scene.raycast_many(*rays, at=times[0], until=times[1])
        hit[left] = met.handles != NO_NODE
    return hit


places = columns(table, 'cx cy cz')
moments = np.sort(rng.uniform(2.0, last - HORIZON - 0.1, MOMENTS))
starts = places[rng.integers(0, len(places), (MOMENTS, ROBOTS))]
starts = starts + rng.normal(0, 4, starts.shape) * [1, 1, 0]
angles = rng.uniform(0, 2 * np.pi, (MOMENTS, ROBOTS))
ways = np.stack((np.cos(angles), np.sin(angles), 0 * angles), axis=-1) * SPEED * HORIZON
truth = [truly_hit(*row) for row in zip(moments, starts, ways, strict=True)]
print(f'{len(tracks)} vehicles; {np.mean(truth):.1%} of {MOMENTS * ROBOTS} robots are hit')
print('| told at, Hz | place: m, as told | predicted | missed, as told | predicted |', end='')
print(' false alarms, as told | predicted | us a robot, as told | predicted |')
print('|--:|' + '--:|' * 8)

results = []
for rate in RATES:
    errors, missed, alarms, spent = np.zeros((4, 2, MOMENTS))
    for i, moment in enumerate(moments):
        update = np.floor(moment * rate) / rate
        scene, known = told(update, 1 / rate)
        ids, true_places, _, _ = world(moment)
        there = zip(ids.tolist(), true_places, strict=True)
        both = [(place, *known[n]) for n, place in there if n in known]
        for k, ahead in enumerate((0.0, moment - update)):
            errors[k, i] = np.mean([np.linalg.norm(v * ahead + p - t) for t, p, v in both])
            begun = nanoseconds(moment)
            when = {'at': begun, 'until': begun + nanoseconds(HORIZON)} if k else {}
            scene.raycast_many(starts[i], ways[i], 1.0, **when)
            start = time.perf_counter()
            met = scene.raycast_many(starts[i], ways[i], 1.0, **when).handles != NO_NODE
            spent[k, i] = (time.perf_counter() - start) / ROBOTS * 1e6
            missed[k, i], alarms[k, i] = (truth[i] & ~met).mean(), (met & ~truth[i]).mean()
    found = errors.mean(axis=1), missed.mean(axis=1), alarms.mean(axis=1), np.median(spent, axis=1)
    results.append(found)
    place, miss, alarm, cost = ([float(x) for x in pair] for pair in found)
    print(f'| {rate} | {place[0]:.3f} | {place[1]:.3f} | {miss[0]:.2%} | {miss[1]:.2%} ', end='')
    print(f'| {alarm[0]:.2%} | {alarm[1]:.2%} | {cost[0]:.2f} | {cost[1]:.2f} |')

if options.plot:
    import matplotlib.pyplot as plt

    figure, axes = plt.subplots(1, 3, figsize=(12, 3.8), layout='constrained')
    labels = ('mean error of a place, m', 'wrong decisions, share', 'wrong decisions, share')
    for k, (name, style) in enumerate((('as told', 'o-'), ('predicted by the scene', 's--'))):
        place = [r[0][k] for r in results]
        wrong = [r[1][k] + r[2][k] for r in results]
        axes[0].loglog(RATES, place, style, label=name)
        axes[1].semilogx(RATES, wrong, style, label=name)
        axes[2].plot([r[3][k] for r in results], wrong, style[0], label=name)
    for panel, label in zip(axes, labels, strict=True):
        panel.set(xlabel='updates a second', ylabel=label)
        panel.grid(alpha=0.3)
        panel.legend(frameon=False)
    axes[2].set(xlabel='us a robot (each point a rate)')
    for panel in axes[:2]:
        panel.set_xticks(RATES, RATES)
    figure.suptitle('Is a robot at 1.5 m/s hit within 3 s?')
    figure.savefig(options.plot, dpi=120)
