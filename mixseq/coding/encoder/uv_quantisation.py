"""Round texture coordinates to a grid on the unit square, within an error.

The grid has an even number of steps, so that 0, 1/2 and 1, where textures end and tiles meet, are kept.
"""

from __future__ import annotations

from dataclasses import replace
from math import ceil

import numpy as np

from mixseq.coding.bitstream.texture_coordinates import grid_values
from mixseq.errors import SettingsError
from mixseq.sequence_header import SequenceHeader, header_fields
from mixseq.surface import CornerValues

UV_ERROR = 2.0**-16
"""Default largest error of u and v: 1/16 of a texel of a texture of 4096 x 4096."""

MOST_UV_ERROR = 0.25
"""Largest allowed error: coarser grids have no steps between 0, 1/2 and 1."""

_MOST_STEPS = 1 << 23
"""Largest coordinate in steps for which float32 separates adjacent steps."""


def with_quantised_uvs(
    header: SequenceHeader, uv_error: float = UV_ERROR, uvs: bool = True
) -> tuple[SequenceHeader, int | None]:
    """Return a header with rounded texture coordinates, and the number of grid steps per unit."""
    if not 0 <= uv_error <= MOST_UV_ERROR:
        raise SettingsError(f"uv_error is {uv_error}; a number from 0 to {MOST_UV_ERROR} is expected")
    exact = header.surface.uvs
    if exact is None or (uvs and uv_error == 0):
        return header, None
    if not uvs:
        return _with_uvs(header, None), None
    for steps in _numbers_of_steps(exact, uv_error):
        values = exact.values.astype(np.float64)
        rounded = grid_values(np.rint(values * steps).astype(np.int64), steps)
        if (np.abs(rounded - values) <= uv_error).all():
            return _with_uvs(header, CornerValues(rounded, exact.indices)), steps
    return header, None


def _numbers_of_steps(uvs: CornerValues, error: float) -> list[int]:
    """Return candidate numbers of steps: the smallest possible, and one for which rounding to float32 does no harm."""
    largest = float(np.abs(uvs.values).max(initial=0.0))
    if not np.isfinite(largest):
        return []
    errors = [each for each in (error, error - largest * 2.0**-24) if each > 0]
    numbers = [2 * ceil(0.25 / each) for each in errors]
    return [steps for steps in numbers if max(largest, 1.0) * steps < _MOST_STEPS]


def _with_uvs(header: SequenceHeader, uvs: CornerValues | None) -> SequenceHeader:
    return SequenceHeader(**{**header_fields(header), "surface": replace(header.surface, uvs=uvs)})
