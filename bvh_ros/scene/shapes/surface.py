# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The triangles of a mesh: which of them a line crosses, and whether they go around a point.

**Nothing slips through an edge.** On which side of an edge a line passes is the sign of a
determinant of the given doubles. It is exact: where rounding leaves it open, the determinant is
summed up without rounding (Shewchuk, "Adaptive Precision Floating-Point Arithmetic and Fast
Robust Geometric Predicates", 1997). The two triangles at an edge get opposite signs, or zero, and
a triangle counts with its edges. So does one in whose plane the line runs.

**Inside by parity.** From a point in a solid every line crosses the surface an odd number of
times. A line through an edge, or along a face, does not tell; then another direction is taken.
"""

import math
from typing import Any, NamedTuple

import numpy as np

from ...tree.access import (
    ALL,
    DEEPEST,
    DIRECTION,
    FARTHEST_ORIGIN,
    LARGEST,
    NONE,
    ORIGIN,
    RAY_ROWS,
    STACK,
    Near,
    Stack,
    Surroundings,
    enter_box,
    intersect_node,
    leaf_within,
    limit32,
    next_leaf,
    next_line_leaf,
    next_near_leaf,
    no_plane32,
    no_snapshot,
    prepare_ray,
    pruning_limit,
    push_root,
    set_ray,
    square32,
    start_ray,
    surround,
    traversal_distance,
    two_product,
    two_sum,
    visit_nearest,
    widen,
)
from ...tree.compiler import inlined, lean_kernel, stack_array
from .shape import length, scale_of
from .triangles32 import LINE, Ball, fill_line, meet_crossed, meet_touched, meet_triangles


class Surface(NamedTuple):
    """Triangles of a mesh and the tree over them; see `hull.Hulls`."""

    vertices: Any
    corners: Any
    nodes: Any
    root: Any
    radius: Any
    wide: Any
    """`Wide`."""


class Wide(NamedTuple):
    """The snapshot of a mesh's tree, as `next_line_leaf` reads it."""

    planes: Any
    children: Any
    masks: Any
    """Nobody reads them: every triangle is seen."""
    triangles: Any
    """See `WideNodes`."""
    center: Any
    per_length: Any
    size: Any
    """How many nodes there are; without any the tree itself serves."""
    loose: Any
    """0: nothing is added to it."""


# ---- exact signs, and values to the last digits

SURE = 2.0**-49  # of a sum of magnitudes: more than what rounds a determinant
FINE = 2.0**-10  # of that sum: a larger determinant is right to 2**-39 of itself
TERMS = 384


@lean_kernel
def exact_sum(terms, count):
    """The sum of the first `count` numbers, which are overwritten: right to a few last digits of
    itself, whatever cancels, and 0 only where it is.
    """
    parts = 0
    for i in range(count):
        total, kept = terms[i], 0
        for j in range(parts):
            total, error = two_sum(total, terms[j])
            if error != 0.0:
                terms[kept] = error
                kept += 1
        if total != 0.0:
            terms[kept] = total
            kept += 1
        parts = kept
    result = 0.0
    for part in range(parts):  # from the least on; they do not overlap
        result += terms[part]
    return result


@lean_kernel
def exact_side(origin, a, b, vector, base, t, direction):
    """`exact_sum` for (vector - base - t direction) . ((a - origin) x (b - origin))."""
    terms, count = stack_array(TERMS, np.float64), 0
    one, two, three = (
        stack_array(4, np.float64),
        stack_array(2, np.float64),
        stack_array(2, np.float64),
    )
    for axis in range(3):
        one[0], one[1] = two_sum(vector[axis], -base[axis])
        one[2], one[3] = two_product(-t, direction[axis])
        for swapped in range(2):
            y, z = (axis + 1 + swapped) % 3, (axis + 2 - swapped) % 3
            two[0], two[1] = two_sum(a[y], -origin[y])
            three[0], three[1] = two_sum(b[z], -origin[z])
            if swapped == 1:
                two[0], two[1] = -two[0], -two[1]
            for number in range(16):
                factor = one[number >> 2]
                if factor == 0.0:
                    continue
                high, low = two_product(two[number >> 1 & 1], three[number & 1])
                terms[count], terms[count + 1] = two_product(high, factor)
                terms[count + 2], terms[count + 3] = two_product(low, factor)
                count += 4
    return exact_sum(terms, count)


@lean_kernel
def side(origin, a, b, vector, base):
    """(vector - base) . ((a - origin) x (b - origin)), with the sign of the exact value.

    With `base` zero it tells on which side of the edge from a to b the line from the origin along
    a vector passes; with `base` the origin, on which side of a triangle's plane the origin is.
    """
    total, size = 0.0, 0.0
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        one = vector[axis] - base[axis]
        first = (a[y] - origin[y]) * (b[z] - origin[z])
        second = (a[z] - origin[z]) * (b[y] - origin[y])
        total += one * (first - second)
        size += abs(one) * (abs(first) + abs(second))
    if abs(total) > SURE * size:
        return total
    return exact_side(origin, a, b, vector, base, 0.0, vector)


LEAST = 1e-300  # instead of a distance that is rounded to zero


# ---- where a line crosses a triangle


class Crossing(NamedTuple):
    """Where a line crosses a triangle."""

    s: Any
    """How far from its origin, in units of its direction; exactly 0 if the triangle holds that;
    inf if the line crosses the triangle nowhere, or only before the origin. In the plane of the
    triangle: where it enters it."""
    sign: Any
    """-1 before the origin, 0 at it, 1 after it."""
    is_clear: Any
    """Whether it crosses the inside of the triangle, or surely not the triangle."""


@inlined
def misses():
    return Crossing(np.inf, 1.0, True)


DOUBT, DOUBT_OF_HEIGHT = 2.0**-48, 2.0**-46  # of products of three lengths: see `SURE`


@lean_kernel
def cross_triangle(vertices, corner, origin, direction, zero):
    """The `Crossing` of a line; `zero` is a zero vector. Points of it before the origin count.

    Nearly all are decided by determinants of rounded differences, of which none is as small as
    what three largest lengths may be off. `cross_in_doubt` looks at the others edge by edge.
    """
    a, b, c = vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]
    ax, ay, az = a[0] - origin[0], a[1] - origin[1], a[2] - origin[2]
    bx, by, bz = b[0] - origin[0], b[1] - origin[1], b[2] - origin[2]
    cx, cy, cz = c[0] - origin[0], c[1] - origin[1], c[2] - origin[2]
    dx, dy, dz = direction[0], direction[1], direction[2]
    far = max(abs(ax), abs(ay), abs(az), abs(bx), abs(by), abs(bz), abs(cx), abs(cy), abs(cz))
    doubt = DOUBT * (abs(dx) + abs(dy) + abs(dz)) * far * far
    nx, ny, nz = by * cz - bz * cy, bz * cx - bx * cz, bx * cy - by * cx
    u = dx * nx + dy * ny + dz * nz
    v = dx * (cy * az - cz * ay) + dy * (cz * ax - cx * az) + dz * (cx * ay - cy * ax)
    w = dx * (ay * bz - az * by) + dy * (az * bx - ax * bz) + dz * (ax * by - ay * bx)
    lowest, highest = min(u, v, w), max(u, v, w)
    if lowest < -doubt and highest > doubt:
        return misses()
    height = ax * nx + ay * ny + az * nz
    is_sure = lowest > doubt or highest < -doubt
    if is_sure and abs(height) > DOUBT_OF_HEIGHT * far * far * far:
        sign = math.copysign(1.0, height) * math.copysign(1.0, u)
        return Crossing(
            math.copysign(distance_along(a, b, c, origin, direction, zero), sign), sign, True
        )
    return cross_in_doubt(a, b, c, origin, direction, zero)


@lean_kernel
def cross_in_doubt(a, b, c, origin, direction, zero):
    """The same, with the exact sign of each determinant."""
    u = side(origin, b, c, direction, zero)
    v = side(origin, c, a, direction, zero)
    if min(u, v) < 0.0 < max(u, v):
        return misses()
    w = side(origin, a, b, direction, zero)
    if min(u, v, w) < 0.0 < max(u, v, w):
        return misses()
    total = u + v + w
    if total == 0.0:
        return cross_within_plane(a, b, c, origin, direction, zero)
    s = distance_along(a, b, c, origin, direction, zero)
    sign = side(origin, b, c, a, origin)
    sign = sign if total > 0.0 else -sign
    sign = 0.0 if sign == 0.0 else math.copysign(1.0, sign)
    s = 0.0 if sign == 0.0 else math.copysign(max(abs(s), LEAST), sign)
    return Crossing(s, sign, u != 0.0 and v != 0.0 and w != 0.0)


@lean_kernel
def distance_along(a, b, c, origin, direction, zero):
    """How far along a line its point in the plane of a triangle is, in units of its direction; no
    nearer than the nearest corner, and no farther than the farthest.

    It is right to 2**-38 of itself also where the line runs nearly in the plane.
    """
    height, slope, size_of_height, size_of_slope, steepest = 0.0, 0.0, 0.0, 0.0, 0
    for axis in range(3):
        y, z = (axis + 1) % 3, (axis + 2) % 3
        plus = (b[y] - a[y]) * (c[z] - a[z])
        minus = (b[z] - a[z]) * (c[y] - a[y])
        normal, size = plus - minus, abs(plus) + abs(minus)
        height += normal * (a[axis] - origin[axis])
        size_of_height += size * abs(a[axis] - origin[axis])
        slope += normal * direction[axis]
        size_of_slope += size * abs(direction[axis])
        if abs(direction[axis]) > abs(direction[steepest]):
            steepest = axis
    if abs(height) < FINE * size_of_height:
        height = exact_side(a, b, c, a, origin, 0.0, direction)
    if abs(slope) < FINE * size_of_slope:
        slope = exact_side(a, b, c, direction, zero, 0.0, direction)
    first = (a[steepest] - origin[steepest]) / direction[steepest]
    second = (b[steepest] - origin[steepest]) / direction[steepest]
    third = (c[steepest] - origin[steepest]) / direction[steepest]
    s = height / slope if slope != 0.0 else first
    return min(max(s, min(first, second, third)), max(first, second, third))


CLOSE = 2.0**-36  # of a distance: more than what rounds it


@lean_kernel
def is_within(vertices, corner, origin, direction, zero, crossing, reach):
    """Whether a line crosses a triangle from its origin on up to a distance, exactly."""
    if crossing.sign < 0.0 or np.isinf(reach) or abs(crossing.s - reach) > CLOSE * reach:
        return crossing.sign >= 0.0 and crossing.s <= reach
    a, b, c = vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]
    # The plane is met at s = (a - origin) . normal / direction . normal.
    height = exact_side(a, b, c, a, origin, 0.0, direction)
    left = exact_side(a, b, c, a, origin, reach, direction)
    if left == 0.0 and height == 0.0 and reach > 0.0:  # the line runs in the plane
        return enter_within_plane(a, b, c, origin, direction, zero, reach) < np.inf
    return left == 0.0 or height == 0.0 or (left < 0.0) != (height < 0.0)


@lean_kernel
def cross_within_plane(a, b, c, origin, direction, zero):
    """The `Crossing` of a line that runs in the plane of a triangle: where it enters it."""
    s = enter_within_plane(a, b, c, origin, direction, zero, np.inf)
    return misses() if s == np.inf else Crossing(s, 0.0 if s == 0.0 else 1.0, False)


@lean_kernel
def enter_within_plane(a, b, c, origin, direction, zero, reach):
    """`enter_flat` of such a line, in the coordinates in which the triangle looks largest."""
    places, line = stack_array((3, 2), np.float64), stack_array((2, 2), np.float64)
    corner, along = stack_array(3, np.int32), stack_array(3, np.float64)
    widest, largest = 0, -1.0
    for axis in range(3):
        fill_places(places, line, a, b, c, origin, direction, axis)
        area = flat_cross(places[1], places[0], 0.0, zero, places[0], places[2])
        if abs(area) > largest:
            widest, largest = axis, abs(area)
    fill_places(places, line, a, b, c, origin, direction, widest)
    square = direction[0] ** 2 + direction[1] ** 2 + direction[2] ** 2
    for number in range(3):
        place = a if number == 0 else (b if number == 1 else c)
        corner[number], along[number] = number, 0.0
        for axis in range(3):
            along[number] += (place[axis] - origin[axis]) * direction[axis]
        along[number] /= square
    return enter_along(places, corner, line[0], line[1], zero, along, reach)


@inlined
def fill_places(places, line, a, b, c, origin, direction, axis):
    """Fill in the corners of a triangle, origin and direction of a line, seen along an axis."""
    for number in range(2):
        other = (axis + 1 + number) % 3
        places[0, number], places[1, number], places[2, number] = a[other], b[other], c[other]
        line[0, number], line[1, number] = origin[other], direction[other]


# ---- where a line crosses a triangle, both at z = 0: seen from above


@lean_kernel
def flat_cross(place, origin, s, direction, base, goal):
    """(place - origin - s direction) x (goal - base) in the plane, right to 2**-38 of itself, with
    the sign of the exact value.
    """
    x = place[0] - origin[0] - s * direction[0]
    y = place[1] - origin[1] - s * direction[1]
    u, v = goal[0] - base[0], goal[1] - base[1]
    wide = abs(place[0] - origin[0]) + abs(s * direction[0])
    high = abs(place[1] - origin[1]) + abs(s * direction[1])
    total = x * v - y * u
    if abs(total) > FINE * (wide * abs(v) + high * abs(u)):
        return total
    return exact_flat_cross(place, origin, s, direction, base, goal)


@lean_kernel
def exact_flat_cross(place, origin, s, direction, base, goal):
    """`exact_sum` for that."""
    terms, count = stack_array(TERMS, np.float64), 0
    one, two = stack_array(4, np.float64), stack_array(2, np.float64)
    for axis in range(2):
        other, sign = 1 - axis, 1.0 - 2.0 * axis
        one[0], one[1] = two_sum(place[axis], -origin[axis])
        one[2], one[3] = two_product(-s, direction[axis])
        two[0], two[1] = two_sum(goal[other], -base[other])
        for number in range(8):
            high, low = two_product(one[number >> 1], two[number & 1])
            terms[count], terms[count + 1] = sign * high, sign * low
            count += 2
    return exact_sum(terms, count)


@lean_kernel
def enter_flat(vertices, corner, origin, direction, zero, reach):
    """How far a line goes until it is on a triangle, exactly 0 if it begins there; inf if it is
    not up to a distance.

    It is where corners of the triangle change sides. They have the same sides in all triangles, so
    nothing slips between two; and a triangle without area is a segment.
    """
    along, square = stack_array(3, np.float64), direction[0] ** 2 + direction[1] ** 2
    for number in range(3):
        place = vertices[corner[number]]
        x, y = place[0] - origin[0], place[1] - origin[1]
        along[number] = (x * direction[0] + y * direction[1]) / square
    return enter_along(vertices, corner, origin, direction, zero, along, reach)


@lean_kernel
def enter_along(vertices, corner, origin, direction, zero, along, reach):
    """`enter_flat`, where it is known how far `along` the line each corner is, up to rounding."""
    sides, across = stack_array(3, np.float64), stack_array(3, np.float64)
    across[0], across[1] = -direction[1], direction[0]
    for number in range(3):
        place = vertices[corner[number]]
        sides[number] = flat_cross(place, origin, 0.0, direction, zero, direction)
    if min(sides[0], sides[1], sides[2]) > 0.0 or max(sides[0], sides[1], sides[2]) < 0.0:
        return np.inf
    first, before, after, within = np.inf, False, False, np.isinf(reach)
    for number in range(3):
        following = (number + 1) % 3
        one, other, s = sides[number], sides[following], along[number]
        place, goal = vertices[corner[number]], vertices[corner[following]]
        begins, ends = 0.0, -1.0  # on which side of origin and end of the line it is crossed
        if one == 0.0:
            begins = flat_cross(place, origin, 0.0, direction, zero, across)
            if not within:
                ends = flat_cross(place, origin, reach, direction, zero, across)
        elif min(one, other) < 0.0 < max(one, other):
            s += (along[following] - s) * (one / (one - other))
            sign = math.copysign(1.0, one)
            begins = sign * flat_cross(place, origin, 0.0, direction, place, goal)
            if not within:
                ends = sign * flat_cross(place, origin, reach, direction, place, goal)
        else:
            continue
        first, before, after = min(first, s), before or begins <= 0.0, after or begins >= 0.0
        within = within or ends <= 0.0
    if not (after and within):
        return np.inf
    return 0.0 if before else min(max(first, LEAST), reach)


# ---- lines through the tree of a mesh


RECORD, ALL32 = no_snapshot(3).record.dtype, np.uint32(ALL)


class Line(NamedTuple):
    """What `enter_box` and `enter_ball` read."""

    ray: Any
    mask: Any
    wide: Any
    radius: Any
    """By how much nodes are grown."""
    box: Any
    """Scratch, (2, 3)."""


@inlined
def enter_ball(nodes, node, line, limit):
    """Where the centre of a ball may enter a node grown by its radius."""
    for axis in range(3):
        line.box[0, axis] = nodes[node].lo[axis] - line.radius
        line.box[1, axis] = nodes[node].hi[axis] + line.radius
    return intersect_node(line.box[0], line.box[1], line.ray, limit, line.wide)


@inlined
def visit_line(surface, ray, reach, found, visit):
    """Hand the triangles that a line may cross up to a distance to a visitor; return what it
    found, `found` at first. visit(surface, ray, face, zero, found) returns what is found now, and
    up to where the line goes on; `zero` is a zero vector.
    """
    return visit_swept(
        surface, ray, 0.0, reach, found, visit, _start_line, meet_crossed, enter_box
    )


@inlined
def visit_ball(surface, ray, radius, reach, found, visit):
    """`visit_line` of the triangles that a ball may touch."""
    return visit_swept(
        surface, ray, radius, reach, found, visit, _start_ball, meet_touched, enter_ball
    )


@inlined
def _start_line(wide, record, ray, radius, room):
    return True, (fill_line(wide, ray, room), room)


@inlined
def _start_ball(wide, record, ray, radius, room):
    widen(record, radius * wide.per_length)
    return radius * wide.per_length < FARTHEST_ORIGIN, Ball(ray, radius)


@inlined
def visit_swept(surface, ray, radius, reach, found, visit, start, meet, enter):
    """`visit_line` of a ball, or of a thin ray: through the snapshot of the tree if there is one,
    and they are suited to it.

    start(wide, record, ray, radius, room) gives (whether they are, what `meet` needs).
    """
    nodes, wide = surface.nodes, surface.wide
    box, zero = stack_array((2, 3), np.float64), stack_array(3, np.float64)
    zero[0] = zero[1] = zero[2] = 0.0
    records, place = stack_array(1, RECORD), stack_array(1, np.int32)
    entries, record = stack_array(STACK, np.int64), records[0]
    stack = Stack(stack_array(DEEPEST, np.int64), stack_array(DEEPEST, np.float64))
    scale, far, limit, top = np.int64(0), False, reach, 0
    suited = start_ray(record, ray[ORIGIN], ray[DIRECTION], wide.center, wide.per_length, reach)
    fits, query = start(wide, record, ray, radius, stack_array(LINE, np.float32))
    suited = suited and fits and wide.size > 0
    place[0], entries[0] = 0, 0
    if not suited:
        for axis in range(3):
            box[0, axis] = nodes[surface.root].lo[axis] - radius
            box[1, axis] = nodes[surface.root].hi[axis] + radius
        scale, far = prepare_ray(ray, box[0], box[1])
        limit = traversal_distance(reach, scale)
    line = Line(ray, ALL, far, radius, box)
    top = 1 if suited else push_root(nodes, surface.root, line, limit, stack, enter)
    while top > 0:
        if suited:
            given = (records, place), query
            face, top = next_line_leaf(wide, *given, ALL32, entries, top, meet)
        else:
            leaf, top = next_leaf(nodes, line, limit, stack, top, enter)
            face = leaf >> 1  # NONE of NONE
        if face == NONE:
            break
        found, reach = visit(surface, ray, np.int64(face), zero, found)
        if suited:
            record.limit = limit32(reach, record.unit)
        else:
            limit = traversal_distance(reach, scale)
    return found


class First(NamedTuple):
    """The first triangle that a line crosses."""

    s: Any
    face: Any
    """Its row; NONE without any."""
    reach: Any
    """How far the line goes."""


@inlined
def _visit_first(surface, ray, face, zero, found):
    line, best = (ray[ORIGIN], ray[DIRECTION], zero), (found.s, found.face)
    first, s = crosses_first(surface, line, face, False, found.reach, best)
    if first:
        found = First(s, face, found.reach)
    return found, min(found.s, found.reach) * (1.0 + CLOSE)


@inlined
def crosses_first(surface, line, face, is_sure, reach, best):
    """(Whether a line, (origin, direction, zero vector), crosses a triangle up to a distance and
    before the best one, (s, row), or (inf, NONE); where). `is_sure`: it surely crosses the
    triangle, and after its origin.
    """
    vertices, corner = surface.vertices, surface.corners[face]
    if is_sure:
        a, b, c = vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]
        crossing = Crossing(distance_along(a, b, c, *line), 1.0, True)
    else:
        crossing = cross_triangle(vertices, corner, *line)
    first = crossing.s < np.inf and is_before(surface, line, (crossing.s, face), best)
    if first:
        first = is_within(vertices, corner, *line, crossing, reach)
    return first, crossing.s


@inlined
def is_before(surface, line, one, other):
    """Whether a line, (origin, direction, zero vector), meets a triangle, (s, row), before another
    one. At one place the lower row is first: only rounding tells the two distances apart.
    """
    (s, face), (best_s, best_face) = one, other
    if abs(s - best_s) <= CLOSE * s and share_place(surface, line, face, best_face):
        return face < best_face
    return s < best_s or (s == best_s and face < best_face)


@lean_kernel
def share_place(surface, line, one, other):
    """Whether a line crosses two triangles at an edge, or a corner, of both; or all three corners
    are the same. False where it runs in the planes of both.
    """
    return lies_in(surface, line, one, other) or lies_in(surface, line, other, one)


@lean_kernel
def lies_in(surface, line, face, other):
    """Whether the corners that the place of a crossing depends on are corners of another triangle,
    too: the two ends where it is on an edge, one where it is at a corner.
    """
    vertices, corner, others = surface.vertices, surface.corners[face], surface.corners[other]
    (origin, direction, zero), depends = line, False
    for k in range(3):
        number, first, second = corner[k], corner[(k + 1) % 3], corner[(k + 2) % 3]
        if side(origin, vertices[first], vertices[second], direction, zero) == 0.0:
            continue
        if number != others[0] and number != others[1] and number != others[2]:
            return False
        depends = True
    return depends


@lean_kernel
def first_crossing(surface, ray, reach):
    """(s, row) of the first triangle that a line, the rows ORIGIN and DIRECTION of a ray, crosses
    up to a distance in units of its direction; (inf, NONE) if it crosses none.
    """
    set_ray(ray, ray[ORIGIN], ray[DIRECTION])
    first = visit_line(surface, ray, reach, First(np.inf, np.int64(NONE), reach), _visit_first)
    return first.s, first.face


@inlined
def _visit_flat(surface, ray, face, zero, found):
    corner = surface.corners[face]
    s = enter_flat(surface.vertices, corner, ray[ORIGIN], ray[DIRECTION], zero, found.reach)
    if s < found.s or (s == found.s and face < found.face):
        found = First(s, face, found.reach)
    return found, min(found.s, found.reach * (1.0 + CLOSE))


@lean_kernel
def first_flat(surface, ray, reach):
    """`first_crossing` where all lies at z = 0; s is exactly 0 if a triangle holds the origin."""
    set_ray(ray, ray[ORIGIN], ray[DIRECTION])
    first = visit_line(surface, ray, reach, First(np.inf, np.int64(NONE), reach), _visit_flat)
    return first.s, first.face


class Parity(NamedTuple):
    """What a line from a point tells of it."""

    is_odd: Any
    is_on_surface: Any
    is_clear: Any
    """False where the line touches an edge, or runs along a face."""


@inlined
def _visit_all(surface, ray, face, zero, found):
    crossing = cross_triangle(
        surface.vertices, surface.corners[face], ray[ORIGIN], ray[DIRECTION], zero
    )
    odd, on_surface, is_clear = found
    if crossing.sign == 0.0:
        on_surface = True
    elif crossing.sign > 0.0 and crossing.s < np.inf:
        odd = not odd
    is_clear = is_clear and crossing.is_clear
    return Parity(odd, on_surface, is_clear), -1.0 if on_surface else np.inf


MOST_DIRECTIONS = 64


@lean_kernel
def holds_point(surface, point):
    """Whether a point is in a solid or on its surface, exactly."""
    box = surface.nodes[surface.root]
    for axis in range(3):
        if not box.lo[axis] <= point[axis] <= box.hi[axis]:
            return False
    return holds_near(surface, point)


@lean_kernel
def holds_near(surface, point):
    """The same of a point in the box around a solid."""
    ray = stack_array((RAY_ROWS, 3), np.float64)
    lowest, highest = surface.nodes[surface.root].lo, surface.nodes[surface.root].hi
    nearest, out, upwards = np.inf, 0, False  # the side of the box that is next
    for axis in range(3):
        ray[ORIGIN, axis] = point[axis]
        below, above = point[axis] - lowest[axis], highest[axis] - point[axis]
        if min(below, above) < nearest:
            nearest, out, upwards = min(below, above), axis, above < below
    x, y, z = 0.3719, 0.8377, 0.4001
    for _ in range(MOST_DIRECTIONS):
        ray[DIRECTION, 0], ray[DIRECTION, 1], ray[DIRECTION, 2] = x - 0.5, y - 0.5, z - 0.5
        ray[DIRECTION, out] += 1.5 if upwards else -1.5
        set_ray(ray, ray[ORIGIN], ray[DIRECTION])
        parity = visit_line(surface, ray, np.inf, Parity(False, False, True), _visit_all)
        if parity.is_on_surface:
            return True
        if parity.is_clear:
            return parity.is_odd
        # Another direction: what chaos makes of this one.
        x, y, z = 3.9 * y * (1.0 - y), 3.93 * z * (1.0 - z), 3.97 * x * (1.0 - x)
    return True  # what nobody can tell is occupied


# ---- the closest point of a surface


@inlined
def share_along(start, end, point):
    """Where the closest point of a segment is, from 0 at its start to 1 at its end."""
    along, square = 0.0, 0.0
    for axis in range(3):
        step = end[axis] - start[axis]
        along += (point[axis] - start[axis]) * step
        square += step * step
    return min(max(along / square, 0.0), 1.0) if square > 0.0 else 0.0


@lean_kernel
def closest_on_segment(a, b, point, out):
    """Fill in the closest point of the segment from a to b; return the squared distance."""
    share, total = share_along(a, b, point), 0.0
    for axis in range(3):
        # From the nearer end: of a long edge that keeps its digits.
        if share <= 0.5:
            out[axis] = a[axis] + share * (b[axis] - a[axis])
        else:
            out[axis] = b[axis] - (1.0 - share) * (b[axis] - a[axis])
        total += (point[axis] - out[axis]) ** 2
    return total


FOOT = 2.0**-46  # of the coordinates: how far a foot may be off
MINUTE = 2.0**-200  # of a triangle's longest edge: a shorter way to its foot has lost digits
ROUND = 2.0**-20  # of the square of a triangle's longest edge: of more, its normal has digits


@lean_kernel
def closest_on_triangle(vertices, corner, point, out):
    """Fill in the closest point of a triangle; return the squared distance."""
    a, b, c = vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]
    return closest_between(a, b, c, point, out)


@inlined
def is_between(a, b, c, point, place, edge):
    """Whether a place is in the box around a triangle, but for what rounds it at a point."""
    inside = True
    for axis in range(3):
        low, high = min(a[axis], b[axis], c[axis]), max(a[axis], b[axis], c[axis])
        doubt = max(abs(point[axis]), abs(low), abs(high), abs(point[axis] - place[axis]))
        doubt = FOOT * max(doubt, MINUTE * edge)
        inside = inside and low - doubt <= place[axis] <= high + doubt
    return inside


@lean_kernel
def closest_between(a, b, c, point, out):
    """The same of the triangle with these corners, of any size."""
    largest = 0.0
    for axis in range(3):
        one, two, three = a[axis] - point[axis], b[axis] - point[axis], c[axis] - point[axis]
        largest = max(largest, abs(one), abs(two), abs(three))
    scale = scale_of(largest)
    if scale == 1.0:
        return closest_by_normal(a, b, c, point, out)
    scaled = stack_array((4, 3), np.float64)
    for axis in range(3):
        scaled[0, axis] = (a[axis] - point[axis]) * scale
        scaled[1, axis] = (b[axis] - point[axis]) * scale
        scaled[2, axis] = (c[axis] - point[axis]) * scale
        scaled[3, axis] = 0.0
    square = closest_by_normal(scaled[0], scaled[1], scaled[2], scaled[3], out)
    for axis in range(3):
        out[axis] = point[axis] + out[axis] / scale
    return square / scale / scale


@lean_kernel
def closest_by_normal(a, b, c, point, out):
    """`closest_between`, where products of four lengths are doubles.

    It is the foot of the perpendicular if that is in the triangle, else on an edge with the point
    on its outer side. A sliver, of which rounding leaves no normal, is as near as its edges. So is
    a triangle so far away that rounding leaves no side of an edge: its foot lies anywhere.
    """
    x, y, z = point[0], point[1], point[2]
    ax, ay, az = a[0] - x, a[1] - y, a[2] - z
    bx, by, bz = b[0] - x, b[1] - y, b[2] - z
    cx, cy, cz = c[0] - x, c[1] - y, c[2] - z
    px, py, pz = b[0] - a[0], b[1] - a[1], b[2] - a[2]
    qx, qy, qz = c[0] - a[0], c[1] - a[1], c[2] - a[2]
    nx, ny, nz = py * qz - pz * qy, pz * qx - px * qz, px * qy - py * qx
    square = nx * nx + ny * ny + nz * nz
    u = nx * (by * cz - bz * cy) + ny * (bz * cx - bx * cz) + nz * (bx * cy - by * cx)
    v = nx * (cy * az - cz * ay) + ny * (cz * ax - cx * az) + nz * (cx * ay - cy * ax)
    w = nx * (ay * bz - az * by) + ny * (az * bx - ax * bz) + nz * (ax * by - ay * bx)
    edge = max(abs(px), abs(py), abs(pz), abs(qx), abs(qy), abs(qz))
    is_round, best = square > (ROUND * edge * edge) * (edge * edge), np.inf
    if square > 0.0 and min(u, v, w) >= 0.0:
        share = (nx * ax + ny * ay + nz * az) / square
        out[0], out[1], out[2] = x + share * nx, y + share * ny, z + share * nz
        if is_between(a, b, c, point, out, edge):
            best = (x - out[0]) ** 2 + (y - out[1]) ** 2 + (z - out[2]) ** 2
            if is_round:
                return best
        is_round = False
    trial = stack_array(3, np.float64)
    for number in range(3):
        start = a if number == 0 else (b if number == 1 else c)
        end = b if number == 0 else (c if number == 1 else a)
        inner = w if number == 0 else (u if number == 1 else v)
        if is_round and inner > 0.0:
            continue
        apart = closest_on_segment(start, end, point, trial)
        if apart < best:
            best = apart
            out[0], out[1], out[2] = trial[0], trial[1], trial[2]
    if best == np.inf:  # the square is beyond the doubles: all corners are as near
        out[0], out[1], out[2] = a[0], a[1], a[2]
    return best


ROUNDED = 2.0**-50  # of the coordinates of a point at a triangle: how far off rounding leaves it


@lean_kernel
def coordinates_in(vertices, corner, point):
    """(u, v) of the point (1 - u - v) a + u b + v c of a triangle that is closest to a point at
    it, up to rounding; u, v and u + v are from 0 to 1.

    Outside, and where rounding leaves a sliver too little area to divide by, it is on an edge.
    """
    a, b, c = vertices[corner[0]], vertices[corner[1]], vertices[corner[2]]
    normal, widest, largest = stack_array(3, np.float64), 0, 0.0
    for axis in range(3):
        largest = max(largest, abs(point[axis]))
        y, z = (axis + 1) % 3, (axis + 2) % 3
        normal[axis] = (b[y] - a[y]) * (c[z] - a[z]) - (b[z] - a[z]) * (c[y] - a[y])
        if abs(normal[axis]) > abs(normal[widest]):
            widest = axis
    y, z, u, v, best = (widest + 1) % 3, (widest + 2) % 3, 0.0, 0.0, np.inf
    if normal[widest] != 0.0:
        above, beside = point[y] - a[y], point[z] - a[z]
        u = (above * (c[z] - a[z]) - beside * (c[y] - a[y])) / normal[widest]
        v = ((b[y] - a[y]) * beside - (b[z] - a[z]) * above) / normal[widest]
        if u >= 0.0 and v >= 0.0 and u + v <= 1.0:
            best = gap_to(a, b, c, u, v, point)
            if best <= (ROUNDED * largest) ** 2:  # nearly always
                return u, v
    for number in range(3):
        start = a if number == 0 else (b if number == 1 else c)
        end = b if number == 0 else (c if number == 1 else a)
        share = share_along(start, end, point)
        one, two = share, 0.0
        if number == 1:
            one, two = 1.0 - share, share
        elif number == 2:
            one, two = 0.0, 1.0 - share
        gap = gap_to(a, b, c, one, two, point)
        if gap < best:
            best, u, v = gap, one, two
    return u, v


@inlined
def gap_to(a, b, c, u, v, point):
    """The squared distance of a point from that of a triangle with coordinates u and v."""
    total = 0.0
    for axis in range(3):
        total += ((1.0 - u - v) * a[axis] + u * b[axis] + v * c[axis] - point[axis]) ** 2
    return total


class NearestPoint(NamedTuple):
    """What `visit_nearest` hands on."""

    surface: Any
    out: Any
    """The closest point so far."""
    face: Any
    """(1,) the row of its triangle."""
    towards: Any
    """(4,): a unit vector from the point of the query to that, zero at first; its distance."""


@inlined
def is_beyond(vertices, corner, point, towards):
    """Whether a triangle lies beyond the plane through the closest point so far, across the line
    from the query to that: then it is no nearer.
    """
    beyond = True
    for number in range(3):
        vertex, along, size = vertices[corner[number]], 0.0, 0.0
        for axis in range(3):
            step = vertex[axis] - point[axis]
            along += towards[axis] * step
            size += abs(step)
        beyond = beyond and along - CLOSE * size > towards[3]
    return beyond


@inlined
def _look_at_triangle(near_by, query, leaf, square, best, count, limit):
    surface, towards, point = near_by.surface, near_by.towards, query.low
    corner = surface.corners[leaf >> 1]
    if is_beyond(surface.vertices, corner, point, towards):
        return np.int64(1), limit
    trial = stack_array(3, np.float64)
    apart = closest_on_triangle(surface.vertices, corner, point, trial)
    if apart < best[0]:
        best[0], near_by.face[0], distance = apart, leaf >> 1, math.sqrt(apart)
        for axis in range(3):
            near_by.out[axis] = trial[axis]
            towards[axis] = (trial[axis] - point[axis]) / distance if distance > 0.0 else 0.0
        towards[3], limit = distance, pruning_limit(distance)
    return np.int64(1), limit


@inlined
def gap_square(nodes, node, query, limit):
    """The squared distance of a node from a box, if it is within a limit, else inf."""
    lo, hi, total = nodes[node].lo, nodes[node].hi, 0.0
    for axis in range(3):
        gap = max(lo[axis] - query.high[axis], 0.0, query.low[axis] - hi[axis])
        total += gap * gap
    return min(total, LARGEST) if total <= limit else np.inf


WAITING = 32


@inlined
def visit_near(near_by, surface, query, best, limit, plane, extent, room, look_at):
    """`visit_nearest` of the triangles of a surface: through the snapshot of their tree if there
    is one, and the query is near enough. `plane` as of `set_plane32`: what does not reach it is
    left out. `extent` is an `Extent`, or None for a point.

    Up to `room` triangles, at most WAITING, wait until the snapshot has no more of them, as each
    one that it comes to may show that others are too far away: so few are looked at in float64.
    """
    wide, count = surface.wide, np.int64(0)
    box, entries = stack_array(6, np.float32), stack_array(STACK, np.int64)
    if not surround(wide, query.low, query.high, box):
        visit_nearest(
            near_by, surface.nodes, surface.root, query, best, limit, gap_square, look_at
        )
        return
    around = Surroundings(box, stack_array(1, np.float32), plane, extent)
    around.limit[0], entries[0], top = square32(limit, wide.per_length), 0, 1
    waiting, waits = stack_array(WAITING, np.int64), 0
    while limit >= 0.0:
        face, top = next_near_leaf(wide, around, entries, top, meet_triangles)
        if face != NONE:
            waiting[waits] = entries[top]  # from where it was taken
            waits += 1
            if waits < room:
                continue
        if waits == 0:
            break
        for place in range(waits):
            face = leaf_within(waiting[place], around.limit[0])
            if face != NONE:
                count, limit = look_at(near_by, query, 2 * face, 0.0, best, count, limit)
                around.limit[0] = min(around.limit[0], square32(limit, wide.per_length))
        waits = 0


FAR = 2.0**450  # m: no surface reaches as far by 35 decades, and squares are finite


@inlined
def closest_on_surface(surface, point, out):
    """Fill in the closest point of a surface; return the distance."""
    return closest_triangle(surface, point, out)[0]


@lean_kernel
def closest_triangle(surface, point, out):
    """`closest_on_surface`, and the row of the triangle that holds it.

    A point beyond FAR is moved towards the surface for the search: which point is closest depends
    on the direction alone there.
    """
    best, towards = stack_array(1, np.float64), stack_array(4, np.float64)
    place, largest = stack_array(3, np.float64), 0.0
    for axis in range(3):
        place[axis] = point[axis]
        largest = max(largest, abs(point[axis]))
    if largest > FAR:
        for axis in range(3):
            place[axis] = point[axis] / largest * FAR
    best[0] = towards[3] = np.inf
    towards[0] = towards[1] = towards[2] = 0.0
    query = Near(place, place, 1, np.inf, ALL)
    near_by = NearestPoint(surface, out, stack_array(1, np.int64), towards)
    plane = stack_array(4, np.float32)
    no_plane32(plane)
    visit_near(near_by, surface, query, best, np.inf, plane, None, WAITING, _look_at_triangle)
    if largest <= FAR:
        return math.sqrt(best[0]), near_by.face[0]
    for axis in range(3):
        place[axis] = point[axis] - out[axis]
    return length(place), near_by.face[0]
