"""Code texture coordinates (multiples of 1 / n) and hard edges on the polygons of a mesh, without loss.

Seams are coded first (`mixseq.compression.bitstream.uv_seams`): corners at a vertex with the same coordinates, or the
same normal, are one *node*. Then the coordinates of nodes are coded, by their differences from guesses. Both are coded
with hashed contexts (`mixseq.compression.bitstream.arithmetic`). The checksum of the coordinates at all corners, or of
the numbers of normals, follows. The number k codes the coordinate k / n, computed in float64 and rounded to float32.
All decisions use integers.

*Coordinates.* Polygons on nodes are visited in their growing order. Corners of a polygon are visited from the first
known corner with an unknown successor, or else from the first corner. At an unknown corner, the differences of u and v
from their guesses are coded. A guess is the copy of an image, or comes from adjacent nodes.

*Images.* The image of a polygon follows from an adjacent polygon. If none follows, and the polygon has unknown nodes,
a number codes whether a region begins here: 0 if not, otherwise how many visits ago the image polygon was visited. A
second number is twice the index, in the image polygon, of the image of the first corner, plus 1 if mirrored. A polygon
loses its image if a copy from two anchors has an error above 8 that also exceeds the error of the other guess.

*Drawing back.* Guesses `AROUND` are drawn back if this had the smaller loss up to now. A loss is a sum of error sizes
that decays by 1/32 at every node with such a guess.

*Numbers.* Bits with models code whether the magnitude has a first bit, a second bit, and so on until it has no more.
The bits after the highest follow, from high to low, then the sign of differences, all without a model. The code here
specifies the contexts: bit counts in excess of expected sizes, which come from recent errors, errors of neighbours,
the length of the edge across, and the spread of guesses (for v, the error of u). A *size* is a bit count in 16ths: 16
per bit, plus the value of the four bits after the highest.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/uvs.npz``, and the digest in
``tests/compression/bitstream/test_hard_edges.py``).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    DAMAGE_CURE,
    EVEN_PROBABILITY,
    HashedBits,
    append_checksum,
    bit_length,
    checksum_of,
    code_bit,
    code_hashed_bit,
    code_raw_bits,
    finish_stream,
    has_failed,
    load_state,
    new_hashed_bits,
    new_hashed_output,
    new_input_stream,
    reserve_bits,
    split_checksum,
    store_state,
)
from mixseq.compression.bitstream.connectivity import (
    Corners,
    corners_on_nodes,
    growing_order,
    next_corner,
    previous_corner,
)
from mixseq.compression.bitstream.uv_seams import (
    AROUND,
    BESIDE,
    COPIED,
    MAX_SEAM_BITS,
    SEAM_KINDS,
    Copies,
    Guess,
    KnownNodes,
    can_be_image,
    code_seams,
    guess_copy,
    inherit_image,
    make_guess,
    new_copies,
    new_guess,
    set_image,
    update_anchors,
)
from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, renumber_by_first_use
from mixseq.runtime.jit import compiled
from mixseq.types import FloatArray, Index, IntArray

_GUESS_GROUPS = 4
"""Groups of guesses with similar errors: around or beyond, copied, beside, anywhere. Frozen: breaks old files."""

VALUE_KINDS = 2 * _GUESS_GROUPS + 2
"""Kinds of bits after the kinds of seams: u and v for every group, and two for regions. Frozen: breaks old files."""

MAX_NUMBER_BITS = 40
"""Largest bit length of a number. Frozen: breaks old files."""

MAX_COORDINATE = 1 << 26
"""Largest magnitude of a coordinate, in steps. Frozen: breaks old files."""

_MAX_COPY_ERROR = 8
"""Error in steps above which a polygon loses its image, if the other guess is better. Frozen: breaks old files."""

_REGION_KIND, _IMAGE_KIND = 2 * _GUESS_GROUPS, 2 * _GUESS_GROUPS + 1
"""Kinds of the two numbers that begin a region. Frozen: breaks old files."""

_NO_NODE = -1
"""Value for no node, of the same type as nodes. Free: saves a compilation."""

_INITIAL_SIZES = (64, 64, 160, 160)
"""Initial expected size of an error in every group. Frozen: breaks old files."""


@compiled
def _code_node_values(
    bits: HashedBits,
    corners: Corners,
    order: Index,
    copies: Copies,
    regions: Index,
    known: KnownNodes,
    guess: Guess,
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


_MAX_PAIR_BITS = 2 * (2 * MAX_NUMBER_BITS + 1)
"""Largest number of bits of a pair of numbers. Free: memory is allocated ahead."""


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
    corners = _corners_of_nodes(polygons, _code_seams(bits, polygons, vertex_count, labels))
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    bits = reserve_bits(bits, (len(values) + len(polygons.counts)) * _MAX_PAIR_BITS)
    values[corners.node] = numbers
    copies, known = _code_values(bits, corners, values, regions)
    return CodedUVs(append_checksum(finish_stream(bits.stream), checksum_of(numbers)), corners, copies, known)


def decode_uvs(data: bytes, polygons: Polygons, vertex_count: int, steps: int) -> CornerValues:
    """Decode the texture coordinates written by `code_uvs`, multiples of ``1 / steps``."""
    stream, expected = split_checksum(data)
    bits = new_hashed_bits(new_input_stream(stream), SEAM_KINDS + VALUE_KINDS)
    nodes = _code_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, np.int64))
    corners = _corners_of_nodes(polygons, nodes)
    values = np.zeros((len(corners.around_starts) - 1, 2), dtype=np.int64)
    if not bits.failed[0]:
        _code_values(bits, corners, values, None)
    if bits.failed[0] or checksum_of(values[corners.node]) != expected:
        raise FormatError(f"coded texture coordinates at {polygons.indices.size} corners are damaged; {DAMAGE_CURE}")
    return CornerValues(from_grid(values, steps), corners.node)


def _code_seams(bits: HashedBits, polygons: Polygons, vertex_count: int, labels: Index) -> Index:
    """Code the seams between labels ``(C,)``, or decode seams; return the node ``(C,)`` of every corner."""
    corners = corners_on_nodes(polygons, vertex_count)
    nodes = np.full(len(labels), -1, dtype=np.int64)
    code_seams(bits, corners, growing_order(corners), labels, nodes)
    return nodes


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


def encode_hard_edges(polygons: Polygons, vertex_count: int, numbers: IntArray) -> bytes | None:
    """Code which corners share a normal, by normal numbers ``(sum of counts,)``; return None if this is impossible."""
    bits = new_hashed_output(len(numbers) * MAX_SEAM_BITS, SEAM_KINDS)
    normal_ids = renumber_by_first_use(numbers)
    nodes = _code_seams(bits, polygons, vertex_count, normal_ids)
    if not np.array_equal(renumber_by_first_use(nodes), normal_ids):
        return None
    return append_checksum(finish_stream(bits.stream), checksum_of(normal_ids))


def decode_hard_edges(data: bytes, polygons: Polygons, vertex_count: int) -> Index:
    """Decode the numbers ``(sum of counts,)`` of normals at the corners: 0, 1, 2, ... in order of first use."""
    stream, expected = split_checksum(data)
    bits = new_hashed_bits(new_input_stream(stream), SEAM_KINDS)
    nodes = _code_seams(bits, polygons, vertex_count, np.zeros(polygons.indices.size, dtype=np.int64))
    numbers = renumber_by_first_use(nodes)
    if bits.failed[0] or checksum_of(numbers) != expected:
        raise FormatError(f"coded hard edges at {polygons.indices.size} corners are damaged; {DAMAGE_CURE}")
    return numbers
