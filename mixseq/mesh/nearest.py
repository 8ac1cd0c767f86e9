"""Exact closest points of a triangle mesh, its self-intersections, and attachments of its disconnected pieces.

Closest points may be limited to where the mesh faces the same way. `trimesh.proximity.closest_point` supports no
directions, needs rtree, and takes 17 times as long (from one frame of horse_gallop to another, 8431 points, with
building the tree; distances differ by 3e-6 diagonals at most).

Every piece but the first, such as eyes, teeth and shoes, is attached at one vertex to one vertex of another piece: the
nearest of those attached already, as in the shortest spanning tree (Prim 1957). Pieces that follow a leader are
attached to it.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.spatial import cKDTree

from mixseq.errors import SettingsError
from mixseq.mesh.box_tree import BoxTree, corners_of, unit_normals
from mixseq.types import Float, FloatArray, Index, IntArray

TOUCH = 1e-12
"""Depths and lengths up to this, in diagonals of the mesh's bounding box, are contact."""


def self_intersections(points: FloatArray, faces: IntArray) -> Index:
    """Find pairs ``(k, 2)`` of triangles ``(F, 3)`` of points ``(V, 3)`` that cross and have no common corner.

    Each has corners on both sides of the other's plane, and they share a segment longer than `TOUCH`. Contact, overlap
    in one plane, and triangles without area do not count. Vertices at the same place, as at seams, are common corners.
    """
    from mixseq.mesh.box_tree import crossing_pairs

    corners = corners_of(points, faces)
    tree = BoxTree.of(corners)
    sizes = tree.boxes[1, 3:] - tree.boxes[1, :3]
    least = TOUCH * float(np.sqrt(sizes @ sizes)) if len(corners) else 0.0
    order = tree.order
    arrays = corners[order], unit_normals(corners)[order], _places(corners)[order]
    pairs = np.empty((len(corners), 2), dtype=np.int64)
    count = crossing_pairs(*arrays, order, tree.firsts, tree.boxes, least, pairs)
    if count > len(pairs):
        pairs = np.empty((count, 2), dtype=np.int64)
        crossing_pairs(*arrays, order, tree.firsts, tree.boxes, least, pairs)
    pairs = pairs[:count]
    return np.asarray(pairs[np.lexsort((pairs[:, 1], pairs[:, 0]))])


def _places(corners: Float) -> Index:
    """Number the positions ``(F, 3)`` of corners, equal ones alike."""
    flat = corners.reshape(-1, 3)
    order = np.lexsort(flat.T)
    new = (np.diff(flat[order], axis=0, prepend=np.nan) != 0).any(axis=1)
    result = np.empty(len(flat), dtype=np.int64)
    result[order] = np.cumsum(new)
    return result.reshape(-1, 3)


ROUNDING = 1e-12  # of cosines, so that angles of 0 and 180 degrees count what they should


@dataclass(frozen=True, eq=False)
class Found:
    """Closest points of a mesh."""

    faces: Index  # (n,) their triangles; -1 where there is none: no triangle faces the same way, or the mesh is empty
    weights: Float  # (n, 3) their barycentric coordinates, in [0, 1] and adding to one; 0 where there is none
    distances: Float  # (n,) their distances from the queries, in the unit of the points; infinite where there is none


@dataclass(frozen=True, eq=False)
class Nearest:
    """Closest-point queries on a triangle mesh."""

    tree: BoxTree  # boxes around the triangles
    # (F, 3, 3) corners of the triangles, in the order of the tree, and those of a triangle by x, y, z: triangles that
    # share a side run along it the same way, seams or not, and compute the same bits, so that ties are ties.
    corners: Float
    sorting: (
        Index  # (F, 3) which corner of triangle f (in the mesh's order) comes first, second, third in that
    )
    normals: Float  # (F, 3) unit normals in the order of the tree, NaN where a triangle has no area
    bounds: Float  # (2 L, 6) least and largest x, y, z of the normals in every node of the tree

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Nearest:
        """Prepare the mesh of triangles ``(F, 3)`` of points ``(V, 3)``."""
        corners = corners_of(points, faces)
        tree = BoxTree.of(corners)
        sorting = np.lexsort((corners[..., 2], corners[..., 1], corners[..., 0]), axis=-1)
        by_place = np.take_along_axis(corners, sorting[..., None], axis=1)[tree.order]
        normals = unit_normals(corners)
        return cls(tree, by_place, sorting, normals[tree.order], tree.bounds(normals))

    def query(
        self, queries: FloatArray, normals: FloatArray | None = None, largest_angle: float = 90.0
    ) -> Found:
        """Find closest points to queries ``(n, 3)``, optionally within `largest_angle` degrees of normals ``(n, 3)``.

        Without a point within the angle the face is -1.
        """
        from mixseq.mesh.box_tree import closest

        queries = _directions_or_points(queries, "queries")
        facing = np.empty((0, 3))
        if normals is not None:
            facing = _directions_or_points(normals, "normals")
            if len(facing) != len(queries):
                raise SettingsError(
                    f"there are {len(queries)} queries and {len(facing)} normals; give as many"
                )
            lengths = np.sqrt(np.einsum("ni,ni->n", facing, facing))[:, None]
            facing = facing / np.where(lengths > 0, lengths, np.nan)
        if not 0 <= largest_angle <= 180:
            raise SettingsError(f"the largest angle is {largest_angle}; give degrees from 0 to 180")
        cosine = float(np.cos(np.radians(largest_angle))) - ROUNDING
        count = len(queries)
        faces, by_place, squares = np.empty(count, np.int64), np.empty((count, 3)), np.empty(count)
        tree = self.tree
        closest(
            self.corners,
            self.normals,
            tree.order,
            tree.firsts,
            tree.boxes,
            self.bounds,
            queries,
            facing,
            cosine,
            faces,
            by_place,
            squares,
        )
        weights = np.zeros((count, 3))
        some = np.flatnonzero(faces >= 0)
        weights[some[:, None], self.sorting[faces[some]]] = np.maximum(by_place[some], 0.0)
        return Found(faces, weights, np.sqrt(squares))


def _directions_or_points(values: FloatArray, what: str) -> Float:
    # A copy: read-only arrays would be compiled for again.
    result = np.array(values, dtype=np.float64, order="C")
    if result.ndim != 2 or result.shape[1] != 3:
        raise SettingsError(f"{what} have the shape {result.shape}; give (n, 3)")
    broken = ~np.isfinite(result).all(axis=1)
    if broken.any():
        raise SettingsError(f"{what}[{int(broken.argmax())}] is not finite; give finite {what}")
    return result


@dataclass(frozen=True, eq=False)
class Attachments:
    """A tree of pieces: each but the root is attached to another one at a vertex."""

    root: int  # the piece that holds all others
    pieces: Index  # (n,) the others, each after its holder
    own: Index  # (n,) the vertex by which each is held
    other: Index  # (n,) the vertex of the holder
    holders: Index  # (n,) the piece of that vertex

    def __len__(self) -> int:
        return len(self.pieces)


def attach(pieces: Sequence[Index], points: Float, leaders: Index) -> Attachments:
    """Attach every piece of a mesh ``(V, 3)`` but the largest to another one, or to its leader ``(V,)``."""
    led = np.array([bool((leaders[each] != each).all()) for each in pieces])
    sizes = np.array([np.linalg.norm(np.ptp(points[each], axis=0)) for each in pieces])
    root = int(np.argmax(np.where(led, -1.0, sizes)))
    free = [number for number in range(len(pieces)) if number != root and not led[number]]
    rows = _spanning_tree(pieces, points, root, free)
    home = np.full(len(points), -1, dtype=np.int64)
    for number in np.flatnonzero(~led)[::-1].tolist():
        home[pieces[number]] = number
    for number in np.flatnonzero(led).tolist():
        other = int(leaders[pieces[number][0]])
        near = np.linalg.norm(points[pieces[number]] - points[other], axis=1).argmin()
        rows.append((number, int(pieces[number][near]), other, int(home[other])))
    table = np.array(rows, dtype=np.int64).reshape(-1, 4)
    return Attachments(root, *table.T)


def _spanning_tree(
    pieces: Sequence[Index], points: Float, root: int, free: list[int]
) -> list[tuple[int, int, int, int]]:
    """Return rows of piece, own vertex, other vertex, holder."""
    if not free:
        return []
    vertices = np.concatenate([pieces[number] for number in free])
    owner = np.repeat(free, [len(pieces[number]) for number in free])
    distance = np.full(len(vertices), np.inf)
    other = np.zeros((2, len(vertices)), dtype=np.int64)
    rows: list[tuple[int, int, int, int]] = []
    newest = root
    while len(vertices):
        found, nearest = map(np.asarray, cKDTree(points[pieces[newest]]).query(points[vertices]))
        closer = found < distance
        distance[closer] = found[closer]
        other[0, closer], other[1, closer] = pieces[newest][nearest[closer]], newest
        first = int(distance.argmin())
        newest = int(owner[first])
        rows.append((newest, int(vertices[first]), int(other[0, first]), int(other[1, first])))
        rest = owner != newest
        vertices, owner, distance, other = vertices[rest], owner[rest], distance[rest], other[:, rest]
    return rows
