"""Alembic, writing: the original archive that is copied with new points, and its meshes matched with a sequence's."""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.arrays import Index
from mixseq.errors import FormatError
from mixseq.polygon_matching import difference
from mixseq.polygons import Polygons
from mixseq.sequence import SequenceHeader
from mixseq_io.alembic.archive_meshes import Mesh, find_meshes
from mixseq_io.alembic.library import ERRORS, length, open_archive
from mixseq_io.alembic.placing import Placing
from mixseq_io.alembic.polymesh import Source, stored_polygons
from mixseq_io.alembic.samples import determinant
from mixseq_io.originals import fit_meshes
from mixseq_io.reader import naming, reading
from mixseq_io.scene_meshes import SceneMesh


@dataclass(frozen=True, eq=False)
class Fit:
    """Mesh of the sequence matched with a mesh of the archive, whose points it replaces."""

    scene_mesh: SceneMesh
    mesh: Mesh
    corners: Index
    placing: Placing
    mirrored: bool


@dataclass(frozen=True, eq=False)
class Original:
    """Archive that fits a sequence."""

    path: Path
    archive: Any
    fits: tuple[Fit, ...]

    @property
    def room(self) -> int:
        """Size of the file in bytes."""
        return self.path.stat().st_size


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open an archive whose meshes may get new points."""
    with reading(path, "Alembic", *ERRORS), naming(path):
        archive = open_archive(path)
        meshes, _ = find_meshes(path, archive)
        fits = fit_meshes(
            path,
            header,
            {mesh.path: mesh for mesh in meshes},
            partial(_fitted, path, header),
            partial(_difference, path),
        )
        for fit in fits:
            try:
                fit.placing.check()
            except FormatError as error:
                raise FormatError(f"{path}: nothing can be laid over {fit.mesh.path!r}: {error}") from None
        return Original(path, archive, tuple(fits))


def _fitted(path: Path, header: SequenceHeader, scene_mesh: SceneMesh, mesh: Mesh) -> Fit | None:
    """Match a mesh of the sequence with one of the archive; None if vertices or faces differ."""
    if length(mesh.schema.getPositionsProperty(), 0) != scene_mesh.vertex_count:
        return None
    placing = Placing.at(mesh.above, header.times, header.fps)
    mirrored = determinant(placing.matrices[0]) < 0
    theirs, order = _polygons(path, scene_mesh, mesh, mirrored)
    read = Polygons(theirs.counts, theirs.indices[order])
    found = scene_mesh.matched_to(read)
    if found is None:
        return None
    ours, match = found
    # Turning corners around twice changes nothing.
    return Fit(ours, mesh, match.corners[order], placing, mirrored)


def _polygons(path: Path, scene_mesh: SceneMesh, mesh: Mesh, mirrored: bool) -> tuple[Polygons, Index]:
    room = path.stat().st_size
    vertices = slice(0, scene_mesh.vertex_count)
    return stored_polygons(Source(path, room, mesh, vertices, mirrored, np.zeros(1)))


def _difference(path: Path, scene_mesh: SceneMesh, mesh: Mesh) -> str:
    """Return the first difference from the only candidate mesh, in words."""
    count = length(mesh.schema.getPositionsProperty(), 0)
    if count != scene_mesh.vertex_count:
        return f"{mesh.path} has {count} vertices, the sequence {scene_mesh.vertex_count}"
    theirs, order = _polygons(path, scene_mesh, mesh, mirrored=False)
    ours = scene_mesh.polygons
    return difference(ours, Polygons(theirs.counts, theirs.indices[order]), ("the sequence", mesh.path))
