r"""Parts of the target: cut them like the parts of the source, and assemble them at pivots.

Neighbouring parts i and j meet at a pivot c, in the middle of their boundary on the target; :math:`\bar c` is its
source point. Given rotations R' of the target's parts (by gradients) and rest centres m, the centres x solve

.. math:: \min_x \sum_{ij} w_{ij}\, | x_i + R'_i (c - m_i) - x_j - R'_j (c - m_j) - g'_{ij} |^2 ,
   \qquad g_{ij} = M_i(\bar c) - M_j(\bar c)

where M is the rigid motion of a part of the source. The gap g' is s G g, up to the correction below (G, s:
`mixseq.retargeting.sources`). The result is an articulated body with the proportions of the target; its joints open and
slide like the joints of the source. The weights w are the squared lengths of boundaries; without loops of parts all
terms vanish. The root has the displacement of the source's root, mapped by s G. Disconnected pieces have pivots at the
vertices to which they are attached.

If proportions differ, the gaps of the source do not fit, and even small differences tear joints at short boundaries.
Gaps by deformation gradients (:math:`\tilde g`) are smoother, but drift over long limbs. So the distance between g' and
:math:`\tilde g` is limited to a multiple of the radius r of the boundary,

.. math:: g' = \tilde g + \frac{\rho r}{\sqrt{(\rho r)^2 + |\delta|^2}}\, \delta , \qquad \delta = s G g - \tilde g ,

which retains the gaps of the source if the difference is small, and varies smoothly with time.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from scipy import sparse

from mixseq.mesh.measures import degenerate_faces
from mixseq.mesh.nearest import Attachments
from mixseq.mesh.topology import Topology, mark_face_vertices, split_labels
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.gradient_transfer import GradientTransfer
from mixseq.retargeting.limbs import ArticulatedBody
from mixseq.retargeting.markers import Correspondence
from mixseq.segmentation.elements import Boundaries
from mixseq.segmentation.joints import MIN_MOTION_HEIGHT_RATIO, Decomposition, PartMotion, decompose
from mixseq.shells.solvers import Factor, factorise
from mixseq.spaces.pieces import align_parts
from mixseq.types import Float, Index, IntArray

MIN_REGION_AREA_RATIO = 0.1  # smallest area of a region that is not merged, relative to the largest of its label
MIN_CORE_VERTEX_RATIO = 0.1  # smallest share of a part's vertices outside joints; lower than in `segmentation.joints`


class PartPoses(NamedTuple):
    """Rotations ``(..., p', 3, 3)`` of parts from rest, and centres ``(..., p', 3)`` in the unit of their space."""

    rotations: Float
    centres: Float


@dataclass(frozen=True, eq=False)
class RestShapes:
    """Parts of a mesh at rest, in the unit of its space."""

    vertices: tuple[Index, ...]  # vertices of each part
    shapes: Float  # (N, 3) rest points of the vertices, part by part, relative to the centre of the part
    centres: Float  # (p, 3) centres of the parts

    @classmethod
    def from_decomposition(cls, decomposition: Decomposition, rest: Float) -> RestShapes:
        """Return the centred rest shapes of the parts of a mesh ``(V, 3)``."""
        centres = np.stack([rest[part].mean(axis=0) for part in decomposition.parts])
        centred_parts = zip(decomposition.parts, centres, strict=True)
        shapes = np.concatenate([rest[part] - centre for part, centre in centred_parts])
        return cls(decomposition.parts, shapes, centres)

    def register(self, points: Float) -> tuple[Float, PartPoses]:
        """Return the parts ``(N, 3)`` of a frame ``(V, 3)``, rigidly aligned to the rest shapes, and the part poses."""
        aligned, rotations, centres = align_parts(self.shapes, self.vertices, points)
        return aligned, PartPoses(rotations, centres)


@dataclass(frozen=True, eq=False)
class PartCorrespondence:
    """Parts and joints of source and target."""

    source: Decomposition  # parts and joints of the source
    target: Decomposition  # parts and joints of the target
    source_parts: Index  # (p',) source part of every target part

    @property
    def part_of_face(self) -> tuple[Index, Index]:
        """Source part of every source triangle ``(F,)`` and of every target triangle ``(F',)``."""
        return self.source.part_of_face, self.source_parts[self.target.part_of_face]

    @property
    def labels(self) -> Index | None:
        """Source part of every target triangle ``(F',)``, if each source part is one part of the target; else None."""
        is_one_to_one = np.array_equal(np.sort(self.source_parts), np.arange(len(self.source.parts)))
        return self.part_of_face[1] if is_one_to_one else None


def transfer_parts(
    source: Decomposition,
    rotations: Float,
    correspondence: Correspondence,
    topology: Topology,
    rest: Float,
    joint_width: int,
) -> PartCorrespondence:
    """Cut a target ``(V', 3)`` into the source's parts, with joint widths from part rotations ``(T, p, 3, 3)``."""
    faces = topology.faces
    labels = transfer_labels(source.part_of_face, correspondence, faces)
    labels = merge_small_regions(topology, labels, TriangleMesh(rest, topology).face_areas)
    parts = split_labels(topology, labels)
    source_parts = labels[np.unique(parts, return_index=True)[1]]
    observed = PartMotion(rotations[:, source_parts], degenerate_faces(rest, faces, MIN_MOTION_HEIGHT_RATIO))
    decomposition = decompose(topology, parts, joint_width, observed, core=MIN_CORE_VERTEX_RATIO)
    faceless_count = len(decomposition.parts) - len(source_parts)  # vertices without faces follow part 0
    source_parts = np.append(source_parts, np.zeros(faceless_count, dtype=np.int64))
    return PartCorrespondence(source, decomposition, source_parts)


def transfer_labels(labels: Index, correspondence: Correspondence, faces: IntArray) -> Index:
    """Return labels ``(F',)`` of target triangles ``(F', 3)`` from labels ``(F,)`` of the source's triangles."""
    mapped = np.flatnonzero(correspondence.faces >= 0)
    target_labels = np.zeros(len(faces), dtype=np.int64)
    target_labels[mapped] = labels[correspondence.faces[mapped]]
    label_of_vertex = np.zeros(len(correspondence.leaders), dtype=np.int64)
    label_of_vertex[faces[mapped[::-1]]] = target_labels[mapped[::-1], None]
    follower_faces = np.flatnonzero(correspondence.faces < 0)
    is_follower = ~correspondence.matched[faces[follower_faces]]
    vertices = faces[follower_faces, is_follower.argmax(axis=1)]
    target_labels[follower_faces] = label_of_vertex[correspondence.leaders[vertices]]
    return target_labels


def merge_small_regions(topology: Topology, labels: Index, areas: Float) -> Index:
    """Merge small regions of labels ``(F,)``, the smallest first, into the neighbour that shares most edges."""
    labels = labels.copy()
    while True:
        regions = split_labels(topology, labels)
        label_of_region = labels[np.unique(regions, return_index=True)[1]]
        region_areas = np.bincount(regions, areas)
        max_areas = np.zeros(int(label_of_region.max(initial=0)) + 1)
        np.maximum.at(max_areas, label_of_region, region_areas)
        region_pairs = regions[topology.hinge_faces]
        region_pairs = region_pairs[region_pairs[:, 0] != region_pairs[:, 1]]
        has_neighbour = np.bincount(region_pairs.reshape(-1), minlength=len(region_areas)) > 0
        is_small = region_areas < MIN_REGION_AREA_RATIO * max_areas[label_of_region]
        small_regions = np.flatnonzero(is_small & has_neighbour)
        if not small_regions.size:
            return labels
        smallest = int(small_regions[np.argmin(region_areas[small_regions])])
        first, second = region_pairs.T
        neighbours = np.concatenate([second[first == smallest], first[second == smallest]])
        labels[regions == smallest] = label_of_region[np.bincount(neighbours).argmax()]


def assign_vertices_to_parts(decomposition: Decomposition, topology: Topology) -> Index:
    """Return a part ``(V,)`` of every vertex: the lowest part of its faces; the last part if it has no faces."""
    part_of_vertex = np.full(topology.vertex_count, len(decomposition.parts) - 1, dtype=np.int64)
    for part in range(int(decomposition.part_of_face.max(initial=-1)), -1, -1):
        part_of_vertex[mark_face_vertices(topology, decomposition.part_of_face == part)] = part
    return part_of_vertex


MIN_BOUNDARY_LENGTH_RATIO = 1e-3  # lower bound of boundary lengths for weights, relative to the longest boundary
MAX_GAP_CORRECTION_RADII = 1.2  # rho: largest gap correction, in boundary radii; chosen on three animal pairs


@dataclass(frozen=True, eq=False)
class Pivots:
    """Pivots of a mesh: first the boundaries between parts, then the attachments of disconnected pieces."""

    pairs: Index  # (n, 2) parts that meet at each pivot; these pairs connect all parts
    boundaries: Boundaries  # edges between parts
    attachments: Attachments  # attachments of disconnected pieces

    @classmethod
    def from_decomposition(cls, gradients: GradientTransfer, decomposition: Decomposition) -> Pivots:
        """Find the pivots of a target."""
        attachments = gradients.attachments
        boundaries = Boundaries.from_labels(gradients.target.topology, decomposition.part_of_face)
        ends = (attachments.pieces, attachments.vertices), (attachments.holders, attachments.holder_vertices)
        attached_parts = np.stack(
            [_parts_at_vertices(gradients, decomposition, pieces, vertices) for pieces, vertices in ends],
            axis=1,
        )
        return cls(np.concatenate([boundaries.parts, attached_parts]), boundaries, attachments)

    def points(self, points: Float) -> Float:
        """Return the pivots ``(n, 3)`` of a target ``(V', 3)``: middles of boundaries, then attachment vertices."""
        return np.concatenate([self.boundaries.middles(points), points[self.attachments.vertices]])

    def boundary_sizes(self, points: Float) -> tuple[Float, Float]:
        """Return lengths ``(n,)`` and root mean square radii ``(n,)`` of the boundaries; zero for attachments."""
        pivots, pair_ids = self.points(points), self.boundaries.pair
        edge_points = points[self.boundaries.edges]
        lengths = np.linalg.norm(edge_points[:, 1] - edge_points[:, 0], axis=1)
        squared_distances = np.square(edge_points.mean(axis=1) - pivots[pair_ids]).sum(axis=1)
        totals = np.bincount(pair_ids, lengths, len(pivots)).astype(np.float64)
        moments = np.bincount(pair_ids, lengths * squared_distances, len(pivots))
        squared_radii = np.divide(moments, totals, out=np.zeros(len(pivots)), where=totals > 0)
        return totals, np.sqrt(squared_radii)


@dataclass(frozen=True, eq=False)
class PivotSolver:
    """Least-squares solver of the centres of a body's parts from the gaps at its pivots."""

    body: ArticulatedBody  # parts at rest, all connected to the root
    lengths: Float  # (n,) length of the boundary at every pivot
    radii: Float  # (n,) root mean square distance of the boundary from its pivot

    @cached_property
    def _incidence(self) -> sparse.csr_array:
        """Incidence matrix ``(n, p)``: 1 at the first part of every pair, -1 at the second part."""
        pair_count = len(self.body.pairs)
        entries = (np.repeat(np.arange(pair_count), 2), self.body.pairs.reshape(-1))
        values = np.tile([1.0, -1.0], pair_count)
        return sparse.coo_array((values, entries), shape=(pair_count, len(self.body.centres))).tocsr()

    @cached_property
    def _root_incidence(self) -> Float:
        """Column ``(n, 1)`` of the root in the incidence matrix."""
        return np.asarray(self._incidence[:, [self.body.root]].toarray())

    @cached_property
    def _free_parts(self) -> Index:
        return np.delete(np.arange(len(self.body.centres)), self.body.root)

    @cached_property
    def _weighted_incidence(self) -> sparse.csr_array:
        """Weighted, transposed incidence matrix ``(p - 1, n)`` of all parts except the root."""
        max_length = self.lengths.max(initial=0.0) or 1.0
        weights = np.square(np.maximum(self.lengths / max_length, MIN_BOUNDARY_LENGTH_RATIO))
        return sparse.csr_array(self._incidence[:, self._free_parts].T @ sparse.diags_array(weights))

    @cached_property
    def _factor(self) -> Factor:
        return factorise(sparse.csr_array(self._weighted_incidence @ self._incidence[:, self._free_parts]))

    def limit_gaps(self, gaps: Float, gradient_gaps: Float) -> Float:
        """Limit the differences of gaps ``(n, 3)`` from gaps by deformation gradients ``(n, 3)``."""
        differences, reach = gaps - gradient_gaps, MAX_GAP_CORRECTION_RADII * self.radii
        norms = np.hypot(reach, np.linalg.norm(differences, axis=1))
        factors = np.divide(reach, norms, out=np.zeros_like(norms), where=norms > 0)
        return np.asarray(gradient_gaps + factors[:, None] * differences)

    def solve_centres(self, rotations: Float, gaps: Float, root_centre: Float) -> Float:
        """Solve for part centres ``(p, 3)``: rotations ``(p, 3, 3)``; gaps ``(n, 3)``; root_centre ``(3,)``."""
        centres = np.empty_like(self.body.centres)
        centres[self.body.root] = root_centre
        if not self._free_parts.size:
            return centres
        targets = gaps - self.body.gaps(rotations, np.zeros_like(self.body.centres))
        targets -= self._root_incidence * root_centre
        centres[self._free_parts] = self._factor.solve(self._weighted_incidence @ targets)
        return centres


def _parts_at_vertices(
    gradients: GradientTransfer, decomposition: Decomposition, pieces: Index, vertices: Index
) -> Index:
    """Return a part ``(n,)`` of each given piece at a given vertex; several pieces may share a vertex."""
    topology = gradients.target.topology
    parts = assign_vertices_to_parts(decomposition, topology)[vertices]
    for index, (piece, vertex) in enumerate(zip(pieces.tolist(), vertices.tolist(), strict=True)):
        faces = gradients.target.pieces.faces[piece]
        vertex_faces = faces[(topology.faces[faces] == vertex).any(axis=1)]
        if vertex_faces.size:
            parts[index] = decomposition.part_of_face[vertex_faces].min()
    return parts
