"""The compiled loop over all corners of a mesh of `mixseq.coding.bitstream.connectivity`, for coding and decoding.

Every new guess at a corner (`corner_guesses`) that is a vertex is one bit: whether it is right. If none is, the vertex
is *named*: its state as a number (-1 unused, 0 open, 1 closed), and the count of vertices of this state between a base
and it. The base is the one nearest on average among the vertex after the last new one, the corner before, the vertex
named last at this place, and the corners of the last two polygons. A number is coded as whether it is not 0, whether it
is negative, whether its magnitude has a second bit, a third, ..., and its bits after the highest. The code here
specifies the contexts of all bits.

Frozen: changing this breaks old files (golden: ``tests/formats/golden/compressed-v1.h5``). numba caches compiled loops
by the text of their own file, and this one inlines `corner_guesses`, `hashed_contexts`, `bit_models`, `arithmetic` and
`half_edges`: edit this file whenever these change. Format 4.
"""

from __future__ import annotations

from mixseq.arrays import Index
from mixseq.coding.bitstream.corner_guesses import (
    BASES,
    GUESSES,
    Past,
    make_guesses,
    remember,
    slot_of,
)
from mixseq.coding.bitstream.half_edges import (
    CLOSED,
    OPEN,
    UNUSED,
    HalfEdges,
    add_polygon,
    move,
    rank_of,
    vertex_of,
)
from mixseq.coding.bitstream.hashed_contexts import INPUTS, Bits, code, has_failed
from mixseq.compiled import compiled, joined

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


@joined
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


@joined
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
    distance = 0 if bits.coded.decoding else rank_of(mesh, state, vertex) - origin
    distance = _number(bits, past, state, distance)
    past.last_distances[state] = distance
    rank = origin + distance
    if rank < 0 or rank >= members:
        bits.failed[0] = 1
        return 0, 0
    for base in range(BASES):
        off = 256 * _bit_length(rank_of(mesh, state, bases[base]) - rank)
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
        bit = code(bits, 4 * (GUESSES + what) + stage, bit)
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


@compiled
def _bit_length(number: int) -> int:
    """Return the bit length of a number's magnitude."""
    rest = abs(number)
    length = 0
    while rest:
        rest >>= 1
        length += 1
    return length


@joined
def _clamped(number: int) -> int:
    """Clamp a number for use as a context, which is from 1 to 63."""
    return min(max(number, -31), 31) + 32
