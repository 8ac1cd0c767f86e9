"""Colourings of a mesh in a scene: a palette entry at every vertex, which may change over time.

- **clay**: uniform.
- **own**: the colours of the mesh, see `mixseq.scene.own_colours`.
- **parts**: rigid parts, in the colours of the pictures on paper, and joints in red. A vertex is a joint's if any of
  its faces is, else of the part of most of its faces.
- **error**, **strain** and **curvature**: numbers from 0 to `top` in viridis, defined in
  `mixseq.scene.vertex_measures`. Strain and curvature are relative to the pose at rest.

A pose has one byte per vertex, so a page stores the palette once and V bytes for each pose, or once if constant.
`Colouring.of_faces` has the colours of whole faces, for films, where nothing is measured.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.arrays import Float, FloatArray, Index, IntArray
from mixseq.choices import COLOURS, Colour
from mixseq.errors import SettingsError
from mixseq.scene.own_colours import own_colours
from mixseq.scene.palettes import CLAY, JOINT_RED, part_colours, segmentation_colours, viridis
from mixseq.scene.vertex_measures import MEASURES, SHARE, distances, two_digits
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence import SequenceHeader, bounding_diagonal

Bytes = NDArray[np.uint8]
Numbers = Callable[[FloatArray, float], Float]
"""From points ``(V, 3)`` and seconds since the first frame to numbers ``(V,)``."""

Original = Callable[[float], FloatArray]
"""From seconds since the first frame to the reference points ``(V, 3)`` of errors."""


JOINT = 255
"""Palette entry of joints; parts cycle through the entries below it."""

UNITS = {"error": "diagonals", "strain": "%", "curvature": "degrees"}
"""Units of the measured numbers."""

LEAST = {"error": 1e-12, "strain": 0.01, "curvature": 0.01}
"""Smallest ends of the scales, in these units, above the rounding of rigid motions in single precision."""

SHARES = {"error": 1.0, "strain": SHARE, "curvature": SHARE}
"""Fraction of vertices within the scales."""


@dataclass(frozen=True, eq=False)
class Colouring:
    """A colouring of a mesh."""

    name: str  # name of the colouring
    palette: Bytes  # (n, 3) sRGB, at most 256 colours; 256 where numbers are measured
    fixed: Bytes | None = None  # (V,) constant entries of the palette; None if measured
    # From points (V, 3) and the seconds elapsed since the first frame to numbers (V,), in the unit.
    measure: Numbers | None = None
    top: float = 1.0  # number of the last colour; 0 has the first
    unit: str = ""  # unit of the numbers
    of_faces: ArrayLike = CLAY  # (3,) RGB in 0..1 of the mesh or of each face, where nothing is measured

    def __post_init__(self) -> None:
        if (self.fixed is None) == (self.measure is None):
            raise SettingsError(
                f"the colours of {self.name} are either fixed or measured; give one of the two"
            )
        if not (np.isfinite(self.top) and self.top > 0):
            raise SettingsError(f"the last colour is at {self.top}; a positive number is expected")

    @property
    def constant(self) -> bool:
        """Whether all poses have the same colours."""
        return self.measure is None

    def indices(self, points: FloatArray, elapsed: float) -> Bytes:
        """Return palette entries ``(V,)`` of points ``(V, 3)`` at some seconds."""
        if self.measure is None:
            assert self.fixed is not None  # checked above
            return self.fixed
        shares = np.clip(self.measure(points, elapsed) / self.top, 0.0, 1.0)
        return np.rint(255 * shares).astype(np.uint8)

    def reached(self, points: FloatArray, elapsed: float) -> float:
        """Return the end of the scale for points ``(V, 3)`` at some seconds; 0 without numbers."""
        if self.measure is None:
            return 0.0
        return float(np.quantile(self.measure(points, elapsed), SHARES[self.name]))

    def scaled(self, top: float) -> Colouring:
        """Return the colouring with its scale ending at another number."""
        if self.constant:
            raise SettingsError(
                f"{self.name} has no scale; choose a colour that means numbers, such as strain"
            )
        return replace(self, top=float(top))

    def legend(self) -> str:
        """Return a caption, such as "strain 0 to 12 %"."""
        if self.constant:
            return {"parts": "parts, joints red", "own": "colours of its own"}.get(self.name, self.name)
        return f"{self.name} 0 to {two_digits(self.top)} {self.unit}"


def clay(count: int) -> Colouring:
    """Return the uniform colouring of `count` vertices."""
    return Colouring("clay", _bytes(np.tile(CLAY, (256, 1))), _fixed(np.zeros(count)))


def colourings_of(
    header: SequenceHeader,
    rest: FloatArray,
    decomposition: Decomposition | None = None,
    original: Original | None = None,
    poses: Iterable[tuple[float, FloatArray]] = (),
) -> dict[str, Colouring]:
    """Return the available colourings of a mesh by name: rest ``(V, 3)``."""
    there: dict[Colour, bool] = {
        "own": header.surface.colours is not None,
        "parts": decomposition is not None,
        "error": original is not None,
    }
    found: dict[str, Colouring] = {
        name: colouring_of(name, header, rest, decomposition, original)
        for name in COLOURS
        if there.get(name, True)
    }
    tops = {name: each.top for name, each in found.items()}
    for elapsed, points in poses:
        tops = {name: max(tops[name], each.reached(points, elapsed)) for name, each in found.items()}
    return {name: each if each.constant else each.scaled(tops[name]) for name, each in found.items()}


def colouring_of(
    name: Colour,
    header: SequenceHeader,
    rest: FloatArray,
    decomposition: Decomposition | None = None,
    original: Original | None = None,
) -> Colouring:
    """Return one of `colourings_of`; a scale ends at `LEAST` or above."""
    faces, count = header.faces, header.vertex_count
    _check("the pose at rest", rest, count)
    if name == "clay":
        return clay(count)
    if name == "own":
        palette, places = own_colours(header)
        of_faces = palette[places[faces]].mean(axis=1) / 255
        return Colouring("own", palette, _fixed(places), of_faces=of_faces)
    if name == "parts":
        assert decomposition is not None
        entries = _fixed(_part_entries(faces, count, decomposition))
        of_faces = segmentation_colours(decomposition.part_of_face, decomposition.joint_of_face)
        return Colouring("parts", _part_palette(), entries, of_faces=of_faces)
    measure = _measure(name, rest, faces, original)
    return Colouring(name, _bytes(viridis()), measure=measure, top=LEAST[name], unit=UNITS[name])


def _measure(name: Colour, rest: FloatArray, faces: IntArray, original: Original | None) -> Numbers:
    """Return the measure of a colouring, in its unit."""
    if name in MEASURES:
        measure, unit = MEASURES[name].of(rest, faces), 100 if name == "strain" else 1
        return lambda points, elapsed: unit * measure(points)
    assert original is not None
    first = original(0.0)
    _check("the original", first, len(rest))
    diagonal = bounding_diagonal(first) or 1.0
    return lambda points, elapsed: distances(points, original(elapsed), diagonal)


def _check(what: str, points: FloatArray, count: int) -> None:
    if points.shape != (count, 3):
        raise SettingsError(
            f"{what} has the shape {points.shape}, the mesh {count} vertices; colours compare poses of one mesh"
        )


def _part_palette() -> Bytes:
    return np.concatenate([_bytes(part_colours(JOINT)), _bytes(np.array([JOINT_RED]))])


def _part_entries(faces: IntArray, count: int, decomposition: Decomposition) -> Index:
    """Return the palette entries ``(V,)`` of parts; 0 for vertices without faces."""
    part_of_face = decomposition.part_of_face
    if len(part_of_face) != len(faces):
        raise SettingsError(
            f"the parts are of {len(part_of_face)} triangles, the mesh has {len(faces)}; give the parts of this mesh"
        )
    parts = int(part_of_face.max()) + 1
    pairs, votes = np.unique(faces.ravel() * np.int64(parts) + np.repeat(part_of_face, 3), return_counts=True)
    vertex, part = np.divmod(pairs, parts)
    # the most votes first, then the lowest number
    order = np.lexsort((part, -votes, vertex))
    winners = order[np.unique(vertex[order], return_index=True)[1]]
    entries = np.zeros(count, dtype=np.int64)
    entries[vertex[winners]] = part[winners] % JOINT
    entries[faces[decomposition.joint_of_face >= 0]] = JOINT
    return entries


def _fixed(entries: NDArray[np.generic]) -> Bytes:
    result = entries.astype(np.uint8)
    result.setflags(write=False)  # all poses share it
    return result


def _bytes(colours: Float) -> Bytes:
    return np.rint(255 * np.asarray(colours)).astype(np.uint8)
