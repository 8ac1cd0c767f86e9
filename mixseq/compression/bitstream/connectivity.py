"""Code polygons without loss: the order of vertices and faces, and first corners, are kept.

Users refer to vertices and faces by number, so the mesh cannot be renumbered as Edgebreaker does. Corners are coded in
the given order, in one compiled loop. They are predicted from the known mesh, from the last polygons, and from the
numbers of their neighbours (in the spirit of the index codec of *meshoptimizer*). Probabilities of the predictions are
learned bit by bit (`mixseq.compression.bitstream.arithmetic`). Meshes in coherent order take 2 to 10 bits per triangle;
random order takes about half a logarithm of V! F!.

The mesh grows by polygons. A *half-edge* runs from the vertex of a corner to the vertex of the next corner, and is
*open* until its opposite is added. A vertex is *unused* until a polygon has it, then *open* while open half-edges end
or start at it, otherwise *closed*; a closed vertex may open again. The rank of a vertex among all vertices of its state
comes from a tree of partial sums (Fenwick 1994, *A new data structure for cumulative frequency tables*).

For every polygon, its number of corners minus that of the polygon before is coded, then its corners. Sixteen *guesses*
follow from open half-edges, unused vertices and earlier corners; one bit codes whether a guess is right. If none is
right, the vertex is *named*: by its state, then by the difference of its rank in this state from the rank of a base.
The checksum of counts and corners follows.

Frozen: changing this breaks old files (guesses, bases and contexts are specified in ``docs/file-format.md``; golden:
``tests/formats/golden/compressed-v1.h5``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.arithmetic import (
    CONTEXTS_PER_BIT,
    DAMAGE_CURE,
    HASH_MULTIPLIER,
    HashedBits,
    bit_length,
    checksum_of,
    code_hashed_bit,
    finish_hashed,
    has_failed,
    new_hashed_output,
    open_hashed_input,
)
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.mesh.polygons import Polygons
from mixseq.runtime.jit import compiled, force_inlined
from mixseq.types import Index, Int32

UNUSED, OPEN, CLOSED = 0, 1, 2  # states of vertices; frozen
INTO, OUT_OF = 0, 1  # rows of tables for half-edges that end, or start, at a vertex; free: not in files
_MAX_SEARCHED_HALF_EDGES = 32  # open half-edges at a vertex, after the first, searched for the opposite; frozen


class HalfEdges(NamedTuple):
    """The mesh of the polygons coded up to now. A half-edge has the number of its first corner."""

    tails: Int32  # (C,) start vertex of every half-edge that was opened
    heads: Int32  # (C,) end vertex of every half-edge that was opened
    # (2, V) the newest open half-edge into (0) and out of (1) every vertex, -1 if there is none.
    newest: Int32
    older: Int32  # (2, C) next older open half-edge into the head (0) and out of the tail (1), -1 for none
    newer: Int32  # (2, C) next newer open half-edge into the head (0) and out of the tail (1), -1 for none
    open_edges: Int32  # (V,) number of open half-edges that end or start at a vertex
    degrees: Int32  # (V,) number of corners at a vertex
    states: NDArray[np.uint8]  # (V,) UNUSED, OPEN, or CLOSED
    state_counts: Index  # (3,) number of vertices in every state
    trees: Int32  # (3, V + 1) partial sums over the vertices of every state
    # (2, V + 2) next unused vertex below (0) and above (1) every vertex. Vertex v has the index and the number v + 1. A
    # used vertex keeps the values from its first use. The first and the last index are not vertices.
    unused: Int32


def new_half_edges(corner_count: int, vertex_count: int) -> HalfEdges:
    """Return a mesh without polygons, whose vertices are unused."""
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
        state_counts=np.array([vertex_count, 0, 0], dtype=np.int64),
        trees=trees,
        unused=np.stack([np.arange(-1, vertex_count + 1), np.arange(1, vertex_count + 3)]).astype(np.int32),
    )


@force_inlined
def vertex_rank(mesh: HalfEdges, state: int, vertex: int) -> int:
    """Return the number of vertices of a state before a vertex, from 0 to V."""
    rank = 0
    while vertex > 0:
        rank += mesh.trees[state, vertex]
        vertex &= vertex - 1
    return rank


@force_inlined
def vertex_at_rank(mesh: HalfEdges, state: int, rank: int) -> int:
    """Return the vertex of a state with a rank, which must be below the number of vertices of this state."""
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


@force_inlined
def set_state(mesh: HalfEdges, vertex: int, state: int) -> None:
    """Set the state of a vertex."""
    old = mesh.states[vertex]
    if old == state:
        return
    mesh.states[vertex] = state
    mesh.state_counts[old] -= 1
    mesh.state_counts[state] += 1
    if old == UNUSED:
        below, above = mesh.unused[0, vertex + 1], mesh.unused[1, vertex + 1]
        mesh.unused[1, below] = above
        mesh.unused[0, above] = below
    node = vertex + 1
    while node < mesh.trees.shape[1]:
        mesh.trees[old, node] -= 1
        mesh.trees[state, node] += 1
        node += node & -node


@force_inlined
def add_polygon(mesh: HalfEdges, indices: Index, start: int, stop: int) -> None:
    """Add the polygon with the corners from `start` to below `stop`."""
    for corner in range(start, stop):
        _add_half_edge(mesh, corner, indices[corner], indices[corner + 1 if corner + 1 < stop else start])
    for corner in range(start, stop):
        vertex = indices[corner]
        mesh.degrees[vertex] += 1
        set_state(mesh, vertex, OPEN if mesh.open_edges[vertex] else CLOSED)


@force_inlined
def _add_half_edge(mesh: HalfEdges, edge: int, tail: int, head: int) -> None:
    """Close the opposite half-edge, or open this one."""
    opposite = mesh.newest[INTO, tail]
    for _ in range(_MAX_SEARCHED_HALF_EDGES):
        if opposite < 0 or mesh.tails[opposite] == head:
            break
        opposite = mesh.older[INTO, opposite]
    change = 1
    if opposite >= 0 and mesh.tails[opposite] == head:
        _unlink(mesh, INTO, tail, opposite)
        _unlink(mesh, OUT_OF, head, opposite)
        change = -1
    else:
        mesh.tails[edge] = tail
        mesh.heads[edge] = head
        _link(mesh, INTO, head, edge)
        _link(mesh, OUT_OF, tail, edge)
    mesh.open_edges[tail] += change
    mesh.open_edges[head] += change


@force_inlined
def _link(mesh: HalfEdges, side: int, vertex: int, edge: int) -> None:
    newest = mesh.newest[side, vertex]
    mesh.older[side, edge] = newest
    if newest >= 0:
        mesh.newer[side, newest] = edge
    mesh.newest[side, vertex] = edge


@force_inlined
def _unlink(mesh: HalfEdges, side: int, vertex: int, edge: int) -> None:
    older, newer = mesh.older[side, edge], mesh.newer[side, edge]
    if older >= 0:
        mesh.newer[side, older] = newer
    if newer >= 0:
        mesh.older[side, newer] = older
    else:
        mesh.newest[side, vertex] = older


GUESS_COUNT, BASE_COUNT = 16, 9  # number of guesses at a corner, and of bases for naming a vertex; frozen
_REPEAT_SLOTS = 1 << 16  # number of slots in the table from three corner differences to the next corner; frozen

_HASH_FACTOR, _HASH_PLACES, _HASH_SHIFT = np.uint64(1000003), np.uint64(4), np.uint64(32)
"""Factors of the hash from differences to a slot, and right shift of the result. Frozen: breaks old files."""


class History(NamedTuple):
    """History of earlier corners, in addition to the mesh."""

    guesses: Index  # (GUESS_COUNT,) guesses at the current corner, -1 if there is none
    successes: Index  # (4, GUESS_COUNT) for every place, 8 bits: whether the last 8 guesses were right
    # (4, 2) at every place of the last two polygons: right guess, or GUESS_COUNT plus the state of the named vertex.
    winners: Index
    recent_winners: Index  # (3,) the same numbers for the last three corners
    recent_corners: Index  # (6,) first, second and last corner of the last polygon, and of the polygon before it
    bases: Index  # (BASE_COUNT,) candidates for the base of the current vertex
    # (3, 4, BASE_COUNT) for every state, place and base: mean bit length of the distance in ranks, in 256ths.
    distances: Index
    last_unguessed: Index  # (4,) the last named vertex at every place
    last_distances: Index  # (3,) the last distance in ranks for every state
    repeats: Index  # (_REPEAT_SLOTS,) corner that last followed the differences of a slot, 0 for none
    facts: Index  # (CONTEXTS_PER_BIT,) known facts that are contexts of the current number
    last_polygons: Int32  # (V,) the polygon that had a vertex last, -1 if there is none


def new_history(vertex_count: int) -> History:
    """Return an empty history."""

    def zeros(*shape: int) -> Index:
        return np.zeros(shape, dtype=np.int64)

    return History(
        guesses=zeros(GUESS_COUNT),
        successes=zeros(4, GUESS_COUNT),
        winners=zeros(4, 2),
        recent_winners=zeros(3),
        recent_corners=zeros(6),
        bases=zeros(BASE_COUNT),
        distances=zeros(3, 4, BASE_COUNT),
        last_unguessed=zeros(4),
        last_distances=zeros(3),
        repeats=zeros(_REPEAT_SLOTS),
        facts=zeros(CONTEXTS_PER_BIT),
        last_polygons=np.full(vertex_count, -1, dtype=np.int32),
    )


@force_inlined
def make_guesses(mesh: HalfEdges, history: History, place: int, previous: int, first: int, last_new: int) -> None:
    """Guess the vertex of the corner at a place 0 to 3 of a polygon with the first vertex `first`.

    `previous` is the vertex of the corner before, `last_new` the vertex last used for the first time.
    """
    guesses, corners = history.guesses, history.recent_corners
    guesses[:] = -1
    if place == 0:
        for i in range(3):
            edge = mesh.newest[INTO, corners[i]]
            if edge >= 0:
                guesses[i] = mesh.tails[edge]
            edge = mesh.newest[OUT_OF, corners[i]]
            if edge >= 0:
                guesses[3 + i] = mesh.heads[edge]
        guesses[9] = 2 * corners[0] - corners[3]
    else:
        edge = mesh.newest[INTO, previous]
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
        guesses[11 + i] = corners[i]
    guesses[14] = previous + 1
    guesses[15] = previous - 1


@force_inlined
def record_guesses(history: History, place: int, vertex: int, winner: int) -> None:
    """Record the right guesses at a corner; `winner` is the first right guess, or `GUESS_COUNT` plus the state."""
    successes, winners, recent = history.successes, history.winners, history.recent_winners
    for g in range(GUESS_COUNT):
        if history.guesses[g] >= 0:
            is_right = 1 if history.guesses[g] == vertex else 0
            successes[place, g] = (successes[place, g] << 1 | is_right) & 255
    recent[2], recent[1], recent[0] = recent[1], recent[0], winner
    winners[place, 1], winners[place, 0] = winners[place, 0], winner


@force_inlined
def repeat_slot(indices: Index, corner: int, place: int) -> int:
    """Return the slot in `History.repeats` of the last three differences of corners."""
    key = np.uint64(indices[corner] - indices[corner - 1])
    key = key * _HASH_FACTOR + np.uint64(indices[corner - 1] - indices[corner - 2])
    key = key * _HASH_FACTOR + np.uint64(indices[corner - 2] - indices[corner - 3])
    slot = np.int64((key * _HASH_PLACES + np.uint64(place)) * HASH_MULTIPLIER >> _HASH_SHIFT)
    return int(slot) & (_REPEAT_SLOTS - 1)


BIT_KINDS = 4 * GUESS_COUNT + 4 * 5
"""Kinds of bits, which have separate mixing weights: guesses by place, numbers by topic. Frozen: breaks old files."""

_COUNT_TOPIC, _STATE_TOPIC = 3, 4  # topics of numbers; topics 0 to 2 are ranks of unused, open, closed vertices; frozen
_MAX_NUMBER_BITS = 33  # largest bit length of a number; frozen
_MAX_SEARCHED_CORNERS = 32  # largest number of corners per polygon searched for a repeated vertex; frozen


@compiled
def code_polygons(bits: HashedBits, mesh: HalfEdges, history: History, counts: Index, indices: Index) -> None:
    """Code all polygons, or decode them into `counts` (P,) and `indices` (C,); set `bits.failed` on failure."""
    guesses, recent_corners = history.guesses, history.recent_corners
    corner = 0
    last_start = older_start = 0  # first corners of the last two polygons
    last_new = -1  # vertex last used for the first time
    repeat = run = 0  # corner after the last equal differences, and number of consecutive right guesses by it
    for polygon in range(len(counts)):
        start = corner
        last_count = counts[polygon - 1] if polygon else 3
        older_count = counts[polygon - 2] if polygon > 1 else 3
        for i in range(CONTEXTS_PER_BIT):
            history.facts[i] = min(last_count, 63) << 6 | min(older_count, 63)
        counts[polygon] = last_count + _code_number(bits, history, _COUNT_TOPIC, counts[polygon] - last_count)
        stop = start + counts[polygon]
        if has_failed(bits) or counts[polygon] < 3 or stop > len(indices):
            bits.failed[0] = 1
            return
        for corner in range(start, stop):
            offset = corner - start
            place = 3 if corner == stop - 1 else min(offset, 2)
            previous = indices[corner - 1] if corner else 0
            make_guesses(mesh, history, place, previous, indices[start] if offset else previous, last_new)
            if repeat:
                guesses[8] = previous + indices[repeat] - indices[repeat - 1]
            same = last_start + offset  # the same corner of the last polygon
            if offset and same < start:
                guesses[9] = previous + indices[same] - indices[same - 1]
            same = older_start + offset
            if offset and same < last_start:
                guesses[10] = previous + indices[same] - indices[same - 1]
            vertex, winner = _code_vertex(bits, mesh, history, indices, polygon, start, corner, place, last_new, run)
            if has_failed(bits):
                return
            indices[corner] = vertex
            record_guesses(history, place, vertex, winner)
            if repeat and guesses[8] == vertex:
                repeat, run = repeat + 1, run + 1
            else:
                repeat = run = 0
            if corner > 2:
                slot = repeat_slot(indices, corner, place)
                repeat = repeat or history.repeats[slot]
                history.repeats[slot] = corner + 1
            if mesh.states[vertex] == UNUSED:
                last_new = vertex
                set_state(mesh, vertex, OPEN)
            history.last_polygons[vertex] = polygon
        corner = stop
        add_polygon(mesh, indices, start, stop)
        for i in range(3):
            recent_corners[3 + i] = recent_corners[i]
        recent_corners[0], recent_corners[1] = indices[start], indices[start + 1]
        recent_corners[2] = indices[stop - 1]
        older_start, last_start = last_start, start
    if corner != len(indices):
        bits.failed[0] = 1


@force_inlined
def _code_vertex(
    bits: HashedBits,
    mesh: HalfEdges,
    history: History,
    indices: Index,
    polygon: int,
    start: int,
    corner: int,
    place: int,
    last_new: int,
    run: int,
) -> tuple[int, int]:
    """Code the vertex of a corner by the first right guess, or by state and rank; return the vertex and the winner."""
    vertex = indices[corner]
    previous = indices[corner - 1] if corner else 0
    first = indices[start] if corner > start else previous
    previous_context = 0
    if corner:
        previous_context = min(mesh.degrees[previous], 8) * 4 + min(mesh.open_edges[previous], 3)
    guesses, contexts = history.guesses, bits.contexts
    winners, recent = history.winners[place], history.recent_winners
    for g in range(GUESS_COUNT):
        guess = guesses[g]
        if guess < 0 or guess >= len(mesh.states):
            continue
        agreeing = 0
        for other in range(GUESS_COUNT):
            agreeing |= (guesses[other] == guess) << other
        if agreeing & ((1 << g) - 1):
            continue  # excluded already
        is_repeated = 0
        for earlier in range(max(start, corner - _MAX_SEARCHED_CORNERS), corner):
            is_repeated |= indices[earlier] == guess
        kind = place * GUESS_COUNT + g
        fan = (is_repeated * 4 + min(mesh.open_edges[guess], 3)) * 9 + min(mesh.degrees[guess], 8)
        last_polygon, successes = history.last_polygons[guess], history.successes[place, g]
        age = bit_length(polygon - last_polygon) if last_polygon >= 0 else 63
        contexts[0] = (successes << 7 | (fan if is_repeated else 0)) << 7 | kind
        contexts[1] = (agreeing << 1 | is_repeated) << 7 | kind
        contexts[2] = ((recent[0] << 5 | recent[1]) << 5 | recent[2]) << 7 | kind
        contexts[3] = ((winners[0] << 5 | winners[1]) << 5 | recent[0]) << 7 | kind
        contexts[4] = (fan << 6 | previous_context) << 7 | kind
        contexts[5] = ((_clamp(guess - previous) << 6 | _clamp(guess - first)) << 5 | recent[0]) << 7 | kind
        contexts[6] = ((agreeing << 5 | recent[0]) << 7 | fan) << 7 | kind
        contexts[7] = ((age << 4 | min(run, 15)) << 3 | (successes & 7)) << 7 | kind
        if code_hashed_bit(bits, kind, 1 if guess == vertex else 0):
            return guess, g
    return _code_unguessed(bits, mesh, history, vertex, previous, place, last_new)


@force_inlined
def _code_unguessed(
    bits: HashedBits, mesh: HalfEdges, history: History, vertex: int, previous: int, place: int, last_new: int
) -> tuple[int, int]:
    """Code a vertex that no guess gives, by its state, and its distance from a base in ranks of this state."""
    facts, bases, recent = history.facts, history.bases, history.recent_winners
    facts[0] = facts[4] = place
    facts[1] = facts[5] = (recent[0] << 5 | recent[1]) << 2 | place
    facts[2] = facts[6] = history.winners[place, 0] << 2 | place
    facts[3] = facts[7] = facts[1] << 5 | history.winners[place, 0]
    state = 0 if bits.stream.is_input else mesh.states[vertex] - OPEN
    state = _code_number(bits, history, _STATE_TOPIC, state) + OPEN
    if state < UNUSED or state > CLOSED:
        bits.failed[0] = 1
        return 0, 0

    bases[0], bases[1], bases[2] = last_new + 1, previous, history.last_unguessed[place]
    for i in range(6):
        bases[3 + i] = history.recent_corners[i]
    distances = history.distances[state, place]
    best, second = 0, 1
    for base in range(1, BASE_COUNT):
        if distances[base] < distances[best]:
            best, second = base, best
        elif distances[base] < distances[second]:
            second = base
    origin = vertex_rank(mesh, state, bases[best])
    offset = vertex_rank(mesh, state, bases[second]) - origin  # of the second base
    count = mesh.state_counts[state]
    last_distance = bit_length(history.last_distances[state]) << 2 | place
    small_offset = min(max(offset, -7), 7) + 7 << 2 | place
    any_offset = best << 7 | bit_length(offset) << 1 | (offset < 0)
    facts[0] = 0
    facts[1] = small_offset
    facts[2] = any_offset
    facts[3] = any_offset << 8 | small_offset
    facts[4] = last_distance
    facts[5] = last_distance << 8 | small_offset
    facts[6] = (origin * 16 // (count + 1)) << 6 | bit_length(count)
    facts[7] = (distances[best] >> 6) << 2 | place
    distance = 0 if bits.stream.is_input else vertex_rank(mesh, state, vertex) - origin
    distance = _code_number(bits, history, state, distance)
    history.last_distances[state] = distance
    rank = origin + distance
    if rank < 0 or rank >= count:
        bits.failed[0] = 1
        return 0, 0
    for base in range(BASE_COUNT):
        distance_bits = 256 * bit_length(vertex_rank(mesh, state, bases[base]) - rank)
        distances[base] += (distance_bits - distances[base]) >> 4
    vertex = vertex_at_rank(mesh, state, rank)
    history.last_unguessed[place] = vertex
    return vertex, GUESS_COUNT + state


@force_inlined
def _code_number(bits: HashedBits, history: History, topic: int, number: int) -> int:
    """Code a number: whether it is not 0, its sign, the bit length of its magnitude, and the bits after the highest."""
    magnitude = abs(number)
    stage = length = negative = shift = 0
    value = 1
    while True:
        prefix, bit = negative, 1 if magnitude else 0
        if stage == 1:
            prefix, bit = 0, 1 if number < 0 else 0
        elif stage == 2:
            prefix, bit = length << 1 | negative, 1 if magnitude >> length else 0
        elif stage == 3:
            prefix, bit = length << 6 | (value if value < 16 else 16 + shift), (magnitude >> shift) & 1
        for i in range(CONTEXTS_PER_BIT):
            fact = history.facts[i] if value < 4 else 0
            bits.contexts[i] = fact << 20 | prefix << 5 | topic << 2 | stage | 1 << 60
        bit = code_hashed_bit(bits, 4 * (GUESS_COUNT + topic) + stage, bit)
        if stage == 0:
            if not bit:
                return 0
            stage = 1
        elif stage == 1:
            negative, stage, length = bit, 2, 1
        elif stage == 2 and bit and length < _MAX_NUMBER_BITS:
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
def _clamp(number: int) -> int:
    """Clamp a number to a context from 1 to 63."""
    return min(max(number, -31), 31) + 32


def encode_polygons(polygons: Polygons, vertex_count: int) -> bytes:
    """Code polygons for `decode_polygons`."""
    if not len(polygons.counts):
        return b""
    lowest, highest = int(polygons.indices.min()), int(polygons.indices.max())
    if lowest < 0 or highest >= vertex_count:
        raise InvalidSequenceError(
            f"corners have vertices {lowest} to {highest}; with {vertex_count} vertices, 0 to {vertex_count - 1} exist"
        )
    counts, indices = polygons.counts.astype(np.int64), polygons.indices.astype(np.int64)
    # Largest number of bits: for guesses, and for numbers (counts, states up to 1, distances).
    count, state, distance = (2 + 2 * largest.bit_length() for largest in (len(indices), 1, vertex_count))
    capacity = len(counts) * count + len(indices) * (GUESS_COUNT + state + distance)
    bits = new_hashed_output(capacity, BIT_KINDS)
    return finish_hashed(bits, _code_polygons(bits, vertex_count, counts, indices))


def _code_polygons(bits: HashedBits, vertex_count: int, counts: Index, indices: Index) -> int:
    """Code polygons, or decode them in place; return their checksum."""
    mesh, history = new_half_edges(len(indices), vertex_count), new_history(vertex_count)
    code_polygons(bits, mesh, history, counts, indices)
    return checksum_of(indices, checksum_of(counts))


def decode_polygons(data: bytes, polygon_count: int, corner_count: int, vertex_count: int) -> Polygons:
    """Decode the polygons written by `encode_polygons`."""
    described = f"{polygon_count} polygons with {corner_count} corners and {vertex_count} vertices"
    in_range = polygon_count >= 0 and corner_count < 1 << 31 and 0 <= vertex_count < 1 << 31
    if not in_range or corner_count < 3 * polygon_count:
        raise FormatError(f"the mesh is damaged, as it cannot have {described}; {DAMAGE_CURE}")
    if not polygon_count or not vertex_count:
        if data or corner_count:
            raise FormatError(f"the coded polygons are damaged, as a mesh with {described} has none; {DAMAGE_CURE}")
        return Polygons(np.zeros(0, dtype=np.int32), np.zeros(0, dtype=np.int32))
    bits, expected = open_hashed_input(data, BIT_KINDS)
    counts, indices = np.zeros(polygon_count, dtype=np.int64), np.zeros(corner_count, dtype=np.int64)
    checksum = _code_polygons(bits, vertex_count, counts, indices)
    if bits.failed[0] or checksum != expected:
        raise FormatError(f"the coded polygons ({described}) are damaged; {DAMAGE_CURE}")
    return Polygons(counts, indices)
