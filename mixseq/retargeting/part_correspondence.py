"""Cut a target into parts as its source, with the source part that moves each."""

from __future__ import annotations

from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from mixseq.arrays import Float, Index, IntArray
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.geometry.lengths_angles import flat_faces
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.segmentation.observed import FLAT, Observed
from mixseq.spaces.registered import registered
from mixseq.topology import Topology, split_labels, vertices_of

SMALL = 0.1
"""Share of the area of its part below which a region joins a neighbour."""

CORE = 0.1
"""Least share of its vertices that a part keeps; less than in `mixseq.segmentation.joints`, to keep vertices free."""


class PartPoses(NamedTuple):
    """Poses of the target's parts: rotations ``(..., p', 3, 3)`` from rest, centres ``(..., p', 3)`` in its unit."""

    rotations: Float
    centres: Float


@dataclass(frozen=True, eq=False)
class RestShapes:
    """The parts of a mesh at rest, in the unit of its space."""

    vertices: tuple[Index, ...]  # their vertices
    shapes: Float  # (N, 3) these at rest, part by part, each part about its centre
    centres: Float  # (p, 3) the centres

    @classmethod
    def of(cls, decomposition: Decomposition, rest: Float) -> RestShapes:
        """Make the centred parts of a mesh ``(V, 3)``."""
        centres = np.stack([rest[part].mean(axis=0) for part in decomposition.parts])
        pairs = zip(decomposition.parts, centres, strict=True)
        shapes = np.concatenate([rest[part] - centre for part, centre in pairs])
        return cls(decomposition.parts, shapes, centres)

    def register(self, x: Float) -> tuple[Float, PartPoses]:
        """Return a frame's parts aligned to their shapes ``(N, 3)``, and their poses."""
        aligned, rotations, centres = registered(self.shapes, self.vertices, x)
        return aligned, PartPoses(rotations, centres)


@dataclass(frozen=True, eq=False)
class PartCorrespondence:
    """Parts and joints of source and target."""

    source: Decomposition  # parts and joints of the source
    target: Decomposition  # parts and joints of the target
    sources: Index  # (p',) source part of every target part

    @property
    def part_of_face(self) -> tuple[Index, Index]:
        """Parts of source triangles ``(F,)``, and source parts of target triangles ``(F',)``."""
        return self.source.part_of_face, self.sources[self.target.part_of_face]


def carry_parts(
    source: Decomposition,
    rotations: Float,
    correspondence: Correspondence,
    topology: Topology,
    rest: Float,
    joint_width: int,
) -> PartCorrespondence:
    """Cut a target at rest ``(V', 3)`` as its source; part rotations ``(T, p, 3, 3)`` determine the joint widths."""
    faces = topology.faces
    labels = carry_labels(source.part_of_face, correspondence, faces)
    labels = without_small_regions(topology, labels, TriangleMesh(rest, topology).face_areas)
    parts = split_labels(topology, labels)
    sources = labels[np.unique(parts, return_index=True)[1]]
    observed = Observed(rotations[:, sources], flat_faces(rest, faces, FLAT))
    decomposition = decompose(topology, parts, joint_width, observed, core=CORE)
    loose = len(decomposition.parts) - len(sources)  # vertices of no face follow the first part
    return PartCorrespondence(source, decomposition, np.append(sources, np.zeros(loose, dtype=np.int64)))


def carry_labels(labels: Index, correspondence: Correspondence, faces: IntArray) -> Index:
    """Transfer labels ``(F,)`` of the source's triangles to the target's ``(F',)``: faces ``(F', 3)``."""
    known = np.flatnonzero(correspondence.faces >= 0)
    result = np.zeros(len(faces), dtype=np.int64)
    result[known] = labels[correspondence.faces[known]]
    at_vertex = np.zeros(len(correspondence.leaders), dtype=np.int64)
    at_vertex[faces[known[::-1]]] = result[known[::-1], None]
    led = np.flatnonzero(correspondence.faces < 0)
    follows = ~correspondence.matched[faces[led]]
    first = faces[led, follows.argmax(axis=1)]
    result[led] = at_vertex[correspondence.leaders[first]]
    return result


def without_small_regions(topology: Topology, labels: Index, areas: Float) -> Index:
    """Merge regions of labels ``(F,)`` that are small in their part into the neighbour with most shared edges.

    The smallest comes first. Regions without a neighbour stay.
    """
    labels = labels.copy()
    while True:
        regions = split_labels(topology, labels)
        label = labels[np.unique(regions, return_index=True)[1]]
        size = np.bincount(regions, areas)
        largest = np.zeros(int(label.max(initial=0)) + 1)
        np.maximum.at(largest, label, size)
        sides = regions[topology.hinge_faces]
        sides = sides[sides[:, 0] != sides[:, 1]]
        bounded = np.bincount(sides.reshape(-1), minlength=len(size)) > 0
        small = np.flatnonzero((size < SMALL * largest[label]) & bounded)
        if not small.size:
            return labels
        smallest = int(small[np.argmin(size[small])])
        beside = np.concatenate([sides[sides[:, 0] == smallest, 1], sides[sides[:, 1] == smallest, 0]])
        labels[regions == smallest] = label[np.bincount(beside).argmax()]


def vertex_parts(decomposition: Decomposition, topology: Topology) -> Index:
    """Return a part ``(V,)`` of every vertex: that of a face at it, the last part without faces."""
    result = np.full(topology.vertex_count, len(decomposition.parts) - 1, dtype=np.int64)
    for part in range(int(decomposition.part_of_face.max(initial=-1)), -1, -1):
        result[vertices_of(topology, decomposition.part_of_face == part)] = part
    return result
