r"""Check a compressed model against its original, and whether it keeps the error that it promises.

With :math:`A, B` the points of the original and of the decoded frames, and d the diagonal of the bounding box of the
original's first frame, or 1 if that is a single point, the promise is

.. math:: \max_{tv} |A_{tv} - B_{tv}| \le \epsilon\, d

and the KG error is that of `mixseq.metrics`. Frames are decoded and compared a few at a time, at any scale: see
`mixseq.diagonal`.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.arrays import FloatArray, PathLike
from mixseq.coding.renumbering import Renumbering
from mixseq.diagonal import Diagonal
from mixseq.errors import FormatError
from mixseq.metrics import comparable, paired_blocks
from mixseq.polygon_matching import matched
from mixseq.progress import Progress, silent
from mixseq.public import public
from mixseq.sequence import Frames, SequenceHeader, check_frames
from mixseq.signals.decoding import FRAMES
from mixseq.signals.model import Model
from mixseq_io.coded.reading import decoded
from mixseq_io.compressed_files import read_compressed

_ROUNDING = 1e-9
"""A largest error that was only measured, and not asked for, may differ by so much of itself."""


@dataclass(frozen=True)
class Verification:
    """What `verify` finds in a file that is not damaged; formulas are at the head of this module.

    Attributes
    ----------
    frames, vertices : int
        What was decoded.
    bound : float
        Largest distance of a vertex from the original that the file states, in diagonals.
    promised : bool
        Whether that bound was asked for when the sequence was compressed; else it was measured then.
    max_error : float or None
        Largest distance of a vertex, in diagonals; None without an original, as all that follow.
    kg_percent : float or None
        Karni-Gotsman error.
    worst_frame, worst_vertex : int or None
        Where the largest distance is, in the original's numbers.
    uv_bound : float or None
        Largest difference of a texture coordinate from the original that was asked for; None if there are none, or
        they are as they were.
    uv_error : float or None
        Largest difference of a texture coordinate, of u and of v, at any corner; None without coordinates of the
        original.
    """

    frames: int
    vertices: int
    bound: float
    promised: bool
    max_error: float | None = None
    kg_percent: float | None = None
    worst_frame: int | None = None
    worst_vertex: int | None = None
    uv_bound: float | None = None
    uv_error: float | None = None

    @property
    def holds(self) -> bool:
        """Whether no vertex, and no coordinate, is beyond its bound; without an original nothing speaks against it."""
        slack = 1.0 if self.promised else 1.0 + _ROUNDING
        if self.uv_bound is not None and self.uv_error is not None and self.uv_error > self.uv_bound:
            return False
        return self.max_error is None or self.max_error <= self.bound * slack

    def as_dict(self) -> dict[str, Any]:
        """Return plain values for JSON, with None for what is infinite."""
        plain = {**asdict(self), "holds": self.holds}
        return {name: None if value == float("inf") else value for name, value in plain.items()}


@public
def verify(path: PathLike, original: Frames | None = None, progress: Progress = silent) -> Verification:
    """Check a compressed model: its checksums, that every frame decodes, and its bound.

    Parameters
    ----------
    path : path-like
        A file that `mixseq.save` wrote of what `mixseq.compress` returned, HDF5 or GLB.
    original : MeshSequence or SequenceReader, optional
        What was compressed; every vertex of every frame is compared with it, also if it has another number there.
    progress : callable, optional
        Told about every frame.

    Raises
    ------
    FormatError
        If the file is damaged, or no compressed model, or a frame is not finite.
    InvalidSequenceError
        If the original is no sequence, another mesh, or has other frames.
    """
    source = Path(path)
    if original is not None:
        check_frames(original)
    coded = read_compressed(source)
    frames = _Checked(source, decoded(source, coded), progress)
    header, parameters = coded.header, coded.parameters
    found = Verification(
        header.frame_count,
        header.vertex_count,
        parameters.max_error,
        parameters.promised,
        uv_bound=parameters.uv_error,
    )
    if original is not None:
        original, renumbering = comparable(original, header)
        uv_error = None if parameters.uv_error is None else _uv_error(original.header, header)
        return replace(found, **_errors(original, frames, renumbering), uv_error=uv_error)
    for _ in frames.blocks():
        pass
    return found


@dataclass(frozen=True)
class _Checked:
    """The frames of a model, all of which have to be finite."""

    path: Path
    model: Model
    progress: Progress

    @property
    def header(self) -> SequenceHeader:
        """Everything but the points."""
        return self.model.header

    def blocks(self, size: int = FRAMES) -> Iterator[FloatArray]:
        """Decode all frames."""
        first = 0
        for block in self.model.blocks(self.model.times, size, progress=self.progress):
            bad = ~np.isfinite(block).all(axis=(1, 2))
            if bad.any():
                name = self.header.frame_name(first + int(bad.argmax()))
                raise FormatError(f"{self.path}: {name} is not finite; it is damaged")
            yield block
            first += len(block)


def _errors(original: Frames, frames: _Checked, renumbering: Renumbering) -> dict[str, Any]:
    """Compare every vertex of every frame; tell the worst one by the number that it had."""
    squares = variation = worst = 0.0
    first, where = 0, (0, 0)
    unit = Diagonal(0.0, 0)
    for x, y in paired_blocks(original, frames, FRAMES):
        if first == 0:
            unit = Diagonal.of(x[0])
        with np.errstate(over="ignore"):  # what overflows is infinitely far
            distances = np.square(unit.shifted(x - y)).sum(axis=2)
            squares += float(distances.sum())
            variation += float(np.square(unit.shifted(x - x.mean(axis=1, keepdims=True))).sum())
        if distances.max() > worst:
            worst = float(distances.max())
            frame, vertex = np.unravel_index(distances.argmax(), distances.shape)
            where = first + int(frame), int(vertex)
        first += len(x)
    return {
        "max_error": _ratio(np.sqrt(worst), unit.fraction or 1.0),
        "kg_percent": 100 * _ratio(np.sqrt(squares), np.sqrt(variation)),
        "worst_frame": where[0],
        "worst_vertex": int(renumbering.vertices[where[1]]),
    }


def _uv_error(original: SequenceHeader, header: SequenceHeader) -> float | None:
    """Compare the texture coordinates at every corner, None if they cannot be compared."""
    uvs, ours = original.surface.uvs, header.surface.uvs
    match = matched(original.polygons, header.polygons)
    if uvs is None or ours is None or match is None:
        return None
    apart = uvs.at_corners.astype(np.float64) - ours.at_corners[match.corners]
    return float(np.abs(apart).max())


def _ratio(value: float, unit: float) -> float:
    if value == 0:
        return 0.0
    return float(value / unit) if 0 < unit < np.inf else float("inf")
