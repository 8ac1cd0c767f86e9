"""Files of labels: read from one of a file's sources, checked to fit the mesh, and written.

=============  ==========================================================================================
source         meaning
=============  ==========================================================================================
``labels``     npz: an array ``part_of_face`` or ``labels`` with a number or name for every triangle or every
               polygon; USD: the family ``mixseq`` of subsets. Both are written by ``mixseq segment``.
``groups``     named sets of faces: OBJ groups, Alembic face sets, USD subsets without a family
*a family*     USD: the subsets of any other family
``materials``  the faces of every material
``colours``    colours of vertices, faces or corners, in all formats that have some
``skeleton``   weights of skins: UsdSkel, glTF
=============  ==========================================================================================

`labels` come first, since they were made as labels. Sources with one label for all faces count only on request.

Parts are written as arrays of triangles (npz), or of polygons, each in the part of most of its triangles: as subsets of
the faces (USD), or as groups (OBJ, Alembic, HDF5).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from mixseq.errors import AmbiguousError, FormatError, InvalidSequenceError, OutputError, SettingsError
from mixseq.mesh.polygons import Polygons, match_triangles
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
    polygon_labels,
    triangle_labels,
)

Sources = dict[str, Callable[[], Labels]]

LABEL_ARRAYS = ("part_of_face", "labels")
"""Names of label arrays in npz files; the first that exists counts."""


def read_labels(
    path: PathLike,
    sequence: Frames | SequenceHeader,
    source: str | None = None,
    *,
    smallest_joint: float = MIN_JOINT_FACE_RATIO,
    **options: Any,
) -> Labels:
    """Read labels of a mesh's faces from a file, unchanged.

    `mixseq.segmentation.segment_by_labels` makes a segmentation of them, whose parts are connected.

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
    sources = _stored(file, header)
    if _is_mesh(file) and not (sources and source in (None, LABELS_SOURCE)):
        with open_sequence(file, **options) as reader:
            sources |= _marked(reader, header, smallest_joint)
    return _chosen(file, sources, source)()


def extract_labels(
    reader: SequenceReader, source: str | None = None, *, smallest_joint: float = MIN_JOINT_FACE_RATIO
) -> Labels:
    """Return the labels from an open sequence's own file; see `read_labels`."""
    sources = _stored(reader.path, reader.header) | _marked(reader, reader.header, smallest_joint)
    return _chosen(reader.path, sources, source)()


def _chosen(file: Path, sources: Sources, wanted: str | None) -> Callable[[], Labels]:
    if wanted == LABEL_SUBSET_FAMILY and wanted not in sources:
        wanted = LABELS_SOURCE  # what the family that `mixseq segment` writes is called here
    if wanted is not None:
        if wanted not in sources:
            raise FormatError(f"{file} has no {wanted!r} to label faces by; {_what_there_is(list(sources))}")
        return sources[wanted]
    if LABELS_SOURCE in sources:
        return sources[LABELS_SOURCE]
    if len(sources) == 1:
        return next(iter(sources.values()))
    telling = {}
    for name, make in sources.items():
        # Sources that cannot be labels (a painted mesh), or have a single one, do not make the choice ambiguous.
        try:
            labels = make()
        except FormatError:
            continue
        if len(labels.names) > 1:
            telling[name] = labels
    if len(telling) == 1:
        (only,) = telling.values()
        return lambda: only
    if not telling:
        raise FormatError(f"{file} has no labels of faces; {_what_there_is(list(sources))}")
    raise AmbiguousError(
        f"{file} has several sources of labels: {', '.join(telling)}; choose one with source=... (--source)"
    )


def _what_there_is(sources: list[str]) -> str:
    if not sources:
        return (
            "it has no array of labels, sets of faces, materials, vertex colours or skin; give another file"
        )
    return f"it has {', '.join(sources)}"


def _stored(file: Path, header: SequenceHeader) -> Sources:
    """Return the label array of an npz file, if any, as a source."""
    if file.suffix.lower() != ".npz":
        return {}
    with open_archive(file) as archive:
        members = archive.names
        name = next((each for each in LABEL_ARRAYS if each in members), "")
        values = archive.read(name) if name else None
        names = archive.read("names") if "names" in members else None
    if values is not None:
        labels = _of_array(file, name, values, names, header.polygons)
        return {LABELS_SOURCE: lambda: labels}
    if "points" not in members:
        raise FormatError(
            f"{file} has the arrays {', '.join(sorted(members)) or 'none'}; `part_of_face` or `labels`, a number for "
            "every triangle or polygon, is needed"
        )
    return {}


def _is_mesh(file: Path) -> bool:
    """Whether a file is a sequence, as opposed to an array of labels."""
    if file.suffix.lower() != ".npz":
        return True
    with open_archive(file) as archive:
        return "points" in archive.names


def _of_array(
    file: Path, name: str, values: NDArray[Any], names: NDArray[Any] | None, polygons: Polygons
) -> Labels:
    triangles, count = len(polygons.triangles), len(polygons.counts)
    if values.ndim != 1 or values.dtype.kind not in "iuU":
        raise FormatError(
            f"{file}: {name} has shape {values.shape} and type {values.dtype}; a list of whole numbers or names is "
            "expected"
        )
    if len(values) not in (triangles, count):
        raise FormatError(
            f"{file} has {len(values)} labels, but the mesh has {triangles} triangles"
            + (f" and {count} polygons" if count != triangles else "")
            + "; give one for each"
        )
    if (
        names is not None
        and values.dtype.kind != "U"
        and values.size
        and are_valid_indices(values, np.size(names))
    ):
        dense, texts = values, tuple(str(each) for each in np.ravel(names).tolist())
    else:
        kinds, dense = np.unique(values, return_inverse=True)
        texts = tuple(str(each) for each in kinds.tolist())
    whole = len(values) != triangles
    return Labels(triangle_labels(dense, polygons) if whole else dense, texts)


def _marked(reader: SequenceReader, header: SequenceHeader, smallest: float) -> Sources:
    """Return labels from a file's markings, for a mesh with the same faces in any order."""
    from mixseq_io.text.derived_labels import labels_of_sets, labels_of_skinning

    if not 0 <= smallest <= 1:
        raise SettingsError(f"smallest_joint is {smallest}; a share of the faces, from 0 to 1, is expected")
    file, polygons = reader.path, reader.header.polygons
    face = _same_faces(file, header, reader.header)
    markings = reader.markings()
    sources: Sources = {name: partial(labels_of_sets, sets, polygons) for name, sets in markings.sets.items()}
    colours = reader.header.surface.colours
    if colours is not None:
        sources[COLOURS_SOURCE] = partial(_colours, file, colours.at_corners, polygons)
    if markings.skinning is not None:
        sources[SKELETON_SOURCE] = partial(labels_of_skinning, markings.skinning, polygons, smallest)
    if face is None:
        return sources
    return {name: partial(_carried, make, face) for name, make in sources.items()}


def _carried(make: Callable[[], Labels], face: Index) -> Labels:
    """Return the labels of reordered faces; all triangles of a polygon have the polygon's label."""
    labels = make()
    return replace(labels, part_of_face=labels.part_of_face[face])


def _colours(file: Path, colours: FloatArray, polygons: Polygons) -> Labels:
    from mixseq_io.text.derived_labels import labels_of_colours

    try:
        return labels_of_colours(colours, polygons)
    except FormatError as error:
        raise FormatError(f"{file} {error}") from None


def _same_faces(file: Path, header: SequenceHeader, found: SequenceHeader) -> Index | None:
    """Return the file's triangle of each of the sequence's ``(F,)``, None if in the same order; refuse another mesh.

    In the same order vertices may be split or welded differently; in another one they must be equal.
    """
    ours, theirs = header.faces, found.faces
    if len(ours) != len(theirs):
        raise FormatError(
            f"{file} has {len(theirs)} triangles, the sequence {len(ours)}; labels need a file of the same mesh"
        )
    a, b = ours.reshape(-1), theirs.reshape(-1)
    if np.array_equal(a, b) or _follows(a, b) or _follows(b, a):
        return None
    try:
        return match_triangles(header.polygons, found.polygons, ("the sequence", str(file)))
    except InvalidSequenceError as error:
        raise FormatError(f"{error}; labels need a file of the same mesh") from None


def _follows(a: IntArray, b: IntArray) -> bool:
    """Whether equal vertices of a are equal in b: b is a, with some vertices welded."""
    pairs = np.unique(np.stack([a, b], axis=1), axis=0)
    return len(pairs) == len(np.unique(a))


ARRAYS, SUBSETS, SETS = "npz", "USD", ("OBJ", "Alembic", "HDF5 sequence")
"""Names of the formats that hold parts: as arrays, as subsets, as face sets."""


def write_labels(
    path: PathLike, sequence: MeshSequence | SequenceReader, labels: Labels, *, flatten: bool = False
) -> None:
    """Write the parts of a mesh; all but npz files include the animation.

    - ``.npz``: the arrays ``part_of_face`` (triangles), ``part_of_polygon`` and ``names``, nothing else.
    - USD: a subset of the family ``mixseq`` for every part. Over a reader's file it is a layer that only adds these, so
      that points, skeletons and materials are still those of the file.
    - OBJ, Alembic and HDF5 sequences: a face set for every part in place of those without material.
    """
    file, header = Path(path), sequence.header
    form = check_label_target(file)
    if form == ARRAYS:
        _write_arrays(file, header, labels)
        return
    of_polygon = polygon_labels(labels.part_of_face, header.polygons)
    _warn_of_cut_polygons(file, header, labels, of_polygon)
    if form == SUBSETS:
        _write_subsets(file, sequence, of_polygon, labels.names, flatten)
        return
    sets = tuple(FaceSet(name, np.flatnonzero(of_polygon == part)) for part, name in enumerate(labels.names))
    kept = tuple(each for each in header.surface.face_sets if each.material)
    surface = replace(header.surface, face_sets=kept + tuple(each for each in sets if each.polygons.size))
    points, velocities = _values(sequence)
    alone = {"flatten": True} if form == "Alembic" else {}  # a copy of the original would have its face sets
    write_blocks(file, replace(header, surface=surface), points, velocities, **alone)


def check_label_target(path: PathLike) -> str:
    """Return the name of a file's format; raise an error if it cannot hold parts."""
    extension = Path(path).suffix.lower()
    able = [form for form in FORMATS if form.name in (ARRAYS, SUBSETS, *SETS)]
    for form in able:
        if extension in form.extensions:
            return form.name
    known = ", ".join(each for form in able for each in form.extensions)
    raise OutputError(
        f"{path}: {extension or 'a file without extension'} has no place for parts; write one of {known}"
    )


def _write_arrays(file: Path, header: SequenceHeader, labels: Labels) -> None:
    with atomic_file(file) as temporary:
        np.savez(
            temporary,
            part_of_face=labels.part_of_face,
            part_of_polygon=polygon_labels(labels.part_of_face, header.polygons),
            names=np.array(labels.names),
        )


def _write_subsets(
    file: Path,
    sequence: MeshSequence | SequenceReader,
    of_polygon: IntArray,
    names: Sequence[str],
    flatten: bool,
) -> None:
    from mixseq_io.usd.writer import FaceParts, write_usd, write_usd_parts

    header = sequence.header
    ends = np.cumsum([each.polygon_count for each in header.objects])[:-1]
    parts = FaceParts(tuple(np.split(of_polygon, ends)), names)
    origin = header.surface.origin
    untouched = (
        isinstance(sequence, SequenceReader)
        and origin is not None
        and Path(origin.path).exists()
        and sequence.path.exists()
        and sequence.path.samefile(origin.path)
    )
    if untouched and not flatten and file.suffix.lower() != ".usdz" and write_usd_parts(file, header, parts):
        return
    if isinstance(sequence, SequenceReader):
        header = _without(header, sequence.markings().sets.get(LABELS_SOURCE, ()))
    write_usd(file, header, *_values(sequence), flatten=flatten, parts=parts)


def _without(header: SequenceHeader, old: Sequence[FaceSet]) -> SequenceHeader:
    """Return a header without the parts that its mesh had before."""
    parts = {(each.name, each.polygons.tobytes()) for each in old}
    kept = (each for each in header.surface.face_sets if (each.name, each.polygons.tobytes()) not in parts)
    return replace(header, surface=replace(header.surface, face_sets=tuple(kept)))


def _values(
    sequence: MeshSequence | SequenceReader,
) -> tuple[Iterable[FloatArray], Iterable[FloatArray] | None]:
    """Return the blocks of a sequence's points, and of its velocities or None."""
    if isinstance(sequence, SequenceReader):
        return sequence.blocks(), sequence.velocity_blocks()
    return [sequence.points], None if sequence.velocities is None else [sequence.velocities]


def _warn_of_cut_polygons(file: Path, header: SequenceHeader, labels: Labels, of_polygon: IntArray) -> None:
    apart = labels.part_of_face != triangle_labels(of_polygon, header.polygons)
    cut = np.unique(np.repeat(np.arange(len(of_polygon)), header.polygons.counts - 2)[apart])
    if cut.size:
        warn(
            f"{file}: {cut.size} of {len(of_polygon)} polygons are in several parts; each goes to that of most of its "
            "triangles (.npz keeps triangles)"
        )
