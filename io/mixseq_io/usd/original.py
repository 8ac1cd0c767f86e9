"""USD, writing: the file that new points are laid over, and its meshes that a sequence fits.

Which mesh of the file a mesh of the sequence goes to is told by its path; where there is none, by its faces, if a
single mesh has them.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from mixseq.arrays import IntArray
from mixseq.errors import FormatError, OutputError
from mixseq.polygons import reversed_corners
from mixseq.sequence import SequenceHeader
from mixseq_io.scene_meshes import SceneMesh, split
from mixseq_io.usd.diagnostics import reading_usd
from mixseq_io.usd.paths import is_prim_path
from mixseq_io.usd.prims import open_stage, prims_of
from mixseq_io.usd.seams import Weld, unwelded, weld


@dataclass(frozen=True, eq=False)
class Fit:
    """A mesh of the sequence and the mesh of the file that it is laid over.

    Parameters
    ----------
    scene_mesh : SceneMesh
        That of the sequence.
    mesh : UsdGeom.Mesh
        The mesh.
    corner_points : (C,) int
        The point at every corner of the mesh.
    order : (C,) int
        Which of its corners each corner of the mesh is.
    weld : Weld
        Which of its vertices each point of the mesh is.
    """

    scene_mesh: SceneMesh
    mesh: UsdGeom.Mesh
    corner_points: IntArray
    order: IntArray
    weld: Weld


@dataclass(frozen=True, eq=False)
class Original:
    """A file that a sequence fits.

    Parameters
    ----------
    path : Path
        The file.
    stage : Usd.Stage
        What it holds.
    fits : tuple of Fit
        The meshes of the sequence, each with its mesh in the file.
    """

    path: Path
    stage: Usd.Stage
    fits: tuple[Fit, ...]


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open a file on which a sequence may be laid.

    Raises
    ------
    OutputError
        If it cannot be opened, has no time, or does not fit: other faces, units or up axis.
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
    rate = stage.GetTimeCodesPerSecond()
    if not 0 < rate < np.inf:
        raise OutputError(f"{path} has {rate:g} time codes per second, a positive number is needed")
    fits = tuple(_fit(path, stage, scene_mesh) for scene_mesh in split(header))
    if len({fit.mesh.GetPath() for fit in fits}) < len(fits):
        raise OutputError(f"{path} has fewer meshes than the sequence, which has {len(fits)}")
    return Original(path, stage, fits)


def _fit(path: Path, stage: Usd.Stage, scene_mesh: SceneMesh) -> Fit:
    """Return the mesh that a mesh of the sequence came from."""
    named = stage.GetPrimAtPath(scene_mesh.path) if is_prim_path(scene_mesh.path) else None
    candidates = [named] if named and UsdGeom.Mesh(named) else prims_of(path, stage)
    meshes = [mesh for prim in candidates if (mesh := UsdGeom.Mesh(prim))]
    fitting = [fit for mesh in meshes if (fit := _fit_to(mesh, scene_mesh)) is not None]
    if len(fitting) != 1:
        what = f"{len(fitting)} meshes" if fitting else "no mesh"
        raise OutputError(f"{path} has {what} with the faces of {scene_mesh.path or scene_mesh.name!r}")
    return fitting[0]


def _fit_to(mesh: UsdGeom.Mesh, scene_mesh: SceneMesh) -> Fit | None:
    """Lay a mesh of the sequence over one of the file; None if it has other faces."""
    earliest = Usd.TimeCode.EarliestTime()
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(earliest) or (), dtype=np.int32)
    points = np.array(mesh.GetFaceVertexIndicesAttr().Get(earliest) or (), dtype=np.int32)
    places = np.array(mesh.GetPointsAttr().Get(earliest) or (), dtype=np.float32).reshape(-1, 3)
    if not np.array_equal(counts, scene_mesh.polygons.counts) or not _within(points, len(places)):
        return None
    # The sequence may have come from elsewhere, with a vertex for every point.
    for seams in (weld(mesh, places), unwelded(len(places))):
        # Readers reverse left-handed faces.
        for order in (np.arange(points.size), reversed_corners(counts, keep_first=True)):
            same = np.array_equal(seams.of_point[points], scene_mesh.polygons.indices[order])
            if same and seams.vertex_count == scene_mesh.vertex_count:
                return Fit(scene_mesh, mesh, points, order, seams)
    return None


def _within(indices: IntArray, count: int) -> bool:
    return not indices.size or bool(indices.min() >= 0 and indices.max() < count)
