# Copyright 2026 The bvh_ros authors
# SPDX-License-Identifier: Apache-2.0
"""A hash table from names (number of the prefix, number) to slots.

Open addressing with linear probing. The table holds slots only: what a slot is called stands in
two arrays beside it. An entry is taken out by moving later ones of its cluster up (Knuth, The Art
of Computer Programming, vol. 3, 6.4, algorithm R), so that the table never fills with tombstones.
"""

from ...tree.compiler import inlined, lean_kernel

EMPTY = -1


@inlined
def _home(prefix, number, seed, mask):
    """Where the search for a name begins.

    Sixteen neighbouring numbers lie side by side, because messages bring them in order; what is
    above is scattered, so that no stride of the numbers makes long clusters.
    """
    word = (number >> 4) * -7046029254386353131 + (prefix + seed) * 0x2545F4914F6CDD1D
    word ^= word >> 29
    word *= -4658895280553007687
    word ^= word >> 32
    return ((word << 4) | ((number + prefix) & 15)) & mask


@inlined
def _place(table, prefix_of, number_of, seed, prefix, number):
    """The place of a name in the table, or the empty one where it belongs."""
    mask = table.shape[0] - 1
    place = _home(prefix, number, seed, mask)
    while True:
        slot = table[place]
        if slot == EMPTY or (prefix_of[slot] == prefix and number_of[slot] == number):
            return place
        place = (place + 1) & mask


@lean_kernel
def find_slots(table, prefix_of, number_of, seed, prefixes, family, numbers, found):
    """Write the slot of each name, prefixes[family] + number, to `found`, EMPTY where there is
    none.
    """
    for row in range(family.shape[0]):
        prefix = prefixes[family[row]]
        place = _place(table, prefix_of, number_of, seed, prefix, numbers[row])
        found[row] = table[place]


@lean_kernel
def add_slots(table, prefix_of, number_of, seed, slots):
    """Enter slots whose names stand in the arrays and are not in the table."""
    for slot in slots:
        place = _place(table, prefix_of, number_of, seed, prefix_of[slot], number_of[slot])
        table[place] = slot


@lean_kernel
def discard_slots(table, prefix_of, number_of, seed, slots):
    """Take out those of the slots that are in the table; return how many these are."""
    mask = table.shape[0] - 1
    count = 0
    for slot in slots:
        gap = _place(table, prefix_of, number_of, seed, prefix_of[slot], number_of[slot])
        if table[gap] != slot:
            continue
        table[gap] = EMPTY
        count += 1
        place = (gap + 1) & mask
        while table[place] != EMPTY:
            other = table[place]
            home = _home(prefix_of[other], number_of[other], seed, mask)
            # It may move up unless its home lies cyclically between the gap and its place.
            if (place - home) & mask >= (place - gap) & mask:
                table[gap] = other
                table[place] = EMPTY
                gap = place
            place = (place + 1) & mask
    return count
