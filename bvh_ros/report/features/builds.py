# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Builds of the tree and the scene without a part: copies of the source with its lines cut out.

The modules of the part are empty, and using what was in them is an error; where other modules ask
whether the part is used, the source says no, so that the compiler drops the branch. Fields that
only the part needs are gone from the records.
"""

import re
from pathlib import Path
from typing import NamedTuple

from ...tree.kernel_cache import cache_folder

PACKAGE = Path(__file__).resolve().parents[2]
# Where kernels may be: a build with the same sources there as ours runs our machine code.
ROOMS = ('tree', 'scene', 'ros/cdr')
EMPTY = '''"""Left out of this build: names can be imported, and cannot be used."""


def __getattr__(name: str) -> object:
    if name.startswith('__'):
        raise AttributeError(name)
    return object()
'''


class Cut(NamedTuple):
    """What to write instead of every match of a pattern; to match nothing is an error."""

    where: str
    """Pattern of files, relative to the package."""
    pattern: str
    instead: str


class Build(NamedTuple):
    """What a build is without."""

    empty: tuple[str, ...] = ()
    """Modules, such as `scene/gjk`."""
    cuts: tuple[Cut, ...] = ()


BALLS = ('scene/ball_casting', 'scene/exact_balls')
PRINTS = ('scene/overlap_footprint', 'scene/ray_footprint')
SHAPED = ('casting', 'contact', 'gjk', 'narrow_phase', 'ray_shapes', 'separation')
STREAMS = ('tree/best_hit', 'tree/ray_streams', 'tree/wide_lanes', 'tree/wide_raycasting')
BATCHES = Build(('tree/ordering', 'tree/packets', *STREAMS))
SWEPT_BOXES = Build(('tree/boxcasting',))
SWEPT_BALLS = Build(BALLS)
SHAPES = Build(
    (*(f'scene/{name}' for name in SHAPED), *BALLS, *PRINTS),
    (
        Cut('scene/queries.py', r'not self\._any_shaped', 'True'),
        Cut('scene/scene.py', r'self\._any_shaped = self\._any_shaped or .*', 'pass'),
        Cut('scene/scene.py', r'if self\._any_shaped\b.*:', 'if False:'),
        Cut('scene/columns.py', r"\('orientation', np\.float64, \(4,\)\),", ''),
        Cut('scene/columns.py', r"\('kind', np\.uint8\),", ''),
        Cut('scene/columns.py', r"\('mesh', np\.int32\),.*", ''),
        Cut('scene/columns.py', r"UNTURNED\['orientation'\] = .*", ''),
    ),
)
PLANAR = Build(
    PRINTS,
    (
        Cut('scene/*.py', r'\bif (self\.)?planar\b', 'if False'),
        Cut('scene/*.py', r'\bif (self|columns)\.footprint is not None', 'if False'),
        Cut('scene/*.py', r'\bif ndim == 3', 'if True'),
        Cut('scene/*.py', r'\bif ndim == 2', 'if False'),
    ),
)
MARGIN = Build(
    (),
    (
        Cut('tree/*.py', r'\btight\.shape\[0\] > 0', 'False'),
        Cut('tree/*.py', r'\btight\.shape\[0\] == 0', 'True'),
    ),
)
VIEWS = Build(
    (),
    (
        Cut('tree/*casting.py', r'[\w\[\]]+\.mask & mask == 0', 'False'),
        Cut('tree/*casting.py', r'[\w\[\]]+\.mask & mask != 0', 'True'),
        Cut('tree/overlapping.py', r'[\w\[\]]+\.mask & mask == 0', 'False'),
    ),
)
EVERYTHING = (BATCHES, SWEPT_BOXES, SHAPES, PLANAR, MARGIN, VIEWS)
WITHOUT: dict[str, Build] = {
    'nothing: the same build again': Build(),
    'batches of rays': BATCHES,
    'swept boxes': SWEPT_BOXES,
    'swept balls': SWEPT_BALLS,
    'other shapes and the narrow phase': SHAPES,
    'planar scenes': PLANAR,
    'margin': MARGIN,
    'masks, and so views': VIEWS,
    'all of these': Build(
        tuple(name for build in EVERYTHING for name in build.empty),
        tuple(cut for build in EVERYTHING for cut in build.cuts),
    ),
}


def make(build: Build, folder: Path, package: str) -> None:
    """Write a build as a package into a folder; files that are there already stay as they are."""
    unused = set(build.cuts)
    for file in [PACKAGE / '__init__.py', *(f for r in ROOMS for f in (PACKAGE / r).glob('*.py'))]:
        name = file.relative_to(PACKAGE)
        text = file.read_text(encoding='utf-8')
        for cut in build.cuts:
            if name.match(cut.where):
                text, times = re.subn(cut.pattern, cut.instead, text)
                unused -= {cut} if times else set()
        if str(name.with_suffix('')) in build.empty:
            text = EMPTY
        _write(folder / package / name, text)
    if unused:
        cut = min(unused)
        raise RuntimeError(f'cannot build without a part: no {cut.pattern!r} in {cut.where}')


def _write(file: Path, text: str) -> None:
    """Written once: other processes may be reading it."""
    if not file.is_file() or file.read_text(encoding='utf-8') != text:
        file.parent.mkdir(parents=True, exist_ok=True)
        file.write_text(text, encoding='utf-8')


def lasting_folder(otherwise: Path) -> Path:
    """Where builds of exactly these sources stay, beside their kernels."""
    kept = cache_folder()
    return otherwise if kept is None else kept / 'builds'
