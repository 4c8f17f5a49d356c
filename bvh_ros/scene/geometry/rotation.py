# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""Rotations by unit quaternions in kernels."""

from ...tree.compiler import lean_kernel


@lean_kernel
def rotate(quaternion, vector, sign):
    """Turn a vector in place by a unit quaternion, or back by it with sign -1."""
    x, y, z, w = sign * quaternion[0], sign * quaternion[1], sign * quaternion[2], quaternion[3]
    a, b, c = vector[0], vector[1], vector[2]
    u, v, n = 2 * (y * c - z * b), 2 * (z * a - x * c), 2 * (x * b - y * a)
    vector[0] = a + w * u + y * n - z * v
    vector[1] = b + w * v + z * u - x * n
    vector[2] = c + w * n + x * v - y * u


@lean_kernel
def fill_rotation(unit, matrix):
    """Fill in the rotation matrix (3, 3) of a unit quaternion; its column k is the shape's own
    axis k.
    """
    x, y, z, w = unit[0], unit[1], unit[2], unit[3]
    matrix[0, 0] = 1 - 2 * (y * y + z * z)
    matrix[0, 1] = 2 * (x * y - z * w)
    matrix[0, 2] = 2 * (x * z + y * w)
    matrix[1, 0] = 2 * (x * y + z * w)
    matrix[1, 1] = 1 - 2 * (x * x + z * z)
    matrix[1, 2] = 2 * (y * z - x * w)
    matrix[2, 0] = 2 * (x * z - y * w)
    matrix[2, 1] = 2 * (y * z + x * w)
    matrix[2, 2] = 1 - 2 * (x * x + y * y)
