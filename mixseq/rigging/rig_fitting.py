"""Fit a skin or morph targets to a sequence, in the units of the file."""

from __future__ import annotations

import warnings
from functools import cache, lru_cache

import numpy as np
from numpy.typing import ArrayLike

from mixseq.errors import MixseqWarning, SettingsError
from mixseq.progress import Progress, silent
from mixseq.public import public
from mixseq.rigging.bone_counts import MOST_BONES, errors, fewest_bones
from mixseq.rigging.centred import Centred
from mixseq.rigging.correctives import fit_correctives, fit_targets
from mixseq.rigging.found_bones import ROUGH, FoundBones, FreeBones
from mixseq.rigging.given_skeletons import fit_to_skeleton
from mixseq.rigging.rigs import Morph, Skin
from mixseq.rigging.skeletons import Skeleton
from mixseq.sequence import Frames, MeshSequence, check_frames
from mixseq.threads import one_blas_thread


@public
def fit_skin(
    sequence: Frames,
    bones: int | ArrayLike | None = None,
    correctives: float | None = None,
    max_targets: int = 32,
    rounds: int = 60,
    progress: Progress = silent,
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
            found = FoundBones.of(centred, rounds, progress)
            if max_error is None and kg is None:
                skin = found.hung(found.free(bones))
            else:
                skin = _reaching(found, max_error, kg)
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
    progress: Progress = silent,
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


def _reaching(bones: FoundBones, max_error: float | None, kg: float | None) -> Skin:
    """Fit the fewest bones for an error."""
    which, wanted = (0, max_error) if kg is None else (1, kg)
    assert wanted is not None, "one of them is given"

    @cache
    def roughly(count: int) -> float:
        return bones.free(count, ROUGH).errors[which]

    @lru_cache(1)
    def free(count: int) -> FreeBones:
        return bones.free(count)

    def hung(count: int) -> tuple[Skin, float]:
        skin = bones.hung(free(count))
        return skin, errors(skin, bones.sequence)[which]

    skin, reached = fewest_bones(
        roughly,
        lambda count: free(count).errors[which],
        hung,
        wanted,
        min(MOST_BONES, len(bones.faces)),
    )
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
