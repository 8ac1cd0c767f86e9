"""Conversion of sequences to another up axis and another unit of length.

The up axis is turned by a quarter turn about the axis that is neither the old nor the new one: from Y to Z the point
(x, y, z) becomes (x, -z, y), the usual convention. Coordinates are permuted and change signs without rounding; only a
change of unit rounds.
"""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass, replace

import numpy as np

from mixseq.arrays import Float, FloatArray
from mixseq.errors import SettingsError
from mixseq.public import public
from mixseq.sequence import MeshSequence
from mixseq.sequence_header import UP_AXES, SequenceHeader

UNITS = {"mm": 0.001, "cm": 0.01, "m": 1.0, "km": 1000.0, "in": 0.0254, "ft": 0.3048, "yd": 0.9144}
"""Units of length by name, in metres."""

_UNITS_NOT_TOLD = ("Alembic",)
"""Formats without units in their files, whose writers cannot detect another unit."""


@dataclass(frozen=True, eq=False)
class UnitConversion:
    """A turn to another up axis and a scale to another unit."""

    up_axis: str
    metres_per_unit: float
    turn: Float
    scale: float

    @classmethod
    def of(
        cls, header: SequenceHeader, up_axis: str | None = None, units: str | float | None = None
    ) -> UnitConversion:
        """Make the conversion of a sequence; parameters and errors as of `convert_units`."""
        up = header.up_axis if up_axis is None else up_axis
        if up not in UP_AXES:
            raise SettingsError(f"up_axis is {up!r}; one of {', '.join(UP_AXES)} is expected")
        metres = header.metres_per_unit if units is None else metres_of(units)
        return cls(up, metres, _turn(header.up_axis, up), header.metres_per_unit / metres)

    @property
    def changes(self) -> bool:
        """Whether the turn or the scale is not the identity."""
        return self.scale != 1.0 or not np.array_equal(self.turn, np.eye(3))

    def header(self, header: SequenceHeader) -> SequenceHeader:
        """Return a header with the new up axis and unit."""
        surface, origin = header.surface, header.surface.origin
        if self.changes and origin is not None and origin.format in _UNITS_NOT_TOLD:
            surface = replace(surface, origin=None)
        return replace(header, up_axis=self.up_axis, metres_per_unit=self.metres_per_unit, surface=surface)

    def values(self, values: FloatArray) -> FloatArray:
        """Turn and scale points, or velocities, ``(..., 3)``, in their precision."""
        if not self.changes:
            return values
        axes = np.abs(self.turn).argmax(axis=1)
        signs = self.turn.sum(axis=1).astype(values.dtype)
        turned: FloatArray = values[..., axes] * signs + values.dtype.type(0)  # no negative zeros in text
        if self.scale == 1.0:
            return turned
        with np.errstate(over="ignore", under="ignore"):  # what is too large is told with its vertex
            scaled: FloatArray = (turned.astype(np.float64) * self.scale).astype(values.dtype)
        return scaled

    def blocks(self, blocks: Iterable[FloatArray]) -> Iterator[FloatArray]:
        """Turn and scale streamed blocks ``(B, V, 3)``."""
        return map(self.values, blocks)


@public
def convert_units(
    sequence: MeshSequence, up_axis: str | None = None, units: str | float | None = None
) -> MeshSequence:
    """Return a sequence turned so that an axis points up, and scaled to a unit of length.

    Points and velocities change, so that size and orientation in the world stay. To set metadata that a file lacks,
    give `up_axis` and `metres_per_unit` to `mixseq.read` instead.

    Parameters
    ----------
    sequence : MeshSequence
        The sequence.
    up_axis : {"X", "Y", "Z"}, optional
        New up axis, by default that of the sequence.
    units : str or float, optional
        New unit of length: a name of `UNITS`, such as "cm", or metres; by default that of the sequence.

    Returns
    -------
    MeshSequence
        The same frames in other coordinates, of the same precision. The origin in an Alembic file is dropped, as that
        has no units.

    Raises
    ------
    SettingsError
        If there is no such axis or unit.

    Examples
    --------
    >>> one = MeshSequence.from_arrays([[[0.0, 0, 0], [1, 2, 3], [1, 0, 0]]], [[0, 1, 2]], metres_per_unit=0.01)
    >>> convert_units(one, up_axis="Z", units="mm").points[0, 1].tolist()
    [10.0, -30.0, 20.0]
    """
    conversion = UnitConversion.of(sequence.header, up_axis, units)
    velocities = sequence.velocities
    return MeshSequence.from_header(
        conversion.header(sequence.header),
        conversion.values(sequence.points),
        None if velocities is None else conversion.values(velocities),
    )


def metres_of(units: str | float) -> float:
    """Return the length of a unit in metres, by name or as a positive number or text; else SettingsError."""
    if units in UNITS:
        return UNITS[str(units)]
    try:
        metres = float(units)
    except (TypeError, ValueError):
        metres = np.nan
    if not (np.isfinite(metres) and metres > 0):
        raise SettingsError(
            f"the unit is {units!r}; one of {', '.join(UNITS)} is expected, or its length in metres"
        )
    return metres


def _turn(old: str, new: str) -> Float:
    """Return the quarter turn ``(3, 3)`` from one up axis to another, or the identity."""
    turn = np.eye(3)
    if old != new:
        first, second = UP_AXES.index(old), UP_AXES.index(new)
        turn[:, [first, second]] = turn[:, [second, first]] * [1.0, -1.0]
    return turn
