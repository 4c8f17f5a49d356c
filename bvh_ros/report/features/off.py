# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What each part of a scene costs when it is there but unused: off costs nothing, as a figure."""

import statistics
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import NamedTuple

from ...scene import ShapeKind
from ..page import Page
from ..progress import Progress
from ..tables import Cell, Table
from . import builds
from .on import random_world
from .running import Figures, Job, Turns, run_in_turns, side_by_side

WHOLE, AGAIN = 'whole', 'nothing: the same build again'
# Not compared: numba knows the record types of whoever is the first in a process by their address,
# and those of the others a little later.
FIRST = 'first'
TIMES = ('update', 'raycast', 'overlap')


class Effort(NamedTuple):
    """How much is done for the table."""

    boxes: int
    processes: int
    turns: int
    starts: int


FULL, BRIEF = Effort(1_000, 5, 80, 2), Effort(200, 2, 5, 1)


def chosen(brief: bool) -> tuple[str, ...]:
    """Rows of the table; in brief one that compiles two builds only."""
    return (AGAIN,) if brief else tuple(builds.WITHOUT)


def steps(brief: bool) -> int:
    """How often the progress bar will move."""
    effort, rows = BRIEF if brief else FULL, len(chosen(brief))
    return rows + 2 + effort.processes + effort.starts * (rows + 1)


def run(page: Page, progress: Progress, brief: bool) -> None:
    """Build, compile, measure."""
    effort = BRIEF if brief else FULL
    with tempfile.TemporaryDirectory() as scratch:
        world = random_world(effort.boxes, ShapeKind.BOX, False, rays=150)
        boxes = world.save(Path(scratch), 'boxes')
        folder = builds.lasting_folder(Path(scratch))
        progress.say('features: builds without a part')
        together, apart = _build(boxes, folder, chosen(brief), progress)
        progress.say('features: each part unused')
        runs = []
        first, *others = together
        for number in range(effort.processes):
            # Who fills a scene early in a process gets other memory: everybody does so once.
            at = number * len(others) // effort.processes
            order = [first, *others[at:], *others[:at]]
            jobs = {name: together[name] for name in order}
            runs.append(side_by_side(jobs, effort.turns))
            progress.step()
        alone = run_in_turns(apart, effort.starts, progress.step)
    found = {name: ratios(name, runs, alone) for name in chosen(brief)}
    _show(page, found, effort)


def _build(
    boxes: Path, folder: Path, names: tuple[str, ...], progress: Progress
) -> tuple[dict[str, Job], dict[str, Job]]:
    """Write the builds, to run together under names of their own and apart under ours, and
    compile what they need, two at a time.
    """
    wanted = {WHOLE: builds.Build()} | {name: builds.WITHOUT[name] for name in names}
    together, apart = {FIRST: Job(boxes)}, {}
    for name, build in wanted.items():
        package = ''.join(letter if letter.isalnum() else '_' for letter in f'bvh_ros {name}')
        builds.make(build, folder, package)
        builds.make(build, folder / package, 'bvh_ros')
        kernels = folder / 'kernels' / package
        together[name] = Job(boxes, package=package, path=folder, kernels=kernels)
        apart[name] = Job(boxes, path=folder / package)

    with ThreadPoolExecutor(2) as pool:
        for _ in pool.map(lambda job: side_by_side({'': job}, 1), together.values()):
            progress.step()
    return together, apart


def ratios(
    name: str, runs: list[dict[str, Turns]], alone: dict[str, list[Figures]]
) -> dict[str, tuple[float, float]]:
    """Whole over without: the median of the processes, and how far they are spread around it.

    In each process the whole build is there twice, and each turn of the one without the part is
    compared with the turns of both next to it in time.
    """
    found = {}
    for kind in TIMES:
        each = []
        for run in runs:
            pairs = zip(run[WHOLE][kind], run[AGAIN][kind], run[name][kind], strict=True)
            if name == AGAIN:
                each.append(statistics.median(one / two for one, two, _ in pairs))
            else:
                each.append(statistics.median((one + two) / 2 / own for one, two, own in pairs))
        found[kind] = _middle(each)
    for kind in ('start', 'memory'):
        both = zip(alone[WHOLE], alone[name], strict=True)
        found[kind] = _middle([whole[kind] / without[kind] for whole, without in both])
    return found


def _middle(ratios: list[float]) -> tuple[float, float]:
    """Median, and standard error of it."""
    middle = statistics.median(ratios)
    if len(ratios) < 2:
        return middle, 0.0
    return middle, 1.25 * statistics.stdev(ratios) / len(ratios) ** 0.5


def _show(page: Page, found: dict[str, dict[str, tuple[float, float]]], effort: Effort) -> None:
    header = ['left out of the build']
    rows: list[list[Cell]] = []
    for name, row in found.items():
        rows.append([name])
        for ratio, error in row.values():
            rows[-1] += [f'{ratio:.3f}', f'{error:.3f}']
    for kind in (*TIMES, 'start', 'memory'):
        header += [f'{kind}, ratio', '+-']
    page.add('### Each part off')
    page.add(
        'The whole build, a part of it unused, over a build without that part: its modules are '
        'empty, and the lines and fields that it needs elsewhere are cut out of the source. '
        f'{effort.boxes:,} axis-aligned boxes, thin rays, overlaps. Times: all builds in one '
        f'process on one core take {effort.turns} short turns, one after the other; each turn is '
        'compared with those of the whole build next to it; median of '
        f'{effort.processes} processes, and its standard error. *start* (processor time from the '
        'start of Python to the first answer) and *memory*: of processes of their own, '
        f'{effort.starts} each. The first row compares the whole build with its copy: what chance '
        'does.'
    )
    page.table(Table('features_off', header, rows))
