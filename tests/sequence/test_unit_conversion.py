"""Sequences in other units: what they are in the world stays."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

import mixseq
from mixseq.errors import SettingsError
from mixseq.mesh.surface import Origin, Surface
from mixseq.sequence.sequence import UNITS, MeshSequence, UnitConversion, convert_units, metres_of

CORNER = [[[0.0, 0, 0], [1, 2, 3], [4, 0, 0]]]


def sequence(dtype: type = np.float64, **header: object) -> MeshSequence:
    made = MeshSequence.from_arrays(np.array(CORNER, dtype), [[0, 1, 2]], **header)  # type: ignore[arg-type]
    return replace(made, velocities=np.array(CORNER, dtype) * 10)


@pytest.mark.parametrize(
    ("old", "new", "expected"),
    [
        ("Y", "Z", [1, -3, 2]),
        ("Z", "Y", [1, 3, -2]),
        ("X", "Y", [-2, 1, 3]),
        ("Y", "X", [2, -1, 3]),
        ("X", "Z", [-3, 2, 1]),
        ("Z", "X", [3, 2, -1]),
        ("Y", "Y", [1, 2, 3]),
    ],
)
@pytest.mark.parametrize("dtype", [np.float32, np.float64])
def test_turned(old: str, new: str, expected: list[float], dtype: type) -> None:
    turned = convert_units(sequence(dtype, up_axis=old), up_axis=new)
    assert turned.up_axis == new
    assert turned.points.dtype == dtype
    assert turned.points[0, 1].tolist() == expected
    assert turned.velocities is not None
    np.testing.assert_array_equal(turned.velocities, 10 * turned.points)
    assert "XYZ"[int(np.argmax(turned.points[0, 1] == [1, 2, 3]["XYZ".index(old)]))] == new


def test_faces_keep_their_side() -> None:
    """A rotation turns no mesh inside out."""
    for old in "XYZ":
        for new in "XYZ":
            assert np.linalg.det(UnitConversion.of(sequence(up_axis=old), new).turn) == pytest.approx(1)


def test_scaled() -> None:
    small = convert_units(sequence(metres_per_unit=0.01), units="m")
    assert small.metres_per_unit == 1
    np.testing.assert_array_equal(small.points, 0.01 * np.array(CORNER))
    assert convert_units(sequence(), units="ft").points[0, 2, 0] == pytest.approx(4 / 0.3048)


@pytest.mark.parametrize("units", [*UNITS, 0.5])
def test_there_and_back(units: str | float) -> None:
    once = convert_units(sequence(np.float32), up_axis="Z", units=units)
    back = convert_units(once, up_axis="Y", units="m")
    np.testing.assert_allclose(back.points, np.array(CORNER), rtol=1e-6)
    assert (back.up_axis, back.metres_per_unit) == ("Y", 1)


def test_nothing_to_do_changes_no_bit() -> None:
    before = sequence(np.float32, up_axis="Z", metres_per_unit=0.01)
    after = mixseq.convert_units(before, up_axis="Z", units="cm")
    assert not UnitConversion.of(before.header, "Z", 0.01).changes
    assert after.points.tobytes() == before.points.tobytes()
    assert after.header.surface is before.header.surface


@pytest.mark.parametrize(("form", "kept"), [("USD", True), ("Alembic", False)])
def test_files_that_do_not_tell_their_units_are_forgotten(form: str, kept: bool) -> None:
    origin = Origin(form, "/shot")
    before = replace(sequence(), surface=Surface(origin=origin))
    assert (convert_units(before, units="cm").surface.origin == origin) is kept
    assert convert_units(before, units="m").surface.origin == origin


def test_refusals() -> None:
    with pytest.raises(SettingsError, match="up_axis is 'W'; one of X, Y, Z"):
        convert_units(sequence(), up_axis="W")
    for units in ("parsec", 0, -1, "nan", "inf"):
        with pytest.raises(SettingsError, match=f"the unit is {units!r}; one of mm, cm, m"):
            metres_of(units)
