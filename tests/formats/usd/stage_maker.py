"""What tests of reading USD have in common: points, and stages that are saved and read."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from pxr import Usd, UsdGeom, UsdSkel, Vt

from mixseq.mesh.surface import FaceSet
from mixseq.sequence.sequence import MeshSequence
from mixseq.types import FloatArray
from mixseq_io.usd.reader import open_usd

CORNERS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=np.float32)

INDICES = [0, 1, 2, 3, 1, 4, 2]

Make = Callable[..., UsdGeom.Mesh]


def raised(height: float) -> Any:
    return Vt.Vec3fArrayFromBuffer(CORNERS + np.array([0, 0, height], dtype=np.float32))


def read(path: Path, prim: str | None = None) -> MeshSequence:
    """Read in this process, where breakpoints and coverage work; `mixseq.read` uses another."""
    with open_usd(path, prim) as reader:
        speeds = reader.velocity_blocks(2)
        return MeshSequence.from_header(
            reader.header,
            np.concatenate(list(reader.blocks(2))),
            None if speeds is None else np.concatenate(list(speeds)),
        )


def saved(stage: Usd.Stage, prim: str | None = None) -> MeshSequence:
    stage.Save()
    return read(Path(stage.GetRootLayer().realPath), prim)


def paths(sequence: MeshSequence) -> list[str]:
    return [each.path for each in sequence.objects]


def plain(face_set: FaceSet) -> tuple[str, list[int], str]:
    return face_set.name, face_set.polygons.tolist(), face_set.material


def lower(points: FloatArray, code: int) -> FloatArray:
    """Move points with the second joint."""
    angle = np.radians(30 * code)
    turn = np.array([[np.cos(angle), np.sin(angle), 0], [-np.sin(angle), np.cos(angle), 0], [0, 0, 1]])
    return np.asarray((points - [1, 0, 0]) @ turn + [1, code, 0])


def baked(stage: Usd.Stage, prim: str, times: FloatArray) -> FloatArray:
    """Return world points as USD bakes them, in a copy."""
    copy = Usd.Stage.Open(stage.Flatten())
    for each in copy.Traverse():
        if UsdSkel.Root(each):
            assert UsdSkel.BakeSkinning(UsdSkel.Root(each))
    mesh = UsdGeom.Mesh(copy.GetPrimAtPath(prim))
    frames = []
    for code in (times * stage.GetTimeCodesPerSecond()).tolist():
        matrix = np.array(UsdGeom.XformCache(code).GetLocalToWorldTransform(mesh.GetPrim()))
        frames.append(np.array(mesh.GetPointsAttr().Get(code)) @ matrix[:3, :3] + matrix[3, :3])
    return np.array(frames)
