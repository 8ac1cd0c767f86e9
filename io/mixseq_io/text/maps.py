"""Read and write map files, which give the source vertex or triangle of every target vertex or triangle.

``.npz`` has the arrays of a `Correspondence`, with checksums of both meshes' triangles, which detect other meshes.
Archives by other programs need ``vertices`` (V',), or ``triangles`` (F',), or both ``corners`` and ``weights`` (V', 3),
as in `mixseq.retargeting.correspond`. Other files are JSON, or text with one row per line (``docs/transfer.md``).

If the kind of map is not stated, rows of four or five numbers are barycentric. Rows of one or two numbers are vertices,
or triangles in ``.tricorrs`` files (Sumner and Popović). Triangle maps use the first source of each target. Rows of
several numbers may follow a line with the number of rows. A target without a row has no source.
"""

from __future__ import annotations

import hashlib
import re
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path
from typing import Any, Literal, get_args

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import FormatError, OutputError, SettingsError
from mixseq.retargeting.correspond import RestMesh, from_barycentric, from_triangles, from_vertices
from mixseq.retargeting.markers import Correspondence
from mixseq.types import Float, IntArray, PathLike
from mixseq_io.files import atomic_file
from mixseq_io.npz import open_archive
from mixseq_io.text.markers import parse_json, read_text

Kind = Literal["vertices", "triangles", "barycentric"]

_ROW_WIDTHS: dict[str, tuple[int, int]] = {"vertices": (1, 2), "triangles": (1, 2), "barycentric": (4, 5)}
"""Lengths of a row by kind of map, without and with the target."""

_SEPARATOR_PATTERN = re.compile(r"\s*(?:->|[,:;\s])\s*")

_Rows = list[tuple[str, list[float]]]
"""Location in the file, for messages, and numbers of every row."""

MAP_VERSION = 1

_STORED_ARRAYS = ("corners", "weights", "faces", "leaders", "sizes", "source", "target")


@dataclass(frozen=True, eq=False)
class MapFile:
    """Contents of a map file, before they are applied to meshes."""

    path: Path
    kind: str  # of rows: vertices, triangles, barycentric; of the arrays in an npz file: corners, stored
    rows: NDArray[np.float64]  # (n, k) rows as in docs/transfer.md; empty for arrays
    arrays: dict[str, NDArray[Any]]  # arrays of an npz file


MIN_MAPPED_RATIO = 0.1
"""Smallest mapped fraction of a mesh; a smaller map is probably a list of markers given by mistake."""


def read_map(path: PathLike) -> MapFile:
    """Read a map file in a format of ``docs/transfer.md``."""
    file = Path(path)
    if file.suffix.lower() == ".npz":
        return _read_npz(file)
    return MapFile(file, *_read_rows(file), {})


def to_correspondence(stored_map: MapFile, source: RestMesh, target: RestMesh) -> Correspondence:
    """Convert a map into the correspondence of a source and a target mesh, each with points ``(V, 3)``."""
    kind, arrays = stored_map.kind, stored_map.arrays
    try:
        if kind == "stored":
            return _stored_correspondence(arrays, source, target)
        if kind == "corners":
            return from_barycentric(arrays["corners"], arrays["weights"], source, target)
        if kind in arrays:
            source_ids, weights = arrays[kind], np.zeros((0, 0))
        else:
            target_count = len(target[1] if kind == "triangles" else target[0])
            source_ids, weights = _sort_by_target(stored_map.rows, target_count, kind)
            mapped_count = np.count_nonzero(source_ids >= 0)
            if mapped_count < MIN_MAPPED_RATIO * target_count:
                raise SettingsError(
                    f"it has rows for {mapped_count} of the target's {target_count} {kind}, too few for a map; if "
                    "these are markers, give them as markers"
                )
        if kind == "vertices":
            return from_vertices(source_ids, source, target)
        if kind == "triangles":
            return from_triangles(source_ids, source, target)
        outside_mask = (source_ids < -1) | (source_ids >= len(source[1]))
        if outside_mask.any():
            vertex = int(np.argmax(outside_mask))
            raise SettingsError(
                f"target vertex {vertex} is on triangle {source_ids[vertex]}, but the source has {len(source[1])}, "
                "numbered from 0"
            )
        corners = np.where(source_ids[:, None] >= 0, np.asarray(source[1])[source_ids], -1)
        return from_barycentric(corners, weights, source, target)
    except SettingsError as error:
        raise FormatError(f"{stored_map.path}: {error}") from None


def write_map(path: PathLike, correspondence: Correspondence, source_faces: IntArray, target_faces: IntArray) -> None:
    """Write the correspondence of meshes with triangles ``(F, 3)`` and ``(F', 3)`` atomically as an npz file."""
    file = Path(path)
    if file.suffix.lower() != ".npz":
        raise OutputError(f"{file}: maps are written as npz files; give it the extension .npz")
    sizes = correspondence.source_size, correspondence.target_size
    arrays: dict[str, Any] = {
        "version": np.int64(MAP_VERSION),
        "corners": correspondence.corners.astype(np.int32),
        "weights": correspondence.weights,
        "faces": correspondence.faces.astype(np.int32),
        "leaders": correspondence.leaders.astype(np.int32),
        "sizes": np.array(sizes, np.int64),
        "source": np.array(mesh_checksum(sizes[0][0], source_faces)),
        "target": np.array(mesh_checksum(sizes[1][0], target_faces)),
    }
    with atomic_file(file) as temporary, temporary.open("wb") as stream:
        np.savez_compressed(stream, allow_pickle=False, **arrays)


def mesh_checksum(vertex_count: int, faces: IntArray) -> str:
    """Return the SHA-256 of a mesh's vertex count and triangles ``(F, 3)``, which identifies the mesh."""
    hashed = hashlib.sha256(str(vertex_count).encode())
    hashed.update(np.ascontiguousarray(faces, "<i8").tobytes())
    return hashed.hexdigest()


def _read_npz(file: Path) -> MapFile:
    with open_archive(file) as archive:
        arrays = {name: archive.read(name) for name in archive.names}
    empty = np.zeros((0, 0))
    if "version" in arrays and "corners" in arrays:
        if arrays["version"].tolist() != MAP_VERSION:  # the array may have any type and shape
            raise FormatError(
                f"{file} is a map of version {arrays['version']!s:.20}; this mixseq reads version {MAP_VERSION}"
            )
        missing = [name for name in _STORED_ARRAYS if name not in arrays]
        if missing:
            raise FormatError(f"{file} has no array {missing[0]!r}; it is damaged")
        return MapFile(file, "stored", empty, arrays)
    if {"corners", "weights"} <= arrays.keys():
        return MapFile(file, "corners", empty, arrays)
    for kind in ("vertices", "triangles"):
        if kind in arrays:
            return MapFile(file, kind, empty, arrays)
    raise FormatError(
        f"{file} has the arrays {', '.join(arrays) or 'none'}; a map has `vertices`, `triangles`, or `corners` and "
        "`weights`"
    )


def _stored_correspondence(arrays: dict[str, NDArray[Any]], source: RestMesh, target: RestMesh) -> Correspondence:
    """Return the correspondence stored by `write_map`; raise an error if it is damaged or belongs to other meshes."""
    sizes = [(len(points), len(faces)) for points, faces in (source, target)]
    for name, mesh in (("source", source), ("target", target)):
        if str(arrays[name]) != mesh_checksum(len(mesh[0]), mesh[1]):
            raise SettingsError(
                f"this is a map of another {name} with other vertices or triangles (this {name} has {len(mesh[0])} and "
                f"{len(mesh[1])}); make a new map from markers"
            )
    (source_vertices, source_faces), (vertices, faces) = sizes
    limits = {
        "corners": (source_vertices, (vertices, 3), -1),
        "faces": (source_faces, (faces,), -1),
        "leaders": (vertices, (vertices,), 0),
    }
    for name, (limit, shape, lowest) in limits.items():
        array = arrays[name]
        has_indices = array.shape == shape and np.issubdtype(array.dtype, np.integer)
        if not (has_indices and (array >= lowest).all() and (array < limit).all()):
            raise SettingsError(f"the array {name!r} does not fit the meshes; the file is damaged")
    weights = arrays["weights"]
    if weights.shape != (vertices, 3) or weights.dtype.kind != "f" or not np.isfinite(weights).all():
        raise SettingsError("the array 'weights' does not fit the meshes; the file is damaged")
    corners, source_triangles, leaders = (arrays[name].astype(np.int64) for name in limits)
    return Correspondence(sizes[0], sizes[1], corners, weights.astype(np.float64), source_triangles, leaders)


def _read_rows(file: Path) -> tuple[Kind, Float]:
    """Return the kind and rows ``(n, k)`` of a map; a kind that the file does not state follows from their length."""
    text = read_text(file, "a map")
    stated, rows = _parse_json(file, text) if file.suffix.lower() == ".json" else _parse_text(file, text)
    if not rows:
        raise FormatError(f"{file} has no rows of a map")
    width = len(rows[0][1])
    short_kind: Kind = "triangles" if file.suffix.lower() == ".tricorrs" else "vertices"
    kind = stated or ("barycentric" if width > 2 else short_kind)
    widths = _ROW_WIDTHS[kind]
    for location, row in rows:
        if len(row) != width or width not in widths:
            raise FormatError(
                f"{file}, {location} has {len(row)} numbers; rows of a {kind} map have {widths[0]} or {widths[1]}"
            )
    table = np.array([row for _, row in rows], np.float64)
    ids = table[:, : 1 + (width == widths[1])]
    wrong = np.argwhere(~((ids >= -1) & (ids < 1 << 53) & (ids == np.floor(ids))))
    if wrong.size:
        row, column = wrong[0]
        raise FormatError(
            f"{file}, {rows[row][0]}: {ids[row, column]:g} is not the number of a vertex or triangle, counted from 0"
        )
    return kind, table


def _parse_text(file: Path, text: str) -> tuple[Kind | None, _Rows]:
    stated: Kind | None = None
    rows: _Rows = []
    for number, line in enumerate(text.splitlines(), start=1):
        word = line.strip().lstrip("#").strip().lower()
        if not rows and word in get_args(Kind):
            stated = get_args(Kind)[get_args(Kind).index(word)]
            continue
        body = line.partition("#")[0].strip().rstrip(",;")
        if not body:
            continue
        try:
            rows.append((f"line {number}", [float(part) for part in _SEPARATOR_PATTERN.split(body)]))
        except ValueError:
            raise FormatError(
                f"{file}, line {number}: {body[:40]!r} is not a row of a map; numbers of the source and of the target "
                "are expected, separated by a space, comma, colon, semicolon or '->'"
            ) from None
    if len(rows) > 1 and len(rows[0][1]) == 1 < len(rows[1][1]):
        (expected,), rows = rows[0][1], rows[1:]
        if expected != len(rows):
            raise FormatError(f"{file} announces {expected:g} rows, but {len(rows)} follow; is it truncated?")
    return stated, rows


def _parse_json(file: Path, text: str) -> tuple[Kind | None, _Rows]:
    tree = parse_json(file, text)
    stated: Kind | None = None
    if isinstance(tree, dict):
        stated = next((kind for kind in get_args(Kind) if kind in tree), None)
        tree = tree.get(stated)
    if not isinstance(tree, list):
        raise FormatError(
            f"{file} has no map; a list is expected, by itself or as 'vertices', 'triangles' or 'barycentric'"
        )
    rows = enumerate(tree, start=1)
    return stated, [(f"row {number}", _parse_json_row(file, number, item)) for number, item in rows]


def _parse_json_row(file: Path, number: int, item: Any) -> list[float]:
    row = item if isinstance(item, list) else [-1 if item is None else item]
    try:
        if all(isinstance(value, int | float) and not isinstance(value, bool) for value in row):
            return [float(value) for value in row]
    except OverflowError:
        pass
    raise FormatError(f"{file}, row {number}: {str(item)[:40]} is not a row of numbers")


def _sort_by_target(
    rows: NDArray[np.float64], target_count: int, kind: str
) -> tuple[NDArray[np.int64], NDArray[np.float64]]:
    """Return source ids ``(n,)`` and weights ``(n, 3)`` of all targets, from rows with or without target ids."""
    source_ids = rows[:, 0].astype(np.int64)
    weights = rows[:, -3:] if kind == "barycentric" else rows[:, :0]
    if rows.shape[1] in (1, 4):
        if len(rows) != target_count:
            raise SettingsError(
                f"there are {len(rows)} rows; one for each of the target's {target_count} is expected, or give pairs"
            )
        return source_ids, weights
    target_ids = rows[:, 1].astype(np.int64)
    outside = target_ids[(target_ids < 0) | (target_ids >= target_count)]
    if outside.size:
        raise SettingsError(
            f"there is no target {outside[0]}: it has {target_count} ({kind}), from 0; rows have the source's number "
            "first, then the target's"
        )
    if kind != "triangles":
        for a, b in pairwise(np.argsort(target_ids, kind="stable").tolist()):
            if target_ids[a] == target_ids[b] and not np.array_equal(rows[a], rows[b]):
                raise SettingsError(f"target {target_ids[a]} is given two sources, {source_ids[a]} and {source_ids[b]}")
    unique_targets, first_rows = np.unique(target_ids, return_index=True)
    sorted_ids, sorted_weights = np.full(target_count, -1), np.zeros((target_count, weights.shape[1]))
    sorted_ids[unique_targets], sorted_weights[unique_targets] = source_ids[first_rows], weights[first_rows]
    return sorted_ids, sorted_weights
