"""The pieces a mesh falls into where triangles are connected across edges, and how they stand in a frame."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray

from mixseq.sequence import FloatArray
from mixseq.spaces.registered import radii_of_gyration, registered
from mixseq.topology import Topology

Float = NDArray[np.float64]
Index = NDArray[np.int64]


@dataclass(frozen=True, eq=False)
class Pieces:
    """Hinge-connected pieces: lengths and angles say nothing about how one stands to another.

    Vertices that no face uses are pieces of their own, after all others. Pieces may share vertices, or the edges of
    which three faces meet; arrays of *rows* hold the vertices of all pieces, piece after piece.

    Attributes
    ----------
    vertices : tuple of (n_k,) int64
        Vertices of every piece, ascending.
    faces : tuple of (m_k,) int64
        Faces of every piece, ascending; none of an unused vertex.
    shapes : (N, 3) float64
        Rows of the reference, every piece about its centre.
    """

    vertices: tuple[Index, ...]
    faces: tuple[Index, ...]
    shapes: Float

    @classmethod
    def of(cls, topology: Topology, reference: FloatArray) -> Pieces:
        """Find the pieces of a mesh, with the reference ``(V, 3)`` that tells how they stand."""
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
        """The vertex ``(N,)`` of every row."""
        return np.concatenate(self.vertices)

    @cached_property
    def slices(self) -> list[slice]:
        """The rows of every piece."""
        ends = np.cumsum([len(each) for each in self.vertices])
        return [slice(int(end) - len(each), int(end)) for end, each in zip(ends, self.vertices, strict=True)]

    @cached_property
    def radii(self) -> Float:
        """Radii of gyration ``(p,)`` in the reference, small numbers for pieces without one."""
        return radii_of_gyration(self.shapes, self.vertices)

    def poses(self, x: FloatArray) -> tuple[Float, Float]:
        """Return rotations ``(p, 3, 3)`` from the reference, and centres ``(p, 3)``, of the pieces of a frame."""
        _, rotations, centres = registered(self.shapes, self.vertices, x)
        return rotations, centres

    def place(self, rows: Float, rotations: Float, centres: Float) -> Float:
        """Move pieces rigidly to where poses say; the inverse of `poses`.

        Parameters
        ----------
        rows : (N, 3) float64
            Shapes of the pieces, every one anywhere.
        rotations, centres : (p, 3, 3), (p, 3) float64
            Poses.

        Returns
        -------
        (V, 3) float64
            Vertices; those of several pieces are the mean of these.
        """
        own = [np.arange(each.start, each.stop) for each in self.slices]
        upright, _, _ = registered(self.shapes, own, rows)
        owner = np.repeat(np.arange(len(self)), [len(each) for each in self.vertices])
        placed = np.einsum("nij,nj->ni", rotations[owner], upright) + centres[owner]
        counts = np.bincount(self.row_vertices)
        sums = [np.bincount(self.row_vertices, column) for column in placed.T]
        return np.stack(sums, axis=1) / counts[:, None]
