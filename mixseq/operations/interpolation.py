r"""Segment sequences, and blend poses by the operator A of the paper and the projection P to meshes.

.. math:: x(w) = P\Bigl(\sum_i w_i\, s_i\Bigr), \qquad \sum_i w_i = 1

In the mixed space (paper, Section 2.2) rigid parts are first registered to each other over all poses (Williams and
Bennamoun). Part vertices, and lengths and angles in joints, blend linearly; rotations blend as quaternions. In other
spaces of `mixseq.spaces`, rigid-motion invariant coordinates and centres blend linearly, rotations as quaternions.

Whole turns of angles and rotations are unwrapped along the poses of nonzero weight, as in a sequence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Unpack, cast

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq import segmentation
from mixseq.choices import PlacementName, SegmentationName, SpaceName
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, StagedProgress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.segmentation.methods import MethodSettings
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, FrameStore, MeshSequence, check_frames, load_frames, own_parts
from mixseq.shells.fitting import ShellReport
from mixseq.signals.detail import encode_sequence
from mixseq.signals.model import Model
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.making import SPACE_STAGES, MixedSettings, SpaceOptions, make_space, segment_faces, space_settings
from mixseq.types import Float


@public
def segment(
    sequence: FileOr[MeshSequence | Model],
    method: SegmentationName = "motion",
    parts: int | None = None,
    settings: MethodSettings | None = None,
) -> NDArray[np.int64]:
    """Find the near-rigid parts of a sequence, as labels for the argument `parts` of `mixseq.fit`.

    Parameters
    ----------
    sequence : MeshSequence or Model
        The animation, or poses of one mesh. The parts of a model are returned, unless other settings are given.
    method : {"motion", "silhouettes", "spanning-tree"}
        Segmentation by rigid motion (the default), by augmented silhouettes (Marras et al. 2012), or by cutting a
        spanning tree (Wuhrer and Brunton 2010).
    parts : int, optional
        Number of parts, by default automatic. Every connected component has at least one part. The motion method may
        find fewer parts if little moves.
    settings : MotionSettings, SilhouetteSettings or SpanningTreeSettings, optional
        Settings of the method.

    Returns
    -------
    (F,) int64
        Part number of every triangle. Parts are numbered from 0 by decreasing area, and connected across edges.

    Raises
    ------
    InvalidSequenceError
        If the argument is not a sequence.
    SettingsError
        If the method does not exist, the settings belong to another method, or `parts` is out of range.

    Examples
    --------
    >>> import mixseq
    >>> mixseq.segment("arm.usdc", parts=2).max().item()
    1
    """
    sequence = cast("MeshSequence | Model", sequence)
    if isinstance(sequence, Model):
        if sequence.parts is not None and (method, parts, settings) == ("motion", None, None):
            return sequence.parts.astype(np.int64)
        sequence = sequence.sample()
    check_frames(sequence)
    topology = Topology(sequence.faces, sequence.vertex_count)
    return segmentation.segment(sequence.points, topology, method, parts, settings)


WEIGHT_SUM_TOLERANCE = 1e-6  # largest accepted deviation of the sum of weights from one, as in single precision


@dataclass(frozen=True, eq=False)
class PoseInterpolator(PickledWithoutCaches):
    """Poses of a mesh as vectors of a shape space, to be blended with any weights. Create it with `from_poses`."""

    header: SequenceHeader
    space: ShapeSpace  # shape space made from the poses
    vectors: Float  # (n, D) encoded poses

    @classmethod
    def from_poses(
        cls,
        poses: Frames,
        space: SpaceName = "mixed",
        *,
        placement: PlacementName = MixedSettings.placement,
        parts: int | ArrayLike | None = None,
        joint_width: int = MixedSettings.joint_width,
        pose_ids: ArrayLike | None = None,
        progress: Progress = log_progress,
        workers: Executor | None = None,
        **settings: Unpack[SpaceOptions],
    ) -> PoseInterpolator:
        """Make a shape space from all poses, and encode the poses `pose_ids` (default: all); see `interpolate`."""
        check_frames(poses)
        if parts is None and space == "mixed":
            parts = own_parts(poses)
        making = space_settings(space, placement=placement, parts=parts, joint_width=joint_width, **settings)
        count = poses.header.frame_count
        ids = np.arange(count) if pose_ids is None else np.asarray(pose_ids)
        if ids.ndim != 1 or not np.issubdtype(ids.dtype, np.integer) or not len(ids):
            raise SettingsError("poses to blend are given by their numbers; give at least one")
        missing = ids[(ids < 0) | (ids >= count)]
        if missing.size:
            raise SettingsError(f"there is no pose {missing[0]}; poses are 0 to {count - 1}")
        stages = StagedProgress(progress, 2 + SPACE_STAGES, count)
        executor = workers or thread_executor()
        with one_blas_thread():
            frames = load_frames(poses, stages.at(0))
            if isinstance(making, MixedSettings):
                topology = Topology(frames.header.faces, frames.header.vertex_count)
                making = replace(making, parts=segment_faces(frames, making, topology), purpose="blends")
            blended = FrameStore(frames.header.with_times(np.arange(len(ids))), frames.points[ids])
            shape_space = make_space(blended, space, making, executor, stages.at(1, SPACE_STAGES))
            encoding = stages.at(1 + SPACE_STAGES)
            encoded = encode_sequence(blended, shape_space, workers=executor, progress=encoding)
            vectors = np.concatenate([encoded.shapes[:], encoded.placement], axis=1)
            vectors = np.pad(vectors, ((0, 0), (0, shape_space.correction_dim)))
        return cls(frames.header, shape_space, vectors)

    def blend(self, weights: ArrayLike) -> Float:
        """Return the points ``(V, 3)`` of a blend of poses with weights ``(n,)``, whose sum is one."""
        return self.blend_with_reports(weights)[0]

    def blend_with_reports(self, weights: ArrayLike) -> tuple[Float, list[ShellReport]]:
        """Blend poses, and also return the reports of fits to lengths and angles, empty in spaces without such fits."""
        with one_blas_thread():
            vector = (normalise_weights(weights, len(self.vectors)) @ self.vectors)[None]
        points, (reports,) = self.space.decode_with_reports(vector)
        return points[0], reports

    def iterate_blends(
        self, weights: ArrayLike, progress: Progress = log_progress, workers: Executor | None = None
    ) -> Iterator[Float]:
        """Yield the points ``(V, 3)`` of one blend per row of the weights ``(m, n)``; each row has the sum one."""
        try:
            table = np.asarray(weights, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise SettingsError("weights are not a table of numbers, with a row for every blend") from error
        rows = [normalise_weights(row, len(self.vectors)) for row in np.atleast_1d(table)]
        executor = workers or thread_executor()
        for done, points in enumerate(executor(PoseInterpolator.blend, self, rows), start=1):
            yield points
            progress(done, len(rows), "blending poses")


@public
def interpolate(
    poses: FileOr[Frames | HasFrames],
    weights: ArrayLike,
    space: SpaceName = "mixed",
    *,
    placement: PlacementName = MixedSettings.placement,
    parts: int | ArrayLike | None = None,
    joint_width: int = MixedSettings.joint_width,
    progress: Progress = log_progress,
    workers: Executor | None = None,
    **settings: Unpack[SpaceOptions],
) -> Float:
    """Blend any number of poses of a mesh in a shape space.

    For several blends of the same poses, create one `PoseInterpolator`.

    Parameters
    ----------
    poses : MeshSequence or SequenceReader
        The poses, as frames of a sequence; times are ignored. Parts are found from all poses. Poses of nonzero weight
        are registered to each other, and angles are unwrapped from each such pose to the next.
    weights : (n,) array_like
        Weights of the poses, with the sum one. Weights below zero or above one exaggerate.
    space : {"mixed", "vertex", "gradient", "lri", "edge"}
        The shape space, as in `mixseq.fit`.
    placement : {"anchored", "free"}
        Mixed space: placement of parts. Free placement, as in the paper, follows from lengths and angles.
    parts : int or (F,) int, optional
        Mixed space: number of parts, or part of every triangle; by default found from the poses.
    joint_width : int
        Mixed space: largest width of joints, in strips of triangles on each side of a boundary.
    progress : callable, optional
        Function called at every stage.
    workers : Executor, optional
        Executor that processes the poses; by default one thread per core.

    Other Parameters
    ----------------
    segmentation, projection, volume, shell : optional
        As in `mixseq.fit`.

    Returns
    -------
    (V, 3) float64
        Vertex positions in the units of the poses.

    Raises
    ------
    SettingsError
        If there is not one finite weight per pose, the sum of weights is not one, or a setting is out of range or
        unused by the space.
    SegmentationError
        If given parts do not fit the mesh.
    ReconstructionError
        If no mesh can be reconstructed from the blend.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=4)
    >>> mixseq.interpolate(walk, [0.5, 0.5, 0, 0]).shape == walk.points[0].shape
    True
    """
    poses = cast("Frames", poses)
    check_frames(poses)
    weights = normalise_weights(weights, poses.header.frame_count)  # raises errors before any work
    used = np.flatnonzero(weights)
    interpolator = PoseInterpolator.from_poses(
        poses,
        space,
        pose_ids=used,
        placement=placement,
        parts=parts,
        joint_width=joint_width,
        progress=progress,
        workers=workers,
        **settings,
    )
    return interpolator.blend(weights[used])


def normalise_weights(weights: ArrayLike, count: int) -> Float:
    """Validate the weights ``(n,)`` of `count` poses and return them divided by their sum."""
    try:
        numbers = np.asarray(weights, dtype=np.float64)
    except (TypeError, ValueError) as error:
        raise SettingsError(f"weights are {weights!r}; one number for each pose is expected") from error
    if numbers.shape != (count,):
        raise SettingsError(f"weights have shape {numbers.shape}; one number for each of the {count} poses is expected")
    if not np.isfinite(numbers).all():
        wrong = int(np.flatnonzero(~np.isfinite(numbers))[0])
        raise SettingsError(f"the weight of pose {wrong} is {numbers[wrong]}; finite numbers are expected")
    total = numbers.sum()
    if abs(total - 1) > WEIGHT_SUM_TOLERANCE:
        raise SettingsError(
            f"weights add up to {total:.10g} and must add up to 1; divide them by their sum"
            if total
            else "weights add up to 0 and must add up to 1; raise one of them"
        )
    return np.asarray(numbers / total)
