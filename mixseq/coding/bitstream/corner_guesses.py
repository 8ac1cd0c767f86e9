"""Guess the next corner of a mesh from earlier ones, and record corners for later guesses.

The *place* of a corner is 0 for the first, 1 for the second, 3 for the last and 2 for those between. With *b* the
corner before (of any polygon; 0 at the start), *s* the first corner of this polygon (*b* at place 0), and :math:`p_0,
p_1, p_2` the first, second and last corner of the polygon before (0 at the start), :math:`q_i` those of the one before
that, the guesses at a corner are

=======  ====================================================================================================
0-2      place 0: where the newest open half-edge into :math:`p_0, p_1, p_2` starts; else: where the newest, second,
         third newest open half-edge into *b* starts
3-5      place 0: where the newest open half-edge out of :math:`p_0, p_1, p_2` ends; place 3: where the newest,
         second, third newest open half-edge out of *s* ends
6, 7     the next unused vertex above, below the one that was last used for the first time
8        *b* plus the difference that came after the same three differences of corners, the last time
9        place 0: :math:`2 p_0 - q_0`; else: *b* plus the same difference in the polygon before
10       not at place 0: *b* plus the same difference in the polygon before that
11-13    :math:`p_0, p_1, p_2`
14, 15   *b* + 1, *b* - 1
=======  ====================================================================================================

`mixseq.coding.bitstream.half_edges` defines open half-edges and unused vertices.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``). numba caches compiled loops
by the text of their own file: edit `mixseq.coding.bitstream.connectivity_kernels` whenever this module changes.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.bitstream.half_edges import INTO, OUT_OF, HalfEdges
from mixseq.coding.bitstream.hashed_contexts import INPUTS, SPREAD
from mixseq.compiled import joined

GUESSES = 16
"""Number of guesses at a corner. Frozen: breaks old files."""

BASES = 9
"""Number of vertices from which unguessed vertices are counted. Frozen: breaks old files."""

_REPEATS = 1 << 16
"""Slots of the table from three corner differences to the corner that followed. Frozen: breaks old files."""


_NEXT, _PLACES, _MIDDLE = np.uint64(1000003), np.uint64(4), np.uint64(32)
"""Constants of the hash from differences to a slot, and its lowest bit used. Frozen: breaks old files."""


class Past(NamedTuple):
    """History of earlier corners beside the mesh."""

    guesses: Index  # (GUESSES,) guesses at the current corner, -1 if there is none
    successes: Index  # (4, GUESSES) at every place, whether the last 8 guesses were right, as bits
    # (4, 2) at every place of the last polygons: which guess was right, or GUESSES and the state of the vertex.
    winners: Index
    trail: Index  # (3,) the same for the last corners
    near: Index  # (6,) first, second and last corner of the polygon before, and of the one before that
    bases: Index  # (BASES,) vertices from which the current one is counted
    # (3, 4, BASES) for every state, place and base: mean of the number of bits of the distance, in 256ths.
    distances: Index
    named: Index  # (4,) the last unguessed vertex at every place
    last_distances: Index  # (3,) the last distance for every state
    repeats: Index  # (_REPEATS,) corners that come after certain differences, 0 for none
    about: Index  # (INPUTS,) contexts of the current number
    used: NDArray[np.int32]  # (V,) the polygon that had a vertex last, -1 if there is none


def no_past(vertex_count: int) -> Past:
    """Return an empty history."""

    def zeros(*shape: int) -> Index:
        return np.zeros(shape, dtype=np.int64)

    return Past(
        guesses=zeros(GUESSES),
        successes=zeros(4, GUESSES),
        winners=zeros(4, 2),
        trail=zeros(3),
        near=zeros(6),
        bases=zeros(BASES),
        distances=zeros(3, 4, BASES),
        named=zeros(4),
        last_distances=zeros(3),
        repeats=zeros(_REPEATS),
        about=zeros(INPUTS),
        used=np.full(vertex_count, -1, dtype=np.int32),
    )


@joined
def make_guesses(mesh: HalfEdges, past: Past, place: int, before: int, first: int, last_new: int) -> None:
    """Guess the vertex of the corner at a place 0 to 3 of a polygon with the first vertex `first`.

    `before` is the vertex of the corner before, `last_new` the one last used for the first time.
    """
    guesses = past.guesses
    for g in range(GUESSES):
        guesses[g] = -1
    if place == 0:
        for i in range(3):
            edge = mesh.newest[INTO, past.near[i]]
            if edge >= 0:
                guesses[i] = mesh.tails[edge]
            edge = mesh.newest[OUT_OF, past.near[i]]
            if edge >= 0:
                guesses[3 + i] = mesh.heads[edge]
        guesses[9] = 2 * past.near[0] - past.near[3]
    else:
        edge = mesh.newest[INTO, before]
        for i in range(3):
            if edge >= 0:
                guesses[i] = mesh.tails[edge]
                edge = mesh.older[INTO, edge]
    if place == 3:
        edge = mesh.newest[OUT_OF, first]
        for i in range(3, 6):
            if edge >= 0:
                guesses[i] = mesh.heads[edge]
                edge = mesh.older[OUT_OF, edge]
    guesses[6] = mesh.unused[1, last_new + 1] - 1
    guesses[7] = mesh.unused[0, last_new + 1] - 1
    for i in range(3):
        guesses[11 + i] = past.near[i]
    guesses[14] = before + 1
    guesses[15] = before - 1


@joined
def remember(past: Past, place: int, vertex: int, winner: int) -> None:
    """Record the right guesses at a corner; `winner` is the first of them, or `GUESSES` plus the state."""
    for g in range(GUESSES):
        if past.guesses[g] >= 0:
            right = 1 if past.guesses[g] == vertex else 0
            past.successes[place, g] = (past.successes[place, g] << 1 | right) & 255
    past.trail[2], past.trail[1], past.trail[0] = past.trail[1], past.trail[0], winner
    past.winners[place, 1], past.winners[place, 0] = past.winners[place, 0], winner


@joined
def slot_of(indices: Index, corner: int, place: int) -> int:
    """Return the slot in `Past.repeats` of the last three differences of corners."""
    key = np.uint64(indices[corner] - indices[corner - 1])
    key = key * _NEXT + np.uint64(indices[corner - 1] - indices[corner - 2])
    key = key * _NEXT + np.uint64(indices[corner - 2] - indices[corner - 3])
    slot = np.int64((key * _PLACES + np.uint64(place)) * SPREAD >> _MIDDLE)
    return int(slot) & (_REPEATS - 1)
