r"""Colour meshes. A colouring has a palette, and a palette entry at every vertex that is constant or changes over time.

- **clay**: one uniform colour.
- **own**: the vertex colours of the mesh, as glTF viewers show them on a plain white material: linear colours, clipped
  to 0..1 and converted to opaque sRGB with 8 bits per channel.
- **parts**: rigid parts in cool hues; in joints paler, and red where parts meet. A vertex has the colour of the part
  that contains most of its faces; if a face is in a joint, it is paler, or red if its faces are in several parts.
- **strain**: mean of :math:`|l / \bar l - 1|` over the edges of a vertex, with edge lengths :math:`\bar l` at rest.
- **curvature** (its change): mean of :math:`|\theta - \bar\theta|` in degrees over the hinges of a vertex, with
  dihedral angles :math:`\bar\theta` at rest and the difference wrapped to :math:`(-\pi, \pi]`. A hinge belongs to the
  two vertices of its edge.
- **error**: distance from the same vertex of an original, :math:`|a_v - b_v| / d`, in diagonals.
- **values**: any numbers of the vertices, constant or for every frame.

Strain, curvature, error and values are measured: from `low`, which is 0 but for values, to `top` they are mapped to the
colour map viridis. Strain and curvature are invariant to rigid motions; uniform scaling by s gives the strain
:math:`|s - 1|` everywhere. Curvatures of different meshes are not comparable, as a bend spreads over more hinges of a
finer mesh. Edges of length zero and hinges of degenerate faces count as unchanged; vertices without edges or hinges
have the value 0.

More than 256 own colours are quantized (as in Wu 1991, without a search for the best cuts). The first box contains all
colours. The box with the largest sum of squared distances from its mean is cut at the mean, along the axis with the
largest share of the sum, until there are 256 boxes. Each box is shown in its mean colour.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, field, replace
from functools import cached_property
from heapq import heappop, heappush

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.choices import COLOURS, Colour
from mixseq.compression.numbering import match_vertices
from mixseq.errors import SettingsError
from mixseq.mesh.measures import degenerate_faces, dihedral_angles, edge_lengths, wrap_angles
from mixseq.mesh.surface import DEFAULT_COLOUR
from mixseq.mesh.topology import Topology
from mixseq.metrics import MIN_NORMAL_HEIGHT_RATIO
from mixseq.pictures.scene import CLAY_COLOUR, Scene, SceneItem, check_start_times, nearest_frames
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import FrameStore, bounding_diagonal
from mixseq.types import ByteArray, Float, FloatArray, Index, IntArray, Mask

JOINT_RED = (0.85, 0.20, 0.13)

JOINT_PALE, JOINT_PALENESS = (0.97, 0.88, 0.83), 0.45
"""Colour that is mixed into the colours of parts in joints, and its share."""

JOINT_ENTRY = 255
"""Palette entry of joints where parts meet."""

PALETTE_PARTS = 127
"""Number of part colours in a palette, which further parts use again; joints have as many after them."""

FIRST_HUE, LAST_HUE = 90.0, 330.0
"""Range of part hues in degrees of OKLCH, from straw to mauve; both ends are 60 degrees from the red of joints."""

OKLAB_TO_LMS = np.array(
    [[1, 0.3963377774, 0.2158037573], [1, -0.1055613458, -0.0638541728], [1, -0.0894841775, -1.2914855480]]
)
LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


VIRIDIS_SAMPLES = bytes.fromhex(
    "44015446085c471063481769481d6f482475472a7a46307e453781433d844142873f48893d4e8a"
    "3a538b38598c355e8d33638d31688e2e6d8e2c718e2a768e297b8e27808e25848e23898e218e8d"
    "20928c1f978b1e9c891fa18821a58524aa8328ae802eb37c35b7793dbc7446c06f50c46a5ac864"
    "65cb5e70cf577cd25089d54895d840a2da37b0dd2fbddf26cae11fd8e219e5e419f1e51dfde725"
)
"""Every fifth colour of matplotlib's colour map viridis (van der Walt and Smith 2015, CC0), three bytes each."""


def viridis() -> Float:
    """Return the colour map viridis ``(256, 3)``, interpolated with an error of at most 1.4 / 255."""
    samples = np.frombuffer(VIRIDIS_SAMPLES, dtype=np.uint8).reshape(-1, 3) / 255
    sample_ids = np.arange(0, 256, 5)
    return np.stack([np.interp(np.arange(256), sample_ids, channel) for channel in samples.T], axis=1)


def part_colours(count: int) -> Float:
    """Return muted, distinguishable, cool colours ``(count, 3)`` with golden-ratio hues and varied lightness."""
    # steps of the golden ratio keep the first n hues apart for any n
    fraction = (0.3 + 0.61803 * np.arange(count, dtype=np.float64)) % 1.0
    hue = FIRST_HUE + (LAST_HUE - FIRST_HUE) * fraction
    lightness = np.resize([0.78, 0.68, 0.85], count)
    return _oklch(lightness, 0.085, hue)


def segmentation_colours(part_of_face: IntArray, joint_of_face: IntArray, faces: IntArray) -> Float:
    """Return colours of faces ``(F, 3)``: those of parts, paler in joints, and `JOINT_RED` where parts meet there."""
    in_joint = np.asarray(joint_of_face) >= 0
    entries = np.asarray(part_of_face) % PALETTE_PARTS + PALETTE_PARTS * in_joint
    is_seam = _seam_vertices(part_of_face, faces)[faces].sum(axis=1) >= 2
    return np.asarray(_parts_palette()[np.where(in_joint & is_seam, JOINT_ENTRY, entries)])


def _parts_palette() -> Float:
    """Return the palette ``(256, 3)`` of parts, of joints in the same order, and of joints where parts meet."""
    parts = part_colours(PALETTE_PARTS)
    joints = (1 - JOINT_PALENESS) * parts + JOINT_PALENESS * np.array(JOINT_PALE)
    return np.concatenate([parts, joints, [JOINT_RED, JOINT_RED]])


def _seam_vertices(part_of_face: IntArray, faces: IntArray) -> Mask:
    """Return the mask ``(V,)`` of vertices whose faces are in several parts."""
    part_of_vertex = np.zeros(int(faces.max()) + 1, dtype=np.int64)
    part_of_vertex[faces] = part_of_face[:, None]
    is_seam = np.zeros(len(part_of_vertex), dtype=bool)
    is_seam[faces[part_of_vertex[faces] != part_of_face[:, None]]] = True
    return is_seam


def _oklch(lightness: Float, chroma: float, hue: Float) -> Float:
    """Convert OKLCH (Ottosson 2020; hue in degrees) to sRGB ``(N, 3)``."""
    a, b = chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))
    lms = (np.stack([lightness, a, b], axis=-1) @ OKLAB_TO_LMS.T) ** 3
    return srgb(np.clip(lms @ LMS_TO_RGB.T, 0, 1))


def srgb(linear: FloatArray) -> Float:
    """Convert linear values in 0..1 to sRGB (IEC 61966-2-1)."""
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


PoseMeasure = Callable[[FloatArray], Float]
"""Function from points ``(V, 3)`` to measured values ``(V,)``."""


def strain_from_rest(rest: FloatArray, faces: IntArray) -> PoseMeasure:
    """Return the mean edge strains of points, relative to a rest pose ``(V, 3)`` of triangles ``(F, 3)``."""
    edges = Topology(faces, len(rest)).edges
    rest_lengths = edge_lengths(np.asarray(rest, dtype=np.float64), edges)

    def measure(points: FloatArray) -> Float:
        lengths = edge_lengths(np.asarray(points, dtype=np.float64), edges)
        strain = np.abs(np.divide(lengths, rest_lengths, out=np.ones_like(lengths), where=rest_lengths > 0) - 1)
        return _vertex_means(strain, edges, len(points))

    return measure


def curvature_from_rest(rest: FloatArray, faces: IntArray) -> PoseMeasure:
    """Return the mean changes of dihedral angles in degrees, 0 to 180, from a rest pose ``(V, 3)``."""
    topology = Topology(faces, len(rest))
    rest_angles, was_defined = _hinge_angles(rest, topology)

    def measure(points: FloatArray) -> Float:
        angles, is_defined = _hinge_angles(points, topology)
        change = np.where(is_defined & was_defined, np.abs(wrap_angles(angles - rest_angles)), 0.0)
        return np.degrees(_vertex_means(change, topology.hinges[:, :2], len(points)))

    return measure


MEASURES = {"strain": strain_from_rest, "curvature": curvature_from_rest}
"""Measures by the name of the colouring that displays them."""


def vertex_distances(points: FloatArray, original: FloatArray, diagonal: float) -> Float:
    """Return the distances ``(V,)`` of points ``(V, 3)`` from their originals, in diagonals."""
    return np.asarray(np.linalg.norm(points - original, axis=1) / diagonal)


def format_two_digits(number: float) -> str:
    """Format a number with two significant digits: 0.0123 as "0.012", 123.4 as "120"."""
    return f"{float(f'{number:.2g}'):g}"


def _vertex_means(values: Float, edges: IntArray, count: int) -> Float:
    """Average edge values ``(n,)`` at vertices: return the mean ``(V,)`` over the edges ``(n, 2)`` of each vertex."""
    vertices = edges.ravel()
    sums = np.bincount(vertices, np.repeat(values, 2), count)
    return np.asarray(sums / np.maximum(np.bincount(vertices, minlength=count), 1))


def _hinge_angles(points: FloatArray, topology: Topology) -> tuple[Float, NDArray[np.bool_]]:
    """Return the dihedral angles ``(H,)`` of hinges, and a mask ``(H,)`` of hinges whose faces both have an area."""
    x = np.asarray(points, dtype=np.float64)
    is_degenerate = degenerate_faces(x, topology.faces, MIN_NORMAL_HEIGHT_RATIO)[topology.hinge_faces]
    return dihedral_angles(x, topology.hinges), np.asarray(~is_degenerate.any(axis=1))


MAX_PALETTE_COLOURS = 256


def own_colours(header: SequenceHeader) -> tuple[ByteArray, Index]:
    """Return a palette ``(n, 3)`` and entries ``(V,)`` of the mesh's own colours; vertices use their first corner."""
    assert header.surface.colours is not None
    linear = header.surface.colours.at_vertices(header.polygons.indices, header.vertex_count, DEFAULT_COLOUR)[:, :3]
    vertex_colours = np.rint(255 * srgb(np.clip(np.nan_to_num(linear), 0, 1))).astype(np.uint8)
    colours, entries, counts = np.unique(vertex_colours, axis=0, return_inverse=True, return_counts=True)
    if len(colours) <= MAX_PALETTE_COLOURS:
        return colours, entries.reshape(-1)
    palette, box_of_colour = _quantize(colours.astype(np.float64), counts)
    return np.rint(palette).astype(np.uint8), box_of_colour[entries.reshape(-1)]


def _quantize(colours: Float, counts: Index) -> tuple[Float, Index]:
    """Divide distinct colours ``(n, 3)`` into boxes; return the mean colours ``(256, 3)`` and box indices ``(n,)``."""
    heap = [_box(colours, counts, np.arange(len(colours)))]
    while len(heap) < MAX_PALETTE_COLOURS:
        _, _, colour_ids, mean, axis = heappop(heap)
        is_above = colours[colour_ids, axis] > mean[axis]
        for half in (colour_ids[~is_above], colour_ids[is_above]):
            heappush(heap, _box(colours, counts, half))
    box_of_colour = np.empty(len(colours), dtype=np.int64)
    for number, (_, _, colour_ids, _, _) in enumerate(heap):
        box_of_colour[colour_ids] = number
    return np.stack([mean for _, _, _, mean, _ in heap]), box_of_colour


def _box(colours: Float, counts: Index, colour_ids: Index) -> tuple[float, int, Index, Float, int]:
    """Return a box of colours as a heap item: negative sum of squares, first colour, colours, mean, longest axis."""
    inside, weights = colours[colour_ids], counts[colour_ids]
    mean = weights @ inside / weights.sum()
    squares = weights @ np.square(inside - mean)
    return -float(squares.sum()), int(colour_ids[0]), colour_ids, mean, int(squares.argmax())


Measure = Callable[[FloatArray, float], Float]
"""Function from points ``(V, 3)`` and elapsed seconds to measured values ``(V,)``."""

ReferencePose = Callable[[float], FloatArray]
"""Function from elapsed seconds to the points ``(V, 3)`` of the original."""


UNITS = {"error": "diagonals", "strain": "%", "curvature": "degrees", "values": ""}
"""Units of the measured values."""

MIN_SCALE_ENDS = {"error": 1e-12, "strain": 0.01, "curvature": 0.01}
"""Smallest ends of the scales, in `UNITS`, above rounding errors of rigid motions in single precision."""

SCALE_QUANTILES = {"error": 1.0, "strain": 0.99, "curvature": 0.99, "values": 1.0}
"""Quantiles of the measured values at which the scales end, so that outliers do not darken all other faces."""


@dataclass(frozen=True, eq=False)
class Colouring:
    """A colouring of a mesh."""

    name: str  # one of `mixseq.choices.COLOURS`
    palette: ByteArray  # (n, 3) sRGB, at most 256 colours; exactly 256 if measured
    constant_entries: ByteArray | None = None  # (V,) palette entries for every pose; None if measured
    measure: Measure | None = None  # function that computes the displayed values, in `unit`; None if constant
    top: float = 1.0  # value shown in the last colour
    low: float = 0.0  # value shown in the first colour
    unit: str = ""  # unit of the displayed values
    face_colours: ArrayLike = CLAY_COLOUR  # RGB in 0..1 of the mesh (3,) or its faces (F, 3), if constant

    def __post_init__(self) -> None:
        if (self.constant_entries is None) == (self.measure is None):
            raise SettingsError(f"{self.name} needs either constant entries or a measure; give one of the two")
        if not (np.isfinite(self.top) and self.top > self.low):
            raise SettingsError(f"the colour scale ends at {self.top}; give a positive number")

    @property
    def is_constant(self) -> bool:
        """Whether all poses have the same colours."""
        return self.measure is None

    def entries(self, points: FloatArray, elapsed: float) -> ByteArray:
        """Return palette entries ``(V,)`` of points ``(V, 3)`` at a time, in elapsed seconds."""
        if self.measure is None:
            assert self.constant_entries is not None  # ensured by `__post_init__`
            return self.constant_entries
        fractions = np.clip((self.measure(points, elapsed) - self.low) / (self.top - self.low), 0.0, 1.0)
        return np.rint(255 * fractions).astype(np.uint8)

    def scale_end(self, points: FloatArray, elapsed: float) -> float:
        """Return the scale end that suits points ``(V, 3)`` at a time, in elapsed seconds; 0 if constant."""
        if self.measure is None:
            return 0.0
        return float(np.quantile(self.measure(points, elapsed), SCALE_QUANTILES[self.name]))

    def with_top(self, top: float) -> Colouring:
        """Return the colouring with a scale that ends at `top`."""
        if self.is_constant:
            raise SettingsError(f"the colour {self.name} has no scale; choose another one, such as strain")
        return replace(self, top=float(top))


def clay(count: int) -> Colouring:
    """Return the uniform colouring of `count` vertices."""
    return Colouring("clay", _to_bytes(np.tile(CLAY_COLOUR, (256, 1))), _shared_entries(np.zeros(count)))


def available_colourings(
    header: SequenceHeader,
    rest: FloatArray,
    decomposition: Decomposition | None = None,
    original: ReferencePose | None = None,
    poses: Iterable[tuple[float, FloatArray]] = (),
    diagonal: float | None = None,
    values: FloatArray | None = None,
) -> dict[str, Colouring]:
    """Return the available colourings of a mesh with rest points ``(V, 3)`` by name, with scales that cover `poses`.

    `diagonal` is that of the original, by default of its first pose.
    """
    colourings: dict[str, Colouring] = {
        name: make_colouring(name, header, rest, decomposition, original, diagonal, values)
        for name in _colour_names(header, decomposition, original, values)
    }
    measured = {name: colouring for name, colouring in colourings.items() if not colouring.is_constant}
    tops = {name: colouring.top for name, colouring in measured.items()}
    for elapsed, points in poses:
        tops = {name: max(tops[name], measured[name].scale_end(points, elapsed)) for name in measured}
    return colourings | {name: measured[name].with_top(top) for name, top in tops.items()}


def _colour_names(header: SequenceHeader, decomposition: object, original: object, values: object) -> Iterator[Colour]:
    """Yield the names of the colourings that a mesh has."""
    needs = {"own": header.surface.colours, "parts": decomposition, "error": original, "values": values}
    return (name for name in COLOURS if needs.get(name, True) is not None)


def make_colouring(
    name: Colour,
    header: SequenceHeader,
    rest: FloatArray,
    decomposition: Decomposition | None = None,
    original: ReferencePose | None = None,
    diagonal: float | None = None,
    values: FloatArray | None = None,
) -> Colouring:
    """Make the colouring of the given name; measured colourings have the smallest scale."""
    faces, count = header.faces, header.vertex_count
    _check_vertex_count("the rest pose", rest, count)
    if name == "clay":
        return clay(count)
    if name == "own":
        palette, entries = own_colours(header)
        face_colours = palette[entries[faces]].mean(axis=1) / 255
        return Colouring("own", palette, _shared_entries(entries), face_colours=face_colours)
    if name == "parts":
        assert decomposition is not None
        entries = _part_entries(faces, count, decomposition)
        face_colours = segmentation_colours(decomposition.part_of_face, decomposition.joint_of_face, faces)
        return Colouring("parts", _to_bytes(_parts_palette()), _shared_entries(entries), face_colours=face_colours)
    if name == "values":
        assert values is not None
        rows = check_values(values, header)
        low, top = value_range(rows)
        return Colouring(
            name,
            _to_bytes(viridis()),
            measure=lambda _, elapsed: rows[nearest_frames(header, np.array([elapsed]))[0]],
            top=top,
            low=low,
        )
    measure = _make_measure(name, rest, faces, original, diagonal)
    return Colouring(name, _to_bytes(viridis()), measure=measure, top=MIN_SCALE_ENDS[name], unit=UNITS[name])


def check_values(values: ArrayLike, header: SequenceHeader) -> Float:
    """Return numbers of vertices ``(V,)`` or ``(T, V)`` as one row per frame of the mesh; refuse any other shape."""
    rows, shape = np.asarray(values, dtype=np.float64), (header.frame_count, header.vertex_count)
    if rows.shape not in (shape, shape[1:]):
        raise SettingsError(
            f"the values have the shape {rows.shape}; give {shape[1]} numbers, one for each vertex, or {shape[0]} "
            "rows of them, one for each frame"
        )
    if not np.isfinite(rows).all():
        raise SettingsError("the values are not all finite; give a number for every vertex")
    return np.broadcast_to(rows, shape)


def value_range(values: Float) -> tuple[float, float]:
    """Return the ends of the colour scale of values, which differ."""
    low, top = float(values.min()), float(values.max())
    return low, top if top > low else low + 1.0


def _make_measure(
    name: Colour, rest: FloatArray, faces: IntArray, original: ReferencePose | None, diagonal: float | None
) -> Measure:
    """Return the measure of a colouring, in the unit of its values, relative to rest points ``(V, 3)``."""
    if name in MEASURES:
        measure, factor = MEASURES[name](rest, faces), 100 if name == "strain" else 1
        return lambda points, elapsed: factor * measure(points)
    assert original is not None
    first = original(0.0)
    _check_vertex_count("the original", first, len(rest))
    unit = diagonal or bounding_diagonal(first) or 1.0
    return lambda points, elapsed: vertex_distances(points, original(elapsed), unit)


def _check_vertex_count(subject: str, points: FloatArray, count: int) -> None:
    if points.shape != (count, 3):
        raise SettingsError(
            f"{subject} has the shape {points.shape}, the mesh {count} vertices; colours compare poses of one mesh"
        )


def _part_entries(faces: IntArray, count: int, decomposition: Decomposition) -> Index:
    """Return the palette entries ``(V,)`` of parts and joints; vertices without faces have 0."""
    part_of_face = decomposition.part_of_face
    if len(part_of_face) != len(faces):
        raise SettingsError(
            f"the parts have {len(part_of_face)} triangles, the mesh {len(faces)}; give the parts of this mesh"
        )
    parts = int(part_of_face.max()) + 1
    pairs, votes = np.unique(faces.ravel() * np.int64(parts) + np.repeat(part_of_face, 3), return_counts=True)
    vertex, part = np.divmod(pairs, parts)
    # sort by vertex, then by descending votes, then by part
    order = np.lexsort((part, -votes, vertex))
    winner_ids = order[np.unique(vertex[order], return_index=True)[1]]
    entries = np.zeros(count, dtype=np.int64)
    entries[vertex[winner_ids]] = part[winner_ids] % PALETTE_PARTS
    in_joint = np.unique(faces[decomposition.joint_of_face >= 0])
    is_seam = _seam_vertices(part_of_face, faces)[in_joint]
    entries[in_joint] = np.where(is_seam, JOINT_ENTRY, entries[in_joint] + PALETTE_PARTS)
    return entries


def _shared_entries(entries: NDArray[np.generic]) -> ByteArray:
    shared = entries.astype(np.uint8)
    shared.setflags(write=False)  # all poses share the array
    return shared


def _to_bytes(colours: Float) -> ByteArray:
    return np.rint(255 * np.asarray(colours)).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class SceneColours:
    """The colourings of all meshes of a scene."""

    scene: Scene  # the unedited scene; its first frames are the rest poses
    original: FrameStore | None = None  # original from which errors are measured
    _colourings: dict[int, dict[str, Colouring]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _clay(self) -> list[Colouring]:
        return [clay(item.header.vertex_count) for item in self.scene.items]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the colourings that at least one mesh has."""
        names = {
            name
            for item in self.scene.items
            for name in _colour_names(item.header, item.decomposition, self._original_of(item), item.values)
        }
        return tuple(sorted(names, key=COLOURS.index))

    def of_mesh(self, index: int) -> dict[str, Colouring]:
        """Return all colourings of a mesh by name."""
        if index not in self._colourings:
            item = self.scene.items[index]
            frames = self.scene.sample_frames(12)  # enough to estimate the ends of scales
            times = map(self.scene.elapsed, frames)
            poses = ((elapsed, item.pose(elapsed)) for elapsed in times)
            self._colourings[index] = available_colourings(
                item.header,
                item.pose(0.0),
                item.decomposition,
                self._original_of(item),
                poses,
                None if self.original is None else self.original.diagonal,
                item.values,
            )
        return self._colourings[index]

    def on_one_scale(self, name: str) -> list[Colouring]:
        """Return one colouring per mesh with the given name and a common scale; use clay for meshes without it."""
        if name == "clay":  # is shown first; avoids the cost of the other colourings
            return self._clay
        colourings = [self.of_mesh(index).get(name, plain) for index, plain in enumerate(self._clay)]
        top = max((colouring.top for colouring in colourings if not colouring.is_constant), default=0.0)
        return [colouring if colouring.is_constant else colouring.with_top(top) for colouring in colourings]

    def _original_of(self, item: SceneItem) -> ReferencePose | None:
        """Return a function that gives the original's pose, or None if the original is a different mesh."""
        if self.original is None:
            return None
        vertex_ids = match_vertices(self.original.header, item.header, quiet=True)
        if vertex_ids is None:
            return None
        pose = SceneItem("the original", self.original).pose
        return lambda elapsed: pose(elapsed)[vertex_ids]


def match_original(header: SequenceHeader, other: SequenceHeader, name: str) -> Index:
    """Return the vertices of a mesh in the order of the named one; raise SettingsError if it is not the same."""
    vertex_ids = match_vertices(header, other)
    if vertex_ids is None:
        raise SettingsError(
            f"{name} has {len(other.faces)} triangles of {other.vertex_count} vertices, what it is compared with "
            f"{len(header.faces)} of {header.vertex_count}, or other faces; errors need the same topology"
        )
    return vertex_ids


def check_original(scene: Scene, original: FrameStore) -> None:
    """Raise SettingsError if no mesh of the scene has the vertices and triangles of the original."""
    header = original.header
    items = [item for item in scene.items if match_vertices(header, item.header) is not None]
    if not items:
        raise SettingsError(
            f"none of the meshes has the {header.vertex_count} vertices and {len(header.faces)} triangles of the "
            "original; errors need the same topology"
        )
    check_start_times(items, header)
