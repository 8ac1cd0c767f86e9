"""USD, timing: when the frames of a stage are.

Frames are all times at which something that moves a mesh has a sample: its points, the transforms above it, its
skeleton, its blend shapes. Where one of them has none, USD interpolates. Between two samples of a rotation points
move on arcs, so where there is more than points that moves, the frames at which the stage is played are added in the
gaps between samples, as `UsdSkel.BakeSkinning` does.

Specification: https://openusd.org/release/api/class_usd_stage.html (time codes and frames per second)
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Usd

from mixseq.errors import FormatError
from mixseq_io.usd.motion import Mover, is_spline

_SAME_TIME = 1e-6
"""Samples of different attributes that are closer than this, in seconds, make one frame."""

_MOST_PLAYED = 100_000
"""More frames than this are not added between samples; an hour has 86 400 at 24 frames per second."""


def frame_codes(path: Path, stage: Usd.Stage, movers: Sequence[Mover]) -> NDArray[np.float64]:
    """Return the time codes (T,) of the frames in which all meshes are to be read.

    Parameters
    ----------
    path : Path
        The file.
    stage : Usd.Stage
        The stage.
    movers : sequence of Mover
        The meshes.

    Raises
    ------
    FormatError
        If something moves by a spline.
    """
    sources = list(dict.fromkeys(each for mover in movers for each in mover.sources))
    for each in sources:
        if is_spline(each):
            raise FormatError(f"{path}: {each.GetPath()} is a spline; bake it into time samples")
    codes = np.empty(0)
    for samples in dict.fromkeys(tuple(each.GetTimeSamples()) for each in sources):
        codes = _united(codes, np.array(samples), _SAME_TIME * stage.GetTimeCodesPerSecond())
    if not codes.size:  # the time of the only sample of the points, if there is one
        return np.array(movers[0].mesh.GetPointsAttr().GetTimeSamples()[:1] or [0.0], dtype=np.float64)
    if all(mover.only_points_move for mover in movers):
        return codes
    played, step = _played(stage, codes[0], codes[-1])
    return _united(codes, played, step / 2)


def _played(stage: Usd.Stage, first: float, last: float) -> tuple[NDArray[np.float64], float]:
    """Return the time codes at which the stage is played, from `first` to `last`, and the step between them."""
    start, rate = stage.GetStartTimeCode(), stage.GetFramesPerSecond()
    step = stage.GetTimeCodesPerSecond() / rate if rate else 0.0
    if not (stage.HasAuthoredTimeCodeRange() and np.isfinite(step) and step > 0 and np.isfinite(start)):
        return np.empty(0), 0.0
    begin = np.ceil((max(first, start) - start) / step)
    end = np.floor((min(last, stage.GetEndTimeCode()) - start) / step)
    if not end - begin < _MOST_PLAYED:
        return np.empty(0), 0.0
    return start + np.arange(begin, end + 1) * step, step


def _united(codes: NDArray[np.float64], more: NDArray[np.float64], tolerance: float) -> NDArray[np.float64]:
    """Return both, sorted, without those of `more` that are as good as one of `codes`.

    Examples
    --------
    >>> _united(np.array([1.0, 2.0]), np.array([1.5, 2.0 + 1e-9]), 1e-6).tolist()
    [1.0, 1.5, 2.0]
    """
    if not codes.size:
        return more
    after = np.minimum(np.searchsorted(codes, more), len(codes) - 1)
    near = (
        np.minimum(np.abs(codes[after] - more), np.abs(codes[np.maximum(after - 1, 0)] - more)) <= tolerance
    )
    return np.union1d(codes, more[~near])
