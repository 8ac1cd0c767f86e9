"""The pieces of a mesh, connected by triangles across edges, and their poses in a frame."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.spaces.metric import radii_of_gyration
from mixseq.spaces.registered import registered
from mixseq.topology import Topology

THIN = 1e-3
"""Ratio of width to length below which a piece is a line."""

WIDTH = 0.1
"""Width given to lines, relative to their length."""


@dataclass(frozen=True, eq=False)
class Pieces:
    """Hinge-connected pieces, whose relative poses lengths and angles do not determine.

    Vertices without faces are pieces of their own, after all others. Pieces may share vertices, but no edges;
    arrays of *rows* hold the vertices of all pieces, piece after piece.
    """

    vertices: tuple[Index, ...]  # vertices of every piece, ascending
    faces: tuple[Index, ...]  # faces of every piece, ascending; none of an unused vertex
    shapes: Float  # (N, 3) rows of the reference, every piece about its centre

    @classmethod
    def of(cls, topology: Topology, reference: FloatArray) -> Pieces:
        """Find the pieces of a mesh; poses are relative to the reference ``(V, 3)``."""
        owner = topology.component_of_face
        order = np.argsort(owner, kind="stable")
        faces = np.split(order, np.cumsum(np.bincount(owner))[:-1])
        vertices = [np.unique(topology.faces[each]).astype(np.int64) for each in faces]
        unused = topology.unused_vertices
        vertices += list(unused[:, None])
        faces += [np.zeros(0, dtype=np.int64)] * len(unused)
        shapes = np.concatenate([reference[each] - reference[each].mean(axis=0) for each in vertices])
        return cls(tuple(vertices), tuple(faces), shapes.astype(np.float64))

    def __len__(self) -> int:
        return len(self.vertices)

    @cached_property
    def row_vertices(self) -> Index:
        """Vertex ``(N,)`` of every row."""
        return np.concatenate(self.vertices)

    @cached_property
    def owner(self) -> Index:
        """Piece ``(N,)`` of every row."""
        return np.repeat(np.arange(len(self)), [len(each) for each in self.vertices])

    def rows_of(self, pieces: Index, vertices: Index) -> Index:
        """Return the rows of vertices in given pieces; arrays broadcast."""
        count = int(self.row_vertices.max(initial=-1)) + 1
        # Rows ascend by piece, then by vertex.
        rows = np.searchsorted(self.owner * count + self.row_vertices, pieces * count + vertices)
        return np.asarray(rows, dtype=np.int64)

    def face_rows(self, topology: Topology) -> Index:
        """Return the rows ``(F, 3)`` of the corners of all faces, each in its own piece."""
        owner = topology.component_of_face.astype(np.int64)
        return self.rows_of(owner[:, None], topology.faces.astype(np.int64))

    @cached_property
    def slices(self) -> list[slice]:
        """The rows of every piece."""
        ends = np.cumsum([len(each) for each in self.vertices])
        return [slice(int(end) - len(each), int(end)) for end, each in zip(ends, self.vertices, strict=True)]

    @cached_property
    def radii(self) -> Float:
        """Radii of gyration ``(p,)`` in the reference, at least a small number."""
        return radii_of_gyration(self.shapes, self.vertices)

    @cached_property
    def steady(self) -> Float:
        """Shapes ``(N, 3)`` for registration, with width added to lines and points to fix their rotation."""
        return np.concatenate([_with_width(self.shapes[each]) for each in self.slices])

    def poses(self, x: FloatArray) -> tuple[Float, Float]:
        """Return rotations ``(p, 3, 3)`` from the reference, and centres ``(p, 3)``, of the pieces of a frame."""
        _, rotations, centres = self._registered(self.vertices, x)
        return rotations, centres

    def place(self, rows: Float, rotations: Float, centres: Float) -> Float:
        """Move rows ``(N, 3)`` by rotations ``(p, 3, 3)`` and centres ``(p, 3)`` to ``(V, 3)``; inverts `poses`."""
        upright, _, _ = self._registered(self._own_rows, rows)
        return self.merged(np.einsum("nij,nj->ni", rotations[self.owner], upright) + centres[self.owner])

    def centred(self, rows: Float, centres: Float) -> Float:
        """Translate pieces, rows ``(N, 3)``, to centres ``(p, 3)``; returns vertices ``(V, 3)``."""
        return self.merged(rows + (centres - self._means(rows))[self.owner])

    def centres(self, x: Float) -> Float:
        """Return the centres ``(p, 3)`` of the pieces of a frame ``(V, 3)``."""
        return self._means(x[self.row_vertices])

    def merged(self, rows: Float) -> Float:
        """Return vertices ``(V, 3)`` of posed rows ``(N, 3)``; the mean where several share one."""
        counts = np.bincount(self.row_vertices)
        sums = [np.bincount(self.row_vertices, column) for column in rows.T]
        return np.stack(sums, axis=1) / counts[:, None]

    @cached_property
    def _own_rows(self) -> list[Index]:
        return [np.arange(each.start, each.stop) for each in self.slices]

    def _registered(self, vertices: Sequence[Index], x: FloatArray) -> tuple[Float, Float, Float]:
        """Register pieces twice: lines in a frame first near the identity, then exactly."""
        upright, rotations, centres = registered(self.steady, vertices, x)
        upright, further, _ = registered(self.steady, self._own_rows, upright)
        return upright, rotations @ further, centres

    def _means(self, rows: Float) -> Float:
        sizes = np.array([len(each) for each in self.vertices])
        sums = np.add.reduceat(rows, np.cumsum([0, *sizes[:-1]]), axis=0)
        return np.asarray(sums / sizes[:, None])


def _with_width(shape: Float) -> Float:
    """Add width to a centred shape ``(n, 3)`` that is a line or a point; return others unchanged.

    Offsets have neither a mean nor a moment along the line, so that a rigidly moving line has exactly that pose.
    """
    _, sizes, axes = np.linalg.svd(shape, full_matrices=False)
    if len(shape) < 3 or sizes[1] > THIN * sizes[0]:
        return shape
    number = np.arange(len(shape), dtype=np.float64)
    if sizes[0] == 0:  # any shape: this is a helix
        helix = np.stack([np.cos(number), np.sin(number), number / len(shape)], axis=1)
        return np.asarray(helix - helix.mean(axis=0))
    along = shape @ axes[0]
    offsets = np.cos(number) - np.cos(number).mean()
    offsets -= along * (along @ offsets) / (along @ along)
    side = np.eye(3)[np.abs(axes[0]).argmin()]
    side -= axes[0] * (axes[0] @ side)
    return np.asarray(shape + WIDTH * sizes[0] * np.outer(offsets, side) / np.linalg.norm(offsets))
