r"""Measures of a mesh: diagonal, edge lengths, dihedral angles, areas, volume, and normals of corners.

Lengths and errors are measured in diagonals of a bounding box, so they do not depend on scale. Squares of lengths below
1e-154 or above 1e154 do not fit into double precision, so lengths are scaled by a power of two before squaring. For
other lengths, scaling leaves results bitwise equal.

For a hinge with edge ``ab`` and opposite vertices ``c`` (first face) and ``d`` (second face), with
``e = b - a``, ``n1 = e x (c - a)`` and ``n2 = (d - a) x e``, the dihedral angle is

.. math:: \theta = \mathrm{atan2}\bigl((n_1 \times n_2) \cdot e / |e|,\; n_1 \cdot n_2\bigr)

in radians in (-pi, pi]: 0 where flat, positive where the surface is convex under the orientation of the first
face (a -> b -> c counter-clockwise seen from outside).

The normal of a group of corners (`mixseq.mesh.surface.Surface.hard_edges`) is the normalised sum of the vector areas of
their polygons. A polygon, planar or not, has the vector area :math:`\frac12 \sum x_i \times x_{i+1}`.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import cached_property
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.mesh.polygons import Polygons
from mixseq.mesh.rotations import FULL_TURN
from mixseq.types import Float, FloatArray, IntArray

BOX_ROW_POINTS = 64  # points per row in which boxes are computed, as NumPy reduces long rows fast and rows of 3 slowly


def bounding_box(points: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the lowest and the highest corner ``(3,)`` of the bounding box of points ``(V, 3)``."""
    whole = len(points) - len(points) % BOX_ROW_POINTS
    low = high = points
    if whole:
        rows, rest = points[:whole].reshape(-1, 3 * BOX_ROW_POINTS), points[whole:]
        low, high = (np.concatenate([row.reshape(-1, 3), rest]) for row in (rows.min(axis=0), rows.max(axis=0)))
    return low.min(axis=0), high.max(axis=0)


@dataclass(frozen=True)
class Diagonal:
    """Diagonal of the bounding box of a frame, stored as ``fraction * 2**exponent``."""

    fraction: float  # from 0.5 to 2, or 0 if all points coincide
    exponent: int

    @classmethod
    def from_points(cls, points: FloatArray) -> Diagonal:
        """Measure the bounding box of points ``(V, 3)``."""
        low, high = (corner.astype(np.float64) for corner in bounding_box(points))
        halved = 1 if max(np.abs(low).max(), np.abs(high).max()) > np.finfo(np.float64).max / 2 else 0
        extent = np.ldexp(high, -halved) - np.ldexp(low, -halved)
        if not extent.any():
            return cls(0.0, 0)
        _, exponent = np.frexp(extent.max())
        return cls(float(np.linalg.norm(np.ldexp(extent, -exponent))), int(exponent) + halved)

    @cached_property
    def length(self) -> float:
        """Length in the units of the points; infinite on overflow."""
        with np.errstate(over="ignore"):
            return float(np.ldexp(self.fraction, self.exponent))

    def rescale(self, lengths: FloatArray) -> Float:
        """Return lengths divided by ``2**exponent``: a length equal to the diagonal becomes `fraction`."""
        with np.errstate(over="ignore", under="ignore"):
            half = -self.exponent // 2  # the whole power of two may overflow
            halfway = np.multiply(lengths, np.ldexp(1.0, half), dtype=np.float64)
            return np.asarray(halfway * np.ldexp(1.0, -self.exponent - half))


FAR_DIAGONALS = 4.0  # distance of a mesh from zero, in diagonals, beyond which its points are relative to an own origin
NO_ORIGIN: Float = np.zeros(3)  # origin of coordinates that are relative to zero


def choose_origin(points: FloatArray) -> Float:
    """Return the origin ``(3,)`` of coordinates in single precision: zero, or near points ``(V, 3)`` that are far away.

    Its coordinates are multiples of a power of two that is about the diagonal, so that they are exact in float32.
    """
    low, high = (corner.astype(np.float64) for corner in bounding_box(points))
    largest = max(np.abs(low).max(), np.abs(high).max())
    if not (0 < largest < np.inf and FAR_DIAGONALS * (diagonal := Diagonal.from_points(points).length) < largest):
        return NO_ORIGIN
    _, exponent = np.frexp(max(diagonal, largest * 2.0**-23))
    return np.asarray(np.ldexp(np.rint(np.ldexp(low / 2 + high / 2, -exponent)), exponent), dtype=np.float64)


def vector_areas(points: FloatArray, polygons: Polygons) -> NDArray[np.float64]:
    """Return the vector areas ``(T, P, 3)`` of the polygons in frames of points ``(T, V, 3)``."""
    if polygons.only_triangles:  # as below, by a single product
        a, b, c = polygons.triangles.T
        apex = points[:, a].astype(np.float64)
        return np.asarray(np.cross(points[:, b] - apex, points[:, c] - apex) / 2)
    starts = np.cumsum(polygons.counts) - polygons.counts
    first = np.repeat(starts, polygons.counts)
    step = np.arange(polygons.indices.size) - first
    following = first + (step + 1) % np.repeat(polygons.counts, polygons.counts)
    # Relative to the polygon's first corner, as products of coordinates far from the origin lose precision.
    origin = points[:, polygons.indices[first]].astype(np.float64)
    corners = points[:, polygons.indices] - origin
    next_corners = points[:, polygons.indices[following]] - origin
    return np.add.reduceat(np.cross(corners, next_corners), starts, axis=1) / 2


def corner_normals(points: FloatArray, polygons: Polygons, groups: IntArray | None = None) -> NDArray[np.float32]:
    """Return normals ``(T, G, 3)`` of corner groups ``(sum of counts,)``, or of vertices, for points ``(T, V, 3)``."""
    group_of_corner = polygons.indices if groups is None else groups
    count = points.shape[1] if groups is None else int(group_of_corner.max(initial=-1)) + 1
    areas = vector_areas(points, polygons)
    polygon_of_corner = np.repeat(np.arange(len(polygons.counts)), polygons.counts)
    sums = np.zeros((len(points), count, 3))
    for frame, total in enumerate(sums):
        for axis in range(3):
            total[:, axis] = np.bincount(group_of_corner, areas[frame, polygon_of_corner, axis], minlength=count)
    lengths = np.linalg.norm(sums, axis=2, keepdims=True)
    up = np.array([0.0, 0.0, 1.0])
    with np.errstate(invalid="ignore", divide="ignore"):
        return np.where(lengths > 0, sums / lengths, up).astype(np.float32)


def hard_edges_from_normals(polygons: Polygons, normals: FloatArray) -> NDArray[np.int32] | None:
    """Group the corners of each vertex by equal normals ``(sum of counts, 3)``; return None if all edges are smooth."""
    # Normals are rounded to three digits, as exporters recompute the normals of a vertex face by face.
    keys = np.column_stack([polygons.indices, np.rint(normals * 1e3).astype(np.int64)])
    groups = np.unique(keys, axis=0, return_inverse=True)[1].reshape(-1)
    if groups.max(initial=-1) + 1 == np.unique(polygons.indices).size:
        return None
    return groups.astype(np.int32)


ELEMENTS_PER_BLOCK = 1 << 16  # elements that are measured at once, where temporary arrays exceed their results


def element_blocks(count: int, frames: int = 1) -> Iterator[slice]:
    """Yield slices of at most `ELEMENTS_PER_BLOCK` elements in all frames together; one slice if there are none."""
    size = max(ELEMENTS_PER_BLOCK // max(frames, 1), 1)
    return (slice(start, start + size) for start in range(0, max(count, 1), size))


def _measure(
    loop: Callable[..., None], points: FloatArray, elements: IntArray, *arguments: float, kind: type = np.float64
) -> NDArray[Any]:
    """Measure elements ``(n, k)`` of points ``(..., V, 3)`` by a compiled loop over a frame; return ``(..., n)``."""
    elements = np.require(elements, np.int32, ["C", "W"])
    values = np.empty((*points.shape[:-2], len(elements)), kind)
    frames = points.reshape(math.prod(points.shape[:-2]), *points.shape[-2:])
    for frame, row in zip(frames, values.reshape(len(frames), len(elements)), strict=True):
        loop(np.require(frame, np.float64, ["C", "W"]), elements, *arguments, row)
    return values


MIN_EDGE_LENGTH_RATIO = 1e-6  # least length of an edge relative to its typical length
MIN_DIRECTED_LENGTH = 1e-12  # in diagonals; shorter edges have no direction and no weight


def edge_lengths(points: FloatArray, edges: IntArray) -> Float:
    """Return the lengths ``(..., E)`` of edges ``(E, 2)`` for points ``(..., V, 3)``."""
    from mixseq.mesh.measure_kernels import measure_lengths

    return _measure(measure_lengths, points, edges)


def length_weights(typical: Float) -> Float:
    """Return weights ``(e,)`` of edges: inverse typical lengths, or 0 for lengths up to `MIN_DIRECTED_LENGTH`."""
    return np.divide(1.0, typical, out=np.zeros_like(typical), where=typical > MIN_DIRECTED_LENGTH)


def clamp_lengths(lengths: Float, weights: Float) -> Float:
    """Clamp lengths to at least `MIN_EDGE_LENGTH_RATIO` times the typical length, as curves may overshoot zero."""
    least = np.divide(MIN_EDGE_LENGTH_RATIO, weights, out=np.zeros_like(weights), where=weights > 0)
    return np.maximum(lengths, least)


def dihedral_angles(points: FloatArray, hinges: IntArray) -> Float:
    """Return the signed dihedral angles ``(..., H)`` of hinges ``(H, 4)`` in radians; 0 at degenerate faces.

    Examples
    --------
    A roof is convex at its ridge ab, so the angle is positive:

    >>> roof = np.array([[0.0, 0, 0], [1, 0, 0], [0, 1, -1], [0, -1, -1]])
    >>> np.degrees(dihedral_angles(roof, np.array([[0, 1, 2, 3]]))).round(9).tolist()
    [90.0]
    """
    from mixseq.mesh.measure_kernels import measure_angles

    return _measure(measure_angles, points, hinges)


def degenerate_faces(points: FloatArray, faces: IntArray, height_ratio: float) -> NDArray[np.bool_]:
    """Mark the faces ``(..., F)`` with a height of at most `height_ratio` times their longest side."""
    from mixseq.mesh.measure_kernels import mark_degenerate

    return _measure(mark_degenerate, points, faces, height_ratio, kind=np.bool_)


def scatter_add(values: FloatArray, indices: IntArray, count: int) -> Float:
    """Return sums ``(count, k)`` of the values ``(m, k)`` with equal indices ``(m,)``, added in order."""
    sums = [np.bincount(indices, column, minlength=count) for column in values.T]
    return np.stack(sums, axis=1).astype(np.float64)  # bincount returns integers without values


def triangle_areas(points: FloatArray, faces: IntArray) -> Float:
    """Return the areas ``(F,)`` of triangles ``(F, 3)`` of points ``(V, 3)``."""
    from mixseq.mesh.measure_kernels import measure_areas

    return _measure(measure_areas, points, faces)


def signed_volume(points: FloatArray, faces: IntArray) -> float:
    """Return the signed volume inside faces ``(m, 3)`` of points ``(n, 3)``, computed relative to the mean point."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    return float(np.einsum("fi,fi->", a, np.cross(b, c))) / 6.0


def volume_gradient(points: FloatArray, faces: IntArray) -> Float:
    """Return the derivatives ``(n, 3)`` of `signed_volume` by the points; their sum is zero."""
    x = points - points.mean(axis=0)
    a, b, c = (x[corner] for corner in faces.T)
    corner_gradients = np.concatenate([np.cross(b, c), np.cross(c, a), np.cross(a, b)]) / 6.0
    gradient = scatter_add(corner_gradients, faces.T.reshape(-1), len(x))
    return np.asarray(gradient - gradient.mean(axis=0))


def wrap_angles(angles: FloatArray) -> Float:
    """Map angles to (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - angles, FULL_TURN), dtype=np.float64)


def unwrap_angles(angles: FloatArray, reference: FloatArray | None = None) -> Float:
    """Make angles ``(T, H)`` continuous in time by adding multiples of 2 pi, starting from a reference ``(H,)``."""
    result = np.array(angles, dtype=np.float64)
    previous = reference
    for frame in result:  # frame by frame, so that results do not depend on blocks
        if previous is not None:
            frame -= FULL_TURN * np.round((frame - previous) / FULL_TURN)
        previous = frame
    return result
