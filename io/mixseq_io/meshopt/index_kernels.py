"""The loops of `mixseq_io.meshopt.indices`: triangles by edges and vertices that were used a short while ago.

The last 16 edges and the last 16 vertices are remembered in rings; `next` is the vertex that comes next if they come in
order, `last` the one that was named last. Names are differences from `last`, in LEB128.
"""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from mixseq.arrays import Index
from mixseq.compiled import compiled, inlined

Bytes = NDArray[np.uint8]

_RING = 16
_TABLE = 16
_WORD = 0xFFFFFFFF


@inlined
def _name(data: Bytes, at: int) -> tuple[int, int]:
    """Return a number in LEB128, at most five bytes, and where the next one begins."""
    number = shift = 0
    for _ in range(5):
        byte = int(data[at])
        at += 1
        number |= (byte & 127) << shift
        shift += 7
        if byte < 128:
            break
    return number & _WORD, at


@inlined
def _put_name(data: Bytes, at: int, number: int) -> int:
    """Write a number in LEB128; return where the next one begins."""
    while number > 127:
        data[at] = number & 127 | 128
        at += 1
        number >>= 7
    data[at] = number
    return at + 1


@inlined
def _difference(zigzag: int) -> int:
    return (zigzag >> 1) ^ -(zigzag & 1)


@inlined
def _zigzag(difference: int) -> int:
    """Return a difference as a number without sign: 0, -1, 1, -2 ... as 0, 1, 2, 3 ..."""
    return 2 * difference if difference >= 0 else -2 * difference - 1


@compiled
def unpack_triangles(data: Bytes, corners: Index) -> bool:
    """Decode the corners ``(3 F,)`` of triangles; whether the data were sound."""
    count = len(corners) // 3
    safe_end = len(data) - _TABLE
    edges = np.full((_RING, 2), -1, np.int64)
    vertices = np.full(_RING, -1, np.int64)
    edge = vertex = upcoming = last = 0
    at = 1 + count
    new, kinds = np.zeros(3, np.int64), np.zeros(3, np.int64)
    for triangle in range(count):
        if at > safe_end:
            return False
        code = int(data[1 + triangle])
        high, low = code >> 4, code & 15
        if high < 15:
            a, b = int(edges[(edge - 1 - high) % _RING, 0]), int(edges[(edge - 1 - high) % _RING, 1])
            c = 0
            if low == 0:
                c = upcoming
                upcoming += 1
            elif low < 13:
                c = int(vertices[(vertex - 1 - low) % _RING])
            elif low < 15:
                last += 2 * (low - 13) - 1
                c = last
            else:
                number, at = _name(data, at)
                last += _difference(number)
                c = last
            if low == 0 or low >= 13:
                vertices[vertex] = c
                vertex = (vertex + 1) % _RING
            edges[edge, 0], edges[edge, 1] = c, b
            edge = (edge + 1) % _RING
            edges[edge, 0], edges[edge, 1] = a, c
            edge = (edge + 1) % _RING
        else:
            named = low >= 14
            pair = int(data[at]) if named else int(data[safe_end + low])
            at += named
            if named and pair == 0:
                upcoming = 0
            kinds[0], kinds[1], kinds[2] = 15 if low == 15 else 0, pair >> 4, pair & 15
            for place in range(3):
                kind = kinds[place]
                if kind == 0:
                    new[place] = upcoming
                    upcoming += 1
                elif kind == 15 and named:
                    number, at = _name(data, at)
                    last += _difference(number)
                    new[place] = last
                else:
                    new[place] = vertices[(vertex - kind) % _RING]
            for place in range(3):
                if kinds[place] == 0 or kinds[place] == 15:
                    vertices[vertex] = new[place]
                    vertex = (vertex + 1) % _RING
            a, b, c = int(new[0]), int(new[1]), int(new[2])
            for place in range(3):
                edges[edge, 0], edges[edge, 1] = new[(place + 1) % 3], new[place]
                edge = (edge + 1) % _RING
        corners[3 * triangle] = a & _WORD
        corners[3 * triangle + 1] = b & _WORD
        corners[3 * triangle + 2] = c & _WORD
    return at == safe_end


@compiled
def pack_triangles(corners: Index, table: Bytes, data: Bytes) -> int:
    """Encode the corners ``(3 F,)`` of triangles without the table; return how many bytes that are."""
    count = len(corners) // 3
    edges = np.full((_RING, 2), -1, np.int64)
    vertices = np.full(_RING, -1, np.int64)
    edge = vertex = upcoming = last = 0
    at = 1 + count
    kinds = np.zeros(3, np.int64)
    for triangle in range(count):
        own = corners[3 * triangle : 3 * triangle + 3]
        found, turn = _edge_of(edges, edge, own)
        if found < 15:
            a, b, c = own[turn], own[(turn + 1) % 3], own[(turn + 2) % 3]
            kind = _place_of(vertices, vertex, c)
            if kind < 1 or kind >= 13:
                kind = 15
                if c == upcoming:
                    kind = 0
                    upcoming += 1
                elif c == last - 1:
                    kind = 13
                elif c == last + 1:
                    kind = 14
            data[1 + triangle] = found << 4 | kind
            if kind == 15:
                at = _put_name(data, at, _zigzag(c - last))
            if kind >= 13:
                last = c
            if kind == 0 or kind >= 13:
                vertices[vertex] = c
                vertex = (vertex + 1) % _RING
            edges[edge, 0], edges[edge, 1] = c, b
            edge = (edge + 1) % _RING
            edges[edge, 0], edges[edge, 1] = a, c
            edge = (edge + 1) % _RING
            continue
        turn = 1 if own[1] == upcoming else (2 if own[2] == upcoming else 0)
        a, b, c = own[turn], own[(turn + 1) % 3], own[(turn + 2) % 3]
        reset = a == 0 and b == 1 and c == 2 and upcoming > 0
        if reset:
            upcoming = 0
            vertices[:] = -1
        kinds[0] = 15
        kinds[1] = _place_of(vertices, vertex, b) + 1
        kinds[2] = _place_of(vertices, vertex, c) + 1
        if a == upcoming:
            kinds[0] = 0
            upcoming += 1
        for place, corner in ((1, b), (2, c)):
            if kinds[place] == 0 or kinds[place] > 14:
                kinds[place] = 15
                if corner == upcoming:
                    kinds[place] = 0
                    upcoming += 1
        pair = kinds[1] << 4 | kinds[2]
        row = 15
        for number in range(14):
            if table[number] == pair:
                row = number
                break
        if kinds[0] == 0 and row < 14 and not reset:
            data[1 + triangle] = 15 << 4 | row
        else:
            data[1 + triangle] = 15 << 4 | (14 if kinds[0] == 0 else 15)
            data[at] = pair
            at += 1
        for place, corner in ((0, a), (1, b), (2, c)):
            if kinds[place] == 15:
                at = _put_name(data, at, _zigzag(corner - last))
                last = corner
            if kinds[place] == 0 or kinds[place] == 15:
                vertices[vertex] = corner
                vertex = (vertex + 1) % _RING
        for one, other in ((b, a), (c, b), (a, c)):
            edges[edge, 0], edges[edge, 1] = one, other
            edge = (edge + 1) % _RING
    return at


@inlined
def _edge_of(edges: Index, edge: int, own: Index) -> tuple[int, int]:
    """Return how long ago an edge of a triangle was used, 15 for longer, and the corner that it begins with."""
    for ago in range(15):
        one, other = edges[(edge - 1 - ago) % _RING]
        for turn in range(3):
            if one == own[turn] and other == own[(turn + 1) % 3]:
                return ago, turn
    return 15, 0


@inlined
def _place_of(vertices: Index, vertex: int, wanted: int) -> int:
    """Return how long ago a vertex was used, -1 for longer."""
    for ago in range(_RING):
        if vertices[(vertex - 1 - ago) % _RING] == wanted:
            return ago
    return -1


@compiled
def unpack_sequence(data: Bytes, indices: Index) -> bool:
    """Decode indices ``(n,)``, each a difference from the last of one of two runs; whether the data were sound."""
    safe_end = len(data) - 4
    last = np.zeros(2, np.int64)
    at = 1
    for place in range(len(indices)):
        if at >= safe_end:
            return False
        number, at = _name(data, at)
        run = number & 1
        last[run] += _difference(number >> 1)
        indices[place] = last[run] & _WORD
    return at == safe_end
