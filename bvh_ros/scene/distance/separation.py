# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Whether a plane keeps two oriented boxes apart: the separating axes of Gottschalk, Lin and
Manocha, "OBBTree", 1996.

Two boxes are apart if and only if their shadows on one of 15 lines are: the three axes of each,
and the cross products of an axis of one with an axis of the other. Boxes are cores, see `gjk`.
"""

import math

import numpy as np

from ...tree.compiler import lean_kernel, stack_array
from .gjk import AXES, CENTRE, HALF
from .simplex import dot

LINES = 15

# The gap along a cross product is known to slack / its length: down to this length, well enough.
NEARLY_PARALLEL = 2.0**-6
PARALLEL = 2.0**-48  # and here the axes of the boxes do all it could


@lean_kernel
def separation(one, other, slack):
    """(gap, sure): a gap between two boxes' shadows on one of the 15 lines, 0 if each gap is
    within `slack`; not `sure` if edges are so nearly parallel that their cross product says
    little. The boxes are at least `gap` apart.
    """
    turn = stack_array((3, 3), np.float64)  # the other's axes seen from one, in columns
    offset = stack_array(3, np.float64)
    for i in range(3):
        offset[i] = 0.0
        for row in range(3):
            offset[i] += one[AXES + i, row] * (other[CENTRE, row] - one[CENTRE, row])
        for j in range(3):
            turn[i, j] = 0.0
            for row in range(3):
                turn[i, j] += one[AXES + i, row] * other[AXES + j, row]
    gap = along_axes(one[HALF], other[HALF], turn, offset) - slack
    if gap > 0.0:
        return gap, True
    return along_crosses(one[HALF], other[HALF], turn, offset, slack)


@lean_kernel
def along_axes(half, other_half, turn, offset):
    """The widest gap along the axes of either box."""
    widest = -np.inf
    for i in range(3):
        apart, other_apart, along = abs(offset[i]) - half[i], -other_half[i], 0.0
        for j in range(3):
            apart -= abs(turn[i, j]) * other_half[j]
            other_apart -= abs(turn[j, i]) * half[j]
            along += turn[j, i] * offset[j]
        widest = max(widest, apart, other_apart + abs(along))
    return widest


@lean_kernel
def along_crosses(half, other_half, turn, offset, slack):
    """`separation` along the cross products.

    That of one's axis i and the other's axis j has, seen from one, the components 0, -turn[z, j]
    and turn[y, j] on i and the two axes y, z that follow it.
    """
    sure = True
    for i in range(3):
        y, z = (i + 1) % 3, (i + 2) % 3
        for j in range(3):
            k, m = (j + 1) % 3, (j + 2) % 3
            reach = half[y] * abs(turn[z, j]) + half[z] * abs(turn[y, j])
            reach += other_half[k] * abs(turn[i, m]) + other_half[m] * abs(turn[i, k])
            apart = abs(offset[z] * turn[y, j] - offset[y] * turn[z, j]) - reach - slack
            across = math.sqrt(turn[y, j] * turn[y, j] + turn[z, j] * turn[z, j])
            if apart > 0.0 and across > PARALLEL:
                return apart / across, True
            sure = sure and not PARALLEL < across < NEARLY_PARALLEL
    return 0.0, sure


@lean_kernel
def fill_line(one, other, line, way):
    """Fill in a unit vector along one of the 15 lines; false if there is none."""
    i, j = (line - 6) // 3, line % 3
    if line >= 6:
        return fill_cross(one[AXES + i], other[AXES + j], way)
    for row in range(3):
        way[row] = one[AXES + j, row] if line < 3 else other[AXES + j, row]
    return dot(way, way) > 0.0


@lean_kernel
def fill_cross(one, other, way):
    """Fill in the unit vector across two; false if they are parallel. Nearly parallel ones leave
    it few digits: those across `one` are put right, as a long edge needs them, and those across
    `other` follow.
    """
    for turn in range(2):
        if turn == 0:
            for axis in range(3):
                y, z = (axis + 1) % 3, (axis + 2) % 3
                way[axis] = one[y] * other[z] - one[z] * other[y]
        else:
            along = dot(one, way)
            for axis in range(3):
                way[axis] -= along * one[axis]
        size = math.sqrt(dot(way, way))
        if size == 0.0:
            return False
        for axis in range(3):
            way[axis] /= size
    return True
