"""Write parts as arrays (npz), as subsets of the faces (USD), or as groups (OBJ, Alembic, HDF5).

npz files store triangles. The other formats store polygons, each in the part of most of its triangles.
"""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from mixseq.arrays import FloatArray, IntArray, PathLike
from mixseq.errors import OutputError
from mixseq.sequence import MeshSequence, SequenceHeader
from mixseq.surface import FaceSet
from mixseq_io.atomic import replacing
from mixseq_io.blocks import warn
from mixseq_io.formats import FORMATS
from mixseq_io.labels.faces import Labels, polygon_labels, triangle_labels
from mixseq_io.labels.markings import LABELS
from mixseq_io.reader import SequenceReader
from mixseq_io.registry import write_blocks

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
    form = check_holds_labels(file)
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


def check_holds_labels(path: PathLike) -> str:
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
    with replacing(file) as temporary:
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
    from mixseq_io.usd.part_labels import Parts
    from mixseq_io.usd.writer import write_usd, write_usd_parts

    header = sequence.header
    ends = np.cumsum([each.polygon_count for each in header.objects])[:-1]
    parts = Parts(tuple(np.split(of_polygon, ends)), names)
    origin = header.surface.origin
    untouched = (
        isinstance(sequence, SequenceReader) and origin is not None and _same(origin.path, sequence.path)
    )
    if untouched and not flatten and file.suffix.lower() != ".usdz" and write_usd_parts(file, header, parts):
        return
    if isinstance(sequence, SequenceReader):
        header = _without(header, sequence.markings().sets.get(LABELS, ()))
    write_usd(file, header, *_values(sequence), flatten=flatten, parts=parts)


def _without(header: SequenceHeader, old: Sequence[FaceSet]) -> SequenceHeader:
    """Return a header without the parts that its mesh had before."""
    parts = {(each.name, each.polygons.tobytes()) for each in old}
    kept = (each for each in header.surface.face_sets if (each.name, each.polygons.tobytes()) not in parts)
    return replace(header, surface=replace(header.surface, face_sets=tuple(kept)))


def _same(a: str, b: Path) -> bool:
    return Path(a).exists() and b.exists() and b.samefile(a)


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
