r"""Transfer by deformation gradients (S_f; Sumner and Popović 2004), the reference method.

The deformation gradient :math:`J_f` of every source triangle, from rest to a frame, moves the corresponding target
triangles. The target's vertices are those with the closest gradients (`mixseq.spaces.gradient`):

.. math:: \min_x \sum_{f'} A_{f'}\, | \nabla x - G J_{f(f')} G^T |^2 .

Gradients do not determine positions of pieces. The largest piece moves as its corresponding points of the source do, on
average; every other piece is attached to the vertex next to it (`mixseq.mesh.nearest`), and rotates with it:

.. math:: x_a = x_b + R_b (y_a - y_b) + s G (g_t - \bar R_b\, g_0)

with the target's rest y, the rotation :math:`\bar R_b` of the source around b, which is :math:`R_b = G \bar R_b G^T` on
the target, and the gap g between the source points of a and b, which may open and close. Triangles without a
counterpart rotate with the vertex that they follow.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from scipy import sparse

from mixseq.mesh.nearest import Attachments, attach
from mixseq.mesh.rigid import nearest_rotations
from mixseq.mesh.topology import Topology
from mixseq.mesh.triangle_mesh import TriangleMesh
from mixseq.retargeting.markers import Correspondence
from mixseq.retargeting.sources import Alignment, align
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.sequence.sequence import bounding_diagonal
from mixseq.spaces.gradient import GradientSpace
from mixseq.types import Float, FloatArray, Index


@dataclass(frozen=True, eq=False)
class GradientTransfer(PickledWithoutCaches):
    """Transfer by the deformation gradients of the source."""

    source: GradientSpace  # gradient space of the source at rest, in a unit of its own
    target: GradientSpace  # gradient space of the target at rest, in a unit of its own
    correspondence: Correspondence  # where the target is on the source
    alignment: Alignment  # from source to target, in the units of the meshes
    parts = None
    """None: gradients have no parts."""

    @cached_property
    def attachments(self) -> Attachments:
        """Attachments of the target's pieces to each other."""
        return attach(self.target.pieces.vertices, self.target.reference, self.correspondence.leaders)

    @cached_property
    def _at_holders(self) -> sparse.csr_array:
        """Matrix ``(n, F)`` of means over the source triangles around the points that hold pieces."""
        return self.around(self.attachments.other)

    @cached_property
    def _led(self) -> tuple[Index, sparse.csr_array]:
        """Target triangles ``(n,)`` without a source triangle, and means around the leaders they rotate with."""
        led = np.flatnonzero(self.correspondence.faces < 0)
        corners = self.target.topology.faces[led]
        follows = ~self.correspondence.matched[corners]
        first = corners[np.arange(len(led)), follows.argmax(axis=1)].astype(np.int64)
        return led, self.around(first)

    def around(self, vertices: Index) -> sparse.csr_array:
        """Matrix ``(n, F)`` of area-weighted means over source triangles at the corners of target vertices ``(n,)``.

        Vertices without corners take those of their leaders.
        """
        faces, sides, given = self.source.topology.faces, self.source.reference_triangles, self.correspondence
        areas = np.linalg.norm(np.cross(sides[:, :, 0], sides[:, :, 1]), axis=1)
        places = (faces.reshape(-1), np.repeat(np.arange(len(faces)), 3))
        shape = (self.source.topology.vertex_count, len(faces))
        at_vertices = sparse.coo_array((np.repeat(areas, 3), places), shape=shape).tocsr()
        leaders, rows = given.leaders[vertices], np.repeat(np.arange(len(vertices)), 3)
        entries = (given.weights[leaders].reshape(-1), (rows, given.corners[leaders].reshape(-1)))
        chosen = sparse.coo_array(entries, shape=(len(vertices), shape[0])).tocsr()
        return normalised(chosen @ normalised(at_vertices))

    def gradients(self, x: FloatArray) -> Float:
        """Gradients ``(F, 3, 3)`` of the source's triangles in a frame ``(V, 3)``."""
        return (
            self.source.complete_triangles(x.astype(np.float64) / self.source.scale)
            @ self.source.inverse_triangles
        )

    def transfer_frame(self, x: FloatArray) -> Float:
        """Move the target ``(V', 3)`` as the source is moved in a frame ``(V, 3)``."""
        target, faces = self.target, self.correspondence.faces
        x = x.astype(np.float64)
        gradients = self.gradients(x)
        turns = nearest_rotations(combined(self._at_holders, gradients))
        moved = self.alignment.turned(gradients[np.maximum(faces, 0)])
        led, around = self._led
        moved[led] = self.alignment.turned(nearest_rotations(combined(around, gradients)))
        rows = target.poisson_system.solve(np.swapaxes(moved @ target.reference_sides, 1, 2).reshape(-1, 3))
        return self._placed(rows, x, turns) * target.scale

    def _placed(self, rows: Float, x: FloatArray, turns: Float) -> Float:
        """Place the pieces, rows ``(N, 3)``; the result is ``(V', 3)`` in the target's unit."""
        pieces, held, rest = self.target.pieces, self.attachments, self.target.reference
        correspondence = self.correspondence
        shift = self.alignment.scale * self.source.scale / self.target.scale * self.alignment.rotation
        own = pieces.vertices[held.root]
        away = correspondence.interpolate(x / self.source.scale - self.source.reference)[own].mean(axis=0)
        placed = rows.copy()
        root = pieces.row_slices[held.root]
        placed[root] += rest[own].mean(axis=0) + shift @ away - rows[root].mean(axis=0)

        ends = pieces.find_rows(held.pieces, held.own), pieces.find_rows(held.holders, held.other)
        gaps = correspondence.interpolate(np.stack([self.source.reference, x / self.source.scale]))
        gaps = gaps[:, held.own] - gaps[:, held.other]
        gaps[:, ~correspondence.matched[held.own]] = 0.0
        for number, piece in enumerate(held.pieces):
            turn = turns[number]
            opened = shift @ (gaps[1, number] - turn @ gaps[0, number])
            span = self.alignment.turned(turn) @ (rest[held.own[number]] - rest[held.other[number]])
            place = placed[ends[1][number]] + span + opened
            placed[pieces.row_slices[piece]] += place - placed[ends[0][number]]
        return pieces.merge_rows(placed)


def gradient_transfer(
    source: Topology, source_rest: Float, target: Topology, target_rest: Float, correspondence: Correspondence
) -> GradientTransfer:
    """Make a transfer between two meshes at rest, ``(V, 3)`` and ``(V', 3)``; raises what `align` does."""
    own, other = _space(source, source_rest), _space(target, target_rest)
    matched = correspondence.matched
    whole = align(
        correspondence.interpolate(own.reference)[matched],
        other.reference[matched],
        TriangleMesh(other.reference, target).vertex_areas[matched],
    )
    in_units = Alignment(whole.rotation, whole.scale * other.scale / own.scale)
    return GradientTransfer(own, other, correspondence, in_units)


def _space(topology: Topology, rest: Float) -> GradientSpace:
    scale = bounding_diagonal(rest) or 1.0
    return GradientSpace(topology, scale, rest / scale)


def combined(weights: sparse.csr_array, matrices: Float) -> Float:
    """Return weighted sums ``(n, 3, 3)`` of matrices ``(F, 3, 3)``."""
    return np.asarray(weights @ matrices.reshape(-1, 9)).reshape(-1, 3, 3)


def normalised(weights: sparse.csr_array) -> sparse.csr_array:
    """Normalise the rows of a matrix of weights to sums of one; rows of zeros stay."""
    sums = np.asarray(weights.sum(axis=1)).reshape(-1)
    return sparse.csr_array(sparse.diags_array(1.0 / np.where(sums > 0, sums, 1.0)) @ weights)
