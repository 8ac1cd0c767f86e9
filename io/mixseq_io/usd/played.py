"""USD, writing: frame rate and time range of a file."""

from __future__ import annotations

from collections.abc import Callable

import numpy as np
from pxr import Sdf

from mixseq.sequence import SequenceHeader
from mixseq_io.usd.mesh_motion import Mover
from mixseq_io.usd.original import Original
from mixseq_io.usd.prims import Notes
from mixseq_io.usd.shown import Shown
from mixseq_io.usd.skeletons import skins_of

_SAME_END = 1.0 - 1e-3
"""Fraction of a frame by which frames at whole time codes may miss the end of a motion."""


def author_times(layer: Sdf.Layer, header: SequenceHeader, shown: Shown, original: Original | None) -> None:
    """Author units, rates and the time range.

    The range is that of the frames. On a side where they cover the meshes' motion in the file, the file's range is kept
    if it is longer, since the meshes are at rest there.
    """
    layer.timeCodesPerSecond = layer.framesPerSecond = header.fps
    start, end = float(shown.codes[0]), float(shown.codes[-1])
    if original:
        below = original.stage
        scale = shown.rate / shown.rate_below
        if scale == 1.0:
            layer.framesPerSecond = below.GetFramesPerSecond()
        if below.HasAuthoredTimeCodeRange() and shown.sources is None:
            first, last = _motion(original, start / scale, end / scale)
            if start < first * scale + _SAME_END:
                start = min(start, _scaled(below.GetStartTimeCode(), scale, np.ceil))
            if end > last * scale - _SAME_END:
                end = max(end, _scaled(below.GetEndTimeCode(), scale, np.floor))
    layer.startTimeCode, layer.endTimeCode = start, end
    layer.pseudoRoot.SetInfo("upAxis", header.up_axis)
    layer.pseudoRoot.SetInfo("metersPerUnit", header.metres_per_unit)


def _motion(original: Original, *otherwise: float) -> tuple[float, float]:
    """Return the first and last time code of the meshes' motion, or the given defaults."""
    meshes = [fit.mesh for fit in original.fits]
    skins = skins_of(meshes, Notes(original.path))
    sources = [each for mesh in meshes for each in Mover(mesh, skins.get(mesh.GetPath())).sources]
    codes = [code for each in sources for code in each.GetTimeSamples()] or otherwise
    return min(codes), max(codes)


def _scaled(code: float, scale: float, inwards: Callable[[float], float]) -> float:
    """Return an end of a range at another rate, kept whole and within the range if it was whole.

    Examples
    --------
    >>> _scaled(1, 30 / 24, np.ceil), _scaled(0.5, 30 / 24, np.ceil), _scaled(1001, 29.97 / 999, np.floor)
    (2.0, 0.625, 30.0)
    """
    scaled, nearest = scale * code, np.rint(scale * code)
    if abs(scaled - nearest) <= 1e-9 * max(1.0, abs(scaled)):
        return float(nearest)
    return float(inwards(scaled)) if float(code).is_integer() else scaled
