r"""Parts of the target: cut as those of the source, and assembled at pivots with the gaps of the source.

Neighbouring parts i and j meet at a pivot c, in the middle of their boundary on the target; :math:`\bar c` is that
point on the source. With the rotations R' of the target's parts (by gradients) and rest centres m the centres x solve

.. math:: \min_x \sum_{ij} w_{ij}\, | x_i + R'_i (c - m_i) - x_j - R'_j (c - m_j) - g'_{ij} |^2 ,
   \qquad g_{ij} = M_i(\bar c) - M_j(\bar c)

where M is the rigid motion of a part of the source, and g' is s G g, up to the correction below (G, s:
`mixseq.retargeting.sources`). That is the articulated body with the proportions of the target, which opens and slides
where the source's does. Without loops of parts all terms vanish; otherwise weights are the squared lengths of
boundaries. The root moves as the source's does, by s G. Disconnected pieces meet the others at the vertices that hold
them.

Flesh is not rigid: with other proportions gaps of the source do not fit, and at short boundaries small differences
tear the joint. Gaps by deformation gradients (:math:`\tilde g`) are smoother, but drift over long limbs. So g' differs
from them by what the boundary, of radius r, can take up,

.. math:: g' = \tilde g + \frac{\rho r}{\sqrt{(\rho r)^2 + |\delta|^2}}\, \delta , \qquad \delta = s G g - \tilde g ,

which is the body of pivots for small differences, and changes smoothly with time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.mesh.measures import flat_faces
from mixseq.mesh.nearest import Attachments
from mixseq.mesh.topology import Topology, split_labels, vertices_of
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.gradient_transfer import GradientTransfer
from mixseq.retargeting.limbs import ArticulatedBody
from mixseq.retargeting.markers import Correspondence
from mixseq.segmentation.elements import Boundaries
from mixseq.segmentation.joints import FLAT, Decomposition, Observed, decompose
from mixseq.shells.solvers import Factor, factorise
from mixseq.spaces.pieces import register_parts
from mixseq.types import Float, Index, IntArray

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
        aligned, rotations, centres = register_parts(self.shapes, self.vertices, x)
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
    labels = transfer_labels(source.part_of_face, correspondence, faces)
    labels = without_small_regions(topology, labels, TriangleMesh(rest, topology).face_areas)
    parts = split_labels(topology, labels)
    sources = labels[np.unique(parts, return_index=True)[1]]
    observed = Observed(rotations[:, sources], flat_faces(rest, faces, FLAT))
    decomposition = decompose(topology, parts, joint_width, observed, core=CORE)
    loose = len(decomposition.parts) - len(sources)  # vertices of no face follow the first part
    return PartCorrespondence(source, decomposition, np.append(sources, np.zeros(loose, dtype=np.int64)))


def transfer_labels(labels: Index, correspondence: Correspondence, faces: IntArray) -> Index:
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


SHORTEST = 1e-3
"""Least length of boundaries in weights, relative to the longest."""

REACH = 1.2
r"""Largest distance :math:`\rho` of gaps from those of gradients, in boundary radii; chosen on three animal pairs."""


@dataclass(frozen=True, eq=False)
class Pivots:
    """Pivots of a mesh: at the boundaries between parts first, then at attachments of pieces."""

    pairs: Index  # (n, 2) adjacent parts, which connect all parts
    boundaries: Boundaries  # edges between parts
    attachments: Attachments  # attachments of disconnected pieces

    @classmethod
    def of(cls, gradients: GradientTransfer, decomposition: Decomposition) -> Pivots:
        """Find the pivots of a target."""
        held = gradients.attachments
        boundaries = Boundaries.of(gradients.target.topology, decomposition.part_of_face)
        ends = ((held.pieces, held.own), (held.holders, held.other))
        attached = np.stack([_parts_at(gradients, decomposition, *end) for end in ends], axis=1)
        return cls(np.concatenate([boundaries.parts, attached]), boundaries, held)

    def points(self, x: Float) -> Float:
        """Return pivots ``(n, 3)`` of a target ``(V', 3)``: middles of boundaries, and held vertices."""
        return np.concatenate([self.boundaries.middles(x), x[self.attachments.own]])

    def sizes(self, x: Float) -> tuple[Float, Float]:
        """Return lengths ``(n,)`` of boundaries and their root mean square radii; 0 of attachments."""
        ends, pair, middles = x[self.boundaries.edges], self.boundaries.pair, self.points(x)
        lengths = np.linalg.norm(ends[:, 1] - ends[:, 0], axis=1)
        away = np.square(ends.mean(axis=1) - middles[pair]).sum(axis=1)
        whole, squares = (np.bincount(pair, each, len(middles)) for each in (lengths, lengths * away))
        squared = np.divide(squares, whole, out=np.zeros(len(middles)), where=whole > 0)
        return whole.astype(np.float64), np.sqrt(squared)


@dataclass(frozen=True, eq=False)
class PivotSolver:
    """Assembles the parts of an articulated body at their pivots."""

    body: ArticulatedBody  # the parts at rest, all of them joined to the root, whose place is given
    lengths: Float  # (n,) length of the boundary at every pivot
    radii: Float  # (n,) root mean square distance of the boundary from its pivot

    @cached_property
    def _incidence(self) -> sparse.csr_array:
        """Matrix ``(n, p)``: 1 at the first part of every pair, -1 at its second."""
        number = len(self.body.pairs)
        places = (np.repeat(np.arange(number), 2), self.body.pairs.reshape(-1))
        values = np.tile([1.0, -1.0], number)
        return sparse.coo_array((values, places), shape=(number, len(self.body.centres))).tocsr()

    @cached_property
    def _others(self) -> Index:
        return np.delete(np.arange(len(self.body.centres)), self.body.root)

    @cached_property
    def _weighted(self) -> sparse.csr_array:
        """Transpose ``(p - 1, n)`` of the incidence of all parts but the root, times the weights."""
        usual = self.lengths.max(initial=0.0) or 1.0
        weights = np.square(np.maximum(self.lengths / usual, SHORTEST))
        return sparse.csr_array(self._incidence[:, self._others].T @ sparse.diags_array(weights))

    @cached_property
    def _factor(self) -> Factor:
        return factorise(sparse.csr_array(self._weighted @ self._incidence[:, self._others]))

    def within_reach(self, gaps: Float, smooth: Float) -> Float:
        """Return gaps ``(n, 3)`` limited to the reach of boundaries around smooth ones."""
        away, reach = gaps - smooth, REACH * self.radii
        whole = np.hypot(reach, np.linalg.norm(away, axis=1))
        share = np.divide(reach, whole, out=np.zeros_like(whole), where=whole > 0)
        return np.asarray(smooth + share[:, None] * away)

    def place(self, rotations: Float, gaps: Float, root: Float) -> Float:
        """Return the centres ``(p, 3)`` of all parts: rotations ``(p, 3, 3)``; gaps ``(n, 3)``; root ``(3,)``."""
        result = np.empty_like(self.body.centres)
        result[self.body.root] = root
        if not self._others.size:
            return result
        away = gaps - self.body.gaps(rotations, np.zeros_like(self.body.centres))
        away -= self._incidence[:, [self.body.root]].toarray() * root
        result[self._others] = self._factor.solve(self._weighted @ away)
        return result


def _parts_at(
    gradients: GradientTransfer, decomposition: Decomposition, pieces: Index, vertices: Index
) -> Index:
    """Return a part ``(n,)`` at each vertex, of the given piece, as several pieces may share the vertex."""
    topology = gradients.target.topology
    result = vertex_parts(decomposition, topology)[vertices]
    for row, (piece, vertex) in enumerate(zip(pieces.tolist(), vertices.tolist(), strict=True)):
        faces = gradients.target.pieces.faces[piece]
        here = faces[(topology.faces[faces] == vertex).any(axis=1)]
        if here.size:  # vertices of no face have none
            result[row] = decomposition.part_of_face[here].min()
    return result
