"""Describe lost surface data, measure float32 rounding, convert colours, and convert surfaces to and from arrays.

A float32 has 24 binary digits, so rounding displaces a vertex at c diagonals from the origin by up to about 1e-7 c
diagonals. This is visible on meshes that are far from the origin or extremely small. Colours become RGBA; values are
not converted between linear and sRGB. The formats npz and HDF5 store the arrays that are described
as ``surface/...`` in docs/file-format.md.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Iterable, Iterator, Mapping, Sequence
from itertools import chain
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import InvalidSequenceError, OutputError
from mixseq.mesh.measures import NO_ORIGIN, Diagonal, bounding_box, choose_origin
from mixseq.mesh.surface import DEFAULT_COLOUR, CornerValues, FaceSet, MeshObject, Origin, Surface
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.provenance import Provenance
from mixseq.sequence.sequence import reference_diagonal, rounding_margin
from mixseq.types import Float, FloatArray, Index, IntArray, Single
from mixseq_io.reader import warn

VISIBLE_ERROR_DIAGONALS = 1e-4
"""Smallest reported displacement in diagonals, a fifth of the visually lossless displacement."""


class RoundingMonitor:
    """Origin of the points of a file in single precision, and their largest displacement by rounding, in diagonals.

    Visible displacements are reported. Those beyond the margin of a bound that a model promises are an error.
    """

    def __init__(self, path: Path, format_name: str, header: SequenceHeader) -> None:
        self.error, self.frame = 0.0, 0
        self.origin = NO_ORIGIN
        self._path, self._format_name, self._header = path, format_name, header
        self._near, self._diagonal = NO_ORIGIN, Diagonal(0.0, 0)
        self._largest = self._largest_local = 0.0
        self._bound = None if header.provenance is None else _promised_bound(header.provenance)
        self._negligible = min(VISIBLE_ERROR_DIAGONALS, self._bound or math.inf)

    def watch(self, blocks: Iterable[FloatArray], has_nodes: bool = False) -> Iterator[FloatArray]:
        """Return an iterator over blocks ``(B, V, 3)``, which raises `OutputError` at its end if a promise is broken.

        Formats with nodes get an `origin`, which is chosen at once, and their writers call `measure`.
        """
        remaining = iter(blocks)
        for first in remaining:
            points = np.asarray(first)
            if points.ndim == 3 and points.size and points.dtype != np.float32:
                self._near = choose_origin(points[0])
            self.origin = self._near if has_nodes else NO_ORIGIN
            return self._watch(chain([first], remaining), has_nodes)
        return remaining

    def _watch(self, blocks: Iterable[FloatArray], has_nodes: bool) -> Iterator[FloatArray]:
        count = 0
        for block in blocks:
            points = np.asarray(block)
            if points.ndim == 3 and points.size and points.dtype != np.float32 and not self._diagonal.fraction:
                with np.errstate(all="ignore"):  # writers report points that are not finite with their vertex
                    self._diagonal = reference_diagonal([points])
            yield block
            if not has_nodes:
                for frame, own in enumerate(points, count):
                    self.measure(frame, own, own)
            count += len(points)
        self._check_promise()

    def measure(self, frame: int, points: FloatArray, written: FloatArray, corners: FloatArray | None = None) -> None:
        """Measure the distances of points ``(V, 3)`` of a frame from those that are written, or rounded, for them.

        `corners` ``(n, 3)`` have the bounding box of `written`; by default it is computed.
        They are not measured where rounding of the largest coordinate is neither visible nor of weight for a promise.
        """
        if points.dtype == np.float32 or not points.size:
            return
        box = np.asarray(bounding_box(written) if corners is None else corners, dtype=np.float64)
        largest = float(np.abs(box).max())
        self._largest = max(self._largest, largest)
        self._largest_local = max(self._largest_local, float(np.abs(box - self._near).max()))
        is_rounded = written is points or written.dtype == np.float32
        is_normal = self._negligible * self._diagonal.length > np.finfo(np.float32).smallest_subnormal
        if is_rounded and is_normal and rounding_margin(self._negligible, largest / (self._diagonal.length or 1.0)):
            return
        with np.errstate(over="ignore", under="ignore"):
            written = written.astype(np.float32) if written is points else written
            errors: Float = self._diagonal.rescale(points - written)
            error = float(np.sqrt(np.einsum("vi,vi->v", errors, errors).max())) / (self._diagonal.fraction or 1.0)
        if error > self.error:
            self.error, self.frame = error, frame

    def _check_promise(self) -> None:
        """Raise an error if rounding takes more of a promised bound than encoders leave for it."""
        bound, unit = self._bound, self._diagonal.length or 1.0
        if bound is None or self.error <= rounding_margin(bound, self._largest / unit, self._largest_local / unit):
            return
        alone = ", or a stand-alone USD, Alembic or glTF file (--flatten)" if self._near.any() else ""
        raise OutputError(
            f"{self._describe()}, which may exceed the promised {bound:g}; write .npz, .h5 or .ply, which hold "
            f"doubles{alone}, or compress with a larger bound"
        )

    def warn(self) -> None:
        """Warn of visible rounding."""
        if self.error > VISIBLE_ERROR_DIAGONALS:
            cure = "write .npz, .h5 or .ply, which hold doubles, or move the sequence to the origin"
            warn(f"{self._describe()}; {cure}")

    def _describe(self) -> str:
        return (
            f"{self._path}: {self._format_name} holds points in single precision, and vertices are off by up to "
            f"{self.error:.2g} of the diagonal, most in {self._header.frame_name(self.frame)}"
        )


def _promised_bound(provenance: Provenance) -> float | None:
    """Return the bound that the last step promises in diagonals; None if it has none, or promises exact frames."""
    from mixseq.signals.detail import EXACT_TOLERANCE

    bound = provenance.bounds[0][1] if provenance.promised and provenance.source else None
    return None if bound is None or bound <= EXACT_TOLERANCE else bound


LARGEST_BYTE = 255
"""Byte that represents the colour value 1.0."""

_MAX_LINEAR_COLOUR = 16
"""Largest value of colours with 1 as white, including bright lights; larger values mean a range of 0 to 255."""


def ensure_alpha(colours: FloatArray) -> FloatArray:
    """Return colours as RGBA ``(n, 4)``; RGB colours ``(n, 3)`` become opaque."""
    alpha = np.ones_like(colours[:, :1]) if colours.shape[1] == 3 else colours[:, 3:]
    return np.hstack([colours[:, :3], alpha])


def scale_text_colours(numbers: FloatArray) -> FloatArray:
    """Scale colours of text files to the range 0 to 1: divide by 255 if the largest number is above 16."""
    largest = numbers[np.isfinite(numbers)].max(initial=0)
    return numbers / (LARGEST_BYTE if largest > _MAX_LINEAR_COLOUR else 1)


def bytes_to_colours(values: NDArray[np.uint8]) -> Single:
    """Convert bytes to float32 colours from 0 to 1."""
    return (values / np.float32(LARGEST_BYTE)).astype(np.float32)


def colours_to_bytes(values: FloatArray) -> NDArray[np.uint8]:
    """Clip colours to the range 0 to 1, and round them to bytes."""
    return np.rint(LARGEST_BYTE * clip_to_unit(values)).astype(np.uint8)


def colours_to_exact_bytes(values: FloatArray) -> NDArray[np.uint8] | None:
    """Return colours as bytes if `bytes_to_colours` restores them exactly, else None."""
    rounded = colours_to_bytes(values)
    return rounded if np.array_equal(bytes_to_colours(rounded), values) else None


def clip_to_unit(values: FloatArray) -> FloatArray:
    """Clip numbers to the range 0 to 1; NaN becomes 0."""
    return np.clip(np.nan_to_num(values), 0, 1)


def format_vertex_colours(header: SequenceHeader, channels: int) -> list[str]:
    """Format each vertex colour as text that follows coordinates, such as " 0.2 0 1"; no texts without colours."""
    colours, vertices = header.surface.colours, header.polygons.indices
    if colours is None:
        return []
    values = clip_to_unit(colours.at_vertices(vertices, header.vertex_count, DEFAULT_COLOUR)[:, :channels])
    return ["".join(f" {channel!s}".removesuffix(".0") for channel in colour) for colour in values]


_CONVERTIBLE_SUFFIXES = (" up", " metres per unit")


def lost_scale(header: SequenceHeader, has_velocities: bool) -> list[str]:
    """Describe the losses in formats without up axis, units and velocities."""
    lost = []
    if header.up_axis != "Y":
        lost.append(f"{header.up_axis} up")
    if header.metres_per_unit != 1.0:
        lost.append(f"{header.metres_per_unit:g} metres per unit")
    if has_velocities:
        lost.append("velocities")
    return lost


def lost_surface(header: SequenceHeader, held: Collection[str] = ()) -> list[str]:
    """Describe the lost fields of a sequence's `Surface`, which are all fields except those in `held`."""
    surface = header.surface
    descriptions = {
        "uvs": surface.uvs is not None and "texture coordinates",
        "colours": surface.colours is not None and "colours",
        "hard_edges": surface.hard_edges is not None and "hard edges",
        "face_sets": bool(surface.face_sets) and "face sets",
        "objects": len(surface.objects) > 1 and f"the names of {len(surface.objects)} objects",
        "subdivision": lost_subdivision(surface),
    }
    return [text for name, text in descriptions.items() if text and name not in held]


def lost_polygons(header: SequenceHeader) -> list[str]:
    """Describe the losses in formats that store only triangles."""
    return [] if header.polygons.only_triangles else ["polygons (they are cut into triangles)"]


def lost_colours(header: SequenceHeader, *, corners: bool = True, alpha: bool = True) -> list[str]:
    """Describe the losses in formats with colours from 0 to 1; `corners` and `alpha` state what the format stores."""
    colours = header.surface.colours
    if colours is None:
        return []
    used = colours.values[np.unique(colours.indices)]
    channels = used[:, : 4 if alpha else 3]
    written = CornerValues(clip_to_unit(colours.values[:, : channels.shape[1]]), colours.indices)
    below, above = bool((channels < 0).any()), bool((channels > 1).any())
    lost = {
        "colours below 0 and above 1 (0 and 1 are written)": below and above,
        "colours below 0 (0 is written)": below and not above,
        "colours above 1 (1 is written)": above and not below,
        "colours that are no numbers (0 is written)": np.isnan(channels).any(),
        "several colours at a vertex (that of its first corner is written)": not (
            corners or written.one_per_vertex(header.polygons.indices)
        ),
        "the alpha of colours": not (alpha or (used[:, 3] == 1).all()),
    }
    return [text for text, is_lost in lost.items() if is_lost]


def lost_subdivision(surface: Surface) -> str:
    """Describe lost subdivision schemes, or return "" if the surface has none."""
    schemes = [scheme for scheme in dict.fromkeys(surface.subdivisions) if scheme != "none"]
    return f"{' and '.join(schemes)} subdivision" if schemes else ""


def warn_of_losses(path: Path, file_kind: str, lost: Sequence[str]) -> None:
    """Issue one warning of all losses, if any; `file_kind` is a text such as "OBJ files"."""
    if lost:
        convert = "; convert_units (--convert-axes Y, --convert-units m) turns and scales the sequence"
        hint = convert if any(each.endswith(_CONVERTIBLE_SUFFIXES) for each in lost) else ""
        warn(f"{path}: {file_kind} cannot hold {', '.join(lost)}; USD, .npz and .h5 can{hint}")


def are_valid_indices(indices: NDArray[np.integer], count: int) -> bool:
    """Whether all indices are at least 0 and less than `count`."""
    return not indices.size or bool(indices.min() >= 0 and indices.max() < count)


def renumber_by_appearance(labels: IntArray) -> tuple[IntArray, IntArray]:
    """Renumber labels ``(n,)`` by first appearance; also return the first index of each new label ``(k,)``."""
    _, first, label_ids = np.unique(labels, return_index=True, return_inverse=True)
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return rank[label_ids.reshape(-1)], first[order]


Arrays = dict[str, NDArray[Any]]

_ARRAY_GROUPS = (
    ("uv_values", "uv_indices"),
    ("colour_values", "colour_indices"),
    ("creases",),
    ("face_set_names", "face_set_materials", "face_set_sizes", "face_set_polygons"),
    ("object_names", "object_paths", "object_sizes"),
    ("object_subdivisions",),
    ("subdivision",),
    ("origin",),
)
SURFACE_ARRAY_NAMES = tuple(name for group in _ARRAY_GROUPS for name in group)
"""Names of the arrays of a surface, in groups; arrays of a group are all stored or all omitted."""


def surface_to_arrays(surface: Surface) -> Arrays:
    """Convert a surface to named arrays, with strings as NumPy's Unicode."""
    arrays: Arrays = {}
    if surface.uvs is not None:
        arrays |= {"uv_values": surface.uvs.values, "uv_indices": surface.uvs.indices}
    if surface.colours is not None:
        values, exact = surface.colours.values, colours_to_exact_bytes(surface.colours.values)
        arrays |= {"colour_values": values if exact is None else exact}
        arrays |= {"colour_indices": surface.colours.indices}
    if surface.hard_edges is not None:
        arrays["creases"] = surface.hard_edges
    sets = surface.face_sets
    if sets:
        arrays |= {
            "face_set_names": np.array([each.name for each in sets]),
            "face_set_materials": np.array([each.material for each in sets]),
            "face_set_sizes": np.array([each.polygons.size for each in sets], dtype=np.int32),
            "face_set_polygons": np.concatenate([each.polygons for each in sets]),
        }
    objects = surface.objects
    if objects:
        sizes = [(each.vertex_count, each.polygon_count) for each in objects]
        arrays |= {
            "object_names": np.array([each.name for each in objects]),
            "object_paths": np.array([each.path for each in objects]),
            "object_sizes": np.array(sizes, dtype=np.int32),
        }
    if len(set(surface.subdivisions)) > 1:
        arrays["object_subdivisions"] = np.array(surface.subdivisions)
    if surface.subdivision != "none":
        arrays["subdivision"] = np.array([surface.subdivision])
    if surface.origin is not None:
        arrays["origin"] = np.array([surface.origin.format, surface.origin.path])
    return arrays


def surface_from_arrays(arrays: Mapping[str, NDArray[Any]], folder: Path | None = None) -> Surface:
    """Restore a surface from named arrays; `folder` is the folder of the file that stores the arrays."""
    for group in _ARRAY_GROUPS:
        missing = [name for name in group if name not in arrays]
        if missing and len(missing) < len(group):
            raise InvalidSequenceError(f"{', '.join(missing)} of the surface are missing")
    uvs = colours = None
    if "uv_values" in arrays:
        uvs = CornerValues(arrays["uv_values"], _read_integers(arrays, "uv_indices"))
    if "colour_values" in arrays:
        values = arrays["colour_values"]
        values = bytes_to_colours(values) if values.dtype == np.uint8 else values
        colours = CornerValues(values, _read_integers(arrays, "colour_indices"))
    origin = None
    if "origin" in arrays:
        if arrays["origin"].size != 2:
            raise InvalidSequenceError("the origin of the surface is not a format and a path")
        origin = _find_moved_origin(Origin(*map(str, arrays["origin"].reshape(-1))), folder)
    return Surface(
        uvs=uvs,
        colours=colours,
        hard_edges=_read_integers(arrays, "creases") if "creases" in arrays else None,
        face_sets=_read_face_sets(arrays) if "face_set_names" in arrays else (),
        objects=_read_objects(arrays) if "object_names" in arrays else (),
        subdivision=str(arrays["subdivision"].item()) if "subdivision" in arrays else "none",
        origin=origin,
    )


def _find_moved_origin(origin: Origin, folder: Path | None) -> Origin:
    """Return the origin with a path in `folder` if its file exists only there, for example after both files moved."""
    if folder is None or Path(origin.path).exists():
        return origin
    moved = folder.absolute() / Path(origin.path).name
    return Origin(origin.format, str(moved)) if moved.is_file() else origin


def _read_face_sets(arrays: Mapping[str, NDArray[Any]]) -> tuple[FaceSet, ...]:
    names, materials = arrays["face_set_names"].reshape(-1), arrays["face_set_materials"].reshape(-1)
    sizes, polygons = _read_integers(arrays, "face_set_sizes"), _read_integers(arrays, "face_set_polygons")
    if not len(names) == len(materials) == len(sizes) or (sizes < 0).any() or sizes.sum() != polygons.size:
        raise InvalidSequenceError("the face sets' names, materials, sizes and polygons do not fit each other")
    members = np.split(polygons, np.cumsum(sizes))
    return tuple(
        FaceSet(str(name), polygon_ids, str(material))
        for name, polygon_ids, material in zip(names, members, materials, strict=False)
    )


def _read_objects(arrays: Mapping[str, NDArray[Any]]) -> tuple[MeshObject, ...]:
    names, paths = arrays["object_names"].reshape(-1), arrays["object_paths"].reshape(-1)
    sizes = _read_integers(arrays, "object_sizes")
    usual = str(arrays["subdivision"].item()) if "subdivision" in arrays else "none"
    schemes = arrays.get("object_subdivisions", np.full(len(names), usual)).reshape(-1)
    if not len(names) == len(paths) == len(sizes) == len(schemes) or sizes.shape[1:] != (2,):
        raise InvalidSequenceError("the objects' names, paths, sizes and schemes of subdivision do not fit each other")
    return tuple(
        MeshObject(str(name), str(path), int(vertices), int(polygons), None if scheme == usual else str(scheme))
        for name, path, (vertices, polygons), scheme in zip(names, paths, sizes, schemes, strict=True)
    )


def _read_integers(arrays: Mapping[str, NDArray[Any]], name: str) -> Index:
    array = arrays[name]
    if array.dtype.kind not in "iu":
        raise InvalidSequenceError(f"{name} of the surface are {array.dtype}; integers are expected")
    return array.astype(np.int64)
