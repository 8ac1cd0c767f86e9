r"""Code texture coordinates (multiples of 1 / n) on the polygons of a mesh, without loss.

Seams are coded first (`mixseq.compression.bitstream.corners`): corners at a vertex with the same coordinates are one
*node*. Then the coordinates of nodes are coded, by their differences from guesses. Both are coded with hashed contexts
(`mixseq.compression.bitstream.arithmetic`). The checksum of the coordinates at all corners follows. The number k codes
the coordinate k / n, computed in float64 and rounded to float32. All decisions use integers. A *size* is a number of
bits in 16ths.

*Guesses.* Corners :math:`a, b` are before and after a corner x in a polygon. The guess is the first possible one of

==========  =========================================================================================================
`AROUND`    the mean of :math:`a + b - z` over all polygons around the node: in a quad, *z* is the corner across; in a
            triangle, the corner before the half-edge beyond the one from *b* to *a*
`BEYOND`    the mean of :math:`2 a - e` and :math:`2 b - e`, or the one that exists: *e* is adjacent to *a* (*b*) in the
            polygon beyond the edge of this polygon that runs into *a* (out of *b*)
`BESIDE`    the mean of *a* and *b*, or the one that is known
`ANYWHERE`  the last known node, (0, 0) at the start
==========  =========================================================================================================

from known nodes only (parallelograms: Touma and Gotsman 1998, *Triangle mesh compression*). Guesses `AROUND` overshoot
where the map is uneven. There they are drawn back towards the midpoint of *a* and *b*, if this had the smaller loss up
to now.

*Copies* are translated, rotated, scaled or mirrored: the two halves of a character are usually unwrapped alike, and
then packed. So a polygon may have an *image*, an earlier polygon with the same number of corners. Where a *region*
begins, the image of the first corner, and whether the image is mirrored, are coded. Within the region, the image of a
polygon follows from the image of an adjacent polygon. Let o be the corner before x, after x, or else the first corner
of the region, whichever first has known coordinates and a known image. With two distant corners :math:`p, q` of the
region, the copy of x is

.. math:: x = o + \frac{q - p}{q' - p'}\, (x' - o')

as complex numbers, where primes are images, conjugated if they are mirrored. If only one corner is known, its image is
translated, and mirrored in u. A polygon loses its image if a copy is wrong, and worse than the other guess.

Frozen: changing this breaks old files (contexts are specified in ``docs/file-format.md``; golden:
``tests/compression/golden/uvs.npz``).
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    EVEN_PROBABILITY,
    HashedBits,
    bit_length,
    checksum_of,
    code_bit,
    code_hashed_bit,
    code_raw_bits,
    finish_hashed,
    has_failed,
    load_state,
    new_hashed_output,
    open_hashed_input,
    reserve_bits,
    store_state,
)
from mixseq.compression.bitstream.corners import (
    MAX_SEAM_BITS,
    SEAM_KINDS,
    Corners,
    code_seams,
    corners_on_nodes,
    growing_order,
    next_corner,
    previous_corner,
)
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues
from mixseq.runtime.jit import compiled
from mixseq.types import FloatArray, Index, Mask

COPIED, AROUND, BEYOND, BESIDE, ANYWHERE = range(5)  # kinds of guesses; frozen


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


_ROTATION_BITS = 17  # bits of the numbers by which copies are rotated and scaled; frozen


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


_GUESS_GROUPS = 4  # groups of guesses with similar errors: around or beyond, copied, beside, anywhere; frozen

VALUE_KINDS = 2 * _GUESS_GROUPS + 2
"""Kinds of bits after the kinds of seams: u and v for every group, and two for regions. Frozen: breaks old files."""

MAX_NUMBER_BITS = 40  # largest bit length of a number; frozen
MAX_COORDINATE = 1 << 26  # largest magnitude of a coordinate, in steps; frozen
_MAX_COPY_ERROR = 8  # error in steps above which a polygon loses its image, if the other guess is better; frozen
_REGION_KIND, _IMAGE_KIND = 2 * _GUESS_GROUPS, 2 * _GUESS_GROUPS + 1  # of the two numbers that begin a region; frozen
_NO_NODE = -1  # value for no node, of the same type as nodes; free: saves a compilation
_INITIAL_SIZES = (64, 64, 160, 160)  # initial expected size of an error in every group; frozen


@compiled
def _code_node_values(
    bits: HashedBits, corners: Corners, order: Index, copies: Copies, regions: Index, known: KnownNodes, guess: Guess
) -> None:
    """Code the values of all nodes, or decode them; set `bits.failed` on failure.

    Polygons are visited in `order` ``(P,)``; `copies`, `known` and `guess` start empty. For coding, `known` has values,
    and `regions` ``(P,)`` is 0 if no region begins with a polygon. Otherwise it is 1 plus twice the image of the first
    corner, in a polygon visited before, plus 1 if the image is mirrored.
    """
    facts, sizes = np.zeros(3, dtype=np.int64), np.zeros(4, dtype=np.int64)
    means = np.array(_INITIAL_SIZES)
    losses = np.zeros(2, dtype=np.int64)  # of unchanged guesses, and of guesses drawn back
    plain = np.zeros(2, dtype=np.int64)  # the guess without copies
    values, node = known.values, corners.node
    last = _NO_NODE
    for polygon in order:
        first, stop = corners.starts[polygon], corners.starts[polygon + 1]
        unknown, start = 0, -1
        for corner in range(first, stop):
            if not known.is_known[node[corner]]:
                unknown += 1
            elif start < 0 and not known.is_known[node[next_corner(corners, corner)]]:
                start = corner
        if not inherit_image(corners, copies, polygon) and unknown:
            for i in range(3):
                facts[i] = 1 if unknown == stop - first else 0
            sizes[:] = 0
            _code_region(bits, corners, order, copies, polygon, regions[polygon], facts, sizes)
        is_region_start = copies.region[polygon] == copies.places[polygon]
        is_image_wrong = False
        corner = max(first, start)
        for _ in range(stop - first):
            x = node[corner]
            if not known.is_known[x]:
                make_guess(corners, known, corner, last, guess)
                kind = guess.facts[0]
                plain[0], plain[1] = guess.value[0], guess.value[1]
                anchors = guess_copy(corners, copies, known, corner, guess)
                if anchors:
                    kind = COPIED if anchors == 2 else BESIDE
                elif kind == AROUND and losses[1] < losses[0]:
                    guess.value[0] -= guess.draw_back[0]
                    guess.value[1] -= guess.draw_back[1]
                group = 1 if kind == COPIED else (kind - 1 if kind >= BESIDE else 0)
                _set_contexts(corners, known, corner, guess.facts, kind, means[group], facts, sizes)
                for i in range(2):
                    error = values[x, i] - guess.value[i]
                    error = _code_number(bits, facts, sizes, 2 * group + i, error)
                    values[x, i] = guess.value[i] + error
                    known.errors[x] += abs(error)
                    means[group] += (16 * bit_length(error) - means[group]) >> 4
                    facts[2] = sizes[3] = 16 * bit_length(error)
                    if abs(values[x, i]) > MAX_COORDINATE:
                        bits.failed[0] = 1
                if has_failed(bits):
                    return
                plain_error = abs(values[x, 0] - plain[0]) + abs(values[x, 1] - plain[1])
                if guess.facts[0] == AROUND:
                    drawn_error = abs(values[x, 0] - plain[0] + guess.draw_back[0])
                    drawn_error += abs(values[x, 1] - plain[1] + guess.draw_back[1])
                    losses[0] += _size_in_bits(plain_error) - (losses[0] >> 5)
                    losses[1] += _size_in_bits(drawn_error) - (losses[1] >> 5)
                if anchors == 2 and known.errors[x] > _MAX_COPY_ERROR and known.errors[x] > plain_error:
                    is_image_wrong = True
                known.is_known[x] = True
                last = x
            if is_region_start:
                update_anchors(corners, copies, known, corner)
            corner = next_corner(corners, corner)
        if is_image_wrong:
            copies.region[polygon] = -1
        elif copies.region[polygon] >= 0:
            for corner in range(first, stop):
                update_anchors(corners, copies, known, corner)


@compiled
def _code_region(
    bits: HashedBits,
    corners: Corners,
    order: Index,
    copies: Copies,
    polygon: int,
    region: int,
    facts: Index,
    sizes: Index,
) -> None:
    """Code whether a region begins with a polygon, and if so, the image of the polygon."""
    place, image, back = copies.places[polygon], (region - 1) >> 1, 0
    if region:
        back = place - copies.places[corners.polygon[image]]
    back = _code_number(bits, facts, sizes, _REGION_KIND, back)
    if back == 0:
        return
    if back > place:
        bits.failed[0] = 1
        return
    other = order[place - back]
    turn = 2 * (image - corners.starts[other]) + ((region - 1) & 1)
    turn = _code_number(bits, facts, sizes, _IMAGE_KIND, turn)
    image = corners.starts[other] + (turn >> 1)
    if image >= corners.starts[other + 1] or not can_be_image(corners, copies, polygon, other):
        bits.failed[0] = 1
        return
    set_image(corners, copies, corners.starts[polygon], image, (turn & 1) == 1, place)


@compiled
def _set_contexts(
    corners: Corners,
    known: KnownNodes,
    corner: int,
    guess_facts: Index,
    kind: int,
    mean: int,
    facts: Index,
    sizes: Index,
) -> None:
    """Write the context facts of a guess, and the expected sizes of its error."""
    a, b = corners.node[previous_corner(corners, corner)], corners.node[next_corner(corners, corner)]
    near, edge = known.errors[a] + known.errors[b], 0
    if known.is_known[a] != known.is_known[b]:
        near *= 2
    if known.is_known[a] and known.is_known[b]:
        edge = abs(known.values[a, 0] - known.values[b, 0]) + abs(known.values[a, 1] - known.values[b, 1])
    facts[0] = facts[1] = kind << 2 | min(guess_facts[1], 3)
    facts[2] = kind
    sizes[0], sizes[1] = mean, _size_in_bits(near)
    sizes[2], sizes[3] = _size_in_bits(edge), _size_in_bits(guess_facts[2])


@compiled
def _code_number(bits: HashedBits, facts: Index, sizes: Index, kind: int, number: int) -> int:
    """Code a number in contexts made from `facts` ``(3,)`` and expected `sizes` ``(4,)``."""
    magnitude, contexts, length = abs(number), bits.contexts, 0
    while length < MAX_NUMBER_BITS:
        excess = _excess_bits(length, sizes[0], 4)
        for i in range(4):
            contexts[i] = _excess_bits(length, sizes[i], 3) << 8 | kind
        contexts[4] = (facts[0] << 6 | length) << 8 | kind
        contexts[5] = (facts[1] << 6 | excess) << 8 | kind
        contexts[6] = ((facts[2] << 6 | _excess_bits(length, sizes[2], 4)) << 6 | excess) << 8 | kind
        contexts[7] = (_excess_bits(length, sizes[1], 4) << 6 | excess) << 8 | kind
        if not code_hashed_bit(bits, SEAM_KINDS + kind, 1 if magnitude >> length else 0):
            break
        length += 1
    if length == 0:
        return 0
    rest, state = code_raw_bits(bits.stream, load_state(bits.stream), length - 1, magnitude)
    value, is_negative = 1 << (length - 1) | rest, 0
    if kind < _REGION_KIND:
        is_negative, state = code_bit(bits.stream, state, EVEN_PROBABILITY, 1 if number < 0 else 0)
    store_state(bits.stream, state)
    return -value if is_negative else value


@compiled
def _excess_bits(length: int, size: int, shift: int) -> int:
    """Return the bits beyond an expected size, in units of ``2^shift`` / 16 bits, plus 32: from 1 to 63."""
    return min(max(16 * length - size + 8 >> shift, -31), 31) + 32


@compiled
def _size_in_bits(number: int) -> int:
    """Return the number of bits of a non-negative number, in 16ths."""
    length = bit_length(number)
    return 16 * length + ((number << 5 >> length) & 15)


_MAX_PAIR_BITS = 2 * (2 * MAX_NUMBER_BITS + 1)  # largest number of bits of a pair of numbers; free: allocated ahead


def to_grid(values: FloatArray, steps: int) -> Index | None:
    """Return coordinates ``(n, 2)`` in steps of the grid, or None if they are too large or off the grid."""
    with np.errstate(invalid="ignore", over="ignore"):
        rounded = np.rint(values.astype(np.float64) * steps)
        if not (np.abs(rounded) <= MAX_COORDINATE).all():
            return None
    numbers = rounded.astype(np.int64)
    return numbers if np.array_equal(from_grid(numbers, steps), values) else None


def from_grid(numbers: Index, steps: int) -> FloatArray:
    """Return the coordinates of numbers of steps ``(n, 2)``, the inverse of `to_grid`."""
    return (numbers / steps).astype(np.float32)


@dataclass(frozen=True, eq=False)
class CodedUVs:
    """Coded texture coordinates."""

    data: bytes  # stream for decode_uvs
    corners: Corners  # corners on nodes, which are pairs of coordinates
    copies: Copies  # images of the polygons
    known: KnownNodes  # coordinates of nodes, and their distances from the guesses


def code_uvs(polygons: Polygons, vertex_count: int, numbers: Index, regions: Index | None = None) -> CodedUVs:
    """Code the coordinates `numbers` ``(sum of counts, 2)``, in steps, with copied `regions` ``(P,)``."""
    keys = np.column_stack([polygons.indices, numbers])
    labels = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1).astype(np.int64)
    bits = new_hashed_output(len(labels) * MAX_SEAM_BITS, SEAM_KINDS + VALUE_KINDS)
    corners = _corners_of_nodes(polygons, code_seams(bits, polygons, vertex_count, labels))
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    bits = reserve_bits(bits, (len(values) + len(polygons.counts)) * _MAX_PAIR_BITS)
    values[corners.node] = numbers
    copies, known = _code_values(bits, corners, values, regions)
    return CodedUVs(finish_hashed(bits, checksum_of(numbers)), corners, copies, known)


def decode_uvs(data: bytes, polygons: Polygons, vertex_count: int, steps: int) -> CornerValues:
    """Decode the texture coordinates written by `code_uvs`, multiples of ``1 / steps``."""
    bits, expected = open_hashed_input(data, SEAM_KINDS + VALUE_KINDS)
    nodes = code_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, np.int64))
    corners = _corners_of_nodes(polygons, nodes)
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    if not bits.failed[0]:
        _code_values(bits, corners, values, None)
    if bits.failed[0] or checksum_of(values[corners.node]) != expected:
        raise FormatError(f"coded texture coordinates at {polygons.indices.size} corners are damaged; {DAMAGE_CURE}")
    return CornerValues(from_grid(values, steps), corners.node)


def _corners_of_nodes(polygons: Polygons, nodes: Index) -> Corners:
    """Return the corners on nodes ``(C,)``; in damaged files, corners without a node are put on the first node."""
    return corners_on_nodes(Polygons(polygons.counts, np.maximum(nodes, 0)), int(nodes.max(initial=-1)) + 1)


def _code_values(bits: HashedBits, corners: Corners, values: Index, regions: Index | None) -> tuple[Copies, KnownNodes]:
    """Code the values ``(N, 2)``, or decode them in place; return the copies and the known nodes."""
    order = growing_order(corners)
    copies = new_copies(corners, order)
    known = KnownNodes(values, np.zeros(len(values), dtype=np.bool_), np.zeros(len(values), dtype=np.int64))
    regions = np.zeros(len(order), dtype=np.int64) if regions is None else regions
    _code_node_values(bits, corners, order, copies, regions, known, new_guess())
    return copies, known
