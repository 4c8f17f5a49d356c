# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Names of obstacles that are numbered parts of something."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from bvh_ros.scene import Families

NOTHING = Families([], np.empty(0, np.int64), np.empty(0, np.int64))


def numbered(spans: Mapping[str, range], after: Families = NOTHING) -> Families:
    """Names that begin with these texts and end in these numbers, after other names."""
    spans = {prefix: span for prefix, span in spans.items() if span}
    if not spans:
        return after
    first = len(after.prefixes)
    family = np.repeat(np.arange(first, first + len(spans)), [len(s) for s in spans.values()])
    numbers = [np.arange(span.start, span.stop) for span in spans.values()]
    return Families(
        [*after.prefixes, *spans],
        np.concatenate((after.family, family)),
        np.concatenate((after.numbers, *numbers)),
    )
