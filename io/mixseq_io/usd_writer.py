"""USD, writing: one mesh with time-sampled points and velocities (.usd and .usdc binary, .usda text).

The file is a component that other tools can reference: the default prim ``/<name>`` is an Xform with the mesh
``/<name>/<name>`` in it. USD's points are float32; larger precision is rounded to that.

Binary files are saved every now and then while they are written, upon which USD lets go of the samples: of
400 frames of 50 000 vertices (240 MB) it held 34 MB at most when saved every 20 frames, against 268 MB when
saved once. Text files are held in memory whole.

Specifications: https://openusd.org/release/api/class_usd_geom_mesh.html,
https://openusd.org/release/glossary.html#usdglossary-component
"""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from pxr import Kind, Sdf, Usd, UsdGeom, Vt

from mixseq.errors import OutputError
from mixseq.sequence import FloatArray, SequenceHeader
from mixseq_io.atomic import replacing
from mixseq_io.blocks import as_float32, checked
from mixseq_io.usd_diagnostics import quiet, writing_usd

_BYTES_BETWEEN_SAVES = 64 << 20


def write_usd(
    path: Path,
    header: SequenceHeader,
    blocks: Iterable[FloatArray],
    velocities: Iterable[FloatArray] | None = None,
) -> None:
    """Write a USD file; see `mixseq_io.write_blocks`.

    Raises
    ------
    OutputError
        If the up axis is X, which USD does not know.
    """
    if header.up_axis == "X":
        raise OutputError(
            f"{path}: USD stages have Y or Z up, this mesh has X; turn it first, or write .npz or .h5"
        )
    with replacing(path) as temporary, quiet(), writing_usd(path):
        codes = time_codes(header.times, header.fps)
        stage = Usd.Stage.CreateNew(str(temporary))
        mesh = _define_mesh(stage, header, codes)
        binary = path.suffix.lower() != ".usda"
        unsaved = 0
        _, numbered = checked(header, blocks, velocities)
        for first, block, speeds in numbered:
            points = as_float32(block, first, "USD")
            moving = None if speeds is None else as_float32(speeds, first, "USD", "the velocity of vertex")
            for frame, code in enumerate(codes[first : first + len(points)]):
                _set_points(mesh, points[frame], Usd.TimeCode(code))
                if moving is not None:
                    _set_velocities(mesh, moving[frame], Usd.TimeCode(code))
                unsaved += points[frame].nbytes * (1 if moving is None else 2)
                if binary and unsaved > _BYTES_BETWEEN_SAVES:
                    stage.Save()
                    unsaved = 0
        stage.Save()


def time_codes(times: NDArray[np.float64], fps: float) -> NDArray[np.float64]:
    """Return ``times * fps``, whole numbers where only rounding keeps them from being whole.

    Examples
    --------
    >>> time_codes(np.arange(4) / 29.97, 29.97).tolist()
    [0.0, 1.0, 2.0, 3.0]
    """
    codes = times * fps
    nearest = np.rint(codes)
    near = np.abs(codes - nearest) <= 1e-9 * np.maximum(1.0, np.abs(codes))
    rounded = np.where(near, nearest, codes)
    return rounded if (np.diff(rounded) > 0).all() else codes


def identifier(name: str) -> str:
    """Return the closest name that a prim can have: letters of any script, digits, underscores.

    Examples
    --------
    >>> identifier("Männchen"), identifier("Cylinder.002"), identifier("2nd try"), identifier("")
    ('Männchen', 'Cylinder_002', '_2nd_try', 'mesh')
    """
    cleaned = "".join(letter if Sdf.Path.IsValidIdentifier("_" + letter) else "_" for letter in name)
    if not cleaned:
        return "mesh"
    return cleaned if Sdf.Path.IsValidIdentifier(cleaned) else "_" + cleaned


def _define_mesh(stage: Usd.Stage, header: SequenceHeader, codes: NDArray[np.float64]) -> UsdGeom.Mesh:
    """Author everything but the points."""
    UsdGeom.SetStageUpAxis(stage, header.up_axis)
    UsdGeom.SetStageMetersPerUnit(stage, header.metres_per_unit)
    stage.SetTimeCodesPerSecond(header.fps)
    stage.SetFramesPerSecond(header.fps)
    stage.SetStartTimeCode(float(codes[0]))
    stage.SetEndTimeCode(float(codes[-1]))
    name = identifier(header.name)
    root = UsdGeom.Xform.Define(stage, f"/{name}")
    stage.SetDefaultPrim(root.GetPrim())
    Usd.ModelAPI(root.GetPrim()).SetKind(Kind.Tokens.component)
    mesh = UsdGeom.Mesh.Define(stage, f"/{name}/{name}")
    if name != header.name:
        mesh.GetPrim().SetDisplayName(header.name)
    mesh.CreateSubdivisionSchemeAttr(UsdGeom.Tokens.none)
    mesh.CreateOrientationAttr(UsdGeom.Tokens.rightHanded)
    mesh.CreateFaceVertexCountsAttr(Vt.IntArrayFromBuffer(header.polygons.counts))
    mesh.CreateFaceVertexIndicesAttr(Vt.IntArrayFromBuffer(header.polygons.indices))
    return mesh


def _set_points(mesh: UsdGeom.Mesh, points: FloatArray, code: Usd.TimeCode) -> None:
    value = Vt.Vec3fArrayFromBuffer(points)
    mesh.GetPointsAttr().Set(value, code)
    mesh.GetExtentAttr().Set(UsdGeom.PointBased.ComputeExtent(value), code)


def _set_velocities(mesh: UsdGeom.Mesh, velocities: FloatArray, code: Usd.TimeCode) -> None:
    """Author velocities in units per second; they count only at the codes at which points have samples."""
    mesh.GetVelocitiesAttr().Set(Vt.Vec3fArrayFromBuffer(velocities), code)
