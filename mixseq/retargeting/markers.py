r"""Markers (pairs of corresponding vertices, set by a person), and dense correspondences of two meshes.

Markers pair components of the meshes (`pair_components`), and give the similarity between the meshes
(`fit_similarity`; Umeyama 1991): the rotation R, scale s and translation t that minimise
:math:`\sum_k \|s R x_k + t - y_k\|^2`. R is that of the best rigid motion, a proper rotation, and with points about
their centroids

.. math:: s = \frac{\sum_k y_k \cdot R x_k}{\sum_k \|x_k\|^2} .

In a dense correspondence a target vertex v is the point :math:`\sum_k w_{vk}\, x_{c_{vk}}` of the source, with three
corners c and barycentric weights w. Vertices without a counterpart (eyes, teeth, hats) rigidly follow another vertex of
the target, their *leader*.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from os import PathLike

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.types import Float, FloatArray, Index, Mask


@dataclass(frozen=True, eq=False)
class Markers:
    """Pairs of vertices.

    Attributes
    ----------
    source, target : (n,) int64
        Vertices of the source and of the target; those of one row are a pair.
    names : tuple of str
        Names in messages, one each or none. Markers without a name, or with an empty one, are numbered from 1.
    """

    source: Index
    target: Index
    names: tuple[str, ...] = ()

    @classmethod
    def from_pairs(cls, pairs: ArrayLike, names: tuple[str, ...] = ()) -> Markers:
        """Make markers of pairs ``(n, 2)`` of whole numbers: source, target.

        Raises
        ------
        SettingsError
            If the pairs are not whole numbers, or the number of names differs.
        """
        try:
            table = np.asarray(pairs)
            table = table.reshape(-1, 2) if table.size == 0 else table
            whole = table.astype(np.int64)
        except (TypeError, ValueError):
            if isinstance(pairs, str | PathLike):
                raise SettingsError(
                    f"markers are the name of a file, {str(pairs)!r}; read it with mixseq.read_markers"
                ) from None
            raise SettingsError(
                "markers are no pairs of vertices; (n, 2) whole numbers are expected"
            ) from None
        if table.ndim != 2 or table.shape[1] != 2 or not np.array_equal(whole, table):
            raise SettingsError(
                f"markers have shape {table.shape}; (n, 2) whole numbers, source and target, are expected"
            )
        if names and len(names) != len(whole):
            raise SettingsError(
                f"there are {len(whole)} markers and {len(names)} names; give one each, or none"
            )
        return cls(whole[:, 0].copy(), whole[:, 1].copy(), names)

    def __len__(self) -> int:
        return len(self.source)

    def name(self, number: int) -> str:
        """Return the name of a marker in messages: its name if it has one, and its pair of vertices."""
        name = self.names[number] if self.names else ""
        called = f"'{name}'" if name else f"{number + 1}"
        return f"{called} ({self.source[number]} -> {self.target[number]})"


@dataclass(frozen=True, eq=False)
class Pairing:
    """Components of a source and of a target joined by markers: shoes and shoes, a body and a body."""

    source_faces: Index  # (f,) triangles of the source's components
    target_faces: Index  # (f',) triangles of the target's components
    source_vertices: Index  # (v,) vertices of the source's components
    target_vertices: Index  # (v',) vertices of the target's components


def pair_components(source: Topology, target: Topology, markers: Markers) -> tuple[Pairing, ...]:
    """Group components that markers join, directly or through others; components without markers are in no group."""
    from scipy import sparse
    from scipy.sparse import csgraph

    own = source.component_of_vertex.astype(np.int64)
    others = target.component_of_vertex.astype(np.int64) + len(np.unique(own))
    size = int(others.max(initial=-1)) + 1
    ends = own[markers.source], others[markers.target]
    graph = sparse.coo_array((np.ones(len(markers)), ends), shape=(size, size))
    joined = csgraph.connected_components(graph, directed=False)[1]
    pairings = []
    for number in np.unique(joined[ends[0]]):
        vertices = [np.flatnonzero(joined[component] == number) for component in (own, others)]
        faces = [
            np.flatnonzero(joined[component[topology.faces[:, 0]]] == number)
            for topology, component in ((source, own), (target, others))
        ]
        pairings.append(Pairing(faces[0], faces[1], vertices[0], vertices[1]))
    return tuple(pairings)


@dataclass(frozen=True, eq=False)
class Similarity:
    """The map ``x -> scale * rotation x + translation``."""

    scale: float  # scale factor
    rotation: Float  # (3, 3) rotation matrix
    translation: Float  # (3,) translation vector

    def __call__(self, points: Float) -> Float:
        """Map points ``(..., 3)``."""
        return np.asarray(self.scale * points @ self.rotation.T + self.translation)


def fit_similarity(source: Float, target: Float) -> Similarity:
    """Find the similarity that best maps points ``(n, 3)`` onto others."""
    rotation, _ = kabsch(source, target)
    from_centre, to_centre = source.mean(axis=0), target.mean(axis=0)
    x, y = (source - from_centre) @ rotation.T, target - to_centre
    spread, shared = float(np.sum(x * x)), float(np.sum(x * y))
    if not (spread > 0 and shared > 0):
        raise SettingsError("the markers are all in one place; mark points all over the meshes")
    scale = shared / spread
    return Similarity(scale, rotation, to_centre - scale * rotation @ from_centre)


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

    def interpolate(self, values: FloatArray) -> Float:
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
