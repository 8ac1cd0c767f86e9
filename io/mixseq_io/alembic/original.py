"""Alembic, writing: the archive that is copied with new points, and its meshes that a sequence fits.

Which mesh of the archive a mesh of the sequence goes to is told by its path; where there is none, by its faces, if a
single mesh has them.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from mixseq.arrays import Index
from mixseq.errors import FormatError
from mixseq.polygon_matching import difference, matched
from mixseq.polygons import Polygons
from mixseq.sequence import SequenceHeader
from mixseq_io.alembic.archive_meshes import Mesh, find_meshes
from mixseq_io.alembic.library import ERRORS, length, open_archive
from mixseq_io.alembic.placing import Placing
from mixseq_io.alembic.polymesh import Source, stored_polygons
from mixseq_io.alembic.samples import determinant
from mixseq_io.choosing import listed
from mixseq_io.reader import naming, reading
from mixseq_io.scene_meshes import SceneMesh, split


@dataclass(frozen=True, eq=False)
class Fit:
    """A mesh of the sequence and the mesh of the archive whose points it takes the place of.

    Parameters
    ----------
    scene_mesh : SceneMesh
        That of the sequence.
    mesh : Mesh
        The mesh.
    corners : (C,) int
        The sequence's corner for every corner of the archive's polygons, which may be in another order.
    placing : Placing
        Where the transforms above the mesh are in every frame of the sequence.
    mirrored : bool
        Whether they turn left into right.
    """

    scene_mesh: SceneMesh
    mesh: Mesh
    corners: Index
    placing: Placing
    mirrored: bool


@dataclass(frozen=True, eq=False)
class Original:
    """An archive that a sequence fits.

    Parameters
    ----------
    path : Path
        The file.
    archive : IArchive
        What it holds.
    fits : tuple of Fit
        The meshes of the sequence, each with its mesh in the archive.
    """

    path: Path
    archive: Any
    fits: tuple[Fit, ...]

    @property
    def room(self) -> int:
        """Size of the file in bytes."""
        return self.path.stat().st_size


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open an archive in which meshes may get other points.

    Raises
    ------
    FormatError
        If it cannot be read, or the meshes of the sequence are not in it.
    """
    with reading(path, "Alembic", *ERRORS), naming(path):
        archive = open_archive(path)
        meshes, _ = find_meshes(path, archive)
        fits: list[Fit] = []
        for scene_mesh in split(header):
            taken = {fit.mesh.path for fit in fits}
            left = [mesh for mesh in meshes if mesh.path not in taken]
            fits.append(_fit(path, header, scene_mesh, left))
        return Original(path, archive, tuple(fits))


def _fit(path: Path, header: SequenceHeader, scene_mesh: SceneMesh, meshes: Sequence[Mesh]) -> Fit:
    """Return the mesh that a mesh of the sequence came from."""
    candidates = [mesh for mesh in meshes if mesh.path == scene_mesh.path] or meshes
    fitting = [fit for mesh in candidates if (fit := _fitted(path, header, scene_mesh, mesh)) is not None]
    wanted = scene_mesh.path or scene_mesh.name
    if len(fitting) == 1:
        try:
            fitting[0].placing.check()
        except FormatError as error:
            raise FormatError(f"{path}: nothing can be laid over {wanted!r}: {error}") from None
        return fitting[0]
    if fitting:
        several = listed([fit.mesh.path for fit in fitting])
        raise FormatError(f"{path} has {len(fitting)} meshes with the faces of {wanted!r}, {several}")
    why = f": {_difference(path, scene_mesh, candidates[0])}" if len(candidates) == 1 else ""
    raise FormatError(f"{path} has no mesh with the faces of {wanted!r}{why}")


def _fitted(path: Path, header: SequenceHeader, scene_mesh: SceneMesh, mesh: Mesh) -> Fit | None:
    """Lay a mesh of the sequence over one of the archive; None if it has other vertices or faces."""
    if length(mesh.schema.getPositionsProperty(), 0) != scene_mesh.vertex_count:
        return None
    placing = Placing.at(mesh.above, header.times, header.fps)
    mirrored = determinant(placing.matrices[0]) < 0
    theirs, order = _polygons(path, scene_mesh, mesh, mirrored)
    read = Polygons(theirs.counts, theirs.indices[order])
    ours = scene_mesh.as_numbered(read)
    match = None if ours is None else matched(read, ours.polygons)
    if ours is None or match is None:
        return None
    # Turning corners around twice changes nothing.
    return Fit(ours, mesh, match.corners[order], placing, mirrored)


def _polygons(path: Path, scene_mesh: SceneMesh, mesh: Mesh, mirrored: bool) -> tuple[Polygons, Index]:
    room = path.stat().st_size
    vertices = slice(0, scene_mesh.vertex_count)
    return stored_polygons(Source(path, room, mesh, vertices, mirrored, np.zeros(1)))


def _difference(path: Path, scene_mesh: SceneMesh, mesh: Mesh) -> str:
    """Return what is the first difference to the only mesh that could have been meant."""
    count = length(mesh.schema.getPositionsProperty(), 0)
    if count != scene_mesh.vertex_count:
        return f"{mesh.path} has {count} vertices, the sequence {scene_mesh.vertex_count}"
    theirs, order = _polygons(path, scene_mesh, mesh, mirrored=False)
    ours = scene_mesh.polygons
    return difference(ours, Polygons(theirs.counts, theirs.indices[order]), ("the sequence", mesh.path))
