r"""Dense correspondence: the point and triangle of a source for every vertex and triangle of a target.

A target vertex v is the point :math:`\sum_k w_{vk}\, x_{c_{vk}}` of the source, with three corners c and barycentric
weights w. Vertices without a counterpart (eyes, teeth, hats) rigidly follow another vertex of the target, their
*leader*.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, FloatArray, Index, Mask
from mixseq.errors import SettingsError


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Where the vertices and triangles of a target are on a source.

    Attributes
    ----------
    source_size, target_size : (int, int)
        Vertices and triangles of the two meshes.
    corners : (V', 3) int64
        Source vertices around every target vertex; all -1 where it follows its leader.
    weights : (V', 3) float64
        Their barycentric weights; they add to one.
    faces : (F',) int64
        The source triangle that moves every target triangle; -1 where a corner of it follows a leader.
    leaders : (V',) int64
        The target vertex that a vertex without corners follows; elsewhere the vertex itself.
    """

    source_size: tuple[int, int]
    target_size: tuple[int, int]
    corners: Index
    weights: Float
    faces: Index
    leaders: Index

    @classmethod
    def identity(cls, vertex_count: int, face_count: int) -> Correspondence:
        """Make the identity of meshes of the same connectivity."""
        vertices = np.arange(vertex_count)
        size = vertex_count, face_count
        weights = np.tile([1.0, 0.0, 0.0], (vertex_count, 1))
        corners = np.repeat(vertices[:, None], 3, axis=1)
        return cls(size, size, corners, weights, np.arange(face_count), vertices)

    @cached_property
    def matched(self) -> Mask:
        """Target vertices ``(V',)`` with a point on the source."""
        return np.asarray((self.corners >= 0).all(axis=1))

    def carry(self, values: FloatArray) -> Float:
        """Transfer values ``(..., V, c)`` of source vertices to target vertices or their leaders, ``(..., V', c)``."""
        corners, weights = self.corners[self.leaders], self.weights[self.leaders]
        return np.asarray(np.einsum("vk,...vkc->...vc", weights, values[..., corners, :]))

    def check(self, source_size: tuple[int, int], target_size: tuple[int, int]) -> None:
        """Raise `SettingsError` if numbers of vertices or triangles differ."""
        for what, own, given in (
            ("source", self.source_size, source_size),
            ("target", self.target_size, target_size),
        ):
            if own != given:
                raise SettingsError(
                    f"the map is of a {what} with {own[0]} vertices and {own[1]} triangles, but the {what} has "
                    f"{given[0]} and {given[1]}; give a map of these meshes, or markers"
                )
