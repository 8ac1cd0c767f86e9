r"""Segmentation of a sequence, and blends of poses: the operator A of the paper, then the projection to meshes.

.. math:: x(w) = P\Bigl(\sum_i w_i\, s_i\Bigr), \qquad \sum_i w_i = 1

In the mixed space (paper, Section 2.2) rigid parts are first registered to each other over all poses (Williams and
Bennamoun). Their vertices, and lengths and angles of joints, then blend linearly; rotations blend as quaternions. In
the other spaces of `mixseq.spaces` rigid-motion invariant coordinates blend linearly, poses as quaternions and centres.

Whole turns of angles and rotations are unwrapped along the poses of nonzero weight, as in a sequence.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass, replace
from typing import Unpack

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq import segmentation
from mixseq.choices import PlacementName, SegmentationName, SpaceName
from mixseq.errors import SettingsError
from mixseq.mesh.topology import Topology
from mixseq.runtime.lazy import PickledWithoutCaches
from mixseq.runtime.parallel import Executor, one_blas_thread, thread_executor
from mixseq.runtime.progress import Progress, StagedProgress, no_progress
from mixseq.runtime.public import public
from mixseq.segmentation.methods import MethodSettings
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, FrameStore, MeshSequence, check_frames, load_frames
from mixseq.shells.gauss_newton import ShellReport
from mixseq.signals.detail import encode_sequence
from mixseq.spaces.base import ShapeSpace
from mixseq.spaces.making import (
    SPACE_STAGES,
    MixedSettings,
    SpaceOptions,
    make_space,
    segment_faces,
    space_settings,
)
from mixseq.types import Float


@public
def segment(
    sequence: MeshSequence,
    method: SegmentationName = "motion",
    parts: int | None = None,
    settings: MethodSettings | None = None,
) -> NDArray[np.int64]:
    """Find the near-rigid parts of a sequence, as labels that `mixseq.fit` takes as its `parts`.

    Parameters
    ----------
    sequence : MeshSequence
        The animation, or poses of one mesh.
    method : {"motion", "silhouettes", "spanning-tree"}
        By rigid motion (the default), by augmented silhouettes (Marras et al. 2012), or by cutting a spanning tree
        (Wuhrer and Brunton 2010).
    parts : int, optional
        Number of parts, by default automatic. Every connected component has at least one. Where little moves, the
        motion method may find fewer.
    settings : MotionSettings, SilhouetteSettings or SpanningTreeSettings, optional
        Details of the method.

    Returns
    -------
    (F,) int64
        Part of every triangle, numbered from 0 by decreasing area. Parts are connected across edges.

    Raises
    ------
    InvalidSequenceError
        If the argument is no sequence.
    SettingsError
        If there is no such method, the settings are another method's, or `parts` is out of range.
    """
    check_frames(sequence)
    topology = Topology(sequence.faces, sequence.vertex_count)
    return segmentation.segment(sequence.points, topology, method, parts, settings)


WEIGHT_SUM_TOLERANCE = 1e-6
"""Largest deviation of the sum of weights from one, for weights in single precision."""


@dataclass(frozen=True, eq=False)
class PoseInterpolator(PickledWithoutCaches):
    """Poses of a mesh as vectors of a shape space, for blends with any weights; make it with `from_poses`."""

    header: SequenceHeader
    space: ShapeSpace  # made from the poses
    vectors: Float  # (n, D) the poses

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
        progress: Progress = no_progress,
        workers: Executor | None = None,
        **settings: Unpack[SpaceOptions],
    ) -> PoseInterpolator:
        """Make a space of all poses, and encode those of `pose_ids`, by default all; see `interpolate`."""
        making = space_settings(space, placement=placement, parts=parts, joint_width=joint_width, **settings)
        check_frames(poses)
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
        """Blend poses with weights ``(n,)`` of sum one to points ``(V, 3)``."""
        return self.blend_with_reports(weights)[0]

    def blend_with_reports(self, weights: ArrayLike) -> tuple[Float, list[ShellReport]]:
        """Blend poses, and return the reports of the fits to lengths and angles, in spaces that fit."""
        with one_blas_thread():
            vector = (normalise_weights(weights, len(self.vectors)) @ self.vectors)[None]
        points, (reports,) = self.space.decode_with_reports(vector)
        return points[0], reports

    def iterate_blends(
        self, weights: ArrayLike, progress: Progress = no_progress, workers: Executor | None = None
    ) -> Iterator[Float]:
        """Yield the points ``(V, 3)`` of blends with weights ``(m, n)``, each row of sum one."""
        try:
            table = np.asarray(weights, dtype=np.float64)
        except (TypeError, ValueError) as error:
            raise SettingsError("weights are not a table of numbers, with a row for every blend") from error
        rows = [normalise_weights(row, len(self.vectors)) for row in np.atleast_1d(table)]
        self.space.precompute()
        executor = workers or thread_executor()
        for done, points in enumerate(executor(PoseInterpolator.blend, self, rows), start=1):
            yield points
            progress(done, len(rows), "blending poses")


@public
def interpolate(
    poses: Frames,
    weights: ArrayLike,
    space: SpaceName = "mixed",
    *,
    placement: PlacementName = MixedSettings.placement,
    parts: int | ArrayLike | None = None,
    joint_width: int = MixedSettings.joint_width,
    progress: Progress = no_progress,
    workers: Executor | None = None,
    **settings: Unpack[SpaceOptions],
) -> Float:
    """Blend any number of poses of a mesh in a shape space.

    For several blends of the same poses make a `PoseInterpolator` once.

    Parameters
    ----------
    poses : MeshSequence or SequenceReader
        The poses, as frames of a sequence; times are ignored. Parts are found from all poses. Those of nonzero weight
        are registered to each other, and angles are unwrapped from each of them to the next.
    weights : (n,) array_like
        Weights, which add up to one. Weights below zero or above one exaggerate.
    space : {"mixed", "vertex", "gradient", "lri", "edge"}
        The shape space, as of `mixseq.fit`.
    placement : {"anchored", "free"}
        Mixed space: how parts are placed. Free is the paper's, found from lengths and angles.
    parts : int or (F,) int, optional
        Mixed space: number of parts, or the part of every triangle; found from the poses by default.
    joint_width : int
        Mixed space: largest width of joints, in strips of triangles on each side of a boundary.
    progress : callable, optional
        Called at every stage.
    workers : Executor, optional
        Executor for work on the poses; by default one thread per core.

    Other Parameters
    ----------------
    segmentation, projection, volume, shell : optional
        As of `mixseq.fit`.

    Returns
    -------
    (V, 3) float64
        Vertex positions in the units of the poses.

    Raises
    ------
    SettingsError
        If the weights are not one finite number for every pose or do not add up to one, or a setting is out of range or
        unused by the space.
    SegmentationError
        If given parts do not fit the mesh.
    ReconstructionError
        If no mesh is found.

    Examples
    --------
    >>> import mixseq
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=4)
    >>> mixseq.interpolate(walk, [0.5, 0.5, 0, 0]).shape == walk.points[0].shape
    True
    """
    check_frames(poses)
    weights = normalise_weights(weights, poses.header.frame_count)  # errors first
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
    """Return the weights ``(n,)`` of `count` poses divided by their sum."""
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
