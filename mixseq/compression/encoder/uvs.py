"""Round texture coordinates to a grid, and code them with or without copies of earlier regions.

The grid has an even number of steps over the unit square, so it contains 0, 1/2 and 1, where textures end and tiles
meet.

*Copied regions* are found by shape. A corner and its two neighbours form a triangle. Its shape, the quotient of its
sides as complex numbers, is invariant to translation, rotation and scale. Corners of similar shape are candidates for
images. From a candidate, the region grows polygon by polygon, while copied coordinates agree with actual coordinates.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil
from typing import NamedTuple

import numpy as np

from mixseq.compression.bitstream.corner_values import CodedUVs, code_uvs, from_grid, next_image
from mixseq.compression.bitstream.corners import Corners, next_corner, previous_corner
from mixseq.errors import SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues
from mixseq.runtime.jit import compiled
from mixseq.sequence.header import SequenceHeader, header_fields
from mixseq.types import Float, Index, Mask

_WIDE_SEARCH, _NARROW_SEARCH = (100, 0.2, 12.0), (12, 0.05, 24.0)
"""Number of candidates, largest distance of their shapes (in logarithms), and least number of bits a region saves."""

_MIN_ERROR_BITS = 8.0  # least number of bits of a polygon's errors for which it is tested as the start of a copy
_MAX_TESTED_POLYGONS = 4096  # largest number of tested polygons, those with the largest errors, to bound the time
_SAMPLED_POLYGONS = 256  # number of polygons examined to estimate the saving of a candidate
_COPY_TOLERANCE = 6.0, 0.01  # of a copied node: in steps, and relative to its image's distance from the first image


class _Search(NamedTuple):
    """Arrays of the search for regions."""

    corners: Corners  # corners on nodes
    places: Index  # (P,) position of every polygon in the visiting order
    values: Index  # (N, 2) coordinates of nodes, in steps
    bits: Float  # (N,) bits of a node's error without a copy
    copied: Mask  # (P,) whether a polygon is in a region
    polygon_stamps: Index  # (P,) number of the last trial that reached a polygon
    node_stamps: Index  # (N,) number of the last trial that reached a node


def encode_uvs(polygons: Polygons, vertex_count: int, numbers: Index) -> bytes:
    """Code texture coordinates ``(sum of counts, 2)`` in steps; return the smallest stream with or without copies."""
    plain = code_uvs(polygons, vertex_count, numbers)
    streams = [plain.data]
    for settings in (_WIDE_SEARCH, _NARROW_SEARCH):
        regions = find_regions(plain, *settings)
        if regions.any():
            streams.append(code_uvs(polygons, vertex_count, numbers, regions).data)
    return min(streams, key=len)


def find_regions(coded: CodedUVs, max_candidates: int, max_distance: float, min_saving: float) -> Index:
    """Find where copies begin in coordinates coded without copies; return `regions` ``(P,)`` for `code_uvs`."""
    from scipy.spatial import cKDTree

    corners, places = coded.corners, coded.copies.places
    regions = np.zeros(len(places), dtype=np.int64)
    bits = np.log2(1.0 + coded.known.errors)
    starts = corners.starts[:-1]
    shapes, valid_mask = _corner_shapes(corners, coded.known.values)
    errors = np.where(valid_mask[starts], np.add.reduceat(bits[corners.node], starts), 0.0)
    tested = np.argsort(-errors, kind="stable")[:_MAX_TESTED_POLYGONS]
    tested = tested[errors[tested] >= _MIN_ERROR_BITS]
    tested = tested[np.argsort(places[tested])]
    shape_ids = np.flatnonzero(np.concatenate([valid_mask, valid_mask]))
    if not len(tested):
        return regions
    _, nearest = cKDTree(shapes[shape_ids]).query(
        shapes[starts[tested]], k=min(max_candidates, len(shape_ids)), distance_upper_bound=max_distance
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
    _choose_regions(search, tested, shape_ids, nearest.reshape(len(tested), -1), min_saving, regions)
    return regions


@compiled
def _choose_regions(
    search: _Search, tested: Index, shape_ids: Index, nearest: Index, min_saving: float, regions: Index
) -> None:
    """Write the regions that begin with the tested polygons ``(n,)``.

    `nearest` ``(n, k)`` are places in `shape_ids`, whose length stands for none.
    """
    corners, places = search.corners, search.places
    corner_count = len(corners.node)
    stamp = 0
    for row in range(len(tested)):
        polygon = tested[row]
        if search.copied[polygon]:
            continue
        best_saving, best_shape = min_saving, 0
        for place in nearest[row]:
            if place == len(shape_ids):
                continue
            shape = shape_ids[place]
            image = shape % corner_count
            if places[corners.polygon[image]] < places[polygon]:
                stamp += 1
                mirrored = shape >= corner_count
                saving = _grow_region(search, stamp, polygon, image, mirrored, _SAMPLED_POLYGONS, False)
                if saving > best_saving:
                    best_saving, best_shape = saving, shape
        if best_saving > min_saving:
            stamp += 1
            image, mirrored = best_shape % corner_count, best_shape >= corner_count
            regions[polygon] = 2 * image + mirrored + 1
            _grow_region(search, stamp, polygon, image, mirrored, len(places), True)


def _corner_shapes(corners: Corners, values: Index) -> tuple[Float, Mask]:
    """Return the shapes ``(2 C, 2)`` of corners, then of mirrored corners, and the mask ``(C,)`` of valid shapes."""
    number = np.arange(len(corners.node))
    start, end = corners.starts[corners.polygon], corners.starts[corners.polygon + 1]
    points = values @ np.array([1, 1j])
    here = points[corners.node]
    following = points[corners.node[np.where(number + 1 < end, number + 1, start)]] - here
    previous = points[corners.node[np.where(number > start, number - 1, end - 1)]] - here
    valid_mask = (following != 0) & (previous != 0)
    quotients = np.where(valid_mask, previous, 1) / np.where(valid_mask, following, 1)
    shapes = np.log(np.concatenate([quotients, np.conj(1 / quotients)]))
    return np.stack([shapes.real, shapes.imag], axis=1), valid_mask


@compiled
def _grow_region(
    search: _Search, stamp: int, polygon: int, image: int, mirrored: bool, max_polygons: int, mark: bool
) -> float:
    """Grow a region from a polygon whose first corner has a given image; return the number of bits saved.

    A region has at most `max_polygons` polygons. With `mark`, they are marked as copied.
    """
    corners, places, values = search.corners, search.places, search.values
    node, twin, starts = corners.node, corners.twin, corners.starts
    queue = np.empty((max_polygons, 2), dtype=np.int64)
    queue[0, 0], queue[0, 1] = starts[polygon], image
    search.polygon_stamps[polygon] = stamp
    head, tail, saving = 0, 1, 0.0
    # Two distant nodes of the region, and their images.
    first, first_image = node[starts[polygon]], node[image]
    second = second_image = -1
    farthest = 0
    while head < tail:
        start, start_image = queue[head]
        head += 1
        own, other = corners.polygon[start], corners.polygon[start_image]
        size = starts[own + 1] - starts[own]
        if starts[other + 1] - starts[other] != size or places[other] >= places[own] or search.copied[own]:
            continue
        agrees, polygon_saving = True, 0.0
        corner, corner_image = start, start_image
        for _ in range(size):
            x, y = node[corner], node[corner_image]
            if second >= 0:
                error = _copy_error(values, x, y, first, first_image, second, second_image, mirrored)
                if error > _COPY_TOLERANCE[0] + _COPY_TOLERANCE[1] * _distance(values, y, first_image):
                    agrees = False
                    break
                if search.node_stamps[x] != stamp:
                    polygon_saving += search.bits[x] - np.log2(1 + error)
            corner = next_corner(corners, corner)
            corner_image = next_image(corners, corner_image, mirrored)
        if not agrees:
            continue
        saving += polygon_saving
        if mark:
            search.copied[own] = True
        corner, corner_image = start, start_image
        for _ in range(size):
            x, y = node[corner], node[corner_image]
            search.node_stamps[x] = stamp
            distance = _distance(values, y, first_image)
            if distance > farthest:
                second, second_image, farthest = x, y, distance
            across = twin[corner]
            edge = twin[previous_corner(corners, corner_image)] if mirrored else twin[corner_image]
            reached = corners.polygon[across]  # arbitrary if across is -1
            if across >= 0 and edge >= 0 and search.polygon_stamps[reached] != stamp and tail < max_polygons:
                search.polygon_stamps[reached] = stamp
                queue[tail, 0] = across
                queue[tail, 1] = next_corner(corners, edge) if mirrored else edge
                tail += 1
            corner = next_corner(corners, corner)
            corner_image = next_image(corners, corner_image, mirrored)
    return saving


@compiled
def _distance(values: Index, x: int, y: int) -> int:
    """Return the distance of two nodes in steps: the sum of the distances in u and in v."""
    distance: int = abs(values[x, 0] - values[y, 0]) + abs(values[x, 1] - values[y, 1])
    return distance


@compiled
def _copy_error(values: Index, x: int, y: int, p: int, p_image: int, q: int, q_image: int, mirrored: bool) -> float:
    """Return the error of copying node x from its image y; nodes p and q and their images define the transform."""
    sign = -1.0 if mirrored else 1.0
    side_u, side_v = values[q, 0] - values[p, 0], values[q, 1] - values[p, 1]
    image_u = values[q_image, 0] - values[p_image, 0]
    image_v = sign * (values[q_image, 1] - values[p_image, 1])
    offset_u = values[y, 0] - values[p_image, 0]
    offset_v = sign * (values[y, 1] - values[p_image, 1])
    norm = image_u * image_u + image_v * image_v
    turn_u = (side_u * image_u + side_v * image_v) / norm
    turn_v = (side_v * image_u - side_u * image_v) / norm
    error: float = abs(values[p, 0] + turn_u * offset_u - turn_v * offset_v - values[x, 0])
    error += abs(values[p, 1] + turn_u * offset_v + turn_v * offset_u - values[x, 1])
    return error


UV_ERROR = 2.0**-16  # default largest error of u and v: 1/16 of a texel of a texture of 4096 x 4096
MAX_UV_ERROR = 0.25  # largest allowed error: its grid has only the steps 0, 1/2 and 1
_MAX_STEPS = 1 << 23  # largest coordinate in steps for which float32 separates adjacent steps


def with_quantised_uvs(
    header: SequenceHeader, uv_error: float = UV_ERROR, uvs: bool = True
) -> tuple[SequenceHeader, int | None]:
    """Return a header with rounded texture coordinates, and the number of grid steps per unit."""
    if not 0 <= uv_error <= MAX_UV_ERROR:
        raise SettingsError(f"uv_error is {uv_error}; a number from 0 to {MAX_UV_ERROR} is expected")
    exact = header.surface.uvs
    if exact is None or (uvs and uv_error == 0):
        return header, None
    if not uvs:
        return _with_uvs(header, None), None
    for steps in _candidate_steps(exact, uv_error):
        values = exact.values.astype(np.float64)
        rounded = from_grid(np.rint(values * steps).astype(np.int64), steps)
        if (np.abs(rounded - values) <= uv_error).all():
            return _with_uvs(header, CornerValues(rounded, exact.indices)), steps
    return header, None


def _candidate_steps(uvs: CornerValues, error: float) -> list[int]:
    """Return candidate numbers of steps: the smallest possible, and one that allows for rounding to float32."""
    largest = float(np.abs(uvs.values).max(initial=0.0))
    if not np.isfinite(largest):
        return []
    errors = [bound for bound in (error, error - largest * 2.0**-24) if bound > 0]
    numbers = [2 * ceil(0.25 / bound) for bound in errors]
    return [steps for steps in numbers if max(largest, 1.0) * steps < _MAX_STEPS]


def _with_uvs(header: SequenceHeader, uvs: CornerValues | None) -> SequenceHeader:
    return SequenceHeader(**{**header_fields(header), "surface": replace(header.surface, uvs=uvs)})
