r"""Compiled loops for texture coordinates: seams, guesses from adjacent nodes, and copies of earlier regions.

*Seams* tell which corners at a vertex have the same coordinates. Polygons are visited in the growing order
(`mixseq.compression.bitstream.connectivity`), corners in that of the polygon. A corner takes the node (the pair of
coordinates) of the polygon across the edge into it, or of that across the edge out of it, or another one of its vertex,
the newest first; each of these is a bit, unless it was excluded already. If it takes none, it has a new node. Nodes are
numbered in order of first use.

*Guesses.* With :math:`a, b` the corners before and after a corner x in a polygon that has it, they are, in this order,

==========  =========================================================================================================
`AROUND`    the mean of :math:`a + b - z` over all polygons around the node: of a quad, *z* is the corner across; of a
            triangle, the corner before the half-edge beyond the one from *b* to *a*
`BEYOND`    the mean of :math:`2 a - e` and :math:`2 b - e`, as far as there are any: *e* is beside *a* (*b*) in the
            polygon beyond the edge of this polygon that runs into *a* (out of *b*)
`BESIDE`    the mean of *a* and *b*, or the one that is known
`ANYWHERE`  the node that was known last, (0, 0) at the start
==========  =========================================================================================================

each from known nodes (parallelograms: Touma and Gotsman 1998, *Triangle mesh compression*). Means round to the nearest
integer, halves up. Where guesses `AROUND` overshoot, as the map is less even than the rule assumes, :math:`a + b - z`
is drawn back to the middle of *a* and *b*, by 3/8 of the way, rounded down.

*Copies* are translated, rotated, scaled, mirrored: the two sides of a character are usually unwrapped alike, and then
packed. So a polygon may have an *image*, an earlier polygon with the same number of corners. The image of its first
corner, and whether it is mirrored, is coded where a *region* begins; from there the image of a polygon follows from
that of an adjacent one. With o a corner whose coordinates and whose image's are known, the one before or after x, or
else the region's first, and :math:`p, q` two more of the region, far from each other, the copy of x is

.. math:: x = o + \frac{q - p}{q' - p'}\, (x' - o')

as complex numbers, where primes are images, conjugated if they are mirrored. With only one known corner the image is
translated, and mirrored in u.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/uvs.npz``). numba caches compiled loops by
the text of their own file, and this one inlines `arithmetic` and `connectivity`: edit this file whenever these change,
and `mixseq.compression.bitstream.uv_values` whenever this one does. Format 4.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.arithmetic import Bits, code_hashed, has_failed
from mixseq.compression.bitstream.connectivity import Corners, after, before
from mixseq.runtime.jit import compiled
from mixseq.types import Index

COPIED, AROUND, BEYOND, BESIDE, ANYWHERE = range(5)
"""Kinds of guesses. Frozen: breaks old files."""


class Guess(NamedTuple):
    """A guess, and the facts about it used as contexts."""

    at: Index  # (2,) the guess
    back: Index  # (2,) how far it is drawn back where such guesses overshoot
    # (3,) kind (AROUND, ...); number of guesses averaged; their spread, u and v added.
    facts: Index
    low: Index  # (2,) least u and v of the guesses in the mean
    high: Index  # (2,) largest u and v of the guesses in the mean


class Known(NamedTuple):
    """Nodes known so far."""

    values: Index  # (N, 2) coordinates
    there: NDArray[np.bool_]  # (N,) whether they are known
    sizes: Index  # (N,) distance from their guess, u and v added


def no_guess() -> Guess:
    """Return an empty guess."""
    return Guess(*(np.zeros(size, dtype=np.int64) for size in (2, 2, 3, 2, 2)))


@compiled
def make_guess(corners: Corners, known: Known, corner: int, last: int, guess: Guess) -> None:
    """Guess the coordinates at a corner; `last` is the last known node, -1 for none."""
    node, twin, values, there = corners.node, corners.twin, known.values, known.there
    x = node[corner]
    for i in range(2):
        guess.at[i] = guess.back[i] = 0
    count = 0
    for place in range(corners.around_starts[x], corners.around_starts[x + 1]):
        other = corners.around[place]
        a, b = before(corners, other), after(corners, other)
        across = after(corners, b)
        size = corners.starts[corners.polygon[other] + 1] - corners.starts[corners.polygon[other]]
        if size == 3 and twin[b] >= 0:
            across = before(corners, twin[b])
        elif size != 4:
            continue
        if there[node[a]] and there[node[b]] and there[node[across]] and node[across] != x:
            for i in range(2):
                both = values[node[a], i] + values[node[b], i]
                guess.back[i] += both - values[node[across], i] - (both >> 1)
                _add(guess, i, both - values[node[across], i], count)
            count += 1
    guess.facts[0] = AROUND
    if count:
        for i in range(2):
            guess.back[i] = 3 * (guess.back[i] // count) >> 3
    else:
        guess.facts[0] = BEYOND
        a, b = before(corners, corner), after(corners, corner)
        for side in range(2):
            beside, edge = (node[a], twin[before(corners, a)]) if side == 0 else (node[b], twin[b])
            if edge < 0 or not there[beside]:
                continue
            beyond = node[before(corners, edge) if side == 0 else after(corners, after(corners, edge))]
            if there[beyond]:
                for i in range(2):
                    _add(guess, i, 2 * values[beside, i] - values[beyond, i], count)
                count += 1
        if not count:
            guess.facts[0] = BESIDE
            for beside in (node[a], node[b]):
                if there[beside]:
                    for i in range(2):
                        _add(guess, i, values[beside, i], count)
                    count += 1
        if not count:
            guess.facts[0] = ANYWHERE
            for i in range(2):
                _add(guess, i, values[last, i] if last >= 0 else 0, 0)
            count = 1
    guess.facts[1] = count
    guess.facts[2] = guess.high[0] - guess.low[0] + guess.high[1] - guess.low[1]
    for i in range(2):
        guess.at[i] = (2 * guess.at[i] + count) // (2 * count)


@compiled
def _add(guess: Guess, i: int, value: int, count: int) -> None:
    """Add one of the guesses to be averaged."""
    guess.at[i] += value
    guess.low[i] = min(guess.low[i], value) if count else value
    guess.high[i] = max(guess.high[i], value) if count else value


_PRECISION = 17
"""Bits of the numbers by which copies are rotated and scaled. Frozen: breaks old files."""


class Copies(NamedTuple):
    """Images so far."""

    places: Index  # (P,) when a polygon is visited
    image: Index  # (C,) the image of every corner, -1 if there is none
    mirrored: NDArray[np.bool_]  # (P,) whether the image of a polygon is mirrored
    region: Index  # (P,) when the region of a polygon began, -1 for none
    # (P, 2) for every region, by when it began: the first corner that is known with its image, and the one whose image
    # is farthest from the image of that; -1 for none.
    anchors: Index


def no_copies(corners: Corners, order: Index) -> Copies:
    """Return a state without regions."""
    places = np.empty(len(order), dtype=np.int64)
    places[order] = np.arange(len(order))
    return Copies(
        places=places,
        image=np.full(len(corners.node), -1, dtype=np.int64),
        mirrored=np.zeros(len(order), dtype=np.bool_),
        region=np.full(len(order), -1, dtype=np.int64),
        anchors=np.full((len(order), 2), -1, dtype=np.int64),
    )


@compiled
def image_of(corners: Corners, copies: Copies, corner: int) -> int:
    """Return the image of a corner that follows from the polygon across the half-edge from it; -1 if there is none."""
    there = corners.twin[corner]
    if there < 0 or copies.region[corners.polygon[there]] < 0:
        return -1
    if not copies.mirrored[corners.polygon[there]]:
        image: int = corners.twin[copies.image[there]]
        return image
    edge = corners.twin[copies.image[after(corners, there)]]
    return after(corners, edge) if edge >= 0 else -1


@compiled
def follow(corners: Corners, copies: Copies, polygon: int) -> bool:
    """Set a polygon's image from an adjacent polygon, its corners in order; return whether there is one."""
    for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
        image = image_of(corners, copies, corner)
        if image >= 0 and fits(corners, copies, polygon, corners.polygon[image]):
            beside = corners.polygon[corners.twin[corner]]
            give_image(corners, copies, corner, image, copies.mirrored[beside], copies.region[beside])
            return True
    return False


@compiled
def fits(corners: Corners, copies: Copies, polygon: int, image: int) -> bool:
    """Return whether a polygon can be the image of another one."""
    starts, places = corners.starts, copies.places
    same = starts[image + 1] - starts[image] == starts[polygon + 1] - starts[polygon]
    return bool(same and places[image] < places[polygon])


@compiled
def give_image(
    corners: Corners, copies: Copies, corner: int, image: int, mirrored: bool, region: int
) -> None:
    """Set the image of a corner, and with it of all corners of its polygon."""
    polygon = corners.polygon[corner]
    copies.mirrored[polygon] = mirrored
    copies.region[polygon] = region
    for _ in range(corners.starts[polygon + 1] - corners.starts[polygon]):
        copies.image[corner] = image
        corner = after(corners, corner)
        image = before(corners, image) if mirrored else after(corners, image)


@compiled
def drop_anchor(corners: Corners, copies: Copies, known: Known, corner: int) -> None:
    """Make a corner an anchor of its region, if it is the first one, or its image farther from the first one's."""
    node, values, image = corners.node, known.values, copies.image[corner]
    anchors = copies.anchors[copies.region[corners.polygon[corner]]]
    if not (known.there[node[corner]] and known.there[node[image]]):
        return
    if anchors[0] < 0:
        anchors[0] = corner
        return
    origin = values[node[copies.image[anchors[0]]]]
    far, at = 0, values[node[image]]
    if anchors[1] >= 0:
        other = values[node[copies.image[anchors[1]]]]
        far = abs(other[0] - origin[0]) + abs(other[1] - origin[1])
    if abs(at[0] - origin[0]) + abs(at[1] - origin[1]) > far:
        anchors[1] = corner


@compiled
def copy(corners: Corners, copies: Copies, known: Known, corner: int, guess: Guess) -> int:
    """Set the guess at a corner to the copy of its image; return its number of anchors, 0 if there is no copy."""
    node, values, there, images = corners.node, known.values, known.there, copies.image
    polygon = corners.polygon[corner]
    if copies.region[polygon] < 0 or not there[node[images[corner]]]:
        return 0
    p, q = copies.anchors[copies.region[polygon]]
    if p < 0:
        return 0
    o = before(corners, corner)
    if not (there[node[o]] and there[node[images[o]]]):
        o = after(corners, corner)
    if not (there[node[o]] and there[node[images[o]]]):
        o = p
    sign = -1 if copies.mirrored[polygon] else 1
    away_u = values[node[images[corner]], 0] - values[node[images[o]], 0]
    away_v = values[node[images[corner]], 1] - values[node[images[o]], 1]
    if q < 0:
        guess.at[0], guess.at[1] = values[node[o], 0] + sign * away_u, values[node[o], 1] + away_v
        return 1
    here_u = values[node[q], 0] - values[node[p], 0]
    here_v = values[node[q], 1] - values[node[p], 1]
    there_u = values[node[images[q]], 0] - values[node[images[p]], 0]
    there_v = sign * (values[node[images[q]], 1] - values[node[images[p]], 1])
    away_v *= sign
    size = abs(here_u) + abs(here_v) + abs(there_u) + abs(there_v)
    while size >> _PRECISION:
        here_u, here_v, there_u, there_v = here_u >> 1, here_v >> 1, there_u >> 1, there_v >> 1
        size >>= 1
    whole = there_u * there_u + there_v * there_v
    if whole == 0:
        return 0
    turn_u = here_u * there_u + here_v * there_v
    turn_v = here_v * there_u - here_u * there_v
    guess.at[0] = values[node[o], 0] + (2 * (turn_u * away_u - turn_v * away_v) + whole) // (2 * whole)
    guess.at[1] = values[node[o], 1] + (2 * (turn_u * away_v + turn_v * away_u) + whole) // (2 * whole)
    return 2


SEAM_KINDS = 4
"""Kinds of bits with mixing weights of their own. Frozen: breaks old files."""

_INTO, _OUT, _OTHER, _BOTH = range(SEAM_KINDS)
"""Node across the edge into the corner, across that out of it, another one, that of both. Frozen: breaks old files."""

MOST_NODES = 32
"""Nodes of a vertex that are searched, which bounds the time. Frozen: breaks old files."""

MOST_SEAM_BITS = 2 + MOST_NODES
"""Bits of a corner at most. Free: memory is allocated ahead."""


@compiled
def walk_seams(bits: Bits, corners: Corners, order: Index, labels: Index, nodes: Index) -> int:
    """Code which corners have the same label ``(C,)``, or decode it; return the number of nodes: order ``(P,)``."""
    vertex, twin = corners.node, corners.twin
    vertex_count = len(corners.around_starts) - 1
    newest = np.full(vertex_count, -1, dtype=np.int64)
    older, label = np.empty(len(vertex), dtype=np.int64), np.empty(len(vertex), dtype=np.int64)
    several = np.zeros(vertex_count, dtype=np.int64)  # nodes of a vertex
    done = np.zeros(vertex_count, dtype=np.int64)  # corners of a vertex that have a node
    count = history = 0
    for polygon in order:
        for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
            at, last, following = vertex[corner], before(corners, corner), after(corners, corner)
            into, out, along_into, along_out = -1, -1, 2, 2
            if twin[last] >= 0:
                into = nodes[twin[last]]
                along_into = _along(nodes[last], nodes[after(corners, twin[last])])
            if twin[corner] >= 0:
                out = nodes[after(corners, twin[corner])]
                along_out = _along(nodes[following], nodes[twin[corner]])
            left = corners.around_starts[at + 1] - corners.around_starts[at] - done[at]
            edges = (along_out * 3 + along_into) * 4 + (1 if out >= 0 else 0) + (2 if into >= 0 else 0)
            own = min(several[at], 3) * 8 + min(left, 7)
            around = (own * 4 + min(several[vertex[last]], 3)) * 4 + min(several[vertex[following]], 3)
            chosen = -1
            if into >= 0:
                kind = _BOTH if into == out else _INTO
                _set_contexts(bits, kind, edges, around, history, min(several[at], 7), own)
                bit = code_hashed(bits, kind, 1 if labels[corner] == label[into] else 0)
                history = (history << 1 | bit) & 255
                chosen = into if bit else -1
            if chosen < 0 and out >= 0 and out != into:
                _set_contexts(bits, _OUT, edges, around, history, min(several[at], 7), own)
                bit = code_hashed(bits, _OUT, 1 if labels[corner] == label[out] else 0)
                history = (history << 1 | bit) & 255
                chosen = out if bit else -1
            node, looked_at = newest[at], 0
            while chosen < 0 and node >= 0 and looked_at < MOST_NODES:
                if node not in (into, out):
                    _set_contexts(bits, _OTHER, edges, around, history, min(several[at], 7), own)
                    if code_hashed(bits, _OTHER, 1 if labels[corner] == label[node] else 0):
                        chosen = node
                looked_at += 1
                node = older[node]
            if chosen < 0:
                chosen = count
                label[count] = labels[corner]
                older[count] = newest[at]
                newest[at] = count
                several[at] += 1
                count += 1
            nodes[corner] = chosen
            done[at] += 1
        if has_failed(bits):
            return count
    return count


@compiled
def _along(one: int, other: int) -> int:
    """Return whether the other end of an edge has one node on both sides; 2 if unknown."""
    return 2 if one < 0 or other < 0 else (1 if one == other else 0)


@compiled
def _set_contexts(
    bits: Bits, kind: int, edges: int, around: int, history: int, several: int, own: int
) -> None:
    contexts = bits.contexts
    contexts[0] = edges << 4 | kind
    contexts[1] = (around << 8 | edges) << 4 | kind
    contexts[2] = ((history & 15) << 8 | edges) << 4 | kind
    contexts[3] = (several << 8 | edges) << 4 | kind
    contexts[4] = (own << 8 | edges) << 4 | kind
    contexts[5] = around << 4 | kind
    contexts[6] = history << 4 | kind
    contexts[7] = ((around >> 4) << 12 | edges << 4 | (history & 15)) << 4 | kind
