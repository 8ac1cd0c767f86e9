r"""Markers (pairs of corresponding vertices, set by hand), and dense correspondences of two meshes.

Markers pair components of the meshes (`pair_components`), and determine a similarity between the meshes
(`align_similarly`; Umeyama 1991): the rotation R, scale s and translation t that minimise
:math:`\sum_k \|s R x_k + t - y_k\|^2`. R is the proper rotation of the best rigid motion. For points relative to their
centroids the scale is

.. math:: s = \frac{\sum_k y_k \cdot R x_k}{\sum_k \|x_k\|^2} .

In a dense correspondence a target vertex v has the source point :math:`\sum_k w_{vk}\, x_{c_{vk}}`, with three corners
c and barycentric weights w. Vertices without a source point (of eyes, teeth, hats) rigidly follow another vertex of the
target, their *leader*.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from functools import cached_property
from os import PathLike
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import SettingsError
from mixseq.mesh.rigid import kabsch
from mixseq.mesh.topology import Topology
from mixseq.sequence.header import SequenceHeader
from mixseq.types import Float, FloatArray, Index, Mask

if TYPE_CHECKING:
    from mixseq.compression.numbering import NumberedVertices  # imports numba


@dataclass(frozen=True, eq=False)
class Markers:
    """Pairs of corresponding vertices.

    Attributes
    ----------
    source, target : (n,) int64
        Source vertex and target vertex of every marker.
    names : tuple of str
        Names of all markers for messages, or an empty tuple. Markers without a name are numbered from 1.
    meshes : pair of NumberedVertices, optional
        What finds the vertices of source and target in files with other numbers.
    """

    source: Index
    target: Index
    names: tuple[str, ...] = ()
    meshes: tuple[NumberedVertices, NumberedVertices] | None = None

    @classmethod
    def from_pairs(cls, pairs: ArrayLike, names: tuple[str, ...] = ()) -> Markers:
        """Make markers from pairs ``(n, 2)`` of a source vertex and a target vertex.

        Raises
        ------
        SettingsError
            If the pairs are not whole numbers, or the number of names differs.
        """
        try:
            table = np.asarray(pairs)
            table = table.reshape(-1, 2) if table.size == 0 else table
            vertex_pairs = table.astype(np.int64)
        except (TypeError, ValueError):
            if isinstance(pairs, str | PathLike):
                raise SettingsError(
                    f"markers are the name of a file, {str(pairs)!r}; read it with mixseq.read_markers"
                ) from None
            raise SettingsError("markers are no pairs of vertices; (n, 2) whole numbers are expected") from None
        if table.ndim != 2 or table.shape[1] != 2 or not np.array_equal(vertex_pairs, table):
            raise SettingsError(
                f"markers have shape {table.shape}; (n, 2) whole numbers, source and target, are expected"
            )
        if names and len(names) != len(vertex_pairs):
            raise SettingsError(
                f"there are {len(vertex_pairs)} markers and {len(names)} names; give a name for each, or none"
            )
        return cls(vertex_pairs[:, 0].copy(), vertex_pairs[:, 1].copy(), names)

    def with_meshes(self, source: SequenceHeader, target: SequenceHeader) -> Markers:
        """Return the markers with what finds their vertices in other files of both meshes."""
        from mixseq.compression.numbering import NumberedVertices

        sides = (source, self.source), (target, self.target)
        first, second = (NumberedVertices.from_mesh(header, vertex_ids) for header, vertex_ids in sides)
        return replace(self, meshes=(first, second))

    def renumbered(self, source: SequenceHeader, target: SequenceHeader) -> Markers:
        """Return the markers in the numbers of two files; raise SettingsError if their meshes or numbers are others."""
        vertices = []
        for side, header in (("source", source), ("target", target)):
            vertex_ids = getattr(self, side)
            if self.meshes is not None:
                name = f"markers of the {side}"
                vertex_ids = self.meshes[side == "target"].find_in(header, vertex_ids, name)
            elif len(self):
                check_numbers(header, f"markers are numbers of vertices, and those of the {side}")
            vertices.append(vertex_ids)
        return replace(self, source=vertices[0], target=vertices[1], meshes=None)

    def __len__(self) -> int:
        return len(self.source)

    def name(self, marker: int) -> str:
        """Return a label for messages: the name or number of a marker, with its vertices."""
        name = self.names[marker] if self.names else ""
        label = f"'{name}'" if name else f"{marker + 1}"
        return f"{label} ({self.source[marker]} -> {self.target[marker]})"


def check_numbers(header: SequenceHeader, what: str) -> None:
    """Raise SettingsError if vertices of a file have other numbers than its original's."""
    provenance = header.provenance
    if provenance is not None and provenance.kept_order == "free":
        raise SettingsError(
            f"{what} differ from its original's ({provenance}, order 'free'); give the original, or compress it with "
            "order='vertices'"
        )


@dataclass(frozen=True, eq=False)
class Pairing:
    """Components of source and target that are connected by markers, such as both bodies or all shoes."""

    source_faces: Index  # (f,) triangles of the source's components
    target_faces: Index  # (f',) triangles of the target's components
    source_vertices: Index  # (v,) vertices of the source's components
    target_vertices: Index  # (v',) vertices of the target's components


def pair_components(source: Topology, target: Topology, markers: Markers) -> tuple[Pairing, ...]:
    """Group the components of both meshes that are connected by markers; omit components without markers."""
    from scipy import sparse
    from scipy.sparse import csgraph

    source_components = source.component_of_vertex.astype(np.int64)
    target_components = target.component_of_vertex.astype(np.int64) + len(np.unique(source_components))
    node_count = int(target_components.max(initial=-1)) + 1
    edges = source_components[markers.source], target_components[markers.target]
    graph = sparse.coo_array((np.ones(len(markers)), edges), shape=(node_count, node_count))
    group_of_component = csgraph.connected_components(graph, directed=False)[1]
    pairings = []
    for group in np.unique(group_of_component[edges[0]]):
        vertices = [
            np.flatnonzero(group_of_component[components] == group)
            for components in (source_components, target_components)
        ]
        faces = [
            np.flatnonzero(group_of_component[components[topology.faces[:, 0]]] == group)
            for topology, components in ((source, source_components), (target, target_components))
        ]
        pairings.append(Pairing(faces[0], faces[1], vertices[0], vertices[1]))
    return tuple(pairings)


def align_similarly(points: Float, source: Float, target: Float) -> Float:
    """Map points ``(V, 3)`` by the similarity that fits source points ``(n, 3)`` to target points best."""
    rotation, _ = kabsch(source, target)
    source_centre, target_centre = source.mean(axis=0), target.mean(axis=0)
    x, y = (source - source_centre) @ rotation.T, target - target_centre
    squared_norm, inner_product = float(np.sum(x * x)), float(np.sum(x * y))
    if not (squared_norm > 0 and inner_product > 0):
        raise SettingsError("the markers are all in one place; mark points all over the meshes")
    scale = inner_product / squared_norm
    return np.asarray(scale * points @ rotation.T + (target_centre - scale * rotation @ source_centre))


@dataclass(frozen=True, eq=False)
class Correspondence:
    """Dense correspondence: the source point of every target vertex, and the source triangle of every target triangle.

    Attributes
    ----------
    source_size, target_size : (int, int)
        Number of vertices and number of triangles of each mesh.
    corners : (V', 3) int64
        Source vertices whose weighted mean is the source point; -1 for vertices that follow a leader.
    weights : (V', 3) float64
        Barycentric weights of the corners, which add to one.
    faces : (F',) int64
        Source triangle of every target triangle; -1 if a vertex of the target triangle follows a leader.
    leaders : (V',) int64
        Leader of every target vertex without a source point; every other vertex is its own leader.
    """

    source_size: tuple[int, int]
    target_size: tuple[int, int]
    corners: Index
    weights: Float
    faces: Index
    leaders: Index

    @classmethod
    def identity(cls, vertex_count: int, face_count: int) -> Correspondence:
        """Return the correspondence of meshes with the same connectivity."""
        vertices = np.arange(vertex_count)
        size = vertex_count, face_count
        weights = np.tile([1.0, 0.0, 0.0], (vertex_count, 1))
        corners = np.repeat(vertices[:, None], 3, axis=1)
        return cls(size, size, corners, weights, np.arange(face_count), vertices)

    def renumbered(self, vertices: Index, faces: Index) -> Correspondence:
        """Return the correspondence with rows of target vertices ``(V',)`` and triangles ``(F',)`` in another order."""
        leaders = np.argsort(vertices)[self.leaders[vertices]]
        corners, weights = self.corners[vertices], self.weights[vertices]
        return replace(self, corners=corners, weights=weights, faces=self.faces[faces], leaders=leaders)

    @cached_property
    def matched(self) -> Mask:
        """Target vertices ``(V',)`` with a point on the source."""
        return np.asarray((self.corners >= 0).all(axis=1))

    def interpolate(self, values: FloatArray, vertices: Index | None = None) -> Float:
        """Interpolate source values ``(..., V, c)`` at the source points of target vertices ``(n,)``."""
        leaders = self.leaders if vertices is None else self.leaders[vertices]
        corners, weights = self.corners[leaders], self.weights[leaders]
        return np.asarray(np.einsum("vk,...vkc->...vc", weights, values[..., corners, :]))

    def check(self, source_size: tuple[int, int], target_size: tuple[int, int]) -> None:
        """Raise if the meshes have other numbers of vertices or triangles than the correspondence."""
        for side, expected, actual in (
            ("source", self.source_size, source_size),
            ("target", self.target_size, target_size),
        ):
            if expected != actual:
                raise SettingsError(
                    f"the map is of a {side} with {expected[0]} vertices and {expected[1]} triangles, but the {side} "
                    f"has {actual[0]} and {actual[1]}; give a map of these meshes, or markers"
                )
