r"""Fit a skin or morph targets to a sequence, with the fewest bones or targets for an error, in the file's units.

*Principal shapes.* For displacements X ``(T, 3V)``, with :math:`X X^T = U \Lambda U^T`, the targets are rows of
:math:`U^T X` and the weights are columns of U (Alexa and Mueller 2000). The first M targets approximate X best in the
sum of squares; all targets together reproduce X exactly. Targets are scaled to a largest weight of one.

*Correctives.* The residual :math:`e_t(v)` of a skin is transformed to rest space (Lewis et al. 2000, pose-space
deformation). The weighted mean of bone rotations at a vertex is :math:`A_t(v) = \sum_b w_{vb} R_{tb}`, and

.. math:: \delta_t(v) = \operatorname*{argmin}_\delta |A_t(v)\, \delta - e_t(v)|^2 + \mu |\delta|^2,

with :math:`\mu = 10^{-6}`. Means of rotations that differ by nearly half a turn are nearly singular. If
:math:`\det A_t` falls below 0.04 in a frame (as for two bones at 157 degrees with equal weights), the vertex follows
only its bone of largest weight, and the targets compensate. Both values were chosen empirically. The targets are the
principal shapes of :math:`\delta`, and the error is measured after skinning.

*The number of bones* is predicted by rough fits of free bones, whose errors are calibrated by full fits. The predicted
number is fitted in full, and then a number smaller by a tenth, which mostly misses the error. Numbers whose rough error
is hopeless are not fitted in full. Free bones with a far too large error are not connected to a tree, since a tree
hardly reduces the error; nor are free bones with a far smaller error, unless no fewer suffice.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import replace
from functools import cache, partial
from typing import cast

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.rigging.bones import Centred
from mixseq.rigging.decomposition import ROUGH_FIT_ROUNDS, FreeBones, fit_free_bones, fit_to_skeleton, fit_tree_skin
from mixseq.rigging.rigs import BONES_PER_VERTEX, Morph, Skeleton, Skin, rotation_matrices
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, log_progress
from mixseq.runtime.public import FileOr, HasFrames, public
from mixseq.sequence.sequence import Frames, MeshSequence, check_frames
from mixseq.types import Float

_PULLBACK_DAMPING = 1e-6
_MIN_ROTATION_DETERMINANT = 0.04
_MIN_VARIANCE_RATIO = 1e-14  # smallest variance relative to the largest; smaller variances are rounding errors


def principal_shapes(displacements: Float) -> tuple[Float, Float]:
    """Return targets ``(M, V, 3)`` and weights ``(T, M)`` of displacements ``(T, V, 3)``, by decreasing variance."""
    frames = len(displacements)
    flat = displacements.reshape(frames, -1)
    variances, directions = np.linalg.eigh(flat @ flat.T)
    components = np.flatnonzero(variances > _MIN_VARIANCE_RATIO * max(variances[-1], 0.0))[::-1]
    weights = directions[:, components]
    if components.size == 0:
        return np.zeros((0, *displacements.shape[1:])), np.zeros((frames, 0))
    # The weight of largest magnitude is made positive, since the library may return either sign.
    largest = weights[np.abs(weights).argmax(axis=0), np.arange(components.size)]
    shapes = (weights * largest).T @ flat
    return shapes.reshape(-1, *displacements.shape[1:]), weights / largest


def fit_targets(
    displacements: Float, bound: float | None, max_targets: int | None, measure: Callable[[int, Float], Float]
) -> tuple[Float, Float, float]:
    """Fit the fewest targets ``(M, V, 3)`` and weights ``(T, M)`` to displacements ``(T, V, 3)`` within a bound.

    `measure` converts the residuals ``(V, 3)`` of a frame to distances. The largest distance is also returned.
    """
    shapes, weights = principal_shapes(displacements)
    max_targets = len(shapes) if max_targets is None else min(max_targets, len(shapes))
    residuals = displacements.copy()

    def error() -> float:
        return max(float(measure(frame, each).max()) for frame, each in enumerate(residuals))

    count = 0
    error_reached = error()
    while count < max_targets and (bound is None or error_reached > bound):
        residuals -= weights[:, count, None, None] * shapes[count]
        count += 1
        if bound is not None or count == max_targets:
            error_reached = error()
    return shapes[:count], weights[:, :count], error_reached


def fit_correctives(skin: Skin, points: Float, bound: float, max_targets: int) -> tuple[Skin, float]:
    """Add the fewest corrective targets that fit points ``(T, V, 3)`` within a bound; return the skin and its error."""
    rotations = rotation_matrices(skin.rotations)
    without_targets = replace(
        skin,
        weights=_prevent_collapse(skin, rotations),
        targets=skin.targets[:0],
        target_weights=skin.target_weights[:, :0],
    )
    displacements = np.empty_like(points)
    for frame, block in enumerate(without_targets.blocks(1)):
        mean_rotations = without_targets.blend_matrices(rotations[frame])
        normal = np.swapaxes(mean_rotations, 1, 2) @ mean_rotations + _PULLBACK_DAMPING * np.eye(3)
        right_side = np.einsum("vji,vj->vi", mean_rotations, points[frame] - block[0])
        displacements[frame] = np.linalg.solve(normal, right_side[:, :, None])[:, :, 0]

    def measure_distances(frame: int, residual: Float) -> Float:
        skinned = np.einsum("vij,vj->vi", without_targets.blend_matrices(rotations[frame]), residual)
        return np.asarray(np.linalg.norm(skinned, axis=1))

    shapes, weights, _ = fit_targets(displacements, bound, max_targets, measure_distances)
    fitted = replace(without_targets, targets=shapes, target_weights=weights)
    error = max(
        float(np.linalg.norm(block[0] - points[frame], axis=1).max()) for frame, block in enumerate(fitted.blocks(1))
    )
    return fitted, error


def _prevent_collapse(skin: Skin, rotations: Float) -> Float:
    """Return skinning weights with a single bone for every vertex whose mean rotation is nearly singular."""
    determinants = np.full(len(skin.rest), np.inf)
    for frame_rotations in rotations:
        np.minimum(determinants, np.linalg.det(skin.blend_matrices(frame_rotations)), out=determinants)
    single = np.eye(1, BONES_PER_VERTEX)
    return np.where(determinants[:, None] < _MIN_ROTATION_DETERMINANT, single, skin.weights)


MAX_BONES = 128  # largest number of bones in a search for an error; constants of this module were chosen empirically

_FIRST_BONE_COUNT = 8
_COUNT_PRECISION_DIVISOR = 10  # ratio of the number of bones to its tolerance
_INITIAL_ERROR_RATIO = 0.6  # assumed error ratio, full to rough fit, before the first full fit
_MIN_ERROR_RATIO = 0.25  # smallest error ratio, full to rough fit; 0.3 was observed
_MAX_TREE_LOSS = 1.25  # ratio by which a tree is expected to increase the error of free bones at most
_MAX_PREDICTED_FITS = 4  # number of fits of predicted numbers of bones before bisection
_MAX_TREE_GAIN = 1.2  # ratio by which a tree may reduce the error of free bones; 1.13 was observed
_TINY_NUMBER = 1e-300


def fit_fewest_bones(
    rough_error: Callable[[int], float],
    free_error: Callable[[int], float],
    fit_tree: Callable[[int], tuple[Skin, float]],
    target_error: float,
    max_count: int,
) -> tuple[Skin, float]:
    """Fit a skin with the fewest bones (to within a tenth) for a target error; return the skin and its error."""
    too_few, enough, error_ratio, fit_count = 0, max_count + 1, _INITIAL_ERROR_RATIO, 0
    best: tuple[Skin, float] | None = None  # the fit of `enough` bones, if they have been connected
    while too_few < max_count:
        is_found = enough <= max_count
        precision = max(1, enough // _COUNT_PRECISION_DIVISOR)
        if is_found and enough - too_few <= precision:
            best = best or fit_tree(enough)
            if best[1] <= target_error:
                return best
            error_ratio = best[1] / max(rough_error(enough), _TINY_NUMBER)
            too_few, enough = enough, max_count + 1
            best = best if too_few == max_count else None
            continue
        largest = enough - precision if is_found else max_count
        rough_target = target_error / max(error_ratio, _TINY_NUMBER)
        predicted = _predict_count(rough_error, too_few, largest, rough_target)
        count = min(largest, max(predicted, too_few + (1 if is_found else _count_margin(too_few))))
        if fit_count >= _MAX_PREDICTED_FITS:
            count = (too_few + enough) // 2 if is_found else min(2 * too_few, max_count)
        if _MIN_ERROR_RATIO * rough_error(count) > _MAX_TREE_GAIN * target_error:
            too_few = count
            continue
        fit_count += 1
        error, fit = free_error(count), None
        # Far more bones than necessary are not connected, unless no fewer suffice.
        if target_error < _MAX_TREE_LOSS * error and error <= _MAX_TREE_GAIN * target_error:
            fit = fit_tree(count)
            error = fit[1]
        error_ratio = error / max(rough_error(count), _TINY_NUMBER)
        if error <= target_error:
            best, enough = fit, count
        else:
            too_few, best = count, best if is_found else fit
    return best or fit_tree(max_count)


def _count_margin(count: int) -> int:
    """Return the tolerance of predicted numbers of bones."""
    return 1 + count // _COUNT_PRECISION_DIVISOR


def _predict_count(rough_error: Callable[[int], float], too_few: int, limit: int, target: float) -> int:
    """Return the fewest bones (to within a tenth) whose rough fit reaches an error, or `limit` if none does."""
    count = min(max(_FIRST_BONE_COUNT, too_few + 1), limit)
    while rough_error(count) > target:
        if count == limit:
            return limit
        too_few, count = count, min(2 * count, limit)
    while count - too_few > _count_margin(count):
        middle = (too_few + count) // 2
        if rough_error(middle) <= target:
            count = middle
        else:
            too_few = middle
    return count


@public
def fit_skin(
    sequence: FileOr[Frames | HasFrames],
    bones: int | ArrayLike | None = None,
    correctives: float | None = None,
    max_targets: int = 32,
    rounds: int = 60,
    progress: Progress = log_progress,
    *,
    skeleton: FileOr[Skeleton] | None = None,
    bind_pose: FileOr[MeshSequence | HasFrames] | None = None,
    max_error: float | None = None,
    kg: float | None = None,
) -> Skin:
    """Fit bones, at most four skinning weights a vertex, and corrective targets to a sequence.

    Bones form a tree and rotate about the joints with their parents. Some joints also slide, with keys for translation,
    so that the error increases by at most a tenth (see `mixseq.rigging.decomposition`).

    With a skeleton, only weights and motions are fitted. Bones keep their names, parents and rest positions, and the
    mesh keeps its bind shape. Only roots have translations, so that bones keep their lengths.

    Parameters
    ----------
    sequence : MeshSequence or an open sequence
        The animation; all frames are held in memory as float64.
    bones : int, or (F,) int array_like, optional
        Largest number of bones, or the initial bone of every triangle. By default bones are the near-rigid parts found
        by motion segmentation, as an animator would expect. More bones are more accurate.
    correctives : float, optional
        Largest distance of a vertex from the sequence, in diagonals, for corrective morph targets. By default there are
        no targets. With targets, vertices between two bones that fold onto each other follow only one of both.
    max_targets : int
        Largest number of targets.
    rounds : int
        Largest number of rounds, which fit weights and motions. Fitting ends earlier if the error hardly decreases.
    progress : callable
        Called with the progress.
    skeleton : Skeleton, optional
        Given bones, from `mixseq.read_skeleton`.
    bind_pose : MeshSequence, optional
        The mesh bound to the skeleton in one frame, with the vertices of the sequence, from `mixseq.read_bind_pose`.
        Mesh and skeleton are converted to the unit and up axis of the sequence. Without a bind pose the skeleton must
        match the first frame in pose, position and unit.
    max_error : float, optional
        Largest distance of a vertex from the sequence, in diagonals, before correctives. The fewest bones (to within a
        tenth, and at most 128) are used. The search takes the time of two or three fits.
    kg : float, optional
        Largest KG error before correctives, in percent, instead of `max_error`.

    Returns
    -------
    Skin
        Without a skeleton, the rest shape is fitted too, near the first frame, and bones that move no vertices are
        removed. With a skeleton, bones that move no vertices keep their rest pose relative to their parents. Weights of
        a vertex are in decreasing order; unused weights are zero and have bone zero.

    Raises
    ------
    InvalidSequenceError
        If `sequence` is not a sequence, or the bind pose has another number of vertices.
    SettingsError
        If `bones` is not a whole number between one and the number of triangles, an error is not positive,
        `max_targets` or `rounds` is negative, several of `bones`, `skeleton`, `max_error` and `kg` are given, the
        skeleton is outside its mesh, or the bind pose has another size than the sequence.
    SegmentationError
        If the number of labels differs from the number of triangles.

    Warns
    -----
    MixseqWarning
        If 128 bones do not reach `max_error` or `kg`, or `max_targets` targets do not reach `correctives`; the message
        has the errors reached.

    Examples
    --------
    >>> import mixseq
    >>> skin = mixseq.fit_skin("arm.usdc", bones=2)
    >>> mixseq.write_rig("arm.glb", skin)
    """
    sequence = cast("Frames", sequence)
    skeleton = cast("Skeleton | None", skeleton)
    bind_pose = cast("MeshSequence | None", bind_pose)
    check_frames(sequence)
    _check_error("correctives", correctives)
    _check_count("max_targets", max_targets)
    _check_count("rounds", rounds)
    _check_error("max_error", max_error)
    _check_error("kg", kg, "percent, such as 0.5")
    _check_bone_settings({"bones": bones, "skeleton": skeleton, "max_error": max_error, "kg": kg}, bind_pose)
    centred = Centred.from_sequence(sequence)
    with one_blas_thread():
        if skeleton is not None:
            skin = fit_to_skeleton(centred, skeleton, bind_pose, rounds, progress)
        else:

            def report(round_id: int) -> None:
                progress(round_id, 2 * rounds + 1, "fitting weights and bones")

            if max_error is None and kg is None:
                free = fit_free_bones(centred, bones, rounds, report)
                skin, _ = fit_tree_skin(centred, free, rounds, lambda done: report(rounds + done))
            else:
                skin = _fit_to_error(centred, max_error, kg, rounds, progress)
        if correctives is None:
            return skin
        progress(2 * rounds, 2 * rounds + 1, "fitting correctives")
        bound = centred.to_length(correctives)
        skin, reached = fit_correctives(skin, centred.points, bound, max_targets)
    reached /= centred.diagonal
    _warn_if_missed(reached, correctives, len(skin.targets), "correctives", "bones or max_targets")
    return skin


@public
def fit_morph(
    sequence: FileOr[Frames | HasFrames],
    max_error: float | None = None,
    max_targets: int | None = None,
    progress: Progress = log_progress,
) -> Morph:
    """Fit morph targets to a sequence: its mean and its principal shapes.

    Parameters
    ----------
    sequence : MeshSequence or an open sequence
        The animation; all frames are held in memory as float64.
    max_error : float, optional
        Largest distance of a vertex from the sequence, in diagonals; the fewest targets are used.
    max_targets : int, optional
        Largest number of targets. If neither limit is given the fit is exact, with fewer targets than frames.
    progress : callable
        Called with the progress.

    Raises
    ------
    InvalidSequenceError
        If `sequence` is not a sequence.
    SettingsError
        If `max_error` is not positive, or `max_targets` is negative.

    Warns
    -----
    MixseqWarning
        If `max_targets` targets do not reach `max_error`; the message has the error reached.

    Examples
    --------
    >>> import mixseq
    >>> morph = mixseq.fit_morph("arm.usdc", max_error=0.01)
    >>> morph.targets.shape, morph.weights.shape
    ((3, 77, 3), (4, 3))
    """
    sequence = cast("Frames", sequence)
    check_frames(sequence)
    _check_error("max_error", max_error)
    _check_count("max_targets", max_targets)
    centred = Centred.from_sequence(sequence)
    progress(0, 1, "fitting targets")
    with one_blas_thread():
        base = centred.points.mean(axis=0)
        bound = None if max_error is None else centred.to_length(max_error)
        displacements = centred.points - base
        shapes, weights, error = fit_targets(
            displacements, bound, max_targets, lambda _, each: np.linalg.norm(each, axis=1)
        )
    _warn_if_missed(error / centred.diagonal, max_error, len(shapes), "max_error", "max_targets")
    progress(1, 1, "fitting targets")
    return Morph(centred.header, base, shapes, weights)


def _fit_to_error(
    sequence: Centred, max_error: float | None, kg: float | None, rounds: int, progress: Progress
) -> Skin:
    """Fit a skin with the fewest bones for `max_error` or `kg`."""
    index, target_error = (0, max_error) if kg is None else (1, kg)
    assert target_error is not None, "one of them is given"

    def report(count: int, round_count: int, round_id: int) -> None:
        progress(round_id, round_count, f"searching for the fewest bones, fitting {count}")

    @cache
    def rough_error(count: int) -> float:
        return fit_free_bones(sequence, count, ROUGH_FIT_ROUNDS, partial(report, count, ROUGH_FIT_ROUNDS)).errors[index]

    @cache
    def free_bones(count: int) -> FreeBones:
        return fit_free_bones(sequence, count, rounds, partial(report, count, 2 * rounds + 1))

    def fit_tree(count: int) -> tuple[Skin, float]:
        free = free_bones(count)
        skin, errors = fit_tree_skin(sequence, free, rounds, lambda done: report(count, 2 * rounds + 1, rounds + done))
        return skin, errors[index]

    max_count = min(MAX_BONES, len(sequence.header.faces))
    skin, reached = fit_fewest_bones(
        rough_error, lambda count: free_bones(count).errors[index], fit_tree, target_error, max_count
    )
    if reached > target_error:
        unit = "diagonals" if kg is None else "% (KG)"
        warnings.warn(
            f"{skin.bone_count} bones reach an error of {reached:.3g} {unit}, not {target_error:g}; add correctives, "
            "or fit a morph if the mesh has no limbs",
            MixseqWarning,
            stacklevel=4,
        )
    return skin


def _check_bone_settings(settings: dict[str, object], bind_pose: MeshSequence | None) -> None:
    """Raise if several settings of the bones are given, or a bind pose without a skeleton."""
    given = [name for name, value in settings.items() if value is not None]
    if len(given) > 1:
        raise SettingsError(f"{given[0]} and {given[1]} both choose the bones; give one of them")
    if bind_pose is not None and given != ["skeleton"]:
        raise SettingsError("bind_pose is the mesh that is bound to a skeleton; give the skeleton, too")


def _check_error(name: str, value: float | None, expected: str = "diagonals, such as 1e-3") -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise SettingsError(f"{name} is {value}; a positive number of {expected}, is expected")


def _check_count(name: str, value: int | None) -> None:
    if value is not None and value < 0:
        raise SettingsError(f"{name} is {value}; a number that is not negative is expected")


def _warn_if_missed(reached: float, bound: float | None, count: int, setting: str, cure: str) -> None:
    if bound is not None and reached > bound:
        warnings.warn(
            f"{count} targets reach an error of {reached:.3g} diagonals, not the {bound:g} of {setting}; "
            f"allow more {cure}",
            MixseqWarning,
            stacklevel=4,
        )
