r"""Where the frames of a sequence or model come from, and how far they are from there.

Frames :math:`B` were compressed from, or fitted to, frames :math:`A`, which may come from others in turn. Every step
has a bound :math:`\epsilon_i`, a fraction of the diagonal :math:`d_i` of its source. By the triangle inequality, frames
are within :math:`\sum_i \epsilon_i d_i` of the first frames, if no step is an edit and every step was measured.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from math import ceil, isfinite, isnan, nan
from typing import Any, Self
from zlib import crc32

import numpy as np

from mixseq.choices import ORDERS, OrderName
from mixseq.errors import SettingsError
from mixseq.types import FloatArray

MAX_STEPS = 64  # largest number of steps from the first frames in files


def frames_checksum(blocks: Iterable[FloatArray], checksum: int = 0) -> int:
    """Continue a CRC-32 of frames in blocks ``(B, V, 3)`` that is independent of precision and order of vertices."""
    for block in blocks:
        bits = (np.asarray(block, dtype=np.float64) + 0.0).view(np.uint64)  # + 0.0: no negative zeros
        checksum = crc32(bits.sum(axis=1).astype("<u8").tobytes(), checksum)
    return checksum


@dataclass(frozen=True)
class Provenance:
    """The name of a sequence or model, and its source with the bound of the error."""

    name: str  # name of the file, or of the mesh if there is no file
    source: Provenance | None = None  # what it was compressed from or fitted to; None for first frames
    max_error: float | None = None  # largest distance of a vertex from the source, in diagonals; None if not measured
    diagonal: float = 1.0  # unit of errors of the source, in its units
    promised: bool = False  # whether the bound was requested instead of measured
    edited: bool = False  # whether frames were edited or resampled since
    order: OrderName = "keep"  # numbering kept from the source
    checksum: int | None = None  # `frames_checksum` of its own frames; None if unknown
    events: str = ""  # events found in the motion of the source, such as cuts, in words

    def __post_init__(self) -> None:
        lengths = self.diagonal, self.max_error or 0.0
        has_numbers = all(isinstance(value, int | float) and isfinite(value) and value >= 0 for value in lengths)
        is_text = isinstance(self.name, str) and isinstance(self.events, str)
        if not (is_text and has_numbers and self.order in ORDERS):
            raise SettingsError("the provenance has a value of the wrong type or out of range")

    @property
    def bounds(self) -> list[tuple[Provenance, float | None]]:
        """All steps with a source, the last step first, each with the largest distance of frames from that source.

        The distance is in diagonals of the source. It is None before an edit or an error that was not measured.
        """
        step, length, bounds = self, 0.0, []
        while step.source is not None:
            error = nan if step.edited or step.max_error is None else step.max_error
            bound = error + length / (step.diagonal or 1.0)
            bounds.append((step, None if isnan(bound) else bound))
            step, length = step.source, bound * step.diagonal
        return bounds

    @property
    def kept_order(self) -> OrderName:
        """The numbering kept by all steps."""
        return max(self.order, self.source.kept_order if self.source else self.order, key=ORDERS.index)

    def __str__(self) -> str:
        """Describe the sources: "1e-4 from r10.h5, which is 6e-4 from walk.usdc"."""
        if self.source is None:
            return f"an edit of {self.name}" if self.edited else ""
        if self.edited and self.max_error is None:
            return f"an edit of {str(self.source) or self.source.name}"
        error = "fitted to" if self.max_error is None else f"{format_error(self.max_error)} from"
        own = f"{'an edit of what is ' * self.edited}{error} {self.source.name or 'an unknown original'}"
        return ", which is ".join(filter(None, [own, str(self.source)]))

    def to_plain(self) -> dict[str, Any]:
        """Return the values that differ from their defaults, for JSON."""
        defaults = Provenance("")
        plain = {name: value for name, value in vars(self).items() if value != getattr(defaults, name)}
        return plain if self.source is None else {**plain, "source": self.source.to_plain()}

    @classmethod
    def from_plain(cls, plain: Any, depth: int = MAX_STEPS) -> Self:
        """Restore the result of `to_plain`; raise SettingsError if it is of another form."""
        names = cls.__dataclass_fields__
        if not (isinstance(plain, Mapping) and depth and set(plain) <= set(names)):
            raise SettingsError("the provenance is of another form")
        source = plain.get("source")
        nested = None if source is None else cls.from_plain(source, depth - 1)
        return cls(**{"name": "", **plain, "source": nested})


def format_error(error: float) -> str:
    """Format an error in diagonals, rounded up to two digits: 1e-4 as "1e-4", 0.00062 as "6.2e-4"."""
    digits, exponent = map(float, f"{error:.12e}".split("e"))
    rounded, carried = f"{ceil(10 * digits) / 10:.1e}".split("e")
    return f"{rounded.removesuffix('.0')}e{int(exponent) + int(carried)}" if error else "0"


def as_edited(provenance: Provenance | None) -> Provenance | None:
    """Return a provenance after an edit."""
    return provenance and replace(provenance, edited=True)


def with_other_motion(provenance: Provenance | None) -> Provenance | None:
    """Return a provenance for the mesh of a file with the motion of another: only renumbering is kept."""
    if provenance is None or provenance.kept_order == "keep":
        return None
    return Provenance("", replace(provenance, source=None, max_error=None, order=provenance.kept_order), edited=True)
