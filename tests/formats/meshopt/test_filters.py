"""What packed vertices are before they are packed: the filters, in closed form."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.errors import FormatError, SettingsError
from mixseq_io.meshopt.filters import fixed_point, folded, unfiltered


@pytest.mark.parametrize(("bits", "most"), [(8, 0.017), (12, 1e-3), (16, 7e-5)])
def test_unit_vectors(bits: int, most: float) -> None:
    vectors = np.random.default_rng(1).normal(size=(500, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    rows = folded(np.concatenate([axes, vectors]), bits)
    kind, one = (np.int8, 127) if bits <= 8 else (np.int16, 32767)
    found = unfiltered(rows, "OCTAHEDRAL").view(kind)[:, :3].astype(np.float64) / one
    np.testing.assert_array_equal(found[:6], axes)
    assert np.abs(found[6:] - vectors).max() < most


def test_fixed_point_numbers_are_multiples_of_the_step() -> None:
    numbers = np.array([[0.0, 1.0, -1.0], [0.3, -0.3, 1000.26]])
    found = unfiltered(fixed_point(numbers, -2), "EXPONENTIAL").view(np.float32)
    assert found.tolist() == [[0, 1, -1], [0.25, -0.25, 1000.25]]
    assert unfiltered(fixed_point([[2.0**23 - 1, -(2.0**23) + 1]], 0), "EXPONENTIAL").view(
        "<f4"
    ).tolist() == [[8388607, -8388607]]


def test_numbers_of_too_many_steps() -> None:
    with pytest.raises(SettingsError, match="too large for steps"):
        fixed_point([[2.0**22]], -1)


def test_quaternions() -> None:
    """The largest component is left out: two bits of the last number tell which, the others what sqrt(1/2) is."""
    half = round(32767 * np.sqrt(0.5))
    for largest in range(4):
        others = np.array([[half, 0, 0, 32764 | largest], [half, half, half, 32764 | largest]], "<i2")
        found = unfiltered(others.view(np.uint8), "QUATERNION").view("<i2") / 32767
        expected = np.zeros((2, 4))
        expected[0, [largest, (largest + 1) % 4]] = np.sqrt([0.75, 0.25])
        expected[1] = 0.5
        np.testing.assert_allclose(found, expected, atol=1e-4)


def test_colours() -> None:
    """Luma and two chromas make red, green and blue; the highest bit of alpha tells what 1 is of all."""
    rows = np.array([[255, 0, 0, 255], [64, 64, 192, 255], [10, 2, 3, 15], [255, 0, 0, 191]], np.uint8)
    expected = [[255, 255, 255, 255], [192, 0, 64, 255], [153, 221, 85, 255], [255, 255, 255, 127]]
    assert unfiltered(rows, "COLOR").tolist() == expected


@pytest.mark.parametrize(
    ("name", "stride"), [("OCTAHEDRAL", 12), ("QUATERNION", 4), ("COLOR", 12), ("SINUSOIDAL", 4)]
)
def test_unknown_filters(name: str, stride: int) -> None:
    with pytest.raises(FormatError, match=f"filter '{name}'"):
        unfiltered(np.zeros((1, stride), np.uint8), name)
