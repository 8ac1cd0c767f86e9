"""Exact closest points of a triangle mesh, optionally only where the mesh faces the same way.

`trimesh.proximity.closest_point` supports no directions, needs rtree, and takes 17 times as long (from one frame of
horse_gallop to another, 8431 points, with building the tree; distances differ by 3e-6 diagonals at most).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.errors import SettingsError
from mixseq.geometry.box_tree import BoxTree, corners_of, unit_normals

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
        from mixseq.geometry.box_tree_kernels import closest

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
