"""Parts carried over: which part of the source moves each part of the target."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from mixseq.arrays import Float, Index, IntArray
from mixseq.correspondence.dense import Correspondence
from mixseq.correspondence.triangle_mesh import TriangleMesh
from mixseq.geometry.lengths_angles import flat_faces
from mixseq.segmentation.joints import Decomposition, decompose
from mixseq.segmentation.observed import FLAT, Observed
from mixseq.topology import Topology, split_labels, vertices_of

CRUMB = 0.1
"""A patch with less than this share of the area of its part joins a neighbour; the value is ours."""

CORE = 0.1
"""Share of its vertices that a part keeps. It is less than for parts that were found on the mesh itself
(`mixseq.segmentation.joints`): where no vertex between two parts is free, it is the mesh that gives way; ours."""


@dataclass(frozen=True, eq=False)
class CarriedParts:
    """Parts and joints of the target.

    Attributes
    ----------
    decomposition : Decomposition
        Parts and joints.
    sources : (p',) int64
        The part of the source that moves every part.
    """

    decomposition: Decomposition
    sources: Index


def carry_parts(
    source: Decomposition,
    rotations: Float,
    correspondence: Correspondence,
    topology: Topology,
    rest: Float,
    joint_width: int,
) -> CarriedParts:
    """Cut the target as the source is cut.

    Parameters
    ----------
    source : Decomposition
        Parts and joints of the source.
    rotations : (T, p, 3, 3) float64
        How its parts turn in some frames: joints are as wide as they bend.
    correspondence : Correspondence
        Where the target is on the source.
    topology : Topology
        Connectivity of the target.
    rest : (V', 3) float64
        Its vertices.
    joint_width : int
        Largest width of joints in strips of triangles.
    """
    faces = topology.faces
    labels = carry_labels(source.part_of_face, correspondence, faces)
    labels = without_crumbs(topology, labels, TriangleMesh(rest, topology).face_areas)
    parts = split_labels(topology, labels)
    sources = labels[np.unique(parts, return_index=True)[1]]
    seen = Observed(rotations[:, sources], flat_faces(rest, faces, FLAT))
    decomposition = decompose(topology, parts, joint_width, seen, core=CORE)
    loose = len(decomposition.parts) - len(sources)  # vertices of no face follow the first part
    return CarriedParts(decomposition, np.append(sources, np.zeros(loose, dtype=np.int64)))


def carry_labels(labels: Index, correspondence: Correspondence, faces: IntArray) -> Index:
    """Carry labels ``(F,)`` of the source's triangles to the target's ``(F',)``.

    Parameters
    ----------
    labels : (F,) int64
        From 0 on.
    correspondence : Correspondence
        Where the target is on the source.
    faces : (F', 3) int
        Triangles of the target.

    Returns
    -------
    (F',) int64
        Triangles that no triangle moves have the label of the first one that is moved at the vertex that they follow;
        0 if none is.
    """
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


def without_crumbs(topology: Topology, labels: Index, areas: Float) -> Index:
    """Give patches that are small beside the rest of their part the label of the neighbour they share most edges with.

    The smallest comes first. Patches without a neighbour stay.

    Parameters
    ----------
    topology : Topology
        Connectivity.
    labels : (F,) int64
        Part of every face.
    areas : (F,) float64
        Areas of the faces, in any unit.
    """
    labels = labels.copy()
    while True:
        patches = split_labels(topology, labels)
        label = labels[np.unique(patches, return_index=True)[1]]
        size = np.bincount(patches, areas)
        largest = np.zeros(int(label.max(initial=0)) + 1)
        np.maximum.at(largest, label, size)
        sides = patches[topology.hinge_faces]
        sides = sides[sides[:, 0] != sides[:, 1]]
        bounded = np.bincount(sides.reshape(-1), minlength=len(size)) > 0
        small = np.flatnonzero((size < CRUMB * largest[label]) & bounded)
        if not small.size:
            return labels
        crumb = int(small[np.argmin(size[small])])
        beside = np.concatenate([sides[sides[:, 0] == crumb, 1], sides[sides[:, 1] == crumb, 0]])
        labels[patches == crumb] = label[np.bincount(beside).argmax()]


def vertex_parts(decomposition: Decomposition, topology: Topology) -> Index:
    """A part ``(V,)`` of every vertex: that of a face at it; the last one of vertices of no face."""
    result = np.full(topology.vertex_count, len(decomposition.parts) - 1, dtype=np.int64)
    for part in range(int(decomposition.part_of_face.max(initial=-1)), -1, -1):
        result[vertices_of(topology, decomposition.part_of_face == part)] = part
    return result
