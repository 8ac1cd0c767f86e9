r"""Colourings of meshes: a palette, and an entry of it at every vertex, which may change over time.

- **clay**: uniform.
- **own**: the colours of the mesh, as viewers of glTF show them on a plain white material: linear, converted to opaque
  sRGB, clipped to 0..1, with 8 bits a channel.
- **parts**: rigid parts in cool hues, and joints in a red reserved for them. A vertex is a joint's if any of its faces
  is, else of the part of most of its faces.
- **strain**: mean over the edges of a vertex of :math:`|l / \bar l - 1|`, with :math:`\bar l` their lengths at rest.
- **curvature** (its change): mean over the hinges of a vertex of :math:`|\theta - \bar\theta|` in degrees, with
  :math:`\bar\theta` their dihedral angles at rest and the difference in :math:`(-\pi, \pi]`, the shorter way round. A
  hinge belongs to the two vertices of its edge, where the surface bends.
- **error**: distance from the same vertex of an original, :math:`|a_v - b_v| / d`, in diagonals.

The last three are numbers from 0 to `top` in viridis. Strain and curvature are invariant to rigid motions; uniform
scaling by s has the strain :math:`|s - 1|` everywhere. On a finer mesh a bend is shared by more hinges, so curvatures
compare poses of one mesh only. Edges of length zero and hinges of flat faces count as unchanged; vertices without edges
or hinges have 0.

A palette of more than 256 own colours is made from boxes: of one box with all of them, the box with the largest sum of
squared distances from its mean is cut there, across the side of largest share, until there are 256 (as Wu 1991, without
a search for the best cuts). A colour then is the mean of its box.

A pose has one byte per vertex, so a page stores the palette once and V bytes for each pose, or once if constant.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable
from dataclasses import dataclass, field, replace
from functools import cached_property
from heapq import heapify, heappop, heappush

import numpy as np
from numpy.typing import ArrayLike, NDArray

from mixseq.choices import COLOURS, Colour
from mixseq.errors import SettingsError
from mixseq.mesh.measures import edge_lengths, wrap
from mixseq.mesh.surface import WHITE
from mixseq.mesh.topology import Topology
from mixseq.pictures.scene import Scene, SceneItem, check_starts, same_mesh
from mixseq.segmentation.joints import Decomposition
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import FrameStore, bounding_diagonal
from mixseq.types import Float, FloatArray, Index, IntArray

Bytes = NDArray[np.uint8]

CLAY_COLOUR = (0.80, 0.77, 0.72)
JOINT_RED = (0.85, 0.20, 0.13)
INK_COLOUR = "#3a3a3a"

FIRST_HUE, LAST_HUE = 90.0, 330.0
"""Degrees on the OKLCH circle, from straw to mauve, equally far from the red of the joints at 30."""

SAGE = 0.3
"""Position of the first hue between those."""

GOLDEN = 0.61803
"""Step from hue to hue, in rounds, which separates the first n hues for any n."""

OKLAB_TO_LMS = np.array(
    [
        [1, 0.3963377774, 0.2158037573],
        [1, -0.1055613458, -0.0638541728],
        [1, -0.0894841775, -1.2914855480],
    ]
)
LMS_TO_RGB = np.array(
    [
        [4.0767416621, -3.3077115913, 0.2309699292],
        [-1.2684380046, 2.6097574011, -0.3413193965],
        [-0.0041960863, -0.7034186147, 1.7076147010],
    ]
)


VIRIDIS = bytes.fromhex(
    "44015446085c471063481769481d6f482475472a7a46307e453781433d844142873f48893d4e8a"
    "3a538b38598c355e8d33638d31688e2e6d8e2c718e2a768e297b8e27808e25848e23898e218e8d"
    "20928c1f978b1e9c891fa18821a58524aa8328ae802eb37c35b7793dbc7446c06f50c46a5ac864"
    "65cb5e70cf577cd25089d54895d840a2da37b0dd2fbddf26cae11fd8e219e5e419f1e51dfde725"
)
"""Every fifth colour of matplotlib's map viridis (van der Walt and Smith 2015, CC0), three bytes each."""


def viridis() -> Float:
    """Return the map viridis ``(256, 3)`` without matplotlib, within 1.4 / 255 of it."""
    known = np.frombuffer(VIRIDIS, dtype=np.uint8).reshape(-1, 3) / 255
    steps = np.arange(0, 256, 5)
    return np.stack([np.interp(np.arange(256), steps, channel) for channel in known.T], axis=1)


def part_colours(count: int) -> Float:
    """Return muted, distinguishable, cool colours ``(count, 3)``: hues by the golden angle, alternating lightness."""
    share = np.asarray((SAGE + GOLDEN * np.arange(count)) % 1.0, dtype=np.float64)
    hue = FIRST_HUE + (LAST_HUE - FIRST_HUE) * share
    lightness = np.resize([0.78, 0.68, 0.85], count)
    return _oklch(lightness, 0.085, hue)


def segmentation_colours(part_of_face: IntArray, joint_of_face: IntArray) -> Float:
    """Return colours ``(F, 3)`` of part_of_face ``(F,)``, or `JOINT_RED` where joint_of_face ``(F,)`` is a joint."""
    palette = part_colours(int(np.max(part_of_face)) + 1)
    return np.where(np.asarray(joint_of_face)[:, None] >= 0, JOINT_RED, palette[part_of_face])


def _oklch(lightness: Float, chroma: float, hue: Float) -> Float:
    """Convert OKLCH (Ottosson 2020; hue in degrees) to sRGB ``(N, 3)``."""
    a, b = chroma * np.cos(np.radians(hue)), chroma * np.sin(np.radians(hue))
    lms = (np.stack([lightness, a, b], axis=-1) @ OKLAB_TO_LMS.T) ** 3
    return srgb(np.clip(lms @ LMS_TO_RGB.T, 0, 1))


def srgb(linear: FloatArray) -> Float:
    """Convert linear numbers from 0 to 1 to sRGB (IEC 61966-2-1)."""
    return np.asarray(np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055))


FLAT = 1e-6
"""Height of a face relative to its longest side below which its normal is undefined; as in `mixseq.metrics`."""

SHARE = 0.99
"""Fraction of vertices within the colour scale, so that a single sliver does not darken all others."""


@dataclass(frozen=True, eq=False)
class Strain:
    """Strain against a pose."""

    edges: IntArray  # (E, 2) edges of the mesh
    lengths: Float  # (E,) their lengths in that pose

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Strain:
        """Make the measure against a pose ``(V, 3)`` of triangles ``(F, 3)``."""
        edges = Topology(faces, len(points)).edges
        return cls(edges, edge_lengths(np.asarray(points, dtype=np.float64), edges))

    def __call__(self, points: FloatArray) -> Float:
        """Return strains ``(V,)`` of points ``(V, 3)``."""
        now = edge_lengths(np.asarray(points, dtype=np.float64), self.edges)
        known = self.lengths > 0
        strain = np.abs(np.divide(now, self.lengths, out=np.ones_like(now), where=known) - 1)
        return _means(strain, self.edges, len(points))


@dataclass(frozen=True, eq=False)
class Curvature:
    """Change of dihedral angles against a pose."""

    faces: IntArray  # (F, 3) triangles of the mesh
    hinges: IntArray  # (H, 2) the vertices that the edge of every hinge joins
    sides: IntArray  # (H, 2) its two faces
    signs: Float  # (H,) 1 where they have one orientation, -1 elsewhere
    angles: Float  # (H,) angles in that pose, in radians
    known: NDArray[np.bool_]  # (H,) whether both faces have area in that pose

    @classmethod
    def of(cls, points: FloatArray, faces: IntArray) -> Curvature:
        """Make the measure against a pose ``(V, 3)`` of triangles ``(F, 3)``."""
        topology = Topology(faces, len(points))
        hinges, sides = topology.hinges[:, :2], topology.hinge_faces
        # the first face goes along the edge from a to b; the second goes back, if it has the same orientation
        second = faces[sides[:, 1]]
        along = (second == hinges[:, :1]) & (np.roll(second, -1, axis=1) == hinges[:, 1:])
        signs = np.where(along.any(axis=1), -1.0, 1.0)
        return cls(faces, hinges, sides, signs, *_angles(points, faces, hinges, sides, signs))

    def __call__(self, points: FloatArray) -> Float:
        """Return changes ``(V,)`` in degrees, 0 to 180, of points ``(V, 3)``."""
        now, known = _angles(points, self.faces, self.hinges, self.sides, self.signs)
        change = np.where(known & self.known, np.abs(wrap(now - self.angles)), 0.0)
        return np.degrees(_means(change, self.hinges, len(points)))


MEASURES: dict[str, type[Strain | Curvature]] = {"strain": Strain, "curvature": Curvature}
"""Measures by the names of their colourings."""


def distances(points: FloatArray, original: FloatArray, diagonal: float) -> Float:
    """Return errors ``(V,)`` of points ``(V, 3)``, in diagonals of the original."""
    return np.asarray(np.linalg.norm(points - original, axis=1) / diagonal)


def two_digits(number: float) -> str:
    """Format the end of a colour scale with two digits: 0.0123 as "0.012", 123.4 as "120"."""
    return f"{float(f'{number:.2g}'):g}"


def _means(values: Float, ends: IntArray, count: int) -> Float:
    """Return means ``(V,)`` at vertices of the values ``(n,)`` of edges with ends ``(n, 2)``."""
    at = ends.ravel()
    sums = np.bincount(at, np.repeat(values, 2), count)
    return np.asarray(sums / np.maximum(np.bincount(at, minlength=count), 1))


def _angles(
    points: FloatArray, faces: IntArray, hinges: IntArray, sides: IntArray, signs: Float
) -> tuple[Float, NDArray[np.bool_]]:
    r"""Return the angles ``(H,)`` of all hinges, and a mask of those between faces with area.

    They are those of `mixseq.mesh.measures`, from normals that are computed once for every face: with
    :math:`n_f = (b - a) \times (c - a)`, the hinge of edge ab and faces f and g has :math:`n_f`, and :math:`n_g`, or
    :math:`-n_g` where g has the other orientation.
    """
    x = np.ascontiguousarray(points.T, dtype=np.float64)  # columns: several times faster than rows of three
    normals, low = _normals(x, faces)
    first, second = (np.take(normals, side, axis=1) for side in sides.T)
    second *= signs
    edge = np.take(x, hinges[:, 1], axis=1) - np.take(x, hinges[:, 0], axis=1)
    sine = _dot(np.cross(first, second, axis=0), edge)
    cosine = _dot(first, second) * np.sqrt(_dot(edge, edge))
    return np.arctan2(sine, cosine), ~(low[sides[:, 0]] | low[sides[:, 1]])


def _normals(x: Float, faces: IntArray) -> tuple[Float, NDArray[np.bool_]]:
    """Return face normals ``(3, F)`` of twice the faces' areas in length, and a mask of flat faces."""
    a, b, c = (np.take(x, corner, axis=1) for corner in faces.T)
    u, v, w = b - a, c - a, c - b
    normals = np.cross(u, v, axis=0)
    longest = np.maximum(np.maximum(_dot(u, u), _dot(v, v)), _dot(w, w))
    return normals, _dot(normals, normals) <= (FLAT * longest) ** 2


def _dot(u: Float, v: Float) -> Float:
    """Return scalar products ``(n,)`` of columns."""
    return np.asarray(u[0] * v[0] + u[1] * v[1] + u[2] * v[2])


ENTRIES = 256
"""Largest number of colours of a palette."""


def own_colours(header: SequenceHeader) -> tuple[Bytes, Index]:
    """Return a palette ``(n, 3)`` and entries ``(V,)`` of vertices, those of their first corners."""
    assert header.surface.colours is not None
    linear = header.surface.colours.at_vertices(header.polygons.indices, header.vertex_count, WHITE)[:, :3]
    shown = np.rint(255 * srgb(np.clip(np.nan_to_num(linear), 0, 1))).astype(np.uint8)
    kinds, entries, counts = np.unique(shown, axis=0, return_inverse=True, return_counts=True)
    if len(kinds) <= ENTRIES:
        return kinds, entries.reshape(-1)
    palette, of_kind = _boxes(kinds.astype(np.float64), counts)
    return np.rint(palette).astype(np.uint8), of_kind[entries.reshape(-1)]


def _boxes(colours: Float, counts: Index) -> tuple[Float, Index]:
    """Return the means ``(256, 3)`` of boxes of different colours ``(n, 3)``, and the box ``(n,)`` of each."""
    heap = [_box(colours, counts, np.arange(len(colours)))]
    heapify(heap)
    while len(heap) < ENTRIES:
        _, _, inside, mean, side = heappop(heap)
        beyond = colours[inside, side] > mean[side]
        for some in (inside[~beyond], inside[beyond]):
            heappush(heap, _box(colours, counts, some))
    box = np.empty(len(colours), dtype=np.int64)
    for number, (_, _, inside, _, _) in enumerate(heap):
        box[inside] = number
    return np.stack([mean for _, _, _, mean, _ in heap]), box


def _box(colours: Float, counts: Index, inside: Index) -> tuple[float, int, Index, Float, int]:
    """Return a box of some colours, sortable: the largest sum of squares first, then by its first colour."""
    own, weights = colours[inside], counts[inside]
    mean = weights @ own / weights.sum()
    squares = weights @ np.square(own - mean)
    return -float(squares.sum()), int(inside[0]), inside, mean, int(squares.argmax())


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
    of_faces: ArrayLike = (
        CLAY_COLOUR  # (3,) RGB in 0..1 of the mesh or of each face, where nothing is measured
    )

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


def clay(count: int) -> Colouring:
    """Return the uniform colouring of `count` vertices."""
    return Colouring("clay", _bytes(np.tile(CLAY_COLOUR, (256, 1))), _fixed(np.zeros(count)))


def available_colourings(
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
        name: make_colouring(name, header, rest, decomposition, original)
        for name in COLOURS
        if there.get(name, True)
    }
    tops = {name: each.top for name, each in found.items()}
    for elapsed, points in poses:
        tops = {name: max(tops[name], each.reached(points, elapsed)) for name, each in found.items()}
    return {name: each if each.constant else each.scaled(tops[name]) for name, each in found.items()}


def make_colouring(
    name: Colour,
    header: SequenceHeader,
    rest: FloatArray,
    decomposition: Decomposition | None = None,
    original: Original | None = None,
) -> Colouring:
    """Return one of `available_colourings`; a scale ends at `LEAST` or above."""
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
        palette = np.concatenate([_bytes(part_colours(JOINT)), _bytes(np.array([JOINT_RED]))])
        return Colouring("parts", palette, entries, of_faces=of_faces)
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


SAMPLES = 12
"""Number of frames from which the ends of scales are measured."""


@dataclass(frozen=True, eq=False)
class SceneColours:
    """The colourings of all meshes of a scene."""

    scene: Scene  # as it was opened: edits are measured against the first frames that it had then
    original: FrameStore | None = None  # what errors are measured against
    _found: dict[int, dict[str, Colouring]] = field(default_factory=dict, init=False, repr=False)

    @cached_property
    def _plain(self) -> list[Colouring]:
        return [clay(item.header.vertex_count) for item in self.scene.items]

    @cached_property
    def names(self) -> tuple[str, ...]:
        """Names of the colourings that at least one mesh has."""
        there = {
            "own": any(item.header.surface.colours is not None for item in self.scene.items),
            "parts": any(item.decomposition is not None for item in self.scene.items),
            "error": any(self._original_of(item) is not None for item in self.scene.items),
        }
        return tuple(name for name in COLOURS if there.get(name, True))

    def of(self, index: int, name: str) -> Colouring:
        """Return a colouring of a mesh, clay if it lacks that."""
        if name == "clay":  # the first colour that is seen, and all others take time
            return self._plain[index]
        return self.each(index).get(name, self._plain[index])

    def each(self, index: int) -> dict[str, Colouring]:
        """Return all colourings of a mesh."""
        if index not in self._found:
            item = self.scene.items[index]
            moments = (self.scene.elapsed(frame) for frame in self.scene.sample_frames(SAMPLES))
            poses = ((elapsed, item.pose(elapsed)) for elapsed in moments)
            original = self._original_of(item)
            self._found[index] = available_colourings(
                item.header, item.pose(0.0), item.decomposition, original, poses
            )
        return self._found[index]

    def shared(self, name: str) -> list[Colouring]:
        """Return the colourings of all meshes, with the scale of the largest end."""
        colourings = [self.of(index, name) for index in range(len(self.scene.items))]
        top = max((each.top for each in colourings if not each.constant), default=0.0)
        return [each if each.constant else each.scaled(top) for each in colourings]

    def _original_of(self, item: SceneItem) -> Original | None:
        """Return the original's points at elapsed times, if it is the same mesh."""
        if self.original is None or not same_mesh(self.original.header, item.header):
            return None
        return SceneItem("the original", self.original).pose


def check_original(scene: Scene, original: FrameStore) -> None:
    """Raise SettingsError for an original that does not fit."""
    header = original.header
    same = [item for item in scene.items if same_mesh(item.header, header)]
    if not same:
        raise SettingsError(
            f"none of the meshes has the {header.vertex_count} vertices and {len(header.faces)} triangles of the "
            "original; errors need one mesh"
        )
    check_starts(same, header)
