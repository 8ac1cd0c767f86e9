"""What both mixed shape spaces have: parts that are registered to their mean shapes, and the joints between them."""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.choices import PlacementName
from mixseq.errors import SettingsError
from mixseq.geometry.lengths_angles import dihedral_angles, edge_lengths
from mixseq.segmentation.joints import Decomposition
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.metric import ANGLE, radii_of_gyration
from mixseq.spaces.registered import registered
from mixseq.topology import Topology

if TYPE_CHECKING:
    from mixseq.spaces.mixed.anchored import AnchoredSpace


@dataclass(frozen=True, eq=False)
class MixedSpace(ShapeSpace):
    """The mixed shape space of one mesh sequence; make it with `mixed_space`.

    Attributes
    ----------
    topology : Topology
        Connectivity of the mesh.
    decomposition : Decomposition
        Its parts and joints.
    scale : float
        Length of the unit of the space, in the units of the sequence: the diagonal of the first frame.
    shapes : (N, 3) float64
        Mean shapes of all parts, each centred, part by part, in the space's unit.
    reference : (V, 3) float64
        The first frame, in the space's unit: the first frame of an encoded sequence stays near its angles.
    """

    topology: Topology
    decomposition: Decomposition
    scale: float
    shapes: Float
    reference: Float
    name = "mixed"
    placement: ClassVar[PlacementName]

    @property
    def decomposed(self) -> Decomposition:
        """Implement `ShapeSpace.decomposed`."""
        return self.decomposition

    def mixed(self) -> MixedSpace:
        """Implement `ShapeSpace.mixed`."""
        return self

    def anchored(self) -> AnchoredSpace:
        """Implement `ShapeSpace.anchored`: the free placement has poses of whole components only."""
        raise SettingsError(
            "parts have poses of their own in the anchored placement only; fit a model with placement='anchored'"
        )

    @cached_property
    def radii(self) -> Float:
        """Radii of gyration ``(p,)`` of the parts, a small number for a part that has none."""
        return radii_of_gyration(self.shapes, self.decomposition.parts)

    @property
    def edge_ids(self) -> Index:
        """Edges ``(E',)`` whose lengths are in a vector, in its order."""
        raise NotImplementedError

    @property
    def hinge_ids(self) -> Index:
        """Hinges ``(H',)`` whose angles are in a vector, in its order."""
        raise NotImplementedError

    @cached_property
    def reference_angles(self) -> Float:
        """Hinge angles ``(H',)`` of the reference frame."""
        return dihedral_angles(self.reference, self.topology.hinges_at(self.hinge_ids))

    def lengths_and_angles(self, x: Float) -> tuple[Float, Float]:
        """Return the lengths ``(..., E')`` and angles ``(..., H')`` of joints in frames ``(..., V, 3)``."""
        edges, hinges = self.topology.edges[self.edge_ids], self.topology.hinges_at(self.hinge_ids)
        return edge_lengths(x, edges), dihedral_angles(x, hinges)

    @cached_property
    def angle_weights(self) -> Float:
        """What an angle ``(H',)`` weighs against a length: `ANGLE` times the length of its edge in the reference."""
        edges = self.topology.edges[self.topology.hinge_edges[self.hinge_ids]]
        return ANGLE * edge_lengths(self.reference, edges)

    def registered(self, x: FloatArray) -> tuple[Float, Float, Float]:
        """Register the parts of a frame ``(V, 3)``, in diagonals; see `mixseq.spaces.registered`."""
        return registered(self.shapes, self.decomposition.parts, x)

    def checked(self, vectors: Float) -> Float:
        """Return vectors ``(T, D)`` if they are of this space.

        Raises
        ------
        SettingsError
            If they are not.
        """
        if vectors.ndim != 2 or vectors.shape[1] != self.dim:
            raise SettingsError(f"vectors have shape {vectors.shape}; (T, {self.dim}) is expected")
        return vectors


def split_rows(vectors: Float, sizes: tuple[int, ...]) -> list[Float]:
    """Return the blocks ``(T, size)`` of vectors ``(T, D)``, as views."""
    return np.split(vectors, np.cumsum(sizes)[:-1], axis=1)


def joined_rows(*blocks: Float) -> Float:
    """Return vectors ``(T, D)`` of blocks ``(T, ...)``; the inverse of `split_rows` and reshaping."""
    return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)
