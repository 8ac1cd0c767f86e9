"""Code the values of texture coordinates: their differences from guesses, node by node.

Polygons are visited in the growing order of the polygons on nodes. Their corners start from the first known one that
has an unknown one after it, else from the first one. Unknown ones are coded: the difference of u from its guess, then
that of v. The guess is the copy of an image, or from adjacent nodes (`mixseq.compression.bitstream.uv_seams`).

*Images.* A polygon has the image that follows from an adjacent one. If none does, and it has unknown nodes, a number
codes whether a region begins with it: 0 for no, else how many polygons before it its image was visited; then another
one, twice the place of the corner in that polygon that is the image of its first corner, plus 1 if it is mirrored. A
polygon loses its image where a copy from two anchors was off by more than 8, and by more than the other guess.

*Drawing back.* Whether guesses `AROUND` are drawn back is decided by the loss of either, a sum of sizes as below that
forgets 1/32 at every node that has such a guess.

*Numbers.* Whether the magnitude has a bit, a second one, a third, ..., until it has no more; then its bits after the
highest, from high to low, and the sign of differences, without a model. The code here specifies the contexts of the
first. They are bit counts beyond the expected ones: recent ones, those of the neighbours, of the length of the edge
across, of the spread of guesses (of v: of u). A *size* is the number of bits of a number in 16ths: 16 for each, plus
the four after the highest.

Frozen: changing this breaks old files (golden: ``tests/compression/golden/uvs.npz``). numba caches compiled loops by
the text of their own file, and this one inlines `arithmetic`, `connectivity` and `uv_seams`: edit this file whenever
these change. Format 4.
"""

from __future__ import annotations

import numpy as np

from mixseq.compression.bitstream.arithmetic import (
    HashedBits,
    bit_length,
    code_hashed_bit,
    code_raw_bits,
    has_failed,
)
from mixseq.compression.bitstream.connectivity import Corners, next_corner, previous_corner
from mixseq.compression.bitstream.uv_seams import (
    AROUND,
    BESIDE,
    COPIED,
    SEAM_KINDS,
    Copies,
    Guess,
    KnownNodes,
    can_be_image,
    guess_copy,
    inherit_image,
    make_guess,
    set_image,
    update_anchors,
)
from mixseq.runtime.jit import compiled
from mixseq.types import Index

_GUESS_GROUPS = 4
"""Groups of guesses with similar errors: around and beyond, copied, beside, anywhere. Frozen: breaks old files."""

VALUE_KINDS = 2 * _GUESS_GROUPS + 2
"""Kinds of bits with mixing weights, after those of seams: u and v by group; regions. Frozen: breaks old files."""

MAX_NUMBER_BITS = 40
"""Bits of the largest numbers. Frozen: breaks old files."""

MAX_COORDINATE = 1 << 26
"""Largest magnitude of a coordinate, in steps. Frozen: breaks old files."""

_MAX_COPY_ERROR = 8
"""Error above which a copy worse than the other guess ends, in steps. Frozen: breaks old files."""

_REGION_KIND, _IMAGE_KIND = 2 * _GUESS_GROUPS, 2 * _GUESS_GROUPS + 1
"""Kinds of the numbers of regions. Frozen: breaks old files."""

_NO_NODE = -1
"""No node, in the type of nodes. Free: saves a compilation."""

_INITIAL_SIZES = (64, 64, 160, 160)
"""Initial expected sizes of the groups. Frozen: breaks old files."""


@compiled
def code_values(
    bits: HashedBits,
    corners: Corners,
    order: Index,
    copies: Copies,
    regions: Index,
    known: KnownNodes,
    guess: Guess,
) -> None:
    """Code the values of all nodes, or decode them; set `bits.failed` on failure.

    Polygons are visited in the order ``(P,)``; `copies`, `known` and `guess` start empty, but for the values of `known`
    when coding. Then `regions` ``(P,)`` marks where they begin: 0 for nowhere, else 1 plus twice the image of the first
    corner, which must have been visited, plus 1 if it is mirrored.
    """
    facts, sizes = np.zeros(3, dtype=np.int64), np.zeros(4, dtype=np.int64)
    means = np.array(_INITIAL_SIZES)
    losses = np.zeros(2, dtype=np.int64)  # of guesses as they are, and drawn back
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
                    losses[0] += size_in_bits(plain_error) - (losses[0] >> 5)
                    losses[1] += size_in_bits(drawn_error) - (losses[1] >> 5)
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
    """Code whether a region begins with a polygon, and its image."""
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
    """Set the facts of a guess, and the expected sizes of its error."""
    a, b = corners.node[previous_corner(corners, corner)], corners.node[next_corner(corners, corner)]
    near, edge = known.errors[a] + known.errors[b], 0
    if known.is_known[a] != known.is_known[b]:
        near *= 2
    if known.is_known[a] and known.is_known[b]:
        edge = abs(known.values[a, 0] - known.values[b, 0]) + abs(known.values[a, 1] - known.values[b, 1])
    facts[0] = facts[1] = kind << 2 | min(guess_facts[1], 3)
    facts[2] = kind
    sizes[0], sizes[1] = mean, size_in_bits(near)
    sizes[2], sizes[3] = size_in_bits(edge), size_in_bits(guess_facts[2])


@compiled
def _code_number(bits: HashedBits, facts: Index, sizes: Index, kind: int, number: int) -> int:
    """Code a number in contexts of known facts ``(3,)`` and expected sizes ``(4,)``."""
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
    value = 1 << (length - 1) | code_raw_bits(bits.stream, length - 1, magnitude)
    if kind < _REGION_KIND and code_raw_bits(bits.stream, 1, 1 if number < 0 else 0):
        return -value
    return value


@compiled
def _excess_bits(length: int, size: int, shift: int) -> int:
    """Return the number of bits beyond the expected size, in units of ``2^shift`` 16ths: 1 to 63, 32 for none."""
    return min(max(16 * length - size + 8 >> shift, -31), 31) + 32


@compiled
def size_in_bits(number: int) -> int:
    """Return the number of bits of a non-negative number, in 16ths."""
    length = bit_length(number)
    return 16 * length + ((number << 5 >> length) & 15)
