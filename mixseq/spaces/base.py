"""The contract of all shape spaces."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable
from typing import TYPE_CHECKING, Any

import numpy as np

from mixseq.arrays import Float, FloatArray, Index
from mixseq.errors import SettingsError
from mixseq.pickling import PickledWithoutCaches
from mixseq.prediction.operator import Operator
from mixseq.prediction.poses import Poses, predicted_alone
from mixseq.progress import Progress, silent

if TYPE_CHECKING:
    from mixseq.segmentation.joints import Decomposition
    from mixseq.shells.gauss_newton import ShellReport

Carry = Callable[[Float], Float]
"""From shapes ``(K, S)`` in one space to the same shapes in another one."""

DIFFERENCE = 1e-4
"""Step of difference quotients, relative to the size of a vector's metric."""


class ShapeSpace(PickledWithoutCaches, ABC):
    """A space of vectors, each of which is a shape of one mesh, that may be added and scaled.

    For every space and all frames x of the sequence it was made for ``decode(encode(x)) = x``, and an affine
    combination of vectors (weights that add up to one) is a vector of the space.

    A vector is ``[shape | placement | correction]``. The *placement* says where the shape, or each of its bodies, is:
    first a quaternion for everything that has a rotation, then a centre for everything that has a place. It has no part
    in distances between shapes. *Corrections* are zero in every encoded frame; between frames they make up for what
    blended shapes lack.
    """

    name: str
    """Name of the space, as `mixseq.fit` knows it."""

    scale: float
    """Length of the unit of the space, in the units of the sequence."""

    vertex_count: int
    """Number V of vertices of the mesh."""

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
        """How many numbers S of a vector are its shape: all but placement and correction."""
        return self.dim - self.placement_dim - self.correction_dim

    @property
    def correction_dim(self) -> int:
        """How many numbers C at the end of a vector are its correction."""
        return 0

    @property
    def pose_dim(self) -> int:
        """How many numbers at the end of a shape say how parts stand to each other."""
        return 0

    @property
    def shape_weights(self) -> Float:
        """Weights ``(S,)`` of a shape."""
        return self.weights[: self.shape_dim]

    @property
    def coarseness(self) -> Float:
        """How much coarser than positions numbers ``(S,)`` of a shape may be rounded: powers of two."""
        return np.ones(self.shape_dim)

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
    def placement_dim(self) -> int:
        """How many numbers P of a vector, after its shape, are its placement."""
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

    def predicted_poses(
        self, operator: Operator, poses: Float, placements: Float, times: Float, in_body: bool
    ) -> tuple[Float, Float]:
        """Predict how parts stand, and placements, between frames.

        Parameters
        ----------
        operator : Operator
            The temporal operator of the sequence.
        poses, placements : (T, pose_dim), (T, P) float64
            How parts stand, and placements, at the frames.
        times : (N,) float64
            When.
        in_body : bool
            Whether parts are predicted as seen from their bodies, too.

        Returns
        -------
        targets : (N, ...) float64
            Poses of the parts as seen from their bodies, which `corrections` takes.
        placements : (N, P) float64
            Here rotations are chained and centres are weighted sums, see `mixseq.prediction`; there are no parts.
        """
        placed = self.placements(predicted_alone(operator.at(times), self.poses(placements)))
        return np.zeros((len(times), 0)), placed

    def held(self, points: Float, vertices: Index, placements: Float) -> Float:
        """Return points ``(T, n, 3)`` of vertices ``(n,)`` as seen from placements ``(T, P)``; here as they are."""
        return points

    def signs(self, poses: Float, before: Float) -> Float:
        """Return factors ``(pose_dim,)`` that keep the shape, with which it goes on from another one: 1 or -1.

        Poses are ``(pose_dim,)``, at the end of shapes. A quaternion and its negative are the same rotation.
        """
        return np.ones(self.pose_dim)

    def corrections(self, poses: Float, targets: Float) -> Float:
        """Return the corrections ``(N, C)`` that shapes with poses ``(N, pose_dim)`` need to have targets."""
        return np.zeros((len(poses), 0))

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
        points : (T, V, 3) or (V, 3) float
            Vertex positions in the units of the sequence: consecutive frames, or one pose.
        previous : (D,) float64, optional
            Vector of the frame before the first one, where a sequence is encoded block by block: angles go on
            from there without jumps. By default the first frame stays near the reference of the space.

        Returns
        -------
        (T, D) float64

        Raises
        ------
        SettingsError
            If the points are no numbers, not finite, or not those of the mesh.
        """
        frames = self._checked_points(points)
        return self.unwrap(self.encode_apart(frames), previous) if len(frames) else np.zeros((0, self.dim))

    def _checked_points(self, points: FloatArray) -> FloatArray:
        """Return frames ``(T, V, 3)``, if these are of the mesh."""
        frames = np.asarray(points)
        if frames.dtype.kind not in "fiu":
            raise SettingsError(f"points are {frames.dtype}; real numbers are expected")
        if frames.ndim == 2:
            frames = frames[None]
        if frames.ndim != 3 or frames.shape[1:] != (self.vertex_count, 3):
            raise SettingsError(
                f"points have shape {np.shape(points)}; (T, {self.vertex_count}, 3) is expected, or "
                f"({self.vertex_count}, 3) for one pose"
            )
        finite = np.isfinite(frames).all(axis=(1, 2))
        if not finite.all():
            raise SettingsError(f"frame {int(finite.argmin())} has points that are not finite")
        return frames

    def checked(self, vectors: Any) -> Any:
        """Return vectors ``(T, D)`` if they are of this space.

        Raises
        ------
        SettingsError
            If they are not.
        """
        if np.ndim(vectors) != 2 or np.shape(vectors)[1] != self.dim:
            raise SettingsError(f"vectors have shape {np.shape(vectors)}; (T, {self.dim}) is expected")
        return vectors

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
        SettingsError
            If the vectors are not of this space.
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
            Added to the shape of the vector, it decodes to `after`, but for the placement. Zeros if nothing was
            changed.
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
        here = self.decode(vectors)
        size = np.abs(rates * self.weights).max(axis=1, initial=0.0)
        step = np.divide(DIFFERENCE, size, out=np.zeros_like(size), where=size > 0)
        change = step[:, None] * rates
        ahead, behind = (self.decode_for_differences(v) for v in (vectors + change, vectors - change))
        inverse = np.divide(0.5, step, out=np.zeros_like(step), where=step > 0)
        return here, (ahead - behind) * inverse[:, None, None]


def unchanged(shapes: Float) -> Float:
    """Return shapes as they are: they are the same vectors in the other space."""
    return shapes
