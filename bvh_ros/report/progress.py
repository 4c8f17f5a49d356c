# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The progress bar: on a terminal as it goes, elsewhere a line a minute at most."""

import sys
from collections.abc import Callable, Iterator, Sequence
from typing import TypeVar

Item = TypeVar('Item')


def bar(items: Sequence[Item], name: Callable[[Item], str]) -> Iterator[Item]:
    """Go through the items under a bar that says what is being done; silent without tqdm."""
    try:
        from tqdm import tqdm
    except ImportError:
        yield from items
        return
    interval = 0.1 if sys.stderr.isatty() else 60.0
    with tqdm(total=len(items), mininterval=interval, dynamic_ncols=True, leave=False) as shown:
        for item in items:
            shown.set_description(name(item), refresh=sys.stderr.isatty())
            yield item
            shown.update()


def say(text: str) -> None:
    """Print above the bar."""
    try:
        from tqdm import tqdm
    except ImportError:
        print(text)
    else:
        tqdm.write(text)
