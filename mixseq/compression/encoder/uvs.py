"""Texture coordinates of a compressed file: rounded to a grid, and coded with or without copies of earlier regions.

The grid on the unit square has an even number of steps, so that 0, 1/2 and 1, where textures end and tiles meet, are
kept.

*Regions* that are copies of earlier ones: a corner with its two neighbours is a triangle, whose shape, the quotient of
its sides as complex numbers, is invariant to translation, rotation and scale. Corners of similar shape are candidates
for images. The region grown from a candidate is compared with the coordinates, polygon by polygon, as far as they
agree.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from mixseq.compression.bitstream.connectivity import Corners, after, before
from mixseq.compression.bitstream.corner_values import CodedUVs, code_uvs, grid_values
from mixseq.errors import SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues
from mixseq.runtime.jit import compiled
from mixseq.sequence.header import SequenceHeader, header_fields
from mixseq.types import Float, Index

_WIDE, _NARROW = (100, 0.2, 12.0), (12, 0.05, 24.0)
"""Number of candidates, largest distance of their shapes (in logarithms), and bits that a region has to save."""

_HEAVY = 8.0
"""Bits of errors of a polygon from which it is tested as the start of a copy."""

_MOST_ASKED = 4096
"""Largest number of tested polygons, those with the largest errors first, which bounds the time."""

_TRIED = 256
"""Number of polygons examined to estimate the saving of a candidate."""

_OFF = 6.0, 0.01
"""Tolerance of a copy: in steps, and as a share of its distance."""


class _Search(NamedTuple):
    """Arrays of the search for regions."""

    corners: Corners  # corners on nodes
    places: Index  # (P,) when polygons are visited
    values: Index  # (N, 2) coordinates
    bits: Float  # (N,) bits of a node's error without a copy
    covered: NDArray[np.bool_]  # (P,) which polygons are copies already
    polygons: Index  # (P,) number of the last try that reached a polygon
    nodes: Index  # (N,) number of the last try that reached a node


def encode_uvs(polygons: Polygons, vertex_count: int, numbers: Index) -> bytes:
    """Code texture coordinates ``(sum of counts, 2)`` in steps, with or without copies, whichever is smallest."""
    plain = code_uvs(polygons, vertex_count, numbers)
    tried = [plain.data]
    for settings in (_WIDE, _NARROW):
        regions = find_regions(plain, *settings)
        if regions.any():
            tried.append(code_uvs(polygons, vertex_count, numbers, regions).data)
    return min(tried, key=len)


def find_regions(coded: CodedUVs, candidates: int, apart: float, least: float) -> Index:
    """Return where copies begin, as `code_uvs` takes it, in coordinates coded without copies."""
    from scipy.spatial import cKDTree

    corners, places = coded.corners, coded.copies.places
    regions = np.zeros(len(places), dtype=np.int64)
    bits = np.log2(1.0 + coded.known.sizes)
    starts = corners.starts[:-1]
    shapes, sound = _shapes(corners, coded.known.values)
    count = len(corners.node)
    misses = np.where(sound[starts], np.add.reduceat(bits[corners.node], starts), 0.0)
    asked = np.argsort(-misses, kind="stable")[:_MOST_ASKED]
    asked = asked[misses[asked] >= _HEAVY]
    asked = asked[np.argsort(places[asked])]
    there = np.flatnonzero(np.concatenate([sound, sound]))
    if not len(asked):
        return regions
    _, found = cKDTree(shapes[there]).query(
        shapes[starts[asked]], k=min(candidates, len(there)), distance_upper_bound=apart
    )
    search = _Search(
        corners,
        places,
        coded.known.values,
        bits,
        np.zeros(len(places), dtype=np.bool_),
        np.zeros(len(places), dtype=np.int64),
        np.zeros(len(bits), dtype=np.int64),
    )
    tries = 0
    for polygon, row in zip(asked.tolist(), found.reshape(len(asked), -1).tolist(), strict=True):
        if search.covered[polygon]:
            continue
        best, saved = (0, False), least
        for each in there[[place for place in row if place < len(there)]].tolist():
            image, mirrored = each % count, each >= count
            if places[corners.polygon[image]] < places[polygon]:
                tries += 1
                saves = _cover(search, tries, polygon, image, mirrored, _TRIED, False)
                if saves > saved:
                    best, saved = (image, mirrored), saves
        if saved > least:
            tries += 1
            regions[polygon] = 2 * best[0] + best[1] + 1
            _cover(search, tries, polygon, *best, len(places), True)
    return regions


def _shapes(corners: Corners, values: Index) -> tuple[Float, Index]:
    """Return the shapes ``(2 C, 2)`` of corners, then of their mirror images; also which corners ``(C,)`` have one."""
    number = np.arange(len(corners.node))
    start, end = corners.starts[corners.polygon], corners.starts[corners.polygon + 1]
    at = values @ np.array([1, 1j])
    here = at[corners.node]
    side = at[corners.node[np.where(number + 1 < end, number + 1, start)]] - here
    other = at[corners.node[np.where(number > start, number - 1, end - 1)]] - here
    sound = (side != 0) & (other != 0)
    shape = np.where(sound, other, 1) / np.where(sound, side, 1)
    both = np.log(np.concatenate([shape, np.conj(1 / shape)]))
    return np.stack([both.real, both.imag], axis=1), sound


@compiled
def _cover(
    search: _Search, stamp: int, polygon: int, image: int, mirrored: bool, most: int, mark: bool
) -> float:
    """Return the bits saved by giving a polygon's first corner an image, and growing the region from it.

    With `mark`, the polygons of the region, at most `most`, are marked as covered.
    """
    corners, places, values = search.corners, search.places, search.values
    node, twin, starts = corners.node, corners.twin, corners.starts
    queue = np.empty((most, 2), dtype=np.int64)
    queue[0, 0], queue[0, 1] = starts[polygon], image
    search.polygons[polygon] = stamp
    head, tail, saved = 0, 1, 0.0
    # two nodes far from each other, and their images
    first, first_image = node[starts[polygon]], node[image]
    second = second_image = -1
    far = 0
    while head < tail:
        start, start_image = queue[head]
        head += 1
        own, other = corners.polygon[start], corners.polygon[start_image]
        size = starts[own + 1] - starts[own]
        if starts[other + 1] - starts[other] != size or places[other] >= places[own] or search.covered[own]:
            continue
        agrees, local = True, 0.0
        corner, there = start, start_image
        for _ in range(size):
            x, y = node[corner], node[there]
            if second >= 0:
                off = _off(values, x, y, first, first_image, second, second_image, mirrored)
                distance = abs(values[y, 0] - values[first_image, 0]) + abs(
                    values[y, 1] - values[first_image, 1]
                )
                if off > _OFF[0] + _OFF[1] * distance:
                    agrees = False
                    break
                if search.nodes[x] != stamp:
                    local += search.bits[x] - np.log2(1 + off)
            corner = after(corners, corner)
            there = before(corners, there) if mirrored else after(corners, there)
        if not agrees:
            continue
        saved += local
        if mark:
            search.covered[own] = True
        corner, there = start, start_image
        for _ in range(size):
            x, y = node[corner], node[there]
            search.nodes[x] = stamp
            distance = abs(values[y, 0] - values[first_image, 0]) + abs(values[y, 1] - values[first_image, 1])
            if distance > far:
                second, second_image, far = x, y, distance
            beside = twin[corner]
            edge = twin[before(corners, there)] if mirrored else twin[there]
            if (
                beside >= 0
                and edge >= 0
                and search.polygons[corners.polygon[beside]] != stamp
                and tail < most
            ):
                search.polygons[corners.polygon[beside]] = stamp
                queue[tail, 0] = beside
                queue[tail, 1] = after(corners, edge) if mirrored else edge
                tail += 1
            corner = after(corners, corner)
            there = before(corners, there) if mirrored else after(corners, there)
    return saved


@compiled
def _off(values: Index, x: int, y: int, p: int, p_image: int, q: int, q_image: int, mirrored: bool) -> float:
    """Return the distance of a node from its position predicted by its image y, and p and q with theirs."""
    sign = -1.0 if mirrored else 1.0
    here_u, here_v = values[q, 0] - values[p, 0], values[q, 1] - values[p, 1]
    there_u = values[q_image, 0] - values[p_image, 0]
    there_v = sign * (values[q_image, 1] - values[p_image, 1])
    away_u = values[y, 0] - values[p_image, 0]
    away_v = sign * (values[y, 1] - values[p_image, 1])
    whole = there_u * there_u + there_v * there_v
    turn_u = (here_u * there_u + here_v * there_v) / whole
    turn_v = (here_v * there_u - here_u * there_v) / whole
    off: float = abs(values[p, 0] + turn_u * away_u - turn_v * away_v - values[x, 0])
    off += abs(values[p, 1] + turn_u * away_v + turn_v * away_u - values[x, 1])
    return off


UV_ERROR = 2.0**-16
"""Default largest error of u and v: 1/16 of a texel of a texture of 4096 x 4096."""

MOST_UV_ERROR = 0.25
"""Largest allowed error: coarser grids have no steps between 0, 1/2 and 1."""

_MOST_STEPS = 1 << 23
"""Largest coordinate in steps for which float32 separates adjacent steps."""


def with_quantised_uvs(
    header: SequenceHeader, uv_error: float = UV_ERROR, uvs: bool = True
) -> tuple[SequenceHeader, int | None]:
    """Return a header with rounded texture coordinates, and the number of grid steps per unit."""
    if not 0 <= uv_error <= MOST_UV_ERROR:
        raise SettingsError(f"uv_error is {uv_error}; a number from 0 to {MOST_UV_ERROR} is expected")
    exact = header.surface.uvs
    if exact is None or (uvs and uv_error == 0):
        return header, None
    if not uvs:
        return _with_uvs(header, None), None
    for steps in _numbers_of_steps(exact, uv_error):
        values = exact.values.astype(np.float64)
        rounded = grid_values(np.rint(values * steps).astype(np.int64), steps)
        if (np.abs(rounded - values) <= uv_error).all():
            return _with_uvs(header, CornerValues(rounded, exact.indices)), steps
    return header, None


def _numbers_of_steps(uvs: CornerValues, error: float) -> list[int]:
    """Return candidate numbers of steps: the smallest possible, and one for which rounding to float32 does no harm."""
    largest = float(np.abs(uvs.values).max(initial=0.0))
    if not np.isfinite(largest):
        return []
    errors = [each for each in (error, error - largest * 2.0**-24) if each > 0]
    numbers = [2 * ceil(0.25 / each) for each in errors]
    return [steps for steps in numbers if max(largest, 1.0) * steps < _MOST_STEPS]


def _with_uvs(header: SequenceHeader, uvs: CornerValues | None) -> SequenceHeader:
    return SequenceHeader(**{**header_fields(header), "surface": replace(header.surface, uvs=uvs)})
