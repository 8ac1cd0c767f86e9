"""USD, writing: the original file that new points are laid over, and its meshes matched with a sequence's."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from pxr import Usd, UsdGeom

from mixseq.arrays import FloatArray, IntArray
from mixseq.errors import FormatError, OutputError
from mixseq.polygon_matching import PolygonMatch, difference
from mixseq.polygons import Polygons, reversed_corners
from mixseq.sequence import SequenceHeader
from mixseq_io.originals import fit_meshes
from mixseq_io.scene_meshes import SceneMesh
from mixseq_io.usd.diagnostics import reading_usd
from mixseq_io.usd.prims import open_stage, prims_of
from mixseq_io.usd.seams import Weld, unwelded, weld


@dataclass(frozen=True, eq=False)
class Fit:
    """Mesh of the sequence matched with a mesh of the file.

    `corner_points` ``(C,)`` are the points at the file's corners, `match` maps its polygons and corners to the
    sequence's, `turned` means reversed corner order, `weld` maps points to vertices.
    """

    scene_mesh: SceneMesh
    mesh: UsdGeom.Mesh
    corner_points: IntArray
    match: PolygonMatch
    turned: bool
    weld: Weld


@dataclass(frozen=True, eq=False)
class Original:
    """File that fits a sequence."""

    path: Path
    stage: Usd.Stage
    fits: tuple[Fit, ...]

    @property
    def rate(self) -> float:
        """Time codes per second."""
        return self.stage.GetTimeCodesPerSecond()


def open_original(path: Path, header: SequenceHeader) -> Original:
    """Open a file that a sequence may be laid over."""
    try:
        with reading_usd(path):
            stage = open_stage(path)
    except FormatError as error:
        raise OutputError(str(error)) from error
    up = str(UsdGeom.GetStageUpAxis(stage))
    if up != header.up_axis:
        raise OutputError(
            f"{path} has {up} up, the sequence {header.up_axis}; convert_units (--convert-axes {up}) turns it"
        )
    unit = UsdGeom.GetStageMetersPerUnit(stage)
    if not np.isclose(unit, header.metres_per_unit, rtol=1e-6):
        raise OutputError(
            f"{path} has units of {unit:g} m, the sequence of {header.metres_per_unit:g} m; convert_units "
            f"(--convert-units {unit:g}) scales it"
        )
    rate = stage.GetTimeCodesPerSecond()
    if not 0 < rate < np.inf:
        raise OutputError(f"{path} has {rate:g} time codes per second, a positive number is needed")
    try:
        meshes = {str(prim.GetPath()): mesh for prim in prims_of(path, stage) if (mesh := UsdGeom.Mesh(prim))}
        return Original(path, stage, tuple(fit_meshes(path, header, meshes, _fitted, _difference)))
    except FormatError as error:
        raise OutputError(str(error)) from error


def _difference(scene_mesh: SceneMesh, mesh: UsdGeom.Mesh) -> str:
    """Return the first difference from the only candidate mesh, in words."""
    stored, places = _stored(mesh)
    if stored is None:
        return ""
    for seams in (weld(mesh, places), unwelded(len(places))):
        if seams.vertex_count == scene_mesh.vertex_count:
            theirs = Polygons(stored.counts, seams.of_point[stored.indices])
            return difference(scene_mesh.polygons, theirs, ("the sequence", str(mesh.GetPath())))
    return f"it has {len(places)} points, the sequence {scene_mesh.vertex_count} vertices"


def _fitted(scene_mesh: SceneMesh, mesh: UsdGeom.Mesh) -> Fit | None:
    """Match a mesh of the sequence with one of the file; None if faces differ."""
    stored, places = _stored(mesh)
    if stored is None:
        return None
    points = stored.indices
    reverse = reversed_corners(stored.counts, keep_first=True)
    # The sequence may have come from elsewhere, with a vertex for every point.
    for seams in (weld(mesh, places), unwelded(len(places))):
        if seams.vertex_count != scene_mesh.vertex_count:
            continue
        theirs = Polygons(stored.counts, seams.of_point[points])
        # Readers reverse left-handed faces.
        for turned in (False, True):
            read = Polygons(theirs.counts, theirs.indices[reverse]) if turned else theirs
            found = scene_mesh.matched_to(read)
            if found is not None:
                ours, match = found
                # Turning corners around twice changes nothing.
                corners = match.corners[reverse] if turned else match.corners
                return Fit(ours, mesh, points, PolygonMatch(match.polygons, corners), turned, seams)
    return None


def _stored(mesh: UsdGeom.Mesh) -> tuple[Polygons | None, FloatArray]:
    """Return a mesh's faces by points, None if they are invalid, and its points ``(P, 3)``."""
    earliest = Usd.TimeCode.EarliestTime()
    counts = np.array(mesh.GetFaceVertexCountsAttr().Get(earliest) or (), dtype=np.int32)
    points = np.array(mesh.GetFaceVertexIndicesAttr().Get(earliest) or (), dtype=np.int32)
    places = np.array(mesh.GetPointsAttr().Get(earliest) or (), dtype=np.float32).reshape(-1, 3)
    sound = counts.min(initial=3) >= 3 and counts.sum() == points.size and _within(points, len(places))
    return (Polygons(counts, points) if sound else None), places


def _within(indices: IntArray, count: int) -> bool:
    return not indices.size or bool(indices.min() >= 0 and indices.max() < count)
