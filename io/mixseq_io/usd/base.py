"""USD, writing: the file that new points are laid over, and its meshes that a sequence fits.

Which mesh a piece of the sequence goes to is told by its path; where there is no mesh, by its faces, if a single mesh
has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from mixseq.errors import FormatError, OutputError
from mixseq.sequence import IntArray, SequenceHeader
from mixseq_io.pieces import Piece, split
from mixseq_io.usd.diagnostics import reading_usd
from mixseq_io.usd.paths import is_prim_path
from mixseq_io.usd.stage import open_stage, prims_of
from mixseq_io.usd.surface import reversal


@dataclass(frozen=True, eq=False)
class Base:
    """A file that a sequence fits.

    Parameters
    ----------
    path : Path
        The file.
    stage : Usd.Stage
        What it holds.
    meshes : tuple of (Piece, UsdGeom.Mesh, order)
        The pieces of the sequence, their meshes, and which of the piece's corners each corner of the mesh is.
    """

    path: Path
    stage: Usd.Stage
    meshes: tuple[tuple[Piece, UsdGeom.Mesh, IntArray], ...]


def open_base(path: Path, header: SequenceHeader) -> Base:
    """Open a file on which a sequence may be laid.

    Raises
    ------
    OutputError
        If it cannot be opened, or does not fit: other faces, units or up axis.
    """
    try:
        with reading_usd(path):
            stage = open_stage(path)
    except FormatError as error:
        raise OutputError(str(error)) from error
    up = str(UsdGeom.GetStageUpAxis(stage))
    if up != header.up_axis:
        raise OutputError(f"{path} has {up} up, the sequence {header.up_axis}")
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if not np.isclose(unit, header.metres_per_unit, rtol=1e-6):
        raise OutputError(f"{path} has units of {unit:g} m, the sequence of {header.metres_per_unit:g} m")
    meshes = tuple((piece, *_mesh_of(path, stage, piece)) for piece in split(header))
    if len({mesh.GetPath() for _, mesh, _ in meshes}) < len(meshes):
        raise OutputError(f"{path} has fewer meshes than the sequence, which has {len(meshes)}")
    return Base(path, stage, meshes)


def _mesh_of(path: Path, stage: Usd.Stage, piece: Piece) -> tuple[UsdGeom.Mesh, IntArray]:
    """Return the mesh that a piece came from, and the order of its corners."""
    named = stage.GetPrimAtPath(piece.path) if is_prim_path(piece.path) else None
    candidates = [named] if named and UsdGeom.Mesh(named) else prims_of(path, stage)
    meshes = [mesh for prim in candidates if (mesh := UsdGeom.Mesh(prim))]
    fitting = [(mesh, order) for mesh in meshes if (order := _corner_order(mesh, piece)) is not None]
    if len(fitting) != 1:
        what = f"{len(fitting)} meshes" if fitting else "no mesh"
        raise OutputError(f"{path} has {what} with the faces of {piece.path or piece.name!r}")
    return fitting[0]


def _corner_order(mesh: UsdGeom.Mesh, piece: Piece) -> IntArray | None:
    """Return which of the piece's corners each corner of the mesh is; None if they are of other faces."""
    earliest = Usd.TimeCode.EarliestTime()
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(earliest) or (), dtype=np.int32)
    indices = np.array(mesh.GetFaceVertexIndicesAttr().Get(earliest) or (), dtype=np.int32)
    if not np.array_equal(counts, piece.polygons.counts):
        return None
    if len(mesh.GetPointsAttr().Get(earliest) or ()) != piece.vertex_count:
        return None
    for order in (np.arange(indices.size), reversal(counts)):  # readers reverse left-handed faces
        if np.array_equal(indices, piece.polygons.indices[order]):
            return order
    return None
