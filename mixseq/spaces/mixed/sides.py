r"""Sides of faces where frames of vertices differ: what keeps the skin from shearing there.

Where the frames of a face's corners are one and the same, its sides follow from the vertices. Elsewhere the two sides
:math:`s_f` of the face are known too, as seen from the mean of these frames. Between frames of the sequence they are
predicted like vertices, and disagree with them a little. The vertices that agree best minimise

.. math:: \sum_f \sum_{ab} w_{ab}\, |x_b - x_a - R_f s_{ab}|^2 + \eta \sum_v |x_v - \hat x_v|^2

with the cotangent weights of the reference frame and the posed vertices :math:`\hat x`. Vertices of other faces stay
where these are. The matrix depends on the space only and is factored once. At frames all terms are zero.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import numpy as np
from numpy.typing import NDArray
from scipy import sparse

from mixseq.arrays import Float, Index
from mixseq.pickling import PickledWithoutCaches
from mixseq.shells.solvers import Factor, factorise
from mixseq.spaces.mixed import vertex_frame_kernels as kernels

HOLD = 1.0
r"""Weight :math:`\eta` of posed vertices against sides. Ours. Between .01 and 1 frames between frames are nearly
the same; models of few modes are the better the more it is."""

COTANGENTS = (0.05, 20.0)
"""Bounds of cotangents: weights stay positive, and of the same size, whatever the triangles are."""


@dataclass(frozen=True, eq=False)
class Sides(PickledWithoutCaches):
    """The faces whose sides are known, and the vertices they decide.

    Attributes
    ----------
    faces : (f, 3) int64
        The faces.
    vertices : (n,) int64
        Vertices of no other faces, ascending.
    reference : (V, 3) float64
        The reference frame, which the weights are of.
    """

    faces: Index
    vertices: Index
    reference: Float

    @classmethod
    def of(cls, faces: Index, free: NDArray[np.bool_], reference: Float) -> Sides:
        """Take the sides of the faces ``(F, 3)`` at free vertices, which are marked ``(V,)``."""
        return cls(faces[free[faces].any(axis=1)].astype(np.int64), np.flatnonzero(free), reference)

    def constants(self) -> tuple[object, ...]:
        """Implement `PickledWithoutCaches.constants`."""
        return (self.factor,) if len(self.vertices) else ()

    @cached_property
    def weights(self) -> Float:
        """Weights ``(f, 3)`` of the sides 01, 12 and 20."""
        corners = self.reference[self.faces]
        columns = []
        for side in range(3):
            first = corners[:, side] - corners[:, side - 1]
            second = corners[:, (side + 1) % 3] - corners[:, side - 1]
            across = np.linalg.norm(np.cross(first, second), axis=1)
            along = np.einsum("fi,fi->f", first, second)
            cotangents = along / np.maximum(across, np.finfo(np.float64).tiny)
            columns.append(np.clip(cotangents, *COTANGENTS) / 2.0)
        return np.stack(columns, axis=1)

    @cached_property
    def _number(self) -> Index:
        number = np.full(len(self.reference), -1, dtype=np.int64)
        number[self.vertices] = np.arange(len(self.vertices))
        return number

    @cached_property
    def factor(self) -> Factor:
        """Factor of the system's matrix."""
        a, b = self.faces.reshape(-1), np.roll(self.faces, -1, axis=1).reshape(-1)
        weights = self.weights.reshape(-1)
        i, j = self._number[a], self._number[b]
        both = (i >= 0) & (j >= 0)
        diagonal = np.full(len(self.vertices), HOLD)
        for end in (i, j):
            np.add.at(diagonal, end[end >= 0], weights[end >= 0])
        count = len(self.vertices)
        places = np.concatenate([i[both], j[both]]), np.concatenate([j[both], i[both]])
        coupling = sparse.coo_array((np.tile(-weights[both], 2), places), shape=(count, count))
        return factorise(sparse.csr_array(coupling.tocsr() + sparse.diags_array(diagonal)))

    def seen(self, motions: Float, x: Float) -> Float:
        """Return the sides 01 and 02 ``(f, 2, 3)`` of a frame ``(V, 3)``, from the mean of the corners' motions."""
        corners = x[self.faces]
        sides = corners[:, 1:] - corners[:, :1]
        return np.asarray(kernels.turn_sides(self.frames(motions), sides, True))

    def frames(self, motions: Float) -> Float:
        """Return the frames ``(f, 4)`` of faces: mean rotations of the motions ``(V, 7)`` of their corners."""
        return np.asarray(kernels.face_frames(motions, self.faces))

    def settle(self, motions: Float, sides: Float, x: Float) -> Float:
        """Move the free vertices of posed points ``(V, 3)`` to where sides ``(f, 2, 3)`` agree with them."""
        return self._solved(kernels.turn_sides(self.frames(motions), sides, False), x)

    def settle_moving(
        self, motions: Float, changes: Float, sides: Float, rates: Float, x: Float, speeds: Float
    ) -> tuple[Float, Float]:
        """Settle points, and return them and their velocities ``(V, 3)``.

        Parameters
        ----------
        motions, changes : (V, 7), (V, 6) float64
            Motions of the vertices and their rates.
        sides, rates : (f, 2, 3) float64
            Sides as seen from the faces' frames, and their derivatives.
        x, speeds : (V, 3) float64
            Posed points and their velocities.
        """
        frames = self.frames(motions)
        turned = kernels.turn_sides(frames, sides, False)
        spins = kernels.face_spins(motions, changes, self.faces)
        turning = kernels.turn_sides(frames, rates, False) + np.cross(spins[:, None], turned)
        return self._solved(turned, x), self._solved(turning, speeds)

    def _solved(self, turned: Float, x: Float) -> Float:
        if not len(self.vertices):
            return x
        right = kernels.right_hand_side(
            self.faces, self.weights, self._number, turned, x, HOLD, self.vertices
        )
        settled = x.copy()
        settled[self.vertices] = self.factor.solve(right)
        return settled
