# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What the tests of scenes share."""

from collections.abc import Callable

import pytest


@pytest.fixture
def set_slices(monkeypatch: pytest.MonkeyPatch) -> Callable[[int, int], None]:
    """Set how few obstacles are updated at once, and how many rows a slice has."""

    def patch(at_once: int, rows: int, prefix: str = '') -> None:
        monkeypatch.setattr(f'bvh_ros.scene.slicing.{prefix}AT_ONCE', at_once)
        monkeypatch.setattr(f'bvh_ros.scene.slicing.{prefix}SLICE', rows)

    return patch
