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

from mixseq.compression.bitstream.arithmetic import Bits, bit_length, code_hashed, code_number, has_failed
from mixseq.compression.bitstream.connectivity import Corners, after, before
from mixseq.compression.bitstream.uv_seams import (
    AROUND,
    BESIDE,
    COPIED,
    SEAM_KINDS,
    Copies,
    Guess,
    Known,
    copy,
    drop_anchor,
    fits,
    follow,
    give_image,
    make_guess,
)
from mixseq.runtime.jit import compiled
from mixseq.types import Index

_GROUPS = 4
"""Groups of guesses with similar errors: around and beyond, copied, beside, anywhere. Frozen: breaks old files."""

VALUE_KINDS = 2 * _GROUPS + 2
"""Kinds of bits with mixing weights, after those of seams: u and v by group; regions. Frozen: breaks old files."""

LONGEST = 40
"""Bits of the largest numbers. Frozen: breaks old files."""

LARGEST = 1 << 26
"""Largest magnitude of a coordinate, in steps. Frozen: breaks old files."""

_TOLERATED = 8
"""Error above which a copy worse than the other guess ends, in steps. Frozen: breaks old files."""

_BACK, _PLACE = 2 * _GROUPS, 2 * _GROUPS + 1
"""Kinds of the numbers of regions. Frozen: breaks old files."""

_NONE = -1
"""No node, in the type of nodes. Free: saves a compilation."""

_FIRST_SIZES = (64, 64, 160, 160)
"""Initial expected sizes of the groups. Frozen: breaks old files."""


@compiled
def walk_values(
    bits: Bits, corners: Corners, order: Index, copies: Copies, regions: Index, known: Known, guess: Guess
) -> None:
    """Code the values of all nodes, or decode them; set `bits.failed` on failure.

    Polygons are visited in the order ``(P,)``; `copies`, `known` and `guess` start empty, but for the values of `known`
    when coding. Then `regions` ``(P,)`` marks where they begin: 0 for nowhere, else 1 plus twice the image of the first
    corner, which must have been visited, plus 1 if it is mirrored.
    """
    about, sizes = np.zeros(3, dtype=np.int64), np.zeros(4, dtype=np.int64)
    means = np.array(_FIRST_SIZES)
    lost = np.zeros(2, dtype=np.int64)
    seen = np.zeros(2, dtype=np.int64)
    values, node = known.values, corners.node
    last = _NONE
    for polygon in order:
        first, stop = corners.starts[polygon], corners.starts[polygon + 1]
        unknown, start = 0, -1
        for corner in range(first, stop):
            if not known.there[node[corner]]:
                unknown += 1
            elif start < 0 and not known.there[node[after(corners, corner)]]:
                start = corner
        if not follow(corners, copies, polygon) and unknown:
            for i in range(3):
                about[i] = 1 if unknown == stop - first else 0
            sizes[:] = 0
            _begin(bits, corners, order, copies, polygon, regions[polygon], about, sizes)
        begun = copies.region[polygon] == copies.places[polygon]
        astray = False
        corner = max(first, start)
        for _ in range(stop - first):
            x = node[corner]
            if not known.there[x]:
                make_guess(corners, known, corner, last, guess)
                kind = guess.facts[0]
                seen[0], seen[1] = guess.at[0], guess.at[1]
                anchors = copy(corners, copies, known, corner, guess)
                if anchors:
                    kind = COPIED if anchors == 2 else BESIDE
                elif kind == AROUND and lost[1] < lost[0]:
                    guess.at[0] -= guess.back[0]
                    guess.at[1] -= guess.back[1]
                group = 1 if kind == COPIED else (kind - 1 if kind >= BESIDE else 0)
                _expect(corners, known, corner, guess.facts, kind, means[group], about, sizes)
                for i in range(2):
                    missed = _number(bits, about, sizes, 2 * group + i, values[x, i] - guess.at[i])
                    values[x, i] = guess.at[i] + missed
                    known.sizes[x] += abs(missed)
                    means[group] += (16 * bit_length(missed) - means[group]) >> 4
                    about[2] = sizes[3] = 16 * bit_length(missed)
                    if abs(values[x, i]) > LARGEST:
                        bits.failed[0] = 1
                if has_failed(bits):
                    return
                if guess.facts[0] == AROUND:
                    drawn = abs(values[x, 0] - seen[0] + guess.back[0])
                    drawn += abs(values[x, 1] - seen[1] + guess.back[1])
                    lost[0] += size_of(_miss(values, x, seen)) - (lost[0] >> 5)
                    lost[1] += size_of(drawn) - (lost[1] >> 5)
                missed = known.sizes[x]
                if anchors == 2 and missed > _TOLERATED and missed > _miss(values, x, seen):
                    astray = True
                known.there[x] = True
                last = x
            if begun:
                drop_anchor(corners, copies, known, corner)
            corner = after(corners, corner)
        if astray:
            copies.region[polygon] = -1
        elif copies.region[polygon] >= 0:
            for corner in range(first, stop):
                drop_anchor(corners, copies, known, corner)


@compiled
def _miss(values: Index, node: int, guess: Index) -> int:
    """Return the distance of a node from a guess."""
    missed: int = abs(values[node, 0] - guess[0]) + abs(values[node, 1] - guess[1])
    return missed


@compiled
def _begin(
    bits: Bits,
    corners: Corners,
    order: Index,
    copies: Copies,
    polygon: int,
    wanted: int,
    about: Index,
    sizes: Index,
) -> None:
    """Code whether a region begins with a polygon, and its image."""
    place, image, back = copies.places[polygon], (wanted - 1) >> 1, 0
    if wanted:
        back = place - copies.places[corners.polygon[image]]
    back = _number(bits, about, sizes, _BACK, back)
    if back == 0:
        return
    if back > place:
        bits.failed[0] = 1
        return
    other = order[place - back]
    turn = 2 * (image - corners.starts[other]) + ((wanted - 1) & 1)
    turn = _number(bits, about, sizes, _PLACE, turn)
    image = corners.starts[other] + (turn >> 1)
    if image >= corners.starts[other + 1] or not fits(corners, copies, polygon, other):
        bits.failed[0] = 1
        return
    give_image(corners, copies, corners.starts[polygon], image, (turn & 1) == 1, place)


@compiled
def _expect(
    corners: Corners,
    known: Known,
    corner: int,
    facts: Index,
    kind: int,
    mean: int,
    about: Index,
    sizes: Index,
) -> None:
    """Record the kind of a guess, and the expected sizes of its error."""
    a, b = corners.node[before(corners, corner)], corners.node[after(corners, corner)]
    near, edge = known.sizes[a] + known.sizes[b], 0
    if known.there[a] != known.there[b]:
        near *= 2
    if known.there[a] and known.there[b]:
        edge = abs(known.values[a, 0] - known.values[b, 0]) + abs(known.values[a, 1] - known.values[b, 1])
    about[0] = about[1] = kind << 2 | min(facts[1], 3)
    about[2] = kind
    sizes[0], sizes[1], sizes[2], sizes[3] = mean, size_of(near), size_of(edge), size_of(facts[2])


@compiled
def _number(bits: Bits, about: Index, sizes: Index, what: int, number: int) -> int:
    """Code a number in contexts of known facts ``(3,)`` and expected sizes ``(4,)``."""
    magnitude, contexts, length = abs(number), bits.contexts, 0
    while length < LONGEST:
        for i in range(4):
            contexts[i] = _beyond(length, sizes[i], 3) << 8 | what
        contexts[4] = (about[0] << 6 | length) << 8 | what
        contexts[5] = (about[1] << 6 | _beyond(length, sizes[0], 4)) << 8 | what
        contexts[6] = (
            (about[2] << 6 | _beyond(length, sizes[2], 4)) << 6 | _beyond(length, sizes[0], 4)
        ) << 8 | what
        contexts[7] = (_beyond(length, sizes[1], 4) << 6 | _beyond(length, sizes[0], 4)) << 8 | what
        if not code_hashed(bits, SEAM_KINDS + what, 1 if magnitude >> length else 0):
            break
        length += 1
    if length == 0:
        return 0
    value = 1 << (length - 1) | code_number(bits.coded, length - 1, magnitude)
    if what < _BACK and code_number(bits.coded, 1, 1 if number < 0 else 0):
        return -value
    return value


@compiled
def _beyond(length: int, size: int, shift: int) -> int:
    """Return the number of bits beyond the expected size, in units of ``2^shift`` 16ths: 1 to 63, 32 for none."""
    return min(max(16 * length - size + 8 >> shift, -31), 31) + 32


@compiled
def size_of(number: int) -> int:
    """Return the number of bits of a number that is not negative, in 16ths."""
    length = bit_length(number)
    return 16 * length + ((number << 5 >> length) & 15)
