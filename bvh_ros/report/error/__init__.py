# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""How wrong each method of answering is, against how long it takes.

The truth is computed in rationals, by brute force behind a sound filter. *wrong first*: an object
is hit, but not the first one; of objects entered at exactly the same distance any will do.
*Plain float64 leaves*: the same kernels with the usual slab test in place of the exact decision.
The methods take turns, each after an untimed run; medians. In the pictures a letter is a method;
the front joins what no cheaper method betters by more than a tenth.
"""

from . import meshes, pairs, worlds

SECTIONS = {
    'Random boxes': worlds.random_scene,
    'Adversarial rays': worlds.adversarial_scene,
    'Building 079, Freiburg': worlds.building_scene,
    'Random shapes': worlds.random_shapes,
    'Shelves and tables': worlds.shelves,
    'A mesh that is not convex': meshes.mesh_of_cells,
    'Pairs of shapes against python-fcl': pairs.against_fcl,
}
