"""From a sequence to a skin or to morph targets, in the units of the file."""

from __future__ import annotations

import warnings
from dataclasses import replace

import numpy as np
from numpy.typing import ArrayLike
from scipy.spatial.transform import Rotation

from mixseq.arrays import Float, Index
from mixseq.errors import MixseqWarning, SegmentationError, SettingsError
from mixseq.frame_store import frame_store
from mixseq.progress import Progress, silent
from mixseq.public import public
from mixseq.rigging.bones import vertex_labels
from mixseq.rigging.correctives import fit_correctives, fit_targets
from mixseq.rigging.decomposition import decompose
from mixseq.rigging.jointed_motions import Joints
from mixseq.rigging.rigs import Morph, Skin, without_sign_jumps
from mixseq.rigging.skeletons import Skeleton
from mixseq.rigging.weights import Binding
from mixseq.segmentation import segment
from mixseq.sequence import Frames, SequenceHeader, bounding_diagonal, check_frames
from mixseq.threads import one_blas_thread
from mixseq.topology import Topology


@public
def fit_skin(
    sequence: Frames,
    bones: int | ArrayLike | None = None,
    correctives: float | None = None,
    max_targets: int = 32,
    rounds: int = 60,
    progress: Progress = silent,
) -> Skin:
    """Fit bones, at most four weights a vertex, and corrective targets to a sequence.

    Bones hang in a tree and turn about the joints to their parents. Joints that would cost more than a tenth of the
    error slide as well: their translations have keys (see `mixseq.rigging.decomposition`).

    Parameters
    ----------
    sequence : MeshSequence or an open sequence
        The animation; all of it is held in memory as float64.
    bones : int, or (F,) int array_like, optional
        How many bones at most, or the bone that every triangle starts with. If not given they are the near-rigid parts
        that motion segmentation finds, which is what an animator would expect; more bones are more accurate.
    correctives : float, optional
        Largest distance of a vertex from the sequence, in diagonals, that corrective morph targets shall reach. None
        makes no targets. With targets, vertices between bones that fold onto each other follow only one of them.
    max_targets : int
        So many of them at most.
    rounds : int
        At most so many rounds of weights and motions (our value); they end before when they gain little.
    progress : callable
        Told how far the work is.

    Returns
    -------
    Skin
        With the rest shape fitted too; it stays near the first frame. Bones that neither a vertex nor a bone with
        vertices follows are left out.
        Weights of a vertex decrease; unused ones are zero, of bone zero.

    Raises
    ------
    InvalidSequenceError
        If it is no sequence.
    SettingsError
        If `bones` is no whole number between one and the number of triangles, `correctives` is not positive, or
        `max_targets` or `rounds` is negative.
    SegmentationError
        If there is not one label for every triangle.

    Warns
    -----
    MixseqWarning
        If `max_targets` do not reach `correctives`; the message says what they reach.
    """
    check_frames(sequence)
    _check_error("correctives", correctives)
    _check_count("max_targets", max_targets)
    _check_count("rounds", rounds)
    header, points = _points_of(sequence)
    diagonal = bounding_diagonal(points[0]) or 1.0
    with one_blas_thread():
        centres = points.mean(axis=1)
        centred = (points - centres[:, None]) / diagonal
        labels, most = _starting_bones(header, centred, bones)
        tracks = np.ascontiguousarray(centred.swapaxes(0, 1).reshape(header.vertex_count, -1))
        faces = header.faces.astype(np.int64)
        found = decompose(tracks, faces, labels, most, rounds, progress)
        skin = _skin_of(header, *found, diagonal, centres)
        if correctives is None:
            return skin
        progress(2 * rounds, 2 * rounds + 1, "fitting correctives")
        skin, reached = fit_correctives(skin, points, correctives * diagonal, max_targets)
    _warn_if_missed(reached / diagonal, correctives, len(skin.targets), "correctives", "bones or max_targets")
    return skin


@public
def fit_morph(
    sequence: Frames,
    max_error: float | None = None,
    max_targets: int | None = None,
    progress: Progress = silent,
) -> Morph:
    """Fit a base shape and morph targets to a sequence: its mean and its principal shapes.

    Parameters
    ----------
    sequence : MeshSequence or an open sequence
        The animation; all of it is held in memory as float64.
    max_error : float, optional
        Largest distance of a vertex, in diagonals, that targets shall reach; as few as it takes are made.
    max_targets : int, optional
        So many targets at most. Without either there are as many as it takes to be exact, at most one less than frames.
    progress : callable
        Told how far the work is.

    Raises
    ------
    InvalidSequenceError
        If it is no sequence.
    SettingsError
        If `max_error` is not positive, or `max_targets` is negative.

    Warns
    -----
    MixseqWarning
        If `max_targets` do not reach `max_error`; the message says what they reach.
    """
    check_frames(sequence)
    _check_error("max_error", max_error)
    _check_count("max_targets", max_targets)
    header, points = _points_of(sequence)
    diagonal = bounding_diagonal(points[0]) or 1.0
    progress(0, 1, "fitting targets")
    with one_blas_thread():
        base = points.mean(axis=0)
        bound = None if max_error is None else max_error * diagonal
        targets = fit_targets(points - base, bound, max_targets, lambda _, left: np.linalg.norm(left, axis=1))
    _warn_if_missed(targets.error / diagonal, max_error, len(targets.shapes), "max_error", "max_targets")
    progress(1, 1, "fitting targets")
    return Morph(header, base, targets.shapes, targets.weights)


def _points_of(sequence: Frames) -> tuple[SequenceHeader, Float]:
    held = frame_store(sequence)
    return held.header, np.asarray(held.points[: held.header.frame_count], dtype=np.float64)


def _starting_bones(
    header: SequenceHeader, points: Float, bones: int | ArrayLike | None
) -> tuple[Index, int]:
    """Return the bone ``(V,)`` that every vertex starts with, and how many there may be."""
    faces = header.faces.astype(np.int64)
    if bones is None or isinstance(bones, int | np.integer):
        if bones is not None and not 1 <= bones <= len(faces):
            raise SettingsError(
                f"{bones} bones are asked for; a number from 1 to {len(faces)}, that of the triangles, is expected"
            )
        count = None if bones is None else int(bones)
        labels = segment(points, Topology(faces, header.vertex_count), parts=count)
    else:
        labels, count = np.asarray(bones), None
        if labels.shape != (len(faces),) or not np.issubdtype(labels.dtype, np.integer):
            raise SegmentationError(
                f"labels of bones have shape {labels.shape} and type {labels.dtype}; "
                f"one whole number for each of the {len(faces)} triangles is expected"
            )
        labels = np.unique(labels, return_inverse=True)[1]
    return vertex_labels(faces, labels, header.vertex_count), count or int(labels.max()) + 1


def _skin_of(
    header: SequenceHeader, binding: Binding, motions: Float, joints: Joints, diagonal: float, centres: Float
) -> Skin:
    """Bring a decomposition of centred frames, in diagonals, to the units of the file; leave out idle bones."""
    order = np.argsort(-binding.weights, axis=1, kind="stable")
    weights = np.take_along_axis(binding.weights, order, axis=1)
    influences = np.take_along_axis(binding.influences, order, axis=1)
    used = np.isin(np.arange(len(motions)), influences[weights > 0])
    kept = (joints.below() & used).any(axis=1)
    place = np.cumsum(kept) - 1
    parents, pivots = joints.parents[kept], joints.pivots[kept]
    m = motions[kept].reshape(kept.sum(), 4, -1, 3).transpose(2, 0, 3, 1)  # (T, B, 3, 4)
    places = np.einsum("tbij,bj->tbi", m[..., :3], pivots) + m[..., 3]
    quaternions = Rotation.from_matrix(m[..., :3].reshape(-1, 3, 3)).as_quat().reshape(*m.shape[:2], 4)
    skeleton = Skeleton.flat(diagonal * pivots + centres[0])
    return Skin(
        header=header,
        rest=diagonal * binding.rest + centres[0],
        skeleton=replace(skeleton, parents=np.where(parents < 0, -1, place[parents])),
        rotations=without_sign_jumps(quaternions),
        translations=diagonal * places + centres[:, None],
        influences=np.where(weights > 0, place[influences], 0),
        weights=weights,
        targets=np.zeros((0, len(weights), 3)),
        target_weights=np.zeros((len(m), 0)),
    )


def _check_error(name: str, value: float | None) -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise SettingsError(f"{name} is {value}; a positive number of diagonals is expected, such as 1e-3")


def _check_count(name: str, value: int | None) -> None:
    if value is not None and value < 0:
        raise SettingsError(f"{name} is {value}; a number that is not negative is expected")


def _warn_if_missed(reached: float, wanted: float | None, count: int, setting: str, cure: str) -> None:
    if wanted is not None and reached > wanted:
        warnings.warn(
            f"{count} targets reach an error of {reached:.3g} diagonals, not {wanted:g} as {setting} asks; "
            f"allow more {cure}",
            MixseqWarning,
            stacklevel=4,
        )
