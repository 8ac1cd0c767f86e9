"""The contract of all shape spaces, the weights of their metrics, and the smallest space, that of vertex positions."""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import SettingsError
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.progress import Progress, log_progress
from mixseq.spaces.temporal import Poses, TemporalOperator, interpolate_poses
from mixseq.types import Float, FloatArray, Index

if TYPE_CHECKING:
    from mixseq.segmentation.joints import Decomposition
    from mixseq.shells.fitting import ShellReport


ANGLE_WEIGHT = 0.3  # weight of a dihedral angle in radians, relative to its edge's length, in all metrics
MIN_GYRATION_RADIUS = 1e-3  # least radius of gyration of a part in metrics, in diagonals


def radii_of_gyration(shapes: Float, parts: Sequence[Index]) -> Float:
    """Return the radii of gyration ``(p,)`` of parts, from centred vertices ``(N, 3)`` listed part by part."""
    sizes = [len(vertex_ids) for vertex_ids in parts]
    sums = np.add.reduceat(np.square(shapes).sum(axis=1), np.cumsum([0, *sizes[:-1]]))
    return np.maximum(np.sqrt(sums / sizes), MIN_GYRATION_RADIUS)


def flatten_blocks(blocks: Iterable[NDArray[Any]]) -> NDArray[Any]:
    """Return rows ``(T, n)`` with the concatenated entries of blocks ``(T, ...)``."""
    return np.concatenate([block.reshape(len(block), -1) for block in blocks], axis=1)


DIFFERENCE_STEP_DIAGONALS = 1e-4  # step of central differences, as a displacement of vertices in diagonals


class ShapeSpace(PickledWithoutCaches, ABC):
    """A linear space of vectors ``(D,)``; every vector represents a shape of the same mesh.

    ``decode(encode(x)) = x`` for all frames x of its sequence. Affine combinations of vectors are vectors of the space.

    A vector is ``[shape | placement | correction]``. The *placement* is the pose of the shape, or of each of its
    bodies, as quaternions, then centres. Distances between shapes ignore the placement. The *correction* is zero in
    encoded frames; between frames it corrects blended part poses.
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
        """Length of the relative part poses at the end of a shape, zero in spaces without parts."""
        return 0

    @property
    def shape_weights(self) -> Float:
        """Metric ``(S,)`` of shapes."""
        return self.weights[: self.shape_dim]

    @property
    def rounding_step_ratios(self) -> Float:
        """Ratios ``(S,)``, powers of two, of the rounding steps of a shape to the rounding step of positions."""
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
        return self.rotation_count

    @property
    def segmentation(self) -> Decomposition | None:
        """Parts and joints of the mesh, or None in spaces without parts."""
        return None

    @property
    def placement_dim(self) -> int:
        """Length P of the placement in a vector."""
        return 4 * self.rotation_count + 3 * self.centre_count

    def unpack_placements(self, placements: Float) -> Poses:
        """Return the quaternions and centres in placements ``(T, placement_dim)``."""
        rotations, centres = np.split(placements, [4 * self.rotation_count], axis=1)
        shape = len(placements), self.rotation_count, 4
        return Poses(rotations.reshape(shape), centres.reshape(len(placements), self.centre_count, 3))

    def pack_placements(self, poses: Poses) -> Float:
        """Return the placements ``(T, placement_dim)`` of poses; the inverse of `unpack_placements`."""
        return flatten_blocks(poses)

    def group_coordinates(self, group_of_vertex: Index) -> Index | None:
        """Return the group ``(S,)`` of shape coordinates from the group ``(V,)`` of vertices; None if they are shared.

        Groups have temporal operators of their own, and consist of components of the mesh.
        """
        return None

    def merge_poses(self, poses: Sequence[tuple[Poses, Float]], group_of_vertex: Index) -> tuple[Poses, Float]:
        """Merge results of `interpolate_poses` with the operators of all groups; by default there are no poses."""
        return poses[0]

    def interpolate_poses(
        self, operator: TemporalOperator, poses: Float, placements: Float, times: Float
    ) -> tuple[Poses, Float]:
        """Interpolate part poses ``(T, pose_dim)`` and placements ``(T, P)`` of the frames at times ``(N,)``.

        Returns poses ``(N, p)`` of parts in body axes, the targets of `pose_corrections`, and placements ``(N, P)``.
        Spaces without parts chain rotations and add weighted centres.
        """
        weights = operator.weights_at(times)
        placed = interpolate_poses(weights, self.unpack_placements(placements))
        return Poses(np.zeros((len(times), 0, 4)), np.zeros((len(times), 0, 3))), self.pack_placements(placed)

    def to_body_axes(self, points: Float, vertex_ids: Index, placements: Float) -> Float:
        """Return points ``(T, n, 3)`` of vertices ``(n,)`` in the axes of their bodies; by default unchanged."""
        return points

    def quaternion_signs(self, poses: Float, previous: Float) -> Float:
        """Return the signs ``(pose_dim,)``, 1 or -1, that align quaternions of poses with previous quaternions."""
        return np.ones(self.pose_dim)

    def pose_corrections(self, poses: Float, targets: Poses) -> Float:
        """Return the corrections ``(N, C)`` that move blended part poses ``(N, pose_dim)`` to targets ``(N, p)``."""
        return np.zeros((len(poses), 0))

    def encode(self, points: FloatArray, previous: Float | None = None) -> Float:
        """Encode frames as vectors.

        Parameters
        ----------
        points : (T, V, 3) or (V, 3) float
            Vertex positions in the units of the sequence: consecutive frames, or one pose.
        previous : (D,) float64, optional
            Vector of the preceding frame, from which angles continue without jumps; by default the reference shape.

        Returns
        -------
        (T, D) float64

        Raises
        ------
        SettingsError
            If the points are not numeric or not finite, or do not fit the mesh.
        """
        frames = self._check_points(points)
        if not len(frames):
            return np.zeros((0, self.dim))
        return self.unwrap(self.encode_independently(frames), previous)

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
        """Encode frames ``(T, V, 3)`` as vectors ``(T, D)``, each frame independently; see `unwrap`."""

    def unwrap(self, vectors: Float, previous: Float | None = None) -> Float:
        """Make vectors ``(T, D)`` continuous in time, in place, and with a previous ``(D,)``; by default unchanged."""
        return vectors

    @abstractmethod
    def decode(self, vectors: Float, progress: Progress = log_progress) -> Float:
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
            If the vectors do not belong to this space.
        ReconstructionError
            If a vector cannot be decoded to a mesh.
        """

    def decode_with_reports(self, vectors: Float) -> tuple[Float, list[list[ShellReport]]]:
        """Decode vectors, and return the fit reports of every frame, which are empty in spaces without fits."""
        return self.decode(vectors), [[] for _ in vectors]

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Return the change ``(S,)`` of a vector's shape from decoded points to edited points ``(V, 3)``.

        The shape plus the change decodes to the edited points, except for the placement. Unedited points give zero.
        """
        # Encode continuously from the vector, because differences of rotation vectors depend on full rotations.
        encoded = self.encode(np.stack([before, after]), vector)[:, : self.shape_dim]
        return np.asarray(encoded[1] - encoded[0])

    def decode_for_differences(self, vectors: Float) -> Float:
        """Decode vectors accurately enough for differences of points of nearly equal vectors."""
        return self.decode(vectors)

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Decode vectors and their rates ``(T, D)`` to points and velocities ``(T, V, 3)``, by central differences."""
        points = self.decode(vectors)
        size = np.abs(rates * self.weights).max(axis=1, initial=0.0)
        step = np.divide(DIFFERENCE_STEP_DIAGONALS, size, out=np.zeros_like(size), where=size > 0)
        change = step[:, None] * rates
        ahead, behind = (self.decode_for_differences(v) for v in (vectors + change, vectors - change))
        inverse = np.divide(0.5, step, out=np.zeros_like(step), where=step > 0)
        return points, (ahead - behind) * inverse[:, None, None]


@dataclass(frozen=True)
class VertexSpace(ShapeSpace):
    """The linear space of vertex positions S_v, for meshes without articulation: blends shrink rotating parts."""

    vertex_count: int
    scale: float  # unit of errors, see `reference_diagonal`, in the units of the sequence
    name = "vertex"

    @property
    def dim(self) -> int:
        """Length of a vector, 3 V."""
        return 3 * self.vertex_count

    @property
    def weights(self) -> Float:
        """Ones: coordinates are in diagonals."""
        return np.ones(self.dim)

    def group_coordinates(self, group_of_vertex: Index) -> Index:
        """Implement `ShapeSpace.group_coordinates`."""
        return np.repeat(group_of_vertex, 3)

    def encode_independently(self, points: FloatArray) -> Float:
        """Implement `ShapeSpace.encode_independently`."""
        return points.astype(np.float64).reshape(len(points), -1) / self.scale

    def decode(self, vectors: Float, progress: Progress = log_progress) -> Float:
        """Implement `ShapeSpace.decode`."""
        points = self.check_vectors(vectors).reshape(len(vectors), self.vertex_count, 3)
        return np.asarray(points * self.scale)

    def shape_difference(self, vector: Float, before: Float, after: Float) -> Float:
        """Implement `ShapeSpace.shape_difference`."""
        return np.asarray((after - before).reshape(-1) / self.scale)

    def decode_with_velocities(self, vectors: Float, rates: Float) -> tuple[Float, Float]:
        """Implement `ShapeSpace.decode_with_velocities`."""
        return self.decode(vectors), self.decode(rates)
