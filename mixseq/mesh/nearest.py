"""Exact closest points of a triangle mesh, hits of rays, self-intersections, and attachments of disconnected pieces.

Closest points may be limited to triangles that face the same way as the query, which trimesh does not support.

Disconnected pieces, such as eyes, teeth and shoes, are attached to the largest piece by a minimum spanning tree (Prim
1957). Each piece is attached at one vertex to the nearest vertex of the pieces attached before. Pieces that follow a
leader vertex are attached to the leader.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.box_tree import BoxTree, closest, crossing_pairs, triangle_corners, unit_normals
from mixseq.types import Float, FloatArray, Index, IntArray

CONTACT_TOLERANCE = 1e-12  # largest depth or length of an intersection that counts as contact, in diagonals


def self_intersections(points: FloatArray, faces: IntArray) -> Index:
    """Find pairs ``(k, 2)`` of triangles ``(F, 3)`` of points ``(V, 3)`` that cross and have no common corner.

    Each triangle has corners on both sides of the other's plane, and both share a segment above `CONTACT_TOLERANCE`.
    Contact, overlap in one plane, and triangles without area do not count. Vertices with equal positions, as at seams,
    are common corners.
    """
    corners = triangle_corners(points, faces)
    tree = BoxTree.from_triangles(corners)
    extent = tree.boxes[1, 3:] - tree.boxes[1, :3]
    tolerance = CONTACT_TOLERANCE * float(np.sqrt(extent @ extent)) if len(corners) else 0.0
    order = tree.order
    arrays = corners[order], unit_normals(corners)[order], _position_ids(corners)[order]
    pairs = np.empty((len(corners), 2), dtype=np.int64)
    count = crossing_pairs(*arrays, order, tree.leaf_starts, tree.boxes, tolerance, pairs)
    if count > len(pairs):
        pairs = np.empty((count, 2), dtype=np.int64)
        crossing_pairs(*arrays, order, tree.leaf_starts, tree.boxes, tolerance, pairs)
    pairs = pairs[:count]
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _position_ids(corners: Float) -> Index:
    """Number the distinct positions ``(F, 3)`` of corners ``(F, 3, 3)``."""
    positions = corners.reshape(-1, 3)
    order = np.lexsort(positions.T)
    is_new = (np.diff(positions[order], axis=0, prepend=np.nan) != 0).any(axis=1)
    ids = np.empty(len(positions), dtype=np.int64)
    ids[order] = np.cumsum(is_new)
    return ids.reshape(-1, 3)


COSINE_TOLERANCE = 1e-12  # so that limits of 0 and 180 degrees include equal and opposite directions


@dataclass(frozen=True, eq=False)
class ClosestPoints:
    """Closest points of a mesh; queries without a result have triangle -1, weights 0 and an infinite distance."""

    faces: Index  # (n,) triangles of the closest points
    weights: Float  # (n, 3) barycentric coordinates of the closest points, in [0, 1] with sum 1
    distances: Float  # (n,) distances from the queries, in the unit of the points


@dataclass(frozen=True, eq=False)
class ClosestPointQuery:
    """Closest-point queries on a triangle mesh."""

    tree: BoxTree  # boxes around the triangles
    # (F, 3, 3) corners of the triangles: triangles in the order of the tree, corners sorted by x, y, z. So triangles
    # that share a side, even at a seam, compute bitwise equal distances from it.
    corners: Float
    corner_order: Index  # (F, 3) sorted corners of every triangle, triangles in the order of the mesh
    normals: Float  # (F, 3) unit normals in the order of the tree, NaN where a triangle has no area
    normal_bounds: Float  # (2 L, 6) least and largest x, y, z of the normals in every node of the tree
    face_ids: Index | None  # (F,) triangles of the mesh that are searched, None for all

    @classmethod
    def from_mesh(
        cls, points: FloatArray, faces: IntArray, face_ids: Index | None = None, order: Index | None = None
    ) -> ClosestPointQuery:
        """Prepare queries on the triangles ``(F, 3)`` of points ``(V, 3)``, or only on those in `face_ids` ``(n,)``.

        The order of the tree of the same triangles in another pose saves two thirds of the time.
        """
        corners = triangle_corners(points, faces if face_ids is None else faces[face_ids])
        tree = BoxTree.from_triangles(corners, order)
        corner_order = np.lexsort((corners[..., 2], corners[..., 1], corners[..., 0]), axis=-1)
        sorted_corners = np.take_along_axis(corners, corner_order[..., None], axis=1)[tree.order]
        normals = unit_normals(corners)
        return cls(tree, sorted_corners, corner_order, normals[tree.order], tree.node_bounds(normals), face_ids)

    def query(
        self,
        queries: FloatArray,
        normals: FloatArray | None = None,
        largest_angle: float = 90.0,
        max_distance: float = np.inf,
    ) -> ClosestPoints:
        """Find closest points to queries ``(n, 3)``, within an angle (degrees) of optional normals, and a distance."""
        queries = _check_vectors(queries, "queries")
        directions = np.empty((0, 3))
        if normals is not None:
            directions = _check_vectors(normals, "normals")
            if len(directions) != len(queries):
                raise SettingsError(f"there are {len(queries)} queries and {len(directions)} normals; give as many")
            lengths = np.sqrt(np.einsum("ni,ni->n", directions, directions))[:, None]
            directions = directions / np.where(lengths > 0, lengths, np.nan)
        if not 0 <= largest_angle <= 180:
            raise SettingsError(f"the largest angle is {largest_angle}; give degrees from 0 to 180")
        min_cosine = float(np.cos(np.radians(largest_angle))) - COSINE_TOLERANCE
        count, tree = len(queries), self.tree
        faces, sorted_weights, distances = np.empty(count, np.int64), np.empty((count, 3)), np.empty(count)
        arrays = self.corners, self.normals, tree.order, tree.leaf_starts, tree.boxes, self.normal_bounds
        closest(*arrays, queries, directions, min_cosine, float(max_distance), faces, sorted_weights, distances)
        weights = np.zeros((count, 3))
        hits = np.flatnonzero(faces >= 0)
        weights[hits[:, None], self.corner_order[faces[hits]]] = np.maximum(sorted_weights[hits], 0.0)
        if self.face_ids is not None:
            faces[hits] = self.face_ids[faces[hits]]
        return ClosestPoints(faces, weights, distances)

    def query_facing(self, queries: Float, normals: Float) -> tuple[Index, Float]:
        """Return the closest triangles that face the same way, or else the closest of any, and barycentric weights."""
        closest = self.query(queries, normals)
        unmatched = np.flatnonzero(closest.faces < 0)
        if unmatched.size:
            closest_any = self.query(queries[unmatched])
            closest.faces[unmatched], closest.weights[unmatched] = closest_any.faces, closest_any.weights
        return closest.faces, closest.weights


def _check_vectors(vectors: FloatArray, what: str) -> Float:
    """Return a copy of vectors ``(n, 3)``; raise SettingsError for another shape or values that are not finite."""
    # The array is copied, as numba would compile another version for read-only arrays.
    result = np.array(vectors, dtype=np.float64, order="C")
    if result.ndim != 2 or result.shape[1] != 3:
        raise SettingsError(f"{what} have the shape {result.shape}; give (n, 3)")
    infinite = ~np.isfinite(result).all(axis=1)
    if infinite.any():
        raise SettingsError(f"{what}[{int(infinite.argmax())}] is not finite; give finite {what}")
    return result


@dataclass(frozen=True, eq=False)
class Attachments:
    """A tree of pieces: every piece except the root is attached at a vertex to another piece, its holder."""

    root: int  # the piece without a holder
    pieces: Index  # (n,) attached pieces, each after its holder
    vertices: Index  # (n,) attached vertex of each piece
    holder_vertices: Index  # (n,) vertex of the holder to which each piece is attached
    holders: Index  # (n,) holder of each piece

    def __len__(self) -> int:
        return len(self.pieces)


def attach_pieces(pieces: Sequence[Index], points: Float, leaders: Index) -> Attachments:
    """Attach pieces of a mesh ``(V, 3)`` to their leaders ``(V,)``, and pieces without to near ones."""
    is_led = np.array([bool((leaders[vertices] != vertices).all()) for vertices in pieces])
    diagonals = np.array([np.linalg.norm(np.ptp(points[vertices], axis=0)) for vertices in pieces])
    root = int(np.argmax(np.where(is_led, -1.0, diagonals)))
    free = [piece for piece in range(len(pieces)) if piece != root and not is_led[piece]]
    rows = _spanning_tree(pieces, points, root, free)
    piece_of_vertex = np.full(len(points), -1, dtype=np.int64)
    for piece in np.flatnonzero(~is_led)[::-1].tolist():
        piece_of_vertex[pieces[piece]] = piece
    for piece in np.flatnonzero(is_led).tolist():
        leader = int(leaders[pieces[piece][0]])
        nearest = np.linalg.norm(points[pieces[piece]] - points[leader], axis=1).argmin()
        rows.append((piece, int(pieces[piece][nearest]), leader, int(piece_of_vertex[leader])))
    table = np.array(rows, dtype=np.int64).reshape(-1, 4)
    return Attachments(root, *table.T)


def _spanning_tree(
    pieces: Sequence[Index], points: Float, root: int, free: list[int]
) -> list[tuple[int, int, int, int]]:
    """Return the minimum spanning tree as rows of piece, vertex, holder vertex and holder."""
    if not free:
        return []
    from scipy.spatial import cKDTree  # slow import, unused by meshes of one piece

    vertices = np.concatenate([pieces[piece] for piece in free])
    owners = np.repeat(free, [len(pieces[piece]) for piece in free])
    distances = np.full(len(vertices), np.inf)
    holder_vertices, holders = np.zeros((2, len(vertices)), dtype=np.int64)
    rows: list[tuple[int, int, int, int]] = []
    newest = root
    while len(vertices):
        to_newest, nearest = map(np.asarray, cKDTree(points[pieces[newest]]).query(points[vertices]))
        closer = to_newest < distances
        distances[closer] = to_newest[closer]
        holder_vertices[closer], holders[closer] = pieces[newest][nearest[closer]], newest
        first = int(distances.argmin())
        newest = int(owners[first])
        rows.append((newest, int(vertices[first]), int(holder_vertices[first]), int(holders[first])))
        rest = owners != newest
        vertices, owners, distances = vertices[rest], owners[rest], distances[rest]
        holder_vertices, holders = holder_vertices[rest], holders[rest]
    return rows


class RayHit(NamedTuple):
    """First intersection of a ray with a mesh."""

    face: int  # index of the triangle
    vertex: int  # corner of this triangle nearest to the intersection
    distance: float  # ray parameter of the intersection


def intersect_ray(points: FloatArray, faces: IntArray, origin: ArrayLike, direction: ArrayLike) -> RayHit | None:
    """Return the first hit of a ray on two-sided triangles ``(F, 3)`` of points ``(V, 3)``, None if there is no hit."""
    start, ray = np.asarray(origin, dtype=np.float64), np.asarray(direction, dtype=np.float64)
    corners = np.asarray(points, dtype=np.float64)[faces]
    a, b, c = np.moveaxis(corners, 1, 0)
    first, second = b - a, c - a
    normal = np.cross(ray, second)
    volume = np.einsum("fi,fi->f", first, normal)
    with np.errstate(divide="ignore", over="ignore", invalid="ignore"):  # the ray may lie in the plane of a triangle
        offset = start - a
        u = np.einsum("fi,fi->f", offset, normal) / volume
        cross = np.cross(offset, first)
        v = cross @ ray / volume
        t = np.einsum("fi,fi->f", second, cross) / volume
        is_hit = (u >= 0) & (v >= 0) & (u + v <= 1) & (t > 0) & np.isfinite(t)
    if not is_hit.any():
        return None
    face = int(np.where(is_hit, t, np.inf).argmin())
    nearest = np.linalg.norm(corners[face] - (start + t[face] * ray), axis=1).argmin()
    return RayHit(face, int(faces[face, nearest]), float(t[face]))
