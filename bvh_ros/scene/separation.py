# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a plane keeps two oriented boxes apart: the separating axes of Gottschalk, Lin and
Manocha, "OBBTree", 1996.

Two boxes are apart if and only if their shadows on one of 15 lines are: the three axes of each,
and the cross products of an axis of one with an axis of the other. Boxes are cores, see `gjk`.
"""

import math

from ..tree.compiling import lean_kernel
from .gjk import AXES, CENTRE, HALF, dot

NEARLY_PARALLEL = 2.0**-20  # cross products shorter than this have lost half their digits
PARALLEL = 2.0**-48  # and here the axes of the boxes do all they could


@lean_kernel
def separation(one, other, slack):
    """(gap, sure): the widest gap between two boxes' shadows on the 15 lines, 0 if each gap is
    within `slack`; not `sure` if edges are so nearly parallel that their cross product says
    nothing. The boxes are at least `gap` apart.
    """
    gap, sure = max(along_axes(one, other, slack), along_axes(other, one, slack)), True
    if gap > 0.0:
        return gap, sure
    for i in range(3):
        for j in range(3):
            across, apart = along_cross(one, other, i, j)
            if apart > slack and across > PARALLEL:
                return (apart - slack) / across, True
            sure = sure and not PARALLEL < across < NEARLY_PARALLEL
    return 0.0, sure


@lean_kernel
def along_axes(one, other, slack):
    """The widest gap beyond `slack` along the axes of `one`."""
    widest = 0.0
    for i in range(3):
        axis = one[AXES + i]
        apart = abs(dot(axis, other[CENTRE]) - dot(axis, one[CENTRE])) - one[HALF, i]
        for j in range(3):
            apart -= abs(dot(axis, other[AXES + j])) * other[HALF, j]
        widest = max(widest, apart - slack)
    return widest


@lean_kernel
def along_cross(one, other, i, j):
    """Length of the cross product of axis i of one and j of the other, and the gap along it, times
    that length.
    """
    first, second = one[AXES + i], other[AXES + j]
    square, offset, reach = 0.0, 0.0, 0.0
    for row in range(3):
        y, z = (row + 1) % 3, (row + 2) % 3
        part = first[y] * second[z] - first[z] * second[y]
        square += part * part
        offset += part * (other[CENTRE, row] - one[CENTRE, row])
    for k in range(3):
        # (a_i x b_j) . a_k is, up to the sign, a_m . b_j with m the third of i, k, m.
        if k != i:
            reach += one[HALF, k] * abs(dot(one[AXES + 3 - i - k], second))
        if k != j:
            reach += other[HALF, k] * abs(dot(other[AXES + 3 - j - k], first))
    return math.sqrt(square), abs(offset) - reach
