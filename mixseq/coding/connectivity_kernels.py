"""The loop over all corners of a mesh, the same for coding and decoding; `mixseq.coding.connectivity` describes it.

numba keeps compiled loops by the text of their own file, and this one contains those of `mixseq.coding.mixing` and
`mixseq.coding.half_edges`. Who changes these changes the file format, and must change this file too: format 1.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.coding.half_edges import (
    CLOSED,
    INTO,
    OPEN,
    OUT_OF,
    UNUSED,
    HalfEdges,
    add_polygon,
    move,
    rank_of,
    vertex_of,
)
from mixseq.coding.mixing import SPREAD, Bits, code
from mixseq.compiled import compiled, constant, inlined

INPUTS = 8
"""Number of contexts of a bit."""

GUESSES = 16
"""Number of guesses at a corner."""

KINDS = 4 * GUESSES + 4 * 5
"""Kinds of bits with weights of their own: of guesses by place, of numbers by what they are about."""

_COUNTS, _STATES = constant(3), constant(4)
"""What numbers are about: 0 to 2 distances among unused, open, closed vertices; numbers of corners; states."""

LONGEST = 33
"""Bits of the largest numbers."""

_LOOKED_AT = 32
"""So many corners of a polygon are looked at for a vertex that comes twice: time stays bounded."""

_BASES = 9
_REPEATS = 1 << 16
_FIRST = constant(0)


class Past(NamedTuple):
    """What is remembered of earlier corners beside the mesh.

    Attributes
    ----------
    guesses : (GUESSES,) int64
        Guesses at the current corner, -1 if there is none.
    successes : (4, GUESSES) int64
        At every place, whether the last 8 guesses were right, as bits.
    winners : (4, 2) int64
        At every place of the last polygons: which guess was right, or `GUESSES` and the state of the vertex.
    trail : (3,) int64
        The same for the last corners.
    near : (6,) int64
        First, second and last corner of the polygon before, and of the one before that.
    bases : (_BASES,) int64
        Vertices from which the current one is counted.
    distances : (3, 4, _BASES) int64
        For every state, place and base: mean of the number of bits of the distance, in 256ths.
    named : (4,) int64
        The last vertex at every place that no guess had.
    last_distances : (3,) int64
        The last distance for every state.
    repeats : (_REPEATS,) int64
        Corners that come after certain differences, 0 for none.
    about : (INPUTS,) int64
        Contexts of the current number.
    used : (V,) int32
        The polygon that had a vertex last, -1 if there is none.
    """

    guesses: Index
    successes: Index
    winners: Index
    trail: Index
    near: Index
    bases: Index
    distances: Index
    named: Index
    last_distances: Index
    repeats: Index
    about: Index
    used: NDArray[np.int32]


def no_past(vertex_count: int) -> Past:
    """Return what is remembered at the start: nothing."""

    def zeros(*shape: int) -> Index:
        return np.zeros(shape, dtype=np.int64)

    return Past(
        guesses=zeros(GUESSES),
        successes=zeros(4, GUESSES),
        winners=zeros(4, 2),
        trail=zeros(3),
        near=zeros(6),
        bases=zeros(_BASES),
        distances=zeros(3, 4, _BASES),
        named=zeros(4),
        last_distances=zeros(3),
        repeats=zeros(_REPEATS),
        about=zeros(INPUTS),
        used=np.full(vertex_count, -1, dtype=np.int32),
    )


@compiled
def walk(bits: Bits, mesh: HalfEdges, past: Past, counts: Index, indices: Index) -> None:
    """Code all polygons, or decode them into `counts` (P,) and `indices` (C,); `bits.failed` says if that failed."""
    corner = _FIRST
    first = previous = 0  # corners that the polygon before, and the one before that, start from
    last_new = -1
    repeat = run = 0  # the corner that comes after the same differences, and for how long it was right
    for polygon in range(len(counts)):
        start = corner
        old = counts[polygon - 1] if polygon else 3
        older = counts[polygon - 2] if polygon > 1 else 3
        for i in range(INPUTS):
            past.about[i] = min(old, 63) << 6 | min(older, 63)
        counts[polygon] = old + _number(bits, past, _COUNTS, counts[polygon] - old)
        stop = start + counts[polygon]
        if bits.failed[0] or counts[polygon] < 3 or stop > len(indices):
            bits.failed[0] = 1
            return
        for corner in range(start, stop):
            j = corner - start
            place = 3 if corner == stop - 1 else min(j, 2)
            before = indices[corner - 1] if corner else 0
            _guess(mesh, past, place, before, indices[start] if j else before, last_new)
            if repeat:
                past.guesses[8] = before + indices[repeat] - indices[repeat - 1]
            if j and first + j < start:
                past.guesses[9] = before + indices[first + j] - indices[first + j - 1]
            if j and previous + j < first:
                past.guesses[10] = before + indices[previous + j] - indices[previous + j - 1]
            vertex, winner = _vertex(bits, mesh, past, indices, polygon, start, corner, place, last_new, run)
            if bits.failed[0]:
                return
            indices[corner] = vertex
            _remember(past, place, vertex, winner)
            if repeat and past.guesses[8] == vertex:
                repeat, run = repeat + 1, run + 1
            else:
                repeat = run = 0
            if corner > 2:
                slot = _slot(indices, corner, place)
                repeat = repeat or past.repeats[slot]
                past.repeats[slot] = corner + 1
            if mesh.states[vertex] == UNUSED:
                last_new = vertex
                move(mesh, vertex, OPEN)
            past.used[vertex] = polygon
        corner = stop
        add_polygon(mesh, indices, start, stop)
        for i in range(3):
            past.near[3 + i] = past.near[i]
        past.near[0], past.near[1], past.near[2] = indices[start], indices[start + 1], indices[stop - 1]
        previous, first = first, start
    if corner != len(indices):
        bits.failed[0] = 1


@inlined
def _remember(past: Past, place: int, vertex: int, winner: int) -> None:
    """Keep which guesses were right."""
    for g in range(GUESSES):
        if past.guesses[g] >= 0:
            right = 1 if past.guesses[g] == vertex else 0
            past.successes[place, g] = (past.successes[place, g] << 1 | right) & 255
    past.trail[2], past.trail[1], past.trail[0] = past.trail[1], past.trail[0], winner
    past.winners[place, 1], past.winners[place, 0] = past.winners[place, 0], winner


@inlined
def _guess(mesh: HalfEdges, past: Past, place: int, before: int, first: int, last_new: int) -> None:
    """Guess the vertex of a corner from its neighbours in the mesh, in the polygons before, and in number."""
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


@inlined
def _vertex(
    bits: Bits,
    mesh: HalfEdges,
    past: Past,
    indices: Index,
    polygon: int,
    start: int,
    corner: int,
    place: int,
    last_new: int,
    run: int,
) -> tuple[int, int]:
    """Code the vertex of a corner: the first right guess, or its state and rank. Also return which of them it was."""
    count = len(mesh.states)
    vertex = indices[corner]
    before = indices[corner - 1] if corner else 0
    first = indices[start] if corner > start else before
    around = 0
    if corner:
        around = min(mesh.degrees[before], 8) * 4 + min(mesh.open_edges[before], 3)
    trail, guesses, contexts = past.trail, past.guesses, bits.contexts
    winners = past.winners[place]
    for g in range(GUESSES):
        guess = guesses[g]
        if guess < 0 or guess >= count:
            continue
        agreeing = 0
        for h in range(GUESSES):
            agreeing |= (guesses[h] == guess) << h
        if agreeing & ((1 << g) - 1):
            continue  # it was said already that it is not this one
        again = 0
        for other in range(max(start, corner - _LOOKED_AT), corner):
            again |= indices[other] == guess
        kind = place * GUESSES + g
        fan = (again * 4 + min(mesh.open_edges[guess], 3)) * 9 + min(mesh.degrees[guess], 8)
        age = _bit_length(polygon - past.used[guess]) if past.used[guess] >= 0 else 63
        successes = past.successes[place, g]
        contexts[0] = (successes << 7 | (fan if again else 0)) << 7 | kind
        contexts[1] = (agreeing << 1 | again) << 7 | kind
        contexts[2] = ((trail[0] << 5 | trail[1]) << 5 | trail[2]) << 7 | kind
        contexts[3] = ((winners[0] << 5 | winners[1]) << 5 | trail[0]) << 7 | kind
        contexts[4] = (fan << 6 | around) << 7 | kind
        contexts[5] = ((_clamped(guess - before) << 6 | _clamped(guess - first)) << 5 | trail[0]) << 7 | kind
        contexts[6] = ((agreeing << 5 | trail[0]) << 7 | fan) << 7 | kind
        contexts[7] = ((age << 4 | min(run, 15)) << 3 | (successes & 7)) << 7 | kind
        if code(bits, kind, 1 if guess == vertex else 0):
            return guess, g
    return _named(bits, mesh, past, vertex, before, place, last_new)


@inlined
def _named(
    bits: Bits, mesh: HalfEdges, past: Past, vertex: int, before: int, place: int, last_new: int
) -> tuple[int, int]:
    """Code a vertex that no guess had: its state, and its distance among the vertices of this state from a base."""
    about, bases = past.about, past.bases
    about[0] = about[4] = place
    about[1] = about[5] = (past.trail[0] << 5 | past.trail[1]) << 2 | place
    about[2] = about[6] = past.winners[place, 0] << 2 | place
    about[3] = about[7] = about[1] << 5 | past.winners[place, 0]
    state = 0 if bits.decoding else mesh.states[vertex] - OPEN
    state = _number(bits, past, _STATES, state) + OPEN
    if bits.failed[0] or state < UNUSED or state > CLOSED:
        bits.failed[0] = 1
        return 0, 0

    bases[0], bases[1], bases[2] = last_new + 1, before, past.named[place]
    for i in range(6):
        bases[3 + i] = past.near[i]
    distances = past.distances[state, place]
    best, second = 0, 1
    for base in range(1, _BASES):
        if distances[base] < distances[best]:
            best, second = base, best
        elif distances[base] < distances[second]:
            second = base
    origin = rank_of(mesh, state, bases[best])
    apart = rank_of(mesh, state, bases[second]) - origin
    members = mesh.members[state]
    last = _bit_length(past.last_distances[state]) << 2 | place
    near = min(max(apart, -7), 7) + 7 << 2 | place
    far = best << 7 | _bit_length(apart) << 1 | (apart < 0)
    about[0] = 0
    about[1] = near
    about[2] = far
    about[3] = far << 8 | near
    about[4] = last
    about[5] = last << 8 | near
    about[6] = (origin * 16 // (members + 1)) << 6 | _bit_length(members)
    about[7] = (distances[best] >> 6) << 2 | place
    distance = 0 if bits.decoding else rank_of(mesh, state, vertex) - origin
    distance = _number(bits, past, state, distance)
    past.last_distances[state] = distance
    rank = origin + distance
    if bits.failed[0] or rank < 0 or rank >= members:
        bits.failed[0] = 1
        return 0, 0
    for base in range(_BASES):
        off = 256 * _bit_length(rank_of(mesh, state, bases[base]) - rank)
        distances[base] += (off - distances[base]) >> 4
    vertex = vertex_of(mesh, state, rank)
    past.named[place] = vertex
    return vertex, GUESSES + state


@compiled
def _number(bits: Bits, past: Past, what: int, number: int) -> int:
    """Code a number: whether it is 0, its sign, how many bits its magnitude has, and those after the first."""
    magnitude = abs(number)
    stage = length = negative = shift = 0
    value = 1
    while True:
        node, bit = negative, 1 if magnitude else 0
        if stage == 1:
            node, bit = 0, 1 if number < 0 else 0
        elif stage == 2:
            node, bit = length << 1 | negative, 1 if magnitude >> length else 0
        elif stage == 3:
            node, bit = length << 6 | (value if value < 16 else 16 + shift), (magnitude >> shift) & 1
        for i in range(INPUTS):
            about = past.about[i] if value < 4 else 0
            bits.contexts[i] = about << 20 | node << 5 | what << 2 | stage | 1 << 60
        bit = code(bits, 4 * (GUESSES + what) + stage, bit)
        if stage == 0:
            if not bit:
                return 0
            stage = 1
        elif stage == 1:
            negative, stage, length = bit, 2, 1
        elif stage == 2 and bit and length < LONGEST:
            length += 1
        else:
            if stage == 2:
                stage, shift = 3, length - 1
            else:
                value = value << 1 | bit
            shift -= 1
            if shift < 0:
                return -value if negative else value


@inlined
def _slot(indices: Index, corner: int, place: int) -> int:
    """Where it is remembered what came after the last three differences."""
    key = indices[corner] - indices[corner - 1]
    key = key * 1000003 + indices[corner - 1] - indices[corner - 2]
    key = key * 1000003 + indices[corner - 2] - indices[corner - 3]
    slot: int = ((key * 4 + place) * SPREAD >> 32) & (_REPEATS - 1)
    return slot


@compiled
def _bit_length(number: int) -> int:
    """How many bits the magnitude of a number has."""
    rest = abs(number)
    length = 0
    while rest:
        rest >>= 1
        length += 1
    return length


@inlined
def _clamped(number: int) -> int:
    """A small number as one from 1 to 63, larger ones as the nearest of these."""
    return min(max(number, -31), 31) + 32
