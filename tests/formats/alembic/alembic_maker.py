"""Archives made with the library itself: meshes, transforms and times in them."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcCoreAbstract, AbcGeom  # noqa: E402

from mixseq.mesh.polygons import Polygons  # noqa: E402
from mixseq.sequence.sequence import MeshSequence  # noqa: E402
from mixseq.types import FloatArray  # noqa: E402
from mixseq_io.alembic.reader import open_alembic  # noqa: E402
from mixseq_io.alembic.writer import write_alembic  # noqa: E402

Scope = AbcGeom.GeometryScope

# A unit square of two faces in the plane z = 0, facing +z: counter-clockwise in mixseq, clockwise in the file.
SQUARE = np.array([[0, 0, 0], [1, 0, 0], [1, 1, 0], [0, 1, 0]], np.float32)

CLOCKWISE = np.array([2, 1, 0, 3, 2, 0])

TRIANGLES = Polygons.from_triangles([[0, 1, 2], [0, 2, 3]])

HELD: list[Any] = []
"""Arrays of samples: the library only points to them until the sample is set."""


def filled(kind: Any, rows: ArrayLike) -> Any:
    content = np.asarray(rows)
    array = kind(len(content))
    HELD.append(array)
    if kind is imath.UnsignedIntArray:
        for place, value in enumerate(content.tolist()):
            array[place] = value
    else:
        np.asarray(array)[...] = content
    return array


def positions(points: ArrayLike) -> Any:
    return filled(imath.V3fArray, np.asarray(points, np.float32))


def acyclic(*times: float) -> Any:
    listed = AbcCoreAbstract.TimeVector()
    listed.extend(list(times))
    return AbcCoreAbstract.TimeSampling(AbcCoreAbstract.TimeSamplingType(AbcCoreAbstract.AcyclicFlag.kAcyclic), listed)


def sampled(parent: Any, sampling: Any) -> int:
    """Return the number of a time sampling, by default two samples per second."""
    return int(parent.getArchive().addTimeSampling(sampling or AbcCoreAbstract.TimeSampling(0.5, 0.0)))


def add_mesh(
    parent: Any,
    name: str,
    frames: FloatArray,
    sampling: Any = None,
    subdivided: bool = False,
    faces: ArrayLike = CLOCKWISE,
    dress: Callable[[Any, int], None] = lambda sample, frame: None,
) -> Any:
    """Add a mesh of triangles with frames (N, V, 3); `dress` adds to the sample of every frame."""
    kind, made = (
        (AbcGeom.OSubD, AbcGeom.OSubDSchemaSample) if subdivided else (AbcGeom.OPolyMesh, AbcGeom.OPolyMeshSchemaSample)
    )
    mesh = kind(parent, name, sampled(parent, sampling))
    indices = filled(imath.IntArray, faces)
    counts = filled(imath.IntArray, np.full(len(indices) // 3, 3))
    for frame, points in enumerate(frames):
        sample = made(positions(points), indices, counts)
        dress(sample, frame)
        mesh.getSchema().set(sample)
    return mesh


def save_mesh(path: Path, *contents: Any, **options: Any) -> None:
    """Write an archive of one mesh; arguments are those of `add_mesh`."""
    archive = Abc.OArchive(str(path))
    add_mesh(archive.getTop(), *contents, **options)


def add_transform(parent: Any, name: str, *rows: ArrayLike, sampling: Any = None, inherits: bool = True) -> Any:
    """Add a transform with one sample per matrix (4, 4), acting on rows."""
    transform = AbcGeom.OXform(parent, name, sampled(parent, sampling))
    for matrix in rows:
        sample = AbcGeom.XformSample()
        sample.setMatrix(imath.M44d(*np.asarray(matrix, np.float64).reshape(-1).tolist()))
        sample.setInheritsXforms(inherits)
        transform.getSchema().set(sample)
    return transform


def shift(
    x: float = 0, y: float = 0, z: float = 0, scale: tuple[float, float, float] = (1, 1, 1)
) -> NDArray[np.float64]:
    matrix = np.diag([*scale, 1.0])
    matrix[3, :3] = x, y, z
    return matrix


def load(path: Path, prim: str | None = None) -> MeshSequence:
    with open_alembic(path, prim=prim) as reader:
        velocities = reader.velocity_blocks()
        points = np.concatenate(list(reader.blocks(2)))
        speeds = None if velocities is None else np.concatenate(list(velocities))
        return MeshSequence.from_header(reader.header, points, speeds)


def save(path: Path, sequence: MeshSequence) -> None:
    speeds = None if sequence.velocities is None else [sequence.velocities]
    write_alembic(path, sequence.header, [sequence.points], speeds)


def rising(frames: int = 3) -> FloatArray:
    """The square, one unit further up z in every frame."""
    return np.stack([SQUARE + np.array([0, 0, k], np.float32) for k in range(frames)])


def moving(**header: Any) -> MeshSequence:
    return MeshSequence.from_arrays(rising(), TRIANGLES, **header)
