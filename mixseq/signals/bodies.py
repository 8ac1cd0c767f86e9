r"""Further bodies of a model: other meshes that move by its time and pose signals.

.. math:: s_b(t) = \sum_j \varphi_j(c(t))\, P_{bj}

The weights :math:`\varphi_j(c(t))` are independent of the mesh; a body b has key shapes :math:`P_{bj}` in its own shape
space. It follows the path of the model, scaled to its size: with the placement Q, C of the model, each in diagonals of
its mesh,

.. math:: Q_b(t) = G_b\, Q(t)\, A_b, \qquad C_b(t) = G_b\, C(t) + d_b .

Corrections of parts are turned into the axes of the parts of b that correspond. All three maps are linear, so that the
knots of the curves are shared, and any body can take the place of the model without loss.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from mixseq.errors import SettingsError
from mixseq.mesh.polygons import read_only
from mixseq.mesh.rotations import quat_conjugate, quat_multiply, quat_to_matrix, rotate_vectors
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import as_edited
from mixseq.signals.curve import Curve
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.temporal import Poses
from mixseq.types import Float, Index


class Relation(NamedTuple):
    """How a body moves, relative to another one of the same model."""

    turn: tuple[float, ...] = (1.0, 0.0, 0.0, 0.0)  # quaternion of the direction in which it moves
    same_parts: bool = False  # whether parts of equal numbers correspond

    def relative_to(self, other: Relation) -> Relation:
        """Return the relation to another body, from those of both to a third."""
        turn = quat_multiply(np.array(self.turn), quat_conjugate(np.array(other.turn)))
        return Relation(tuple(turn.tolist()), self.same_parts and other.same_parts)


SAME_BODY = Relation(same_parts=True)  # relation of a body to itself


@dataclass(frozen=True, eq=False)
class Body:
    """A body that moves by the time and pose signals of a model; see `Model.bodies`.

    Attributes
    ----------
    header : SequenceHeader
        Mesh and name of the body; times and frame rate are those of the model.
    space : ShapeSpace
        The shape space of the mesh.
    shapes : (K, S) float64
        Key shapes, one for each key shape of the model.
    turn : (4,) float64
        Quaternion G of the direction in which the body moves, relative to the model.
    rotations : (B, 4) float64
        Quaternions A from the axes of the model's placement to those of this one.
    shifts : (B, 3) float64
        Shifts d between both placements, in diagonals.
    part_turns : (p, 3, 3) float64, optional
        Rotations from the axes of the model's parts to those of this one; by default parts do not correspond, and the
        correction of the model is left out.
    """

    header: SequenceHeader
    space: ShapeSpace
    shapes: Float
    turn: Float
    rotations: Float
    shifts: Float
    part_turns: Float | None = None

    def __post_init__(self) -> None:
        for name in ("shapes", "turn", "rotations", "shifts", "part_turns"):
            if (values := getattr(self, name)) is not None:
                object.__setattr__(self, name, read_only(np.asarray(values, dtype=np.float64)))
        arrays = self.shapes, self.turn, self.rotations, self.shifts, self.part_turns
        placed = (self.space.rotation_count, 4), (self.space.centre_count, 3)
        turns = None if self.part_turns is None else (self.space.correction_dim // 6, 3, 3)
        expected = (len(self.shapes), self.space.shape_dim), (4,), *placed, turns
        if tuple(None if array is None else array.shape for array in arrays) != expected:
            raise SettingsError(f"the body {self.header.name!r} does not fit its shape space")

    @property
    def relation(self) -> Relation:
        """The relation to the model."""
        return Relation(tuple(self.turn.tolist()), self.part_turns is not None)

    def relative_to(self, other: Body) -> Body:
        """Return the body with its maps from another body of the same model."""
        turns = None
        if self.part_turns is not None and other.part_turns is not None:
            turns = other.part_turns.swapaxes(1, 2) @ self.part_turns
        turn = quat_multiply(self.turn, quat_conjugate(other.turn))
        rotations = quat_multiply(quat_conjugate(other.rotations), self.rotations)
        shifts = self.shifts - rotate_vectors(quat_to_matrix(turn), other.shifts)
        return replace(self, turn=turn, rotations=rotations, shifts=shifts, part_turns=turns)

    def edited(self, count: int) -> Body:
        """Return the body after an edit, with a number of key shapes; those it lacks are the first one again."""
        missing = np.repeat(self.shapes[:1], count - len(self.shapes), axis=0)
        shapes = np.concatenate([self.shapes, missing]) if len(missing) else self.shapes
        return replace(self, shapes=shapes, header=replace(self.header, provenance=as_edited(self.header.provenance)))

    def place(self, poses: Poses) -> Poses:
        """Return poses ``(N, B)`` of this body's placement from those of the model's."""
        rotations = quat_multiply(quat_multiply(self.turn, poses.rotations), self.rotations)
        return Poses(rotations, rotate_vectors(quat_to_matrix(self.turn), poses.centres) + self.shifts)

    def turn_correction(self, correction: Curve, body_of_part: Index) -> Curve:
        """Return the correction of the model in the axes of this body; zero if parts do not correspond."""
        if self.part_turns is None:
            ends = np.unique(correction.times[[0, -1]])
            return Curve(ends, np.zeros((len(ends), self.space.correction_dim)))
        turns = np.stack([self.part_turns, quat_to_matrix(self.rotations)[body_of_part]])
        vectors = correction.values.reshape(-1, 2, len(self.part_turns), 3)
        turned = np.einsum("rpij,mrpi->mrpj", turns, vectors)
        return Curve(correction.times, turned.reshape(len(vectors), -1))
