# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Views: named parts of the world, chosen by patterns of obstacle names."""

from __future__ import annotations

import fnmatch
import re
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from bvh_ros.ros.parameters import ConfigurationError, ViewSettings
from bvh_ros.ros.texts import shortened
from bvh_ros.scene import Families
from bvh_ros.scene.names import BARE
from bvh_ros.tree.access import ALL

# Views: named parts of the world, chosen by patterns of obstacle names, each a bit of a mask.
#
# An obstacle's bits are found once, when it appears. A query of a view carries the view's bit as
# its mask, and the unions of masks in the tree's inner nodes prune everything else.

Masks = NDArray[np.uint32]
EVERYTHING = 1  # bit 0: the mask of an obstacle that no view has


@dataclass(frozen=True)
class View:
    """What a query sees, and under which names its services and topics are offered."""

    name: str = ''  # '': everything
    mask: int = ALL
    skip_inside: bool = False

    def topic(self, name: str) -> str:
        """Return the name of a service or topic of this view: `~/raycast`, `~/arm/raycast`."""
        return f'~/{self.name}/{name}' if self.name else f'~/{name}'


WHOLE = View()


def create_views(settings: Sequence[ViewSettings]) -> list[View]:
    """Return the view of everything and the configured ones; the k-th of these has bit k."""
    named = (View(given.name, 1 << k, given.skip_inside) for k, given in enumerate(settings, 1))
    return [WHOLE, *named]


def view_of_scan(views: Sequence[View], name: str) -> View:
    """Return the view that the virtual scan is configured with; ConfigurationError if there is
    none.
    """
    for view in views:
        if view.name == name:
            return view
    raise ConfigurationError(
        f"parameter 'virtual_scan.view' is '{shortened(name)}', no view of this node"
    )


class Patterns:
    """Whether a name matches one of some glob patterns; `*` matches slashes too."""

    def __init__(self, patterns: Sequence[str]) -> None:
        self._patterns = patterns
        together = '|'.join(fnmatch.translate(pattern) for pattern in patterns)
        self._matches = re.compile(together).match if patterns else None

    def match(self, name: str) -> bool:
        """Whether one of the patterns matches all of the name."""
        return self._matches is not None and self._matches(name) is not None

    def same_for_all_numbers(self, prefix: str) -> bool:
        """Whether every name `prefix` + number is answered alike, as far as can be seen."""
        return all(_same_for_all_numbers(pattern, prefix) for pattern in self._patterns)


def _same_for_all_numbers(pattern: str, prefix: str) -> bool:
    """Whether the number after `prefix` cannot matter to this pattern.

    It cannot where the pattern's literal head contradicts the prefix. Else the head has to lie
    within the prefix, and the rest to have no digit, no ? and no [: then only a * can match a
    digit, and it matches any number of them.
    """
    head = re.split(r'[*?\[]', pattern, maxsplit=1)[0]
    common = min(len(head), len(prefix))
    if head[:common] != prefix[:common]:
        return True
    return common == len(head) and not re.search(r'[0-9?\[]', pattern[common:])


class Categoriser:
    """Gives obstacles the bits of the views that show them.

    Parameters
    ----------
    settings : sequence of ViewSettings
        In the order of their bits, see `create_views`.
    """

    def __init__(self, settings: Sequence[ViewSettings]) -> None:
        self._views = [
            (np.uint32(1 << bit), Patterns(given.include), Patterns(given.exclude))
            for bit, given in enumerate(settings, 1)
        ]

    def __call__(self, names: Families) -> Masks:
        """Return the masks of n names, shape (n,)."""
        masks = np.full(len(names), EVERYTHING, np.uint32)
        kind = 2 * names.family + (names.numbers == BARE)
        order = np.argsort(kind, kind='stable')
        changes = np.flatnonzero(np.diff(kind[order])) + 1
        for rows in np.split(order, changes) if len(names) else ():
            prefix, numbers = names.prefixes[names.family[rows[0]]], names.numbers[rows]
            every: list[str] = []  # made where a pattern asks for the number
            for bit, include, exclude in self._views:
                if numbers[0] == BARE:
                    texts = [prefix]
                elif include.same_for_all_numbers(prefix) and exclude.same_for_all_numbers(prefix):
                    texts = [f'{prefix}0']  # stands for all
                else:
                    every = every or [f'{prefix}{number}' for number in numbers.tolist()]
                    texts = every
                shown = [include.match(text) and not exclude.match(text) for text in texts]
                masks[rows] |= np.where(shown, bit, np.uint32(0))
        return masks
