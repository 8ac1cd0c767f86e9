"""Read labels from one of several sources in a file, check that they fit the mesh, and write labels.

Sources are label arrays (npz) and the family ``mixseq`` of subsets (USD), both named ``labels``; named sets of faces
(``groups``), any other family of USD subsets, ``materials``, ``colours``, and skinning weights (``skeleton``).
``docs/formats.md`` lists them by format. `labels` are preferred, since they were stored as labels. Other sources need
at least two labels.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import AmbiguousError, FormatError, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons, describe_difference
from mixseq.mesh.surface import FaceSet
from mixseq.sequence.header import SequenceHeader
from mixseq.sequence.sequence import Frames, MeshSequence
from mixseq.types import FloatArray, Index, IntArray, PathLike
from mixseq_io.files import atomic_file
from mixseq_io.npz import open_archive
from mixseq_io.reader import SequenceReader, warn
from mixseq_io.registry import FORMATS, open_sequence, write_blocks
from mixseq_io.surfaces import are_valid_indices
from mixseq_io.text.labels import (
    COLOURS_SOURCE,
    LABEL_SUBSET_FAMILY,
    LABELS_SOURCE,
    MIN_JOINT_FACE_RATIO,
    SKELETON_SOURCE,
    Labels,
    labels_from_colours,
    labels_from_sets,
    labels_from_skinning,
    polygon_labels,
    triangle_labels,
)

Sources = dict[str, Callable[[], Labels]]

LABEL_ARRAY_NAMES = ("part_of_face", "labels")
"""Possible names of the label array in npz files; the first existing array is read."""

_MESH_ARRAYS = ("polygon_counts", "polygon_indices", "object_vertices")
"""Names of the arrays that store the mesh of labels in npz files."""


def read_labels(
    path: PathLike,
    sequence: Frames | SequenceHeader,
    source: str | None = None,
    *,
    smallest_joint: float = MIN_JOINT_FACE_RATIO,
    **options: Any,
) -> Labels:
    """Read the labels of a mesh's faces from a file without changing them.

    `mixseq.segmentation.segment_by_labels` converts them into a segmentation with connected parts.

    Examples
    --------
    >>> import tempfile
    >>> from mixseq.creature import walk_cycle
    >>> walk = walk_cycle(frames=1)
    >>> with tempfile.TemporaryDirectory() as folder:
    ...     np.savez(folder + "/halves.npz", labels=np.arange(len(walk.faces)) % 2)
    ...     labels = read_labels(folder + "/halves.npz", walk)
    >>> labels.part_of_face[:3].tolist(), labels.names
    ([0, 1, 0], ('0', '1'))
    """
    file = Path(path)
    header = sequence if isinstance(sequence, SequenceHeader) else sequence.header
    sources, is_mesh = _read_array(file, header)
    if is_mesh and not (sources and source in (None, LABELS_SOURCE)):
        with open_sequence(file, **options) as reader:
            sources |= _markings_sources(reader, header, smallest_joint)
    return _choose_labels(file, sources, source)


def extract_labels(reader: SequenceReader, source: str | None = None) -> Labels:
    """Read the labels in the file of an open sequence; see `read_labels`."""
    sources, _ = _read_array(reader.path, reader.header)
    sources |= _markings_sources(reader, reader.header, MIN_JOINT_FACE_RATIO)
    return _choose_labels(reader.path, sources, source)


def _choose_labels(file: Path, sources: Sources, source: str | None) -> Labels:
    available = f"it has {', '.join(sources)}"
    if not sources:
        available = "it has no labels, face sets, materials, vertex colours or skin; give another file"
    if source == LABEL_SUBSET_FAMILY and source not in sources:
        source = LABELS_SOURCE  # `mixseq segment` writes this family
    if source is not None:
        if source not in sources:
            raise FormatError(f"{file} has no {source!r} to label faces by; {available}")
        return sources[source]()
    if LABELS_SOURCE in sources:
        return sources[LABELS_SOURCE]()
    if len(sources) == 1:
        return next(iter(sources.values()))()
    candidates = {}
    for name, make_labels in sources.items():
        # Skip sources that are not labels, such as painted colours, and sources with a single label.
        try:
            labels = make_labels()
        except FormatError:
            continue
        if len(labels.names) > 1:
            candidates[name] = labels
    if not candidates:
        raise FormatError(f"{file} has no labels of faces; {available}")
    if len(candidates) > 1:
        raise AmbiguousError(
            f"{file} has several sources of labels: {', '.join(candidates)}; choose one with source=... (--source)"
        )
    return next(iter(candidates.values()))


def _read_array(file: Path, header: SequenceHeader) -> tuple[Sources, bool]:
    """Return the label array of an npz file, if any, as a source; also return whether the file has a mesh."""
    if file.suffix.lower() != ".npz":
        return {}, True
    with open_archive(file) as archive:
        members = archive.names
        name = next((name for name in LABEL_ARRAY_NAMES if name in members), "")
        values = archive.read(name) if name else None
        names = archive.read("names") if "names" in members else None
        mesh = [archive.read(each) for each in _MESH_ARRAYS if each in members]
    if values is not None:
        polygons, sizes = header.polygons, _object_sizes(header)
        if len(mesh) == len(_MESH_ARRAYS):
            polygons, sizes = Polygons(mesh[0], mesh[1]), mesh[2].tolist()
        provenance = header.provenance
        if not mesh and provenance is not None and provenance.kept_order != "keep":
            raise FormatError(
                f"{file} has labels without a mesh, and faces of {provenance.name} have other numbers than in the "
                f"original (order {provenance.kept_order!r}); give labels that mixseq segment wrote, or compress the "
                "original with order='keep'"
            )
        labels = _labels_from_array(file, name, values, names, polygons)
        face_ids = _match_faces(file, header, polygons, sizes)
        labels = labels if face_ids is None else _reorder_labels(labels, face_ids)
        return {LABELS_SOURCE: lambda: labels}, "points" in members
    if "points" not in members:
        raise FormatError(
            f"{file} has the arrays {', '.join(sorted(members)) or 'none'}; `part_of_face` or `labels`, a number for "
            "every triangle or polygon, is needed"
        )
    return {}, True


def _labels_from_array(
    file: Path, name: str, values: NDArray[Any], names: NDArray[Any] | None, polygons: Polygons
) -> Labels:
    triangle_count, polygon_count = len(polygons.triangles), len(polygons.counts)
    if values.ndim != 1 or values.dtype.kind not in "iuU":
        raise FormatError(
            f"{file}: {name} has shape {values.shape} and type {values.dtype}; a list of whole numbers or names is "
            "expected"
        )
    if len(values) not in (triangle_count, polygon_count):
        raise FormatError(
            f"{file} has {len(values)} labels, but the mesh has {triangle_count} triangles"
            + (f" and {polygon_count} polygons" if polygon_count != triangle_count else "")
            + "; give one for each"
        )
    has_indices = values.dtype.kind != "U" and values.size > 0
    if names is not None and has_indices and are_valid_indices(values, np.size(names)):
        labels, label_names = values, np.ravel(names).tolist()
    else:
        distinct, labels = np.unique(values, return_inverse=True)
        label_names = distinct.tolist()
    if len(values) != triangle_count:
        labels = triangle_labels(labels, polygons)
    return Labels(labels, tuple(map(str, label_names)))


def _markings_sources(reader: SequenceReader, header: SequenceHeader, min_ratio: float) -> Sources:
    """Return the sources of labels in an open file, for a mesh with the same faces in any order."""
    if not 0 <= min_ratio <= 1:
        raise SettingsError(f"smallest_joint is {min_ratio}; a fraction of the faces is expected, 0 to 1")
    file, polygons = reader.path, reader.header.polygons
    face_ids = _match_faces(file, header, polygons, _object_sizes(reader.header))
    markings = reader.markings()
    sets = markings.sets.items()
    sources: Sources = {name: partial(labels_from_sets, own, polygons) for name, own in sets}
    colours = reader.header.surface.colours
    if colours is not None:
        sources[COLOURS_SOURCE] = partial(labels_from_colours, file, colours.at_corners, polygons)
    if markings.skinning is not None:
        sources[SKELETON_SOURCE] = partial(labels_from_skinning, markings.skinning, polygons, min_ratio)
    if face_ids is None:
        return sources
    return {name: partial(lambda make: _reorder_labels(make(), face_ids), make) for name, make in sources.items()}


def _object_sizes(header: SequenceHeader) -> list[int]:
    return [each.vertex_count for each in header.objects]


def _reorder_labels(labels: Labels, face_ids: Index) -> Labels:
    """Reorder labels by face ids ``(F,)``."""
    return replace(labels, part_of_face=labels.part_of_face[face_ids])


def _match_faces(file: Path, header: SequenceHeader, polygons: Polygons, sizes: Sequence[int]) -> Index | None:
    """Return the file's triangle for each triangle ``(F,)`` of the sequence, or None if the order is the same.

    Triangles in the same order may have differently split vertices. Another order needs equal vertices, or vertices
    that were renumbered by a compressed file. `sizes` are the numbers of vertices of the objects in the file.
    """
    from mixseq.compression.numbering import match_meshes, mesh_of, warn_of_numbers  # imports numba

    a, b = header.faces.reshape(-1), polygons.triangles.reshape(-1)
    if len(a) != len(b):
        raise FormatError(
            f"{file} has {len(b) // 3} triangles, the sequence {len(a) // 3}; labels need a file of the same mesh"
        )
    if np.array_equal(a, b) or _is_welded(a, b) or _is_welded(b, a):
        return None
    numbering = match_meshes((polygons, sizes), mesh_of(header))
    if numbering is None:
        difference = describe_difference(header.polygons, polygons, ("the sequence", str(file)))
        raise FormatError(f"{difference}; labels need a file of the same mesh")
    is_free, reorders_faces = numbering.order == "free", numbering.reorders_faces
    warn_of_numbers(file.name, header.file_name, vertices=is_free, faces=reorders_faces)
    return np.asarray(numbering.renumber_labels(np.arange(len(b) // 3), polygons))


def _is_welded(a: IntArray, b: IntArray) -> bool:
    """Whether corners b result from corners a by welding: corners with equal vertices in a have equal vertices in b."""
    pairs = np.unique(np.stack([a, b], axis=1), axis=0)
    return len(pairs) == len(np.unique(a))


_ARRAY_FORMAT, _SUBSET_FORMAT, _FACE_SET_FORMATS = "npz", "USD", ("OBJ", "Alembic", "HDF5 sequence")
"""Names of the formats that store parts as arrays, as subsets, and as face sets."""


def write_labels(
    path: PathLike, sequence: MeshSequence | SequenceReader, labels: Labels, *, flatten: bool = False
) -> None:
    """Write the parts of a mesh; in all formats except npz the file also contains the animation.

    - ``.npz``: only the arrays ``part_of_face`` (triangles), ``part_of_polygon`` and ``names``, and the mesh's polygons
      (``polygon_counts``, ``polygon_indices``, ``object_vertices``), by which labels find their faces in other orders.
    - USD: a subset of the family ``mixseq`` for every part. If `sequence` is a reader of a USD file, the output is a
      layer that adds only these subsets to the file.
    - OBJ, Alembic and HDF5 sequences: a face set for every part; other face sets without material are removed.
    """
    file, header = Path(path), sequence.header
    format_name = check_label_target(file)
    of_polygon = polygon_labels(labels.part_of_face, header.polygons)
    if format_name == _ARRAY_FORMAT:
        faces, names = labels.part_of_face, np.array(labels.names)
        mesh_arrays = header.polygons.counts, header.polygons.indices, np.array(_object_sizes(header))
        with atomic_file(file) as temporary:
            arrays: dict[str, Any] = dict(zip(_MESH_ARRAYS, mesh_arrays, strict=True))
            np.savez(temporary, part_of_face=faces, part_of_polygon=of_polygon, names=names, **arrays)
        return
    _warn_of_cut_polygons(file, header, labels, of_polygon)
    if format_name == _SUBSET_FORMAT:
        _write_subsets(file, sequence, of_polygon, labels.names, flatten)
        return
    parts = (FaceSet(name, np.flatnonzero(of_polygon == part)) for part, name in enumerate(labels.names))
    with_material = tuple(face_set for face_set in header.surface.face_sets if face_set.material)
    face_sets = with_material + tuple(part for part in parts if part.polygons.size)
    surface = replace(header.surface, face_sets=face_sets)
    points, velocities = _blocks(sequence)
    # a copy of the original file would contain the old face sets
    options = {"flatten": True} if format_name == "Alembic" else {}
    write_blocks(file, replace(header, surface=surface), points, velocities, **options)


def check_label_target(path: PathLike) -> str:
    """Return the name of a file's format; raise an error if the format cannot store parts."""
    extension = Path(path).suffix.lower()
    names = (_ARRAY_FORMAT, _SUBSET_FORMAT, *_FACE_SET_FORMATS)
    formats = {known: form.name for form in FORMATS if form.name in names for known in form.extensions}
    if extension not in formats:
        kind = extension or "a file without extension"
        raise OutputError(f"{path}: {kind} has no place for parts; write one of {', '.join(formats)}")
    return formats[extension]


def _write_subsets(
    file: Path, sequence: MeshSequence | SequenceReader, of_polygon: IntArray, names: Sequence[str], flatten: bool
) -> None:
    from mixseq_io.usd.writer import FaceParts, write_usd, write_usd_parts

    header = sequence.header
    ends = np.cumsum([mesh.polygon_count for mesh in header.objects])[:-1]
    parts = FaceParts(tuple(np.split(of_polygon, ends)), names)
    origin = header.surface.origin
    is_original = (
        isinstance(sequence, SequenceReader)
        and origin is not None
        and Path(origin.path).exists()
        and sequence.path.exists()
        and sequence.path.samefile(origin.path)
    )
    is_layer = is_original and not flatten and file.suffix.lower() != ".usdz"
    if is_layer and write_usd_parts(file, header, parts):
        return
    if isinstance(sequence, SequenceReader):
        header = _remove_face_sets(header, sequence.markings().sets.get(LABELS_SOURCE, ()))
    write_usd(file, header, *_blocks(sequence), flatten=flatten, parts=parts)


def _remove_face_sets(header: SequenceHeader, old: Sequence[FaceSet]) -> SequenceHeader:
    """Return a header without the face sets `old`, which are the previous parts of the mesh."""
    removed = {(face_set.name, face_set.polygons.tobytes()) for face_set in old}
    face_sets = header.surface.face_sets
    kept = (part for part in face_sets if (part.name, part.polygons.tobytes()) not in removed)
    return replace(header, surface=replace(header.surface, face_sets=tuple(kept)))


def _blocks(sequence: MeshSequence | SequenceReader) -> tuple[Iterable[FloatArray], Iterable[FloatArray] | None]:
    """Return the blocks of a sequence's points, and the blocks of its velocities or None."""
    if isinstance(sequence, SequenceReader):
        return sequence.blocks(), sequence.velocity_blocks()
    return [sequence.points], None if sequence.velocities is None else [sequence.velocities]


def _warn_of_cut_polygons(file: Path, header: SequenceHeader, labels: Labels, of_polygon: IntArray) -> None:
    cut_mask = labels.part_of_face != triangle_labels(of_polygon, header.polygons)
    cut_ids = np.unique(np.repeat(np.arange(len(of_polygon)), header.polygons.counts - 2)[cut_mask])
    if cut_ids.size:
        warn(
            f"{file}: {cut_ids.size} of {len(of_polygon)} polygons are in several parts; each is written to the part "
            "of most of its triangles (.npz keeps triangles)"
        )
