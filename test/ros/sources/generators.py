# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Conversions pause now and then; these go on until they are done."""


def ended(work):
    """What a generator returns in the end."""
    while True:
        try:
            next(work)
        except StopIteration as end:
            return end.value
