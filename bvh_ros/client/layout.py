# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""What several nodes say of themselves: their regions, and what must be the same for all."""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import TYPE_CHECKING, NamedTuple

import numpy as np
from numpy.typing import NDArray
from rcl_interfaces.srv import GetParameters

from bvh_ros.client.batch import tellers_of_names
from bvh_ros.client.coverage import Coverage
from bvh_ros.client.errors import BvhError, BvhTimeoutError
from bvh_ros.client.waiting import left

if TYPE_CHECKING:
    from bvh_ros.client.client import BvhClient

LEAVES = 'the query leaves the regions of all nodes'
ASKED = ('region', 'planar', 'frame_id', 'footprint', 'nearest_limit')


class Known(NamedTuple):
    """What one node says of itself."""

    name: str
    tellers: frozenset[bytes]
    """Its publishers of names: another one is another life of the node."""
    lo: NDArray[np.float64]
    hi: NDArray[np.float64]
    frame_id: str
    footprint: tuple[float, ...]
    nearest_limit: int

    def is_current(self, one: BvhClient) -> bool:
        """Whether no new life of the node is seen. One that has died is the same: who asks it
        waits in vain, who need not ask it does not mind.
        """
        return tellers_of_names(one.node, one.name)[1] <= self.tellers


class Layout(NamedTuple):
    """What all nodes say, in their order."""

    nodes: list[Known]
    coverage: Coverage

    @property
    def nearest_limit(self) -> int:
        """How many of the nearest obstacles all of them tell."""
        return min(node.nearest_limit for node in self.nodes)

    def footprint(self) -> tuple[float, ...]:
        """The one footprint; BvhError if there are two, or none."""
        first, *others = (node.footprint for node in self.nodes)
        if any(other != first for other in others) or first in ((), (0.0,)):
            raise BvhError("the nodes do not have the same parameter 'footprint'")
        return first

    def is_current(self, clients: Sequence[BvhClient]) -> bool:
        """Whether no node was started again since."""
        return all(node.is_current(one) for node, one in zip(self.nodes, clients, strict=True))


def read_layout(clients: Sequence[BvhClient], old: Layout | None, deadline: float) -> Layout:
    """What the nodes say; what is known already of those that live on.

    Raises
    ------
    BvhError
        If they do not fit together; BvhTimeoutError if one does not answer until `deadline`.
    """
    if old is not None and old.is_current(clients):
        return old
    nodes = []
    for number, one in enumerate(clients):
        if old is not None and old.nodes[number].is_current(one):
            nodes.append(old.nodes[number])
        else:
            nodes.append(_ask(one, deadline))
    for node in nodes:
        if node.frame_id != nodes[0].frame_id:
            raise BvhError(
                f"'{node.name}' is in frame '{node.frame_id}', '{nodes[0].name}' in "
                f"'{nodes[0].frame_id}': their regions cannot be compared"
            )
    corners = (np.array(corner) for corner in zip(*((n.lo, n.hi) for n in nodes), strict=True))
    return Layout(nodes, Coverage(*corners))


def _ask(one: BvhClient, deadline: float) -> Known:
    def is_found() -> bool:
        return tellers_of_names(one.node, one.name)[0] != ''

    if not one.waiting.until(is_found, left(deadline)):
        raise BvhTimeoutError(f"'{one.name}' is not found")
    # The publishers first: if the parameters are those of a later life, that shows.
    topic, tellers = tellers_of_names(one.node, one.name)
    service = f'{topic.rpartition("/")[0]}/get_parameters'
    asked = GetParameters.Request(names=[*ASKED])
    reply = one.services.once(GetParameters, service, asked, left(deadline))
    region, planar, frame_id, footprint, nearest_limit = reply.values
    corners = np.array(region.double_array_value)
    if corners.shape != (6,):
        raise BvhError(f"'{one.name}' has no parameter 'region'")
    lo, hi = corners[:3], corners[3:]
    if planar.bool_value:  # who does not look at z knows all of it
        lo[2], hi[2] = -math.inf, math.inf
    return Known(
        *(one.name, tellers, lo, hi, frame_id.string_value),
        *(tuple(footprint.double_array_value), nearest_limit.integer_value),
    )
