r"""Fit a skin or morph targets to a sequence, in the units of the file: the fewest bones and targets for an error.

*Principal shapes.* Of displacements X ``(T, 3V)``, with :math:`X X^T = U \Lambda U^T`, the targets are rows of
:math:`U^T X` and the weights columns of U (Alexa and Mueller 2000). The first M of them approximate X best in the sum
of squares, and all of them exactly. Targets are scaled to a largest weight of one: a target has its displayed size.

*Correctives.* The residual of a skin, :math:`e_t(v)`, is pulled back to the rest pose, before skinning, by the weighted
mean of its bones' rotations, :math:`A_t(v) = \sum_b w_{vb} R_{tb}` (as in pose-space deformation, Lewis et al. 2000):

.. math:: \delta_t(v) = \operatorname*{argmin}_\delta |A_t(v)\, \delta - e_t(v)|^2 + \mu |\delta|^2,

with :math:`\mu = 10^{-6}`. Means of rotations that differ by nearly half a turn have no useful inverse: a vertex where
:math:`\det A_t` falls below 0.04 in a frame (two bones at 157 degrees, half and half) follows only the bone of its
largest weight, and the targets compensate. Both values were chosen empirically. The targets are the principal shapes
of :math:`\delta`, and the error is measured after skinning.

*The number of bones.* Rough fits of free bones, in a few rounds, give the error as a function of their number; a full
fit at one number calibrates them all. The predicted number is fitted, and then one a tenth smaller, which mostly fails.
Free bones with a clearly too large error are not built into a tree, which reduces it a little at best.
"""

from __future__ import annotations

import warnings
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.rigging.bones import Centred
from mixseq.rigging.decomposition import ROUGH, FreeBones, fit_free_bones, fit_to_skeleton, skin_of_tree
from mixseq.rigging.rigs import INFLUENCES, Morph, Skeleton, Skin, rotation_matrices
from mixseq.runtime.parallel import one_blas_thread
from mixseq.runtime.progress import Progress, no_progress
from mixseq.runtime.public import public
from mixseq.sequence.sequence import Frames, MeshSequence, check_frames
from mixseq.types import Float

_DAMPING = 1e-6
_COLLAPSED = 0.04
_RANK = 1e-14  # variances below this, relative to the largest, are rounding


@dataclass(frozen=True, eq=False)
class Targets:
    """Displacements as a sum of targets."""

    shapes: Float  # (M, V, 3) the targets
    weights: Float  # (T, M) weights of the targets
    error: float  # largest remaining distance, in the units of the displacements


def principal_shapes(displacements: Float) -> tuple[Float, Float]:
    """Return all targets ``(M, V, 3)`` and weights ``(T, M)``, the most important first."""
    frames = len(displacements)
    flat = displacements.reshape(frames, -1)
    variances, directions = np.linalg.eigh(flat @ flat.T)
    kept = np.flatnonzero(variances > _RANK * max(variances[-1], 0.0))[::-1]
    weights = directions[:, kept]
    if kept.size == 0:
        return np.zeros((0, *displacements.shape[1:])), np.zeros((frames, 0))
    # The sign is that of the largest weight, so that it does not depend on the library.
    largest = weights[np.abs(weights).argmax(axis=0), np.arange(kept.size)]
    shapes = (weights * largest).T @ flat
    return shapes.reshape(-1, *displacements.shape[1:]), weights / largest


def fit_targets(
    displacements: Float, bound: float | None, most: int | None, shown: Callable[[int, Float], Float]
) -> Targets:
    """Fit the fewest targets that bring all displacements ``(T, V, 3)`` within a bound, or as many as allowed."""
    shapes, weights = principal_shapes(displacements)
    most = len(shapes) if most is None else min(most, len(shapes))
    left = displacements.copy()

    def error() -> float:
        return max(float(shown(frame, rest).max()) for frame, rest in enumerate(left))

    count = 0
    reached = error()
    while count < most and (bound is None or reached > bound):
        left -= weights[:, count, None, None] * shapes[count]
        count += 1
        if bound is not None or count == most:
            reached = error()
    return Targets(shapes[:count], weights[:, :count], reached)


def fit_correctives(skin: Skin, points: Float, bound: float, most: int) -> tuple[Skin, float]:
    """Add corrective targets until every vertex of points ``(T, V, 3)`` is within a bound, or there are `most`."""
    turns = rotation_matrices(skin.rotations)
    bare = replace(
        skin,
        weights=_without_collapse(skin, turns),
        targets=skin.targets[:0],
        target_weights=skin.target_weights[:, :0],
    )
    displacements = np.empty_like(points)
    for frame, block in enumerate(bare.blocks(1)):
        a = _mean_rotations(bare, turns[frame])
        normal = np.swapaxes(a, 1, 2) @ a + _DAMPING * np.eye(3)
        right = np.einsum("vji,vj->vi", a, points[frame] - block[0])
        displacements[frame] = np.linalg.solve(normal, right[:, :, None])[:, :, 0]

    def shown(frame: int, left: Float) -> Float:
        moved = np.einsum("vij,vj->vi", _mean_rotations(bare, turns[frame]), left)
        return np.asarray(np.linalg.norm(moved, axis=1))

    targets = fit_targets(displacements, bound, most, shown)
    fitted = replace(bare, targets=targets.shapes, target_weights=targets.weights)
    error = max(
        float(np.linalg.norm(block[0] - points[frame], axis=1).max())
        for frame, block in enumerate(fitted.blocks(1))
    )
    return fitted, error


def _without_collapse(skin: Skin, turns: Float) -> Float:
    """Return the weights, with only one bone for vertices where the mean rotation is nearly singular."""
    volume = np.full(len(skin.rest), np.inf)
    for turn in turns:
        np.minimum(volume, np.linalg.det(_mean_rotations(skin, turn)), out=volume)
    one = np.eye(1, INFLUENCES)
    return np.where(volume[:, None] < _COLLAPSED, one, skin.weights)


def _mean_rotations(skin: Skin, turns: Float) -> Float:
    """Return weighted means ``(V, 3, 3)`` of the rotations ``(B, 3, 3)`` of a frame."""
    means = np.zeros((len(skin.rest), 3, 3))
    for column in range(INFLUENCES):
        means += skin.weights[:, column, None, None] * turns[skin.influences[:, column]]
    return means


MOST_BONES = 128
"""Largest number of bones that is tried; constants here were chosen empirically."""

_FIRST = 8
_CLOSE = 10  # the count may be too large by 1 / _CLOSE
_CONVERGED = 0.8  # assumed ratio of errors of full to rough fits, before the first full one
_GUESSED = 4  # fits at numbers predicted by rough fits; then bisection
_NEARER = 1.2  # largest error of free bones, relative to the target, that a tree may reduce enough; 1.13 was observed
_NONE = 1e-300


def fewest_bones(
    roughly: Callable[[int], float],
    free: Callable[[int], float],
    hung: Callable[[int], tuple[Skin, float]],
    wanted: float,
    most: int,
) -> tuple[Skin, float]:
    """Return a skin with the fewest bones that reaches an error, to within a tenth, and its error."""
    few, enough, left, tries = 0, most + 1, _CONVERGED, 0
    best: tuple[Skin, float] | None = None
    tried: tuple[Skin, float] | None = None
    while few < most and (best is None or enough - few > _margin(enough)):
        last = enough - _margin(enough) if best else most
        promising = _promising(roughly, few, last, wanted / max(left, _NONE))
        count = min(last, max(promising, few + (1 if best else _margin(few))))
        if tries >= _GUESSED:
            count = (few + enough) // 2 if best else min(2 * few, most)
        tries += 1
        error = free(count)
        tried = hung(count) if error <= _NEARER * wanted else None
        left = (tried[1] if tried else error) / max(roughly(count), _NONE)
        if tried and tried[1] <= wanted:
            best, enough = tried, count
        else:
            few = count
    return best or tried or hung(most)


def _margin(count: int) -> int:
    return 1 + count // _CLOSE


def _promising(roughly: Callable[[int], float], few: int, most: int, wanted: float) -> int:
    """Return the number of bones above `few` with a sufficient rough fit, to within a tenth; `most` if none has."""
    count = min(max(_FIRST, few + 1), most)
    while roughly(count) > wanted:
        if count == most:
            return most
        few, count = count, min(2 * count, most)
    while count - few > _margin(count):
        middle = (few + count) // 2
        if roughly(middle) <= wanted:
            count = middle
        else:
            few = middle
    return count


def errors(skin: Skin, sequence: Centred) -> tuple[float, float]:
    r"""Return the largest distance from a sequence in diagonals, and the KG error in percent.

    .. math:: KG = 100 \frac{\lVert y - x \rVert_F}{\lVert x - \bar x \rVert_F}
    """
    largest = squares = spread = 0.0
    for frame, shown in enumerate(skin.blocks(1)):
        off = np.square(shown[0] - sequence.points[frame]).sum(axis=1)
        largest, squares = max(largest, float(off.max())), squares + float(off.sum())
        spread += float(np.square(sequence.points[frame] - sequence.centres[frame]).sum())
    return float(np.sqrt(largest)) / sequence.diagonal, 100 * float(np.sqrt(squares / (spread or 1.0)))


@public
def fit_skin(
    sequence: Frames,
    bones: int | ArrayLike | None = None,
    correctives: float | None = None,
    max_targets: int = 32,
    rounds: int = 60,
    progress: Progress = no_progress,
    *,
    skeleton: Skeleton | None = None,
    bind_pose: MeshSequence | None = None,
    max_error: float | None = None,
    kg: float | None = None,
) -> Skin:
    """Fit bones, at most four weights a vertex, and corrective targets to a sequence.

    Bones form a tree and turn about the joints to their parents. Joints that would cost more than a tenth of the error
    slide as well: their translations have keys (see `mixseq.rigging.decomposition`).

    Bones of a given skeleton keep their names, parents and rest positions, and the mesh keeps the shape in which it is
    bound to them; weights and motions are fitted. Only roots slide, so that bones keep their lengths.

    Parameters
    ----------
    sequence : MeshSequence or an open sequence
        The animation; all of it is held in memory as float64.
    bones : int, or (F,) int array_like, optional
        Largest number of bones, or the initial bone of every triangle. By default the near-rigid parts found by motion
        segmentation, which is what an animator would expect; more bones are more accurate.
    correctives : float, optional
        Largest distance of a vertex from the sequence, in diagonals, for corrective morph targets. None makes no
        targets. With targets, vertices between bones that fold onto each other follow only one of them.
    max_targets : int
        Largest number of targets.
    rounds : int
        Largest number of rounds of weights and motions; they end earlier when they gain little.
    progress : callable
        Called with the progress.
    skeleton : Skeleton, optional
        The bones, from `mixseq.read_skeleton`, instead of those that are found.
    bind_pose : MeshSequence, optional
        The mesh bound to the skeleton, from `mixseq.read_bind_pose`, in one frame, with the vertices of the sequence;
        unit and up axis are converted, and with them those of the skeleton. Without it the skeleton must match the
        first frame in pose, position and unit.
    max_error : float, optional
        Largest distance of a vertex from the sequence, in diagonals, for bones alone: the fewest bones are used, to
        within a tenth, and at most 128. It takes the time of two or three fits.
    kg : float, optional
        The same for the KG error, in percent.

    Returns
    -------
    Skin
        The rest shape of found bones is fitted too, and stays near the first frame; bones without vertices on them or
        below are removed. Bones of a given skeleton that move nothing keep their rest pose relative to their parents.
        Weights of a vertex decrease; unused ones are zero, of bone zero.

    Raises
    ------
    InvalidSequenceError
        If it is no sequence, or the bind pose has other vertices.
    SettingsError
        If `bones` is no whole number between one and the number of triangles, an error is not positive, `max_targets`
        or `rounds` is negative, more than one of `bones`, `skeleton`, `max_error` and `kg` is given, or the skeleton
        does not stand in its mesh, or that has another size than the sequence.
    SegmentationError
        If there is not one label for every triangle.

    Warns
    -----
    MixseqWarning
        If 128 bones do not reach `max_error` or `kg`, or `max_targets` do not reach `correctives`; the message has the
        errors reached.
    """
    check_frames(sequence)
    _check_error("correctives", correctives)
    _check_count("max_targets", max_targets)
    _check_count("rounds", rounds)
    _check_error("max_error", max_error)
    _check_error("kg", kg, "percent, such as 0.5")
    _check_ways({"bones": bones, "skeleton": skeleton, "max_error": max_error, "kg": kg}, bind_pose)
    centred = Centred.of(sequence)
    with one_blas_thread():
        if skeleton is not None:
            skin = fit_to_skeleton(centred, skeleton, bind_pose, rounds, progress)
        else:

            def told(done: int) -> None:
                progress(done, 2 * rounds + 1, "fitting weights and bones")

            if max_error is None and kg is None:
                free = fit_free_bones(centred, bones, rounds, told)
                skin = skin_of_tree(centred, free, rounds, lambda done: told(rounds + done))
            else:
                skin = _reaching(centred, max_error, kg, rounds, told)
        if correctives is None:
            return skin
        progress(2 * rounds, 2 * rounds + 1, "fitting correctives")
        bound = correctives * centred.diagonal
        skin, reached = fit_correctives(skin, centred.points, bound, max_targets)
    reached /= centred.diagonal
    _warn_if_missed(reached, correctives, len(skin.targets), "correctives", "bones or max_targets")
    return skin


@public
def fit_morph(
    sequence: Frames,
    max_error: float | None = None,
    max_targets: int | None = None,
    progress: Progress = no_progress,
) -> Morph:
    """Fit a base shape and morph targets to a sequence: its mean and its principal shapes.

    Parameters
    ----------
    sequence : MeshSequence or an open sequence
        The animation; all of it is held in memory as float64.
    max_error : float, optional
        Largest distance of a vertex, in diagonals; the fewest targets are made.
    max_targets : int, optional
        Largest number of targets. Without either the fit is exact, with at most one target less than frames.
    progress : callable
        Called with the progress.

    Raises
    ------
    InvalidSequenceError
        If it is no sequence.
    SettingsError
        If `max_error` is not positive, or `max_targets` is negative.

    Warns
    -----
    MixseqWarning
        If `max_targets` do not reach `max_error`; the message has the error reached.
    """
    check_frames(sequence)
    _check_error("max_error", max_error)
    _check_count("max_targets", max_targets)
    held = Centred.of(sequence)
    progress(0, 1, "fitting targets")
    with one_blas_thread():
        base = held.points.mean(axis=0)
        bound = None if max_error is None else max_error * held.diagonal
        off = held.points - base
        targets = fit_targets(off, bound, max_targets, lambda _, left: np.linalg.norm(left, axis=1))
    _warn_if_missed(targets.error / held.diagonal, max_error, len(targets.shapes), "max_error", "max_targets")
    progress(1, 1, "fitting targets")
    return Morph(held.header, base, targets.shapes, targets.weights)


def _reaching(
    sequence: Centred, max_error: float | None, kg: float | None, rounds: int, told: Callable[[int], None]
) -> Skin:
    """Fit the fewest bones for an error."""
    which, wanted = (0, max_error) if kg is None else (1, kg)
    assert wanted is not None, "one of them is given"

    @cache
    def roughly(count: int) -> float:
        return fit_free_bones(sequence, count, ROUGH, told).errors[which]

    @lru_cache(1)
    def free(count: int) -> FreeBones:
        return fit_free_bones(sequence, count, rounds, told)

    def hung(count: int) -> tuple[Skin, float]:
        skin = skin_of_tree(sequence, free(count), rounds, lambda done: told(rounds + done))
        return skin, errors(skin, sequence)[which]

    most = min(MOST_BONES, len(sequence.header.faces))
    skin, reached = fewest_bones(roughly, lambda count: free(count).errors[which], hung, wanted, most)
    if reached > wanted:
        unit = "diagonals" if kg is None else "% (KG)"
        warnings.warn(
            f"{skin.bone_count} bones reach an error of {reached:.3g} {unit}, not {wanted:g}; correctives take it "
            "further, and a morph is for what has no limbs",
            MixseqWarning,
            stacklevel=4,
        )
    return skin


def _check_ways(ways: dict[str, object], bind_pose: MeshSequence | None) -> None:
    """Raise an error for several settings of the bones, and for a bind pose without a skeleton."""
    given = [name for name, value in ways.items() if value is not None]
    if len(given) > 1:
        raise SettingsError(f"{given[0]} and {given[1]} both tell which bones there are; give one of them")
    if bind_pose is not None and given != ["skeleton"]:
        raise SettingsError("bind_pose is the mesh that is bound to a skeleton; give that, too")


def _check_error(name: str, value: float | None, expected: str = "diagonals, such as 1e-3") -> None:
    if value is not None and not (np.isfinite(value) and value > 0):
        raise SettingsError(f"{name} is {value}; a positive number of {expected}, is expected")


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
