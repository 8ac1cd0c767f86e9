"""The contract of all shape spaces, and what their metrics share: how far angles and rotations move vertices."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.mesh.measures import edge_lengths
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.low_memory import LargeArray
from mixseq.runtime.parallel import Executor
from mixseq.runtime.progress import Progress, no_progress
from mixseq.sequence.sequence import iterate_blocks
from mixseq.spaces.temporal import Poses, TemporalOperator, interpolate_poses
from mixseq.types import Float, FloatArray, Index

if TYPE_CHECKING:
    from mixseq.segmentation.joints import Decomposition
    from mixseq.shells.gauss_newton import ShellReport


ANGLE_WEIGHT = 0.3
"""Weight of a radian relative to the length of the hinge's edge, in the metrics of all spaces with both."""

MIN_GYRATION_RADIUS = 1e-3
"""Least radius of gyration of a part, in diagonals."""


def radii_of_gyration(shapes: Float, parts: Sequence[Index]) -> Float:
    """Return the radii of gyration ``(p,)`` of centred shapes ``(N, 3)``, part by part, at least `SMALLEST`."""
    squares = np.square(shapes).sum(axis=1)
    sizes = [len(vertices) for vertices in parts]
    starts = np.cumsum([0, *sizes[:-1]])
    return np.maximum(np.sqrt(np.add.reduceat(squares, starts) / sizes), MIN_GYRATION_RADIUS)


def mean_edge_lengths(
    points: LargeArray, edges: NDArray[np.integer], scale: float, workers: Executor, progress: Progress
) -> Float:
    """Return mean lengths ``(E,)`` of edges ``(E, 2)`` over frames ``(T, V, 3)``, in units of the scale."""
    total, done = np.zeros(len(edges)), 0
    for block in workers(_edge_lengths_of_block, edges, iterate_blocks(points)):
        for lengths in block:  # one by one: the sum must not depend on the blocks
            total += lengths
        done += len(block)
        progress(done, len(points), "measuring edges")
    return total / (done * scale)


def _edge_lengths_of_block(edges: NDArray[np.integer], points: FloatArray) -> list[Float]:
    return [edge_lengths(frame.astype(np.float64), edges) for frame in points]


ShapeMap = Callable[[Float], Float]
"""Map of shapes ``(K, S)`` of one space to the same shapes of another space."""

DIFFERENCE_STEP = 1e-4
"""Step of difference quotients, relative to the size of a vector in the metric."""


class ShapeSpace(PickledWithoutCaches, ABC):
    """A linear space of vectors ``(D,)``, each a shape of one mesh.

    ``decode(encode(x)) = x`` for all frames x of its sequence. Affine combinations of vectors are vectors of the space.

    A vector is ``[shape | placement | correction]``. A *placement* poses the shape, or each of its bodies: quaternions,
    then centres. It does not count in distances between shapes. *Corrections* are zero in encoded frames; between
    frames they are added to blended part poses.
    """

    name: str
    """Name of the space in `mixseq.fit`."""

    scale: float
    """Unit of length of the space, in the units of the sequence."""

    vertex_count: int
    """Number V of vertices."""

    @property
    @abstractmethod
    def dim(self) -> int:
        """Length D of a vector."""

    @property
    @abstractmethod
    def weights(self) -> Float:
        """Metric ``(D,)``: vertex displacement in diagonals per unit of each coordinate."""

    @property
    def shape_dim(self) -> int:
        """Length S of the shape in a vector."""
        return self.dim - self.placement_dim - self.correction_dim

    @property
    def correction_dim(self) -> int:
        """Length C of the correction at the end of a vector."""
        return 0

    @property
    def pose_dim(self) -> int:
        """Length of the relative part poses at the end of a shape."""
        return 0

    @property
    def shape_weights(self) -> Float:
        """Metric ``(S,)`` of shapes."""
        return self.weights[: self.shape_dim]

    @property
    def rounding_step_ratios(self) -> Float:
        """Rounding steps ``(S,)`` of a shape over that of positions: powers of two."""
        return np.ones(self.shape_dim)

    @property
    def embedding_weights(self) -> Float:
        """Metric ``(S,)`` of shapes for embeddings and similarity of poses."""
        return self.shape_weights

    @property
    def rotation_count(self) -> int:
        """Number of quaternions of a placement."""
        return 0

    @property
    def centre_count(self) -> int:
        """Number of centres of a placement."""
        return 0

    @property
    def segmentation(self) -> Decomposition | None:
        """Parts and joints of the mesh, None in spaces without parts."""
        return None

    @property
    def placement_dim(self) -> int:
        """Length P of the placement in a vector."""
        return 4 * self.rotation_count + 3 * self.centre_count

    def unpack_placements(self, placements: Float) -> Poses:
        """Return quaternions and centres of placements ``(T, placement_dim)``."""
        turns, centres = np.split(placements, [4 * self.rotation_count], axis=1)
        count = len(placements)
        return Poses(
            turns.reshape(count, self.rotation_count, 4), centres.reshape(count, self.centre_count, 3)
        )

    def pack_placements(self, poses: Poses) -> Float:
        """Return the placements ``(T, placement_dim)`` of quaternions and centres; the inverse of `poses`."""
        return np.concatenate([block.reshape(len(block), -1) for block in poses], axis=1)

    def interpolate_poses(
        self, operator: TemporalOperator, poses: Float, placements: Float, times: Float, in_body: bool
    ) -> tuple[Float, Float]:
        """Predict part poses relative to bodies ``(N, ...)``, for `corrections`, and placements ``(N, P)``.

        Poses ``(T, pose_dim)`` and placements ``(T, P)`` are those of the frames; ``in_body`` adds predictions in body
        axes. Here rotations are chained, centres are weighted sums (`mixseq.spaces.temporal`), and there are no parts.
        """
        placed = self.pack_placements(
            interpolate_poses(operator.weights_at(times), self.unpack_placements(placements))
        )
        return np.zeros((len(times), 0)), placed

    def to_body_axes(self, points: Float, vertices: Index, placements: Float) -> Float:
        """Return points ``(T, n, 3)`` of vertices ``(n,)`` in the axes of placements ``(T, P)``; here unchanged."""
        return points

    def quaternion_signs(self, poses: Float, before: Float) -> Float:
        """Return the signs ``(pose_dim,)``, 1 or -1, that bring quaternions of poses nearest to those before."""
        return np.ones(self.pose_dim)

    def pose_corrections(self, poses: Float, targets: Float) -> Float:
        """Return corrections ``(N, C)`` from poses ``(N, pose_dim)`` of shapes to target poses."""
        return np.zeros((len(poses), 0))

    def extend(self, points: Float) -> tuple[ShapeSpace, ShapeMap]:
        """Return a space that contains this one and a shape ``(V, 3)``, and the map to it; here this space."""
        return self, identity_map

    def merge(self, other: ShapeSpace) -> tuple[ShapeSpace, ShapeMap | None, ShapeMap | None]:
        """Return a space of the shapes of both, and the maps to it, None to encode again; here this space."""
        return self, identity_map, identity_map if other is self else None

    def encode(self, points: FloatArray, previous: Float | None = None) -> Float:
        """Encode frames as vectors.

        Parameters
        ----------
        points : (T, V, 3) or (V, 3) float
            Vertex positions in the units of the sequence: consecutive frames, or one pose.
        previous : (D,) float64, optional
            Vector of the frame before the first one, from which angles continue without jumps; by default a reference.

        Returns
        -------
        (T, D) float64

        Raises
        ------
        SettingsError
            If the points are not numeric, not finite, or not those of the mesh.
        """
        frames = self._check_points(points)
        return (
            self.unwrap(self.encode_independently(frames), previous)
            if len(frames)
            else np.zeros((0, self.dim))
        )

    def _check_points(self, points: FloatArray) -> FloatArray:
        """Return points as frames ``(T, V, 3)``, or raise `SettingsError`."""
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

    def check_vectors(self, vectors: Any) -> Any:
        """Return vectors ``(T, D)`` of this space, or raise `SettingsError`."""
        if np.ndim(vectors) != 2 or np.shape(vectors)[1] != self.dim:
            raise SettingsError(f"vectors have shape {np.shape(vectors)}; (T, {self.dim}) is expected")
        return vectors

    @abstractmethod
    def encode_independently(self, points: FloatArray) -> Float:
        """Encode frames ``(T, V, 3)`` as vectors ``(T, D)``, each independently; `unwrap` makes them continuous."""

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Make vectors ``(T, D)`` of `encode_apart` continuous, after a previous one if given; here unchanged."""
        return vectors

    @abstractmethod
    def decode(self, vectors: Float, progress: Progress = no_progress) -> Float:
        """Decode vectors ``(T, D)`` to vertex positions ``(T, V, 3)`` in the units of the sequence.

        Parameters
        ----------
        vectors : (T, D) float64
            Vectors.
        progress : callable, optional
            Called for every frame.

        Raises
        ------
        SettingsError
            If the vectors are not of this space.
        ReconstructionError
            If no mesh could be found for a vector.
        """

    def decode_with_reports(
        self, vectors: Float, progress: Progress = no_progress
    ) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors, and return the reports of all fits, frame by frame; empty in spaces without fits."""
        return self.decode(vectors, progress), [[] for _ in vectors]

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return the change ``(S,)`` of a vector's shape from decoded points to edited ones ``(V, 3)``.

        Added to the shape it decodes to the edited points, except for the placement. It is zero if nothing was changed.
        """
        # Rotation vectors with more turns, or fewer, differ by something else: those of the vector count.
        encoded = self.encode(np.stack([before, after]), vector)[:, : self.shape_dim]
        return np.asarray(encoded[1] - encoded[0])

    def decode_for_differences(self, vectors: Float) -> Float:
        """Decode as `decode` does, accurately enough to subtract points of nearly equal vectors."""
        return self.decode(vectors)

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Decode vectors and rates ``(T, D)`` to points and velocities ``(T, V, 3)``; here by central differences."""
        here = self.decode(vectors)
        size = np.abs(rates * self.weights).max(axis=1, initial=0.0)
        step = np.divide(DIFFERENCE_STEP, size, out=np.zeros_like(size), where=size > 0)
        change = step[:, None] * rates
        ahead, behind = (self.decode_for_differences(v) for v in (vectors + change, vectors - change))
        inverse = np.divide(0.5, step, out=np.zeros_like(step), where=step > 0)
        return here, (ahead - behind) * inverse[:, None, None]


def identity_map(shapes: Float) -> Float:
    """Return shapes unchanged: the `ShapeMap` between spaces with the same vectors."""
    return shapes
