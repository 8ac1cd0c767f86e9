"""The contract of all shape spaces."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, ClassVar

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.errors import SettingsError
from mixseq.pickling import PickledWithoutCaches
from mixseq.prediction.operator import Operator
from mixseq.prediction.poses import Neighbours, Poses, predicted_alone
from mixseq.progress import Progress, silent

if TYPE_CHECKING:
    from mixseq.segmentation.joints import Decomposition
    from mixseq.shells.gauss_newton import ShellReport
    from mixseq.spaces.mixed.anchored import AnchoredSpace
    from mixseq.spaces.mixed.mixed_space import MixedSpace

Carry = Callable[[Float], Float]
"""From shapes ``(K, S)`` in one space to the same shapes in another one."""

DIFFERENCE = 1e-4
"""Step of difference quotients, relative to the size of a vector's metric."""


class ShapeSpace(PickledWithoutCaches, ABC):
    """A space of vectors, each of which is a shape of one mesh, that may be added and scaled.

    For every space and all frames x of the sequence it was made for ``decode(encode(x)) = x``, and an affine
    combination of vectors (weights that add up to one) is a vector of the space.

    A vector may end with a *placement*: numbers that say where the shape, or each of its parts, is. First a quaternion
    for everything that has a rotation, then a centre for everything that has a place. They have no part in distances
    between shapes, and are combined as accurately as they are known.
    """

    name: str
    """Name of the space, as `mixseq.fit` knows it."""

    scale: float
    """Length of the unit of the space, in the units of the sequence."""

    posed_parts: ClassVar[bool] = False
    """Whether every part has a pose of its own, so that limbs can be moved in their joints."""

    @property
    @abstractmethod
    def dim(self) -> int:
        """Length D of a vector."""

    @property
    @abstractmethod
    def weights(self) -> Float:
        """Weights ``(D,)`` of the coordinates: a change by one moves vertices by so many diagonals."""

    @property
    def shape_dim(self) -> int:
        """How many numbers S of a vector are its shape: all but the placement."""
        return self.dim - self.placement_dim

    @property
    def shape_weights(self) -> Float:
        """Weights ``(S,)`` of a vector without its placement."""
        return self.weights[: self.shape_dim]

    @property
    def embedding_weights(self) -> Float:
        """Weights ``(S,)`` of the same where poses are to be told apart: embeddings, and what is similar."""
        return self.shape_weights

    @property
    def rotation_count(self) -> int:
        """How many quaternions a placement begins with."""
        return 0

    @property
    def centre_count(self) -> int:
        """How many centres a placement ends with."""
        return 0

    @property
    def decomposed(self) -> Decomposition | None:
        """Parts and joints of the mesh, if the space knows any."""
        return None

    @property
    def neighbours(self) -> Neighbours:
        """Which of the poses in a placement see each other; here none do."""
        return Neighbours(np.zeros((0, 2), dtype=np.int64), np.zeros((0, 3)), np.ones(self.rotation_count))

    @property
    def parents(self) -> Index:
        """The part ``(r,)`` that the part of each pose hangs on, -1 for roots; here all are."""
        return np.full(self.rotation_count, -1, dtype=np.int64)

    @property
    def bodies(self) -> Index:
        """The body ``(r,)`` that each pose is of: poses of one body turn the same way round. Here each is one."""
        return np.arange(self.rotation_count)

    def anchored(self) -> AnchoredSpace:
        """Return the space, if its parts have poses of their own, so that they can be moved one by one.

        Raises
        ------
        SettingsError
            If they have none.
        """
        raise SettingsError(f"the {self.name} space has no parts; fit a model with space='mixed'")

    def mixed(self) -> MixedSpace:
        """Return the space, if it is the mixed shape space.

        Raises
        ------
        SettingsError
            If it is another one, which has no parts.
        """
        raise SettingsError(f"the {self.name} space has no parts; fit a model with space='mixed'")

    @property
    def placement_dim(self) -> int:
        """How many numbers at the end of a vector are its placement."""
        return 4 * self.rotation_count + 3 * self.centre_count

    def poses(self, placements: Float) -> Poses:
        """Return quaternions and centres of placements ``(T, placement_dim)``."""
        turns, centres = np.split(placements, [4 * self.rotation_count], axis=1)
        count = len(placements)
        return Poses(
            turns.reshape(count, self.rotation_count, 4), centres.reshape(count, self.centre_count, 3)
        )

    def placements(self, poses: Poses) -> Float:
        """Return the placements ``(T, placement_dim)`` of quaternions and centres; the inverse of `poses`."""
        return np.concatenate([block.reshape(len(block), -1) for block in poses], axis=1)

    def predicted_placements(self, operator: Operator, placements: Float, times: Float) -> Float:
        """Return placements ``(N, placement_dim)`` at times ``(N,)`` from those ``(T, placement_dim)`` at the frames.

        Rotations are chained and centres are weighted sums, see `mixseq.prediction`. Spaces that know more say so.
        """
        return self.placements(predicted_alone(operator.at(times), self.poses(placements)))

    def blended_placements(self, weights: Float, placements: Float) -> Float:
        """Return the placement ``(placement_dim,)`` of a blend of T poses, with weights ``(T,)`` that add up to one.

        Here that is the weighted sum. Spaces that know more say so.
        """
        return np.asarray(weights @ placements)

    def with_shape(self, points: Float) -> tuple[ShapeSpace, Carry]:
        """Return a space that has all shapes of this one and another one ``(V, 3)``, and how shapes get there.

        Here that is this space: it has all shapes of the mesh.
        """
        return self, unchanged

    def joined(self, other: ShapeSpace) -> tuple[ShapeSpace, Carry | None, Carry | None]:
        """Return a space for the shapes of this one and of another one of the same mesh, and how they get there.

        Nothing tells how shapes get there if frames must be decoded and encoded again. Here it is this space.
        """
        return self, unchanged, unchanged if other is self else None

    def encode(self, points: FloatArray, previous: Float | None = None) -> Float:
        """Turn frames into vectors.

        Parameters
        ----------
        points : (T, V, 3) float
            Vertex positions in the units of the sequence, consecutive frames.
        previous : (D,) float64, optional
            Vector of the frame before the first one, where a sequence is encoded block by block: angles go on
            from there without jumps. By default the first frame stays near the reference of the space.

        Returns
        -------
        (T, D) float64
        """
        return self.unwrap(self.encode_apart(points), previous)

    @abstractmethod
    def encode_apart(self, points: FloatArray) -> Float:
        """Turn frames ``(T, V, 3)`` into vectors ``(T, D)``, each by itself: `unwrap` makes them a sequence."""

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Let vectors ``(T, D)`` of `encode_apart` go on from frame to frame, and from the one before, as in `encode`.

        Frames can be encoded in any order, which is most of the work, and be put in order afterwards. Here nothing
        jumps.
        """
        return vectors

    @abstractmethod
    def decode(self, vectors: Float, progress: Progress = silent) -> Float:
        """Turn vectors ``(T, D)`` into vertex positions ``(T, V, 3)`` in the units of the sequence.

        Parameters
        ----------
        vectors : (T, D) float64
            Vectors.
        progress : callable, optional
            Told about every frame.

        Raises
        ------
        ReconstructionError
            If no mesh could be found for a vector.
        """

    def decode_with_reports(
        self, vectors: Float, progress: Progress = silent
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors as `decode` does, and tell how every fit to lengths and angles went, frame by frame.

        Spaces that fit nothing have no reports.
        """
        return self.decode(vectors, progress), [[] for _ in vectors]

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return what a change of a frame is in the shape coordinates, its placement left as it is.

        Parameters
        ----------
        vector : (D,) float64
            Vector of the frame.
        before, after : (V, 3) float64
            The decoded frame and what became of it, in the units of the sequence.

        Returns
        -------
        (S,) float64
            Added to the shape of the vector, without the `placement_dim` numbers at its end, it decodes to `after`,
            but for the placement. Zeros if nothing was changed.
        """
        # Rotation vectors with more turns, or fewer, differ by something else: those of the vector count.
        encoded = self.encode(np.stack([before, after]), vector)[:, : self.shape_dim]
        return np.asarray(encoded[1] - encoded[0])

    def decode_for_differences(self, vectors: Float) -> Float:
        """Do what `decode` does, so accurately that the points of nearly the same vectors can be subtracted."""
        return self.decode(vectors)

    def decode_moving(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Turn vectors that change into points that move.

        Parameters
        ----------
        vectors, rates : (T, D) float64
            Vectors, and their derivatives by time.

        Returns
        -------
        points, velocities : (T, V, 3) float64
            Positions, and the derivative of `decode` in the direction of the rates. Spaces that know no
            derivative return central differences along that direction.
        """
        size = np.abs(rates * self.weights).max(axis=1, initial=0.0)
        step = np.divide(DIFFERENCE, size, out=np.zeros_like(size), where=size > 0)
        change = step[:, None] * rates
        here = self.decode(vectors)
        ahead, behind = (self.decode_for_differences(v) for v in (vectors + change, vectors - change))
        inverse = np.divide(0.5, step, out=np.zeros_like(step), where=step > 0)
        return here, (ahead - behind) * inverse[:, None, None]


def unchanged(shapes: Float) -> Float:
    """Return shapes as they are: they are the same vectors in the other space."""
    return shapes
