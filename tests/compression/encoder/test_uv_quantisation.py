"""Texture coordinates are rounded within what is asked for, and stay where textures end."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.compression.encoder.uvs import UV_ERROR, with_quantised_uvs
from mixseq.errors import SettingsError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.types import FloatArray


def textured(values: FloatArray) -> SequenceHeader:
    polygons = Polygons.from_triangles(np.tile(np.arange(3), (len(values), 1)))
    uvs = CornerValues(values, np.repeat(np.arange(len(values)), 3))
    return SequenceHeader(polygons=polygons, vertex_count=3, times=np.zeros(1), surface=Surface(uvs=uvs))


def values_of(header: SequenceHeader) -> FloatArray:
    assert header.surface.uvs is not None
    return header.surface.uvs.values


@pytest.mark.parametrize("error", [0.25, 0.01, 1e-4, UV_ERROR, 4e-6])
@pytest.mark.parametrize("scale", [1.0, 10.0])
def test_no_coordinate_is_off_by_more(error: float, scale: float) -> None:
    values = np.random.default_rng(0).uniform(-scale, scale, (2000, 2)).astype(np.float32)
    values[:3] = np.array([[0, 0], [0.5, 1], [-1, 0.5]])
    found, steps = with_quantised_uvs(textured(values), error)
    apart = np.abs(values_of(found).astype(np.float64) - values)
    assert steps is not None
    assert steps <= 0.5 / (error - 10 * 2**-24) + 2
    assert 0.5 * error < apart.max() <= error
    assert not apart[:3].any()


def test_by_default_texels_of_powers_of_two_stay() -> None:
    values = np.arange(4096, dtype=np.float32).reshape(-1, 2) / 4096
    found, steps = with_quantised_uvs(textured(values))
    assert steps == 1 << 15
    np.testing.assert_array_equal(values_of(found), values)


def test_as_they_were_or_not_at_all() -> None:
    header = textured(np.array([[0.1, 0.7]], dtype=np.float32))
    assert with_quantised_uvs(header, 0) == (header, None)
    bare, steps = with_quantised_uvs(header, uvs=False)
    assert (bare.surface.uvs, steps) == (None, None)
    assert with_quantised_uvs(bare) == (bare, None)


@pytest.mark.parametrize("value", [np.nan, np.inf, 1e9, 5000.0])
def test_what_no_grid_holds_stays_as_it_was(value: float) -> None:
    header = textured(np.array([[0.1, value]], dtype=np.float32))
    assert with_quantised_uvs(header) == (header, None)


@pytest.mark.parametrize("error", [-1e-9, 0.3, np.nan, np.inf])
def test_errors_out_of_range_are_refused(error: float) -> None:
    with pytest.raises(SettingsError, match=r"uv_error is .*; a number from 0 to 0.25"):
        with_quantised_uvs(textured(np.zeros((1, 2))), error)
