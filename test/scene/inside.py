# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""The one door by which tests look into a scene: its store."""


def store_of(scene):
    """The store of a scene: tree, columns, names and groups."""
    return scene._store


def boxes_of(scene):
    """Lower and upper corner of each box as the tree has it, in the order of handles."""
    tree = store_of(scene).tree
    lo, hi = tree.boxes(tree.ids())
    return [*zip(lo.tolist(), hi.tolist(), strict=True)]
