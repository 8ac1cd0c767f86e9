"""The compiled loop over all corners of a mesh, for coding and decoding connectivity.

*Half-edges* of a mesh that grows polygon by polygon run from a corner's vertex to the next corner's. A half-edge is
*open* until another one runs the other way. A vertex is *unused* until a polygon has it, then *open* while open
half-edges end or start there, else *closed*; it may open again. Vertices of a state have ranks, in the order of their
numbers, by a tree of partial sums (Fenwick 1994, *A new data structure for cumulative frequency tables*).

*Guesses.* The *place* of a corner is 0 for the first, 1 for the second, 3 for the last and 2 for those between. With
*b* the corner before (of any polygon; 0 at the start), *s* the first corner of this polygon (*b* at place 0), and
:math:`p_0, p_1, p_2` the first, second and last corner of the polygon before (0 at the start), :math:`q_i` those of the
one before that, the guesses at a corner are

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

*Bits.* Every new guess at a corner that is a vertex is one bit: whether it is right. If none is, the vertex is *named*:
its state as a number (-1 unused, 0 open, 1 closed), and the count of vertices of this state between a base and it. The
base is the one nearest on average among the vertex after the last new one, the corner before, the vertex named last at
this place, and the corners of the last two polygons. A number is coded as whether it is not 0, whether it is negative,
whether its magnitude has a second bit, a third, ..., and its bits after the highest. The code here specifies the
contexts of all bits.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``). numba caches compiled loops
by the text of their own file, and this one inlines `arithmetic`: edit this file whenever that changes. Format 5.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.arithmetic import INPUTS, SPREAD, Bits, bit_length, code_hashed, has_failed
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Index

Small = NDArray[np.int32]

UNUSED, OPEN, CLOSED = 0, 1, 2
"""States of vertices. Frozen: breaks old files."""

INTO, OUT_OF = 0, 1
"""Half-edges that end, or start, at a vertex. Free: rows of tables."""

_SEARCHED_HALF_EDGES = 32
"""Open half-edges at a vertex, after the first, searched for the opposite one. Frozen: breaks old files."""


class HalfEdges(NamedTuple):
    """The mesh so far. A half-edge has the number of its first corner."""

    tails: Small  # (C,) start vertex of every half-edge that was opened
    heads: Small  # (C,) end vertex of every half-edge that was opened
    # (2, V) the newest open half-edge into (0) and out of (1) every vertex, -1 if there is none.
    newest: Small
    older: Small  # (2, C) next older open half-edge into the head (0) and out of the tail (1), -1 for none
    newer: Small  # (2, C) next newer open half-edge into the head (0) and out of the tail (1), -1 for none
    open_edges: Small  # (V,) number of open half-edges that end or start at a vertex
    degrees: Small  # (V,) number of corners at a vertex
    states: NDArray[np.uint8]  # (V,) UNUSED, OPEN, or CLOSED
    members: Index  # (3,) number of vertices in every state
    trees: Small  # (3, V + 1) partial sums over the vertices of every state
    # (2, V + 2) for vertex v at v + 1, the next unused vertex below (0) and above (1), also at v + 1; of used vertices,
    # as it was when they came into use. The ends are no vertices.
    unused: Small


def no_half_edges(corner_count: int, vertex_count: int) -> HalfEdges:
    """Return a mesh of unused vertices."""
    trees = np.zeros((3, vertex_count + 1), dtype=np.int32)
    numbers = np.arange(vertex_count + 1, dtype=np.int32)
    trees[UNUSED] = numbers & -numbers
    return HalfEdges(
        tails=np.zeros(corner_count, dtype=np.int32),
        heads=np.zeros(corner_count, dtype=np.int32),
        newest=np.full((2, vertex_count), -1, dtype=np.int32),
        older=np.full((2, corner_count), -1, dtype=np.int32),
        newer=np.full((2, corner_count), -1, dtype=np.int32),
        open_edges=np.zeros(vertex_count, dtype=np.int32),
        degrees=np.zeros(vertex_count, dtype=np.int32),
        states=np.zeros(vertex_count, dtype=np.uint8),
        members=np.array([vertex_count, 0, 0], dtype=np.int64),
        trees=trees,
        unused=np.stack([np.arange(-1, vertex_count + 1), np.arange(1, vertex_count + 3)]).astype(np.int32),
    )


@compiled
def rank_of(mesh: HalfEdges, state: int, vertex: int) -> int:
    """Return the number of vertices of a state before a vertex, from 0 to V."""
    rank = 0
    while vertex > 0:
        rank += mesh.trees[state, vertex]
        vertex &= vertex - 1
    return rank


@compiled
def vertex_of(mesh: HalfEdges, state: int, rank: int) -> int:
    """Return the vertex of a state and rank, which must be below the number of vertices of that state."""
    count = mesh.trees.shape[1]
    step = 1
    while 2 * step < count:
        step *= 2
    vertex = 0
    while step:
        if vertex + step < count and mesh.trees[state, vertex + step] <= rank:
            vertex += step
            rank -= mesh.trees[state, vertex]
        step >>= 1
    return vertex


@compiled
def move(mesh: HalfEdges, vertex: int, state: int) -> None:
    """Set the state of a vertex."""
    old = mesh.states[vertex]
    if old == state:
        return
    mesh.states[vertex] = state
    mesh.members[old] -= 1
    mesh.members[state] += 1
    if old == UNUSED:
        below, above = mesh.unused[0, vertex + 1], mesh.unused[1, vertex + 1]
        mesh.unused[1, below] = above
        mesh.unused[0, above] = below
    at = vertex + 1
    while at < mesh.trees.shape[1]:
        mesh.trees[old, at] -= 1
        mesh.trees[state, at] += 1
        at += at & -at


@compiled
def add_polygon(mesh: HalfEdges, indices: Index, start: int, stop: int) -> None:
    """Add the polygon with the corners from `start` to below `stop`."""
    for corner in range(start, stop):
        _add(mesh, corner, indices[corner], indices[corner + 1 if corner + 1 < stop else start])
    for corner in range(start, stop):
        vertex = indices[corner]
        mesh.degrees[vertex] += 1
        move(mesh, vertex, OPEN if mesh.open_edges[vertex] else CLOSED)


@force_inlined
def _add(mesh: HalfEdges, edge: int, tail: int, head: int) -> None:
    """Close the opposite half-edge, or open this one."""
    other = mesh.newest[INTO, tail]
    for _ in range(_SEARCHED_HALF_EDGES):
        if other < 0 or mesh.tails[other] == head:
            break
        other = mesh.older[INTO, other]
    change = 1
    if other >= 0 and mesh.tails[other] == head:
        _unlink(mesh, INTO, tail, other)
        _unlink(mesh, OUT_OF, head, other)
        change = -1
    else:
        mesh.tails[edge] = tail
        mesh.heads[edge] = head
        _link(mesh, INTO, head, edge)
        _link(mesh, OUT_OF, tail, edge)
    mesh.open_edges[tail] += change
    mesh.open_edges[head] += change


@force_inlined
def _link(mesh: HalfEdges, way: int, vertex: int, edge: int) -> None:
    newest = mesh.newest[way, vertex]
    mesh.older[way, edge] = newest
    if newest >= 0:
        mesh.newer[way, newest] = edge
    mesh.newest[way, vertex] = edge


@force_inlined
def _unlink(mesh: HalfEdges, way: int, vertex: int, edge: int) -> None:
    older, newer = mesh.older[way, edge], mesh.newer[way, edge]
    if older >= 0:
        mesh.newer[way, older] = newer
    if newer >= 0:
        mesh.older[way, newer] = older
    else:
        mesh.newest[way, vertex] = older


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


@force_inlined
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


@force_inlined
def remember(past: Past, place: int, vertex: int, winner: int) -> None:
    """Record the right guesses at a corner; `winner` is the first of them, or `GUESSES` plus the state."""
    for g in range(GUESSES):
        if past.guesses[g] >= 0:
            right = 1 if past.guesses[g] == vertex else 0
            past.successes[place, g] = (past.successes[place, g] << 1 | right) & 255
    past.trail[2], past.trail[1], past.trail[0] = past.trail[1], past.trail[0], winner
    past.winners[place, 1], past.winners[place, 0] = past.winners[place, 0], winner


@force_inlined
def slot_of(indices: Index, corner: int, place: int) -> int:
    """Return the slot in `Past.repeats` of the last three differences of corners."""
    key = np.uint64(indices[corner] - indices[corner - 1])
    key = key * _NEXT + np.uint64(indices[corner - 1] - indices[corner - 2])
    key = key * _NEXT + np.uint64(indices[corner - 2] - indices[corner - 3])
    slot = np.int64((key * _PLACES + np.uint64(place)) * SPREAD >> _MIDDLE)
    return int(slot) & (_REPEATS - 1)


KINDS = 4 * GUESSES + 4 * 5
"""Kinds of bits with mixing weights of their own: guesses by place, numbers by topic. Frozen: breaks old files."""

_COUNTS, _STATES = 3, 4
"""Topics of numbers: 0 to 2 ranks of unused, open, closed vertices; corner counts; states. Frozen: breaks old files."""

_LONGEST = 33
"""Bits of the largest numbers. Frozen: breaks old files."""

_LOOKED_AT = 32
"""Corners of a polygon searched for a repeated vertex, which bounds the time. Frozen: breaks old files."""


@compiled
def walk(bits: Bits, mesh: HalfEdges, past: Past, counts: Index, indices: Index) -> None:
    """Code all polygons, or decode them into `counts` (P,) and `indices` (C,); set `bits.failed` on failure."""
    corner = 0
    first = previous = 0  # first corners of the last two polygons
    last_new = -1
    repeat = run = 0  # the corner after the same differences, and for how long it was right
    for polygon in range(len(counts)):
        start = corner
        old = counts[polygon - 1] if polygon else 3
        older = counts[polygon - 2] if polygon > 1 else 3
        for i in range(INPUTS):
            past.about[i] = min(old, 63) << 6 | min(older, 63)
        counts[polygon] = old + _number(bits, past, _COUNTS, counts[polygon] - old)
        stop = start + counts[polygon]
        if has_failed(bits) or counts[polygon] < 3 or stop > len(indices):
            bits.failed[0] = 1
            return
        for corner in range(start, stop):
            j = corner - start
            place = 3 if corner == stop - 1 else min(j, 2)
            before = indices[corner - 1] if corner else 0
            make_guesses(mesh, past, place, before, indices[start] if j else before, last_new)
            if repeat:
                past.guesses[8] = before + indices[repeat] - indices[repeat - 1]
            if j and first + j < start:
                past.guesses[9] = before + indices[first + j] - indices[first + j - 1]
            if j and previous + j < first:
                past.guesses[10] = before + indices[previous + j] - indices[previous + j - 1]
            vertex, winner = _vertex(bits, mesh, past, indices, polygon, start, corner, place, last_new, run)
            if has_failed(bits):
                return
            indices[corner] = vertex
            remember(past, place, vertex, winner)
            if repeat and past.guesses[8] == vertex:
                repeat, run = repeat + 1, run + 1
            else:
                repeat = run = 0
            if corner > 2:
                slot = slot_of(indices, corner, place)
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


@force_inlined
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
    """Code the vertex of a corner: the first right guess, or its state and rank. Also return the index of the guess."""
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
            continue  # excluded already
        again = 0
        for other in range(max(start, corner - _LOOKED_AT), corner):
            again |= indices[other] == guess
        kind = place * GUESSES + g
        fan = (again * 4 + min(mesh.open_edges[guess], 3)) * 9 + min(mesh.degrees[guess], 8)
        age = bit_length(polygon - past.used[guess]) if past.used[guess] >= 0 else 63
        successes = past.successes[place, g]
        contexts[0] = (successes << 7 | (fan if again else 0)) << 7 | kind
        contexts[1] = (agreeing << 1 | again) << 7 | kind
        contexts[2] = ((trail[0] << 5 | trail[1]) << 5 | trail[2]) << 7 | kind
        contexts[3] = ((winners[0] << 5 | winners[1]) << 5 | trail[0]) << 7 | kind
        contexts[4] = (fan << 6 | around) << 7 | kind
        contexts[5] = ((_clamped(guess - before) << 6 | _clamped(guess - first)) << 5 | trail[0]) << 7 | kind
        contexts[6] = ((agreeing << 5 | trail[0]) << 7 | fan) << 7 | kind
        contexts[7] = ((age << 4 | min(run, 15)) << 3 | (successes & 7)) << 7 | kind
        if code_hashed(bits, kind, 1 if guess == vertex else 0):
            return guess, g
    return _named(bits, mesh, past, vertex, before, place, last_new)


@force_inlined
def _named(
    bits: Bits, mesh: HalfEdges, past: Past, vertex: int, before: int, place: int, last_new: int
) -> tuple[int, int]:
    """Code a vertex that was not guessed: its state, and its distance from a base among the vertices of this state."""
    about, bases = past.about, past.bases
    about[0] = about[4] = place
    about[1] = about[5] = (past.trail[0] << 5 | past.trail[1]) << 2 | place
    about[2] = about[6] = past.winners[place, 0] << 2 | place
    about[3] = about[7] = about[1] << 5 | past.winners[place, 0]
    state = 0 if bits.coded.decoding else mesh.states[vertex] - OPEN
    state = _number(bits, past, _STATES, state) + OPEN
    if state < UNUSED or state > CLOSED:
        bits.failed[0] = 1
        return 0, 0

    bases[0], bases[1], bases[2] = last_new + 1, before, past.named[place]
    for i in range(6):
        bases[3 + i] = past.near[i]
    distances = past.distances[state, place]
    best, second = 0, 1
    for base in range(1, BASES):
        if distances[base] < distances[best]:
            best, second = base, best
        elif distances[base] < distances[second]:
            second = base
    origin = rank_of(mesh, state, bases[best])
    apart = rank_of(mesh, state, bases[second]) - origin
    members = mesh.members[state]
    last = bit_length(past.last_distances[state]) << 2 | place
    near = min(max(apart, -7), 7) + 7 << 2 | place
    far = best << 7 | bit_length(apart) << 1 | (apart < 0)
    about[0] = 0
    about[1] = near
    about[2] = far
    about[3] = far << 8 | near
    about[4] = last
    about[5] = last << 8 | near
    about[6] = (origin * 16 // (members + 1)) << 6 | bit_length(members)
    about[7] = (distances[best] >> 6) << 2 | place
    distance = 0 if bits.coded.decoding else rank_of(mesh, state, vertex) - origin
    distance = _number(bits, past, state, distance)
    past.last_distances[state] = distance
    rank = origin + distance
    if rank < 0 or rank >= members:
        bits.failed[0] = 1
        return 0, 0
    for base in range(BASES):
        off = 256 * bit_length(rank_of(mesh, state, bases[base]) - rank)
        distances[base] += (off - distances[base]) >> 4
    vertex = vertex_of(mesh, state, rank)
    past.named[place] = vertex
    return vertex, GUESSES + state


@compiled
def _number(bits: Bits, past: Past, what: int, number: int) -> int:
    """Code a number: whether it is 0, its sign, the bit length of its magnitude, and the bits after the first."""
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
        bit = code_hashed(bits, 4 * (GUESSES + what) + stage, bit)
        if stage == 0:
            if not bit:
                return 0
            stage = 1
        elif stage == 1:
            negative, stage, length = bit, 2, 1
        elif stage == 2 and bit and length < _LONGEST:
            length += 1
        else:
            if stage == 2:
                stage, shift = 3, length - 1
            else:
                value = value << 1 | bit
            shift -= 1
            if shift < 0:
                return -value if negative else value


@force_inlined
def _clamped(number: int) -> int:
    """Clamp a number for use as a context, which is from 1 to 63."""
    return min(max(number, -31), 31) + 32
