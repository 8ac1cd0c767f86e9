r"""Code seams of texture coordinates, and guess coordinates from adjacent nodes and copies of earlier regions.

*Seams* separate corners at a vertex that have different coordinates. Polygons are visited in the growing order
(`mixseq.compression.bitstream.connectivity`), and corners in the order of the polygon. Candidates for the node (pair of
coordinates) of a corner are the node across the edge into the corner, the node across the edge out of it, then other
nodes of its vertex, the newest first. One bit per candidate codes whether it is the node, unless it was excluded
already. If no candidate is the node, the corner has a new node. Nodes are numbered in order of first use.

*Guesses.* Corners :math:`a, b` are before and after a corner x in a polygon. The guess is the first possible one of

==========  =========================================================================================================
`AROUND`    the mean of :math:`a + b - z` over all polygons around the node: in a quad, *z* is the corner across; in a
            triangle, the corner before the half-edge beyond the one from *b* to *a*
`BEYOND`    the mean of :math:`2 a - e` and :math:`2 b - e`, or the one that exists: *e* is adjacent to *a* (*b*) in the
            polygon beyond the edge of this polygon that runs into *a* (out of *b*)
`BESIDE`    the mean of *a* and *b*, or the one that is known
`ANYWHERE`  the last known node, (0, 0) at the start
==========  =========================================================================================================

from known nodes only (parallelograms: Touma and Gotsman 1998, *Triangle mesh compression*). Means round to the nearest
integer, halves up. Guesses `AROUND` overshoot where the map is uneven. There :math:`a + b - z` is drawn back towards
the midpoint of *a* and *b*, by 3/8 of the distance, rounded down.

*Copies* are translated, rotated, scaled or mirrored: the two halves of a character are usually unwrapped alike, and
then packed. So a polygon may have an *image*, an earlier polygon with the same number of corners. Where a *region*
begins, the image of the first corner, and whether the image is mirrored, are coded. Within the region, the image of a
polygon follows from the image of an adjacent polygon. Let o be the corner before x, after x, or else the first corner
of the region, whichever first has known coordinates and a known image. With two distant corners :math:`p, q` of the
region, the copy of x is

.. math:: x = o + \frac{q - p}{q' - p'}\, (x' - o')

as complex numbers, where primes are images, conjugated if they are mirrored. If only one corner is known, its image is
translated, and mirrored in u.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/uvs.npz``).
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.arithmetic import HashedBits, code_hashed_bit, has_failed
from mixseq.compression.bitstream.connectivity import Corners, next_corner, previous_corner
from mixseq.runtime.jit import compiled
from mixseq.types import Index, Mask

COPIED, AROUND, BEYOND, BESIDE, ANYWHERE = range(5)
"""Kinds of guesses. Frozen: breaks old files."""


class Guess(NamedTuple):
    """A guess, and the properties of it used as contexts."""

    value: Index  # (2,) the guess
    draw_back: Index  # (2,) amount by which the guess is drawn back where guesses overshoot
    # (3,) kind (AROUND, ...); number of averaged guesses; their spread, summed over u and v.
    facts: Index
    low: Index  # (2,) least u and v of the guesses in the mean
    high: Index  # (2,) largest u and v of the guesses in the mean


class KnownNodes(NamedTuple):
    """Coordinates of the known nodes."""

    values: Index  # (N, 2) coordinates
    is_known: Mask  # (N,) whether coordinates are known
    errors: Index  # (N,) distance of coordinates from their guess, summed over u and v


def new_guess() -> Guess:
    """Return an empty guess."""
    return Guess(*(np.zeros(size, dtype=np.int64) for size in (2, 2, 3, 2, 2)))


@compiled
def make_guess(corners: Corners, known: KnownNodes, corner: int, last: int, guess: Guess) -> None:
    """Guess the coordinates at a corner; `last` is the last known node, or -1 at the start."""
    node, twin, values, is_known = corners.node, corners.twin, known.values, known.is_known
    x = node[corner]
    for i in range(2):
        guess.value[i] = guess.draw_back[i] = 0
    count = 0
    for place in range(corners.around_starts[x], corners.around_starts[x + 1]):
        corner_of_x = corners.around[place]
        polygon = corners.polygon[corner_of_x]
        a, b = previous_corner(corners, corner_of_x), next_corner(corners, corner_of_x)
        z = next_corner(corners, b)
        size = corners.starts[polygon + 1] - corners.starts[polygon]
        if size == 3 and twin[b] >= 0:
            z = previous_corner(corners, twin[b])
        elif size != 4:
            continue
        if is_known[node[a]] and is_known[node[b]] and is_known[node[z]] and node[z] != x:
            for i in range(2):
                both = values[node[a], i] + values[node[b], i]
                guess.draw_back[i] += both - values[node[z], i] - (both >> 1)
                _add_to_mean(guess, i, both - values[node[z], i], count)
            count += 1
    guess.facts[0] = AROUND
    if count:
        for i in range(2):
            guess.draw_back[i] = 3 * (guess.draw_back[i] // count) >> 3
    else:
        guess.facts[0] = BEYOND
        a, b = previous_corner(corners, corner), next_corner(corners, corner)
        for side in range(2):
            near, edge = (node[a], twin[previous_corner(corners, a)]) if side == 0 else (node[b], twin[b])
            if edge < 0 or not is_known[near]:
                continue
            after_edge = next_corner(corners, edge)
            e = node[previous_corner(corners, edge) if side == 0 else next_corner(corners, after_edge)]
            if is_known[e]:
                for i in range(2):
                    _add_to_mean(guess, i, 2 * values[near, i] - values[e, i], count)
                count += 1
        if not count:
            guess.facts[0] = BESIDE
            for near in (node[a], node[b]):
                if is_known[near]:
                    for i in range(2):
                        _add_to_mean(guess, i, values[near, i], count)
                    count += 1
        if not count:
            guess.facts[0] = ANYWHERE
            for i in range(2):
                _add_to_mean(guess, i, values[last, i] if last >= 0 else 0, 0)
            count = 1
    guess.facts[1] = count
    guess.facts[2] = guess.high[0] - guess.low[0] + guess.high[1] - guess.low[1]
    for i in range(2):
        guess.value[i] = (2 * guess.value[i] + count) // (2 * count)


@compiled
def _add_to_mean(guess: Guess, i: int, value: int, count: int) -> None:
    """Add a coordinate to the mean and the range of the guesses."""
    guess.value[i] += value
    guess.low[i] = min(guess.low[i], value) if count else value
    guess.high[i] = max(guess.high[i], value) if count else value


_ROTATION_BITS = 17
"""Bits of the numbers by which copies are rotated and scaled. Frozen: breaks old files."""


class Copies(NamedTuple):
    """Images of the visited polygons."""

    places: Index  # (P,) position of a polygon in the visiting order
    image: Index  # (C,) the image of every corner, -1 if there is none
    mirrored: Mask  # (P,) whether the image of a polygon is mirrored
    region: Index  # (P,) position at which the region of a polygon began, -1 for no region
    # (P, 2) anchors of a region, by the position at which it began: the first corner that is known with its image, and
    # the corner whose image is farthest from that first image; -1 for none.
    anchors: Index


def new_copies(corners: Corners, order: Index) -> Copies:
    """Return copies without regions."""
    return Copies(
        places=np.argsort(order),
        image=np.full(len(corners.node), -1, dtype=np.int64),
        mirrored=np.zeros(len(order), dtype=np.bool_),
        region=np.full(len(order), -1, dtype=np.int64),
        anchors=np.full((len(order), 2), -1, dtype=np.int64),
    )


@compiled
def next_image(corners: Corners, image: int, mirrored: bool) -> int:
    """Return the image of the next corner of a polygon."""
    return previous_corner(corners, image) if mirrored else next_corner(corners, image)


@compiled
def inherited_image(corners: Corners, copies: Copies, corner: int) -> int:
    """Return a corner's image that follows from the polygon across its half-edge, or -1 if there is none."""
    across = corners.twin[corner]
    if across < 0 or copies.region[corners.polygon[across]] < 0:
        return -1
    if not copies.mirrored[corners.polygon[across]]:
        image: int = corners.twin[copies.image[across]]
        return image
    edge = corners.twin[copies.image[next_corner(corners, across)]]
    return next_corner(corners, edge) if edge >= 0 else -1


@compiled
def inherit_image(corners: Corners, copies: Copies, polygon: int) -> bool:
    """Set a polygon's image from the first adjacent polygon that gives one; return whether there is one."""
    for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
        image = inherited_image(corners, copies, corner)
        if image >= 0 and can_be_image(corners, copies, polygon, corners.polygon[image]):
            across = corners.polygon[corners.twin[corner]]
            set_image(corners, copies, corner, image, copies.mirrored[across], copies.region[across])
            return True
    return False


@compiled
def can_be_image(corners: Corners, copies: Copies, polygon: int, image: int) -> bool:
    """Return whether a polygon can be the image of another one."""
    starts, places = corners.starts, copies.places
    same_size = starts[image + 1] - starts[image] == starts[polygon + 1] - starts[polygon]
    return bool(same_size and places[image] < places[polygon])


@compiled
def set_image(corners: Corners, copies: Copies, corner: int, image: int, mirrored: bool, region: int) -> None:
    """Set the image of a corner, and the resulting images of all corners of its polygon."""
    polygon = corners.polygon[corner]
    copies.mirrored[polygon] = mirrored
    copies.region[polygon] = region
    for _ in range(corners.starts[polygon + 1] - corners.starts[polygon]):
        copies.image[corner] = image
        corner = next_corner(corners, corner)
        image = next_image(corners, image, mirrored)


@compiled
def update_anchors(corners: Corners, copies: Copies, known: KnownNodes, corner: int) -> None:
    """Make a corner an anchor of its region if it is the first one, or its image is farthest from the first image."""
    node, values, image = corners.node, known.values, copies.image[corner]
    anchors = copies.anchors[copies.region[corners.polygon[corner]]]
    if not (known.is_known[node[corner]] and known.is_known[node[image]]):
        return
    if anchors[0] < 0:
        anchors[0] = corner
        return
    origin = values[node[copies.image[anchors[0]]]]
    farthest, candidate = 0, values[node[image]]
    if anchors[1] >= 0:
        second = values[node[copies.image[anchors[1]]]]
        farthest = abs(second[0] - origin[0]) + abs(second[1] - origin[1])
    if abs(candidate[0] - origin[0]) + abs(candidate[1] - origin[1]) > farthest:
        anchors[1] = corner


@compiled
def guess_copy(corners: Corners, copies: Copies, known: KnownNodes, corner: int, guess: Guess) -> int:
    """Set the guess at a corner to the copy of its image; return the number of anchors used, 0 if there is no copy."""
    node, values, is_known, images = corners.node, known.values, known.is_known, copies.image
    polygon = corners.polygon[corner]
    if copies.region[polygon] < 0 or not is_known[node[images[corner]]]:
        return 0
    p, q = copies.anchors[copies.region[polygon]]
    if p < 0:
        return 0
    o = previous_corner(corners, corner)
    if not (is_known[node[o]] and is_known[node[images[o]]]):
        o = next_corner(corners, corner)
    if not (is_known[node[o]] and is_known[node[images[o]]]):
        o = p
    sign = -1 if copies.mirrored[polygon] else 1
    offset_u = values[node[images[corner]], 0] - values[node[images[o]], 0]
    offset_v = values[node[images[corner]], 1] - values[node[images[o]], 1]
    if q < 0:
        guess.value[0] = values[node[o], 0] + sign * offset_u
        guess.value[1] = values[node[o], 1] + offset_v
        return 1
    side_u = values[node[q], 0] - values[node[p], 0]
    side_v = values[node[q], 1] - values[node[p], 1]
    image_u = values[node[images[q]], 0] - values[node[images[p]], 0]
    image_v = sign * (values[node[images[q]], 1] - values[node[images[p]], 1])
    offset_v *= sign
    size = abs(side_u) + abs(side_v) + abs(image_u) + abs(image_v)
    while size >> _ROTATION_BITS:
        side_u, side_v, image_u, image_v = side_u >> 1, side_v >> 1, image_u >> 1, image_v >> 1
        size >>= 1
    norm = image_u * image_u + image_v * image_v
    if norm == 0:
        return 0
    turn_u = side_u * image_u + side_v * image_v
    turn_v = side_v * image_u - side_u * image_v
    guess.value[0] = values[node[o], 0] + (2 * (turn_u * offset_u - turn_v * offset_v) + norm) // (2 * norm)
    guess.value[1] = values[node[o], 1] + (2 * (turn_u * offset_v + turn_v * offset_u) + norm) // (2 * norm)
    return 2


SEAM_KINDS = 4
"""Number of kinds of bits, which have separate mixing weights. Frozen: breaks old files."""

_INTO, _OUT, _OTHER, _BOTH = range(SEAM_KINDS)
"""Node across the edge into a corner, across the edge out of it, another node, or one node across both edges.
Frozen: breaks old files.
"""

MAX_SEARCHED_NODES = 32
"""Largest number of searched nodes per vertex, to bound the time. Frozen: breaks old files."""

MAX_SEAM_BITS = 2 + MAX_SEARCHED_NODES
"""Largest number of bits per corner. Free: memory is allocated ahead."""


@compiled
def code_seams(bits: HashedBits, corners: Corners, order: Index, labels: Index, nodes: Index) -> int:
    """Code or decode which corners at a vertex have equal labels ``(C,)``; polygons are visited in `order` ``(P,)``.

    Writes the nodes of the corners to `nodes` ``(C,)``, and returns the number of nodes.
    """
    vertices, twin = corners.node, corners.twin
    vertex_count = len(corners.around_starts) - 1
    newest = np.full(vertex_count, -1, dtype=np.int64)
    older, label_of = np.empty(len(vertices), dtype=np.int64), np.empty(len(vertices), dtype=np.int64)
    node_counts = np.zeros(vertex_count, dtype=np.int64)  # nodes of a vertex
    coded = np.zeros(vertex_count, dtype=np.int64)  # corners of a vertex that have a node already
    count = history = 0
    for polygon in order:
        for corner in range(corners.starts[polygon], corners.starts[polygon + 1]):
            vertex, label = vertices[corner], labels[corner]
            previous, following = previous_corner(corners, corner), next_corner(corners, corner)
            into, out, shared_into, shared_out = -1, -1, 2, 2
            if twin[previous] >= 0:
                into = nodes[twin[previous]]
                shared_into = _is_shared(nodes[previous], nodes[next_corner(corners, twin[previous])])
            if twin[corner] >= 0:
                out = nodes[next_corner(corners, twin[corner])]
                shared_out = _is_shared(nodes[following], nodes[twin[corner]])
            remaining = corners.around_starts[vertex + 1] - corners.around_starts[vertex] - coded[vertex]
            edges = (shared_out * 3 + shared_into) * 4 + (1 if out >= 0 else 0) + (2 if into >= 0 else 0)
            own = min(node_counts[vertex], 3) * 8 + min(remaining, 7)
            around = own * 4 + min(node_counts[vertices[previous]], 3)
            around = around * 4 + min(node_counts[vertices[following]], 3)
            own_count, chosen = min(node_counts[vertex], 7), -1
            if into >= 0:
                kind = _BOTH if into == out else _INTO
                _set_contexts(bits, kind, edges, around, history, own_count, own)
                bit = code_hashed_bit(bits, kind, 1 if label == label_of[into] else 0)
                history = (history << 1 | bit) & 255
                chosen = into if bit else -1
            if chosen < 0 and out >= 0 and out != into:
                _set_contexts(bits, _OUT, edges, around, history, own_count, own)
                bit = code_hashed_bit(bits, _OUT, 1 if label == label_of[out] else 0)
                history = (history << 1 | bit) & 255
                chosen = out if bit else -1
            node, searched = newest[vertex], 0
            while chosen < 0 and node >= 0 and searched < MAX_SEARCHED_NODES:
                if node not in (into, out):
                    _set_contexts(bits, _OTHER, edges, around, history, own_count, own)
                    if code_hashed_bit(bits, _OTHER, 1 if label == label_of[node] else 0):
                        chosen = node
                searched += 1
                node = older[node]
            if chosen < 0:
                chosen = count
                label_of[count] = label
                older[count] = newest[vertex]
                newest[vertex] = count
                node_counts[vertex] += 1
                count += 1
            nodes[corner] = chosen
            coded[vertex] += 1
        if has_failed(bits):
            return count
    return count


@compiled
def _is_shared(node: int, other: int) -> int:
    """Return 1 if both sides of an edge have the same node at its other end, 0 if not, 2 if unknown."""
    return 2 if node < 0 or other < 0 else (1 if node == other else 0)


@compiled
def _set_contexts(bits: HashedBits, kind: int, edges: int, around: int, history: int, own_count: int, own: int) -> None:
    contexts = bits.contexts
    contexts[0] = edges << 4 | kind
    contexts[1] = (around << 8 | edges) << 4 | kind
    contexts[2] = ((history & 15) << 8 | edges) << 4 | kind
    contexts[3] = (own_count << 8 | edges) << 4 | kind
    contexts[4] = (own << 8 | edges) << 4 | kind
    contexts[5] = around << 4 | kind
    contexts[6] = history << 4 | kind
    contexts[7] = ((around >> 4) << 12 | edges << 4 | (history & 15)) << 4 | kind
