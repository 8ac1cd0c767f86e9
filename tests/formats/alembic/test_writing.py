"""Alembic, writing: what our archives hold, read by us and by the library."""

from __future__ import annotations

import os
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcGeom  # noqa: E402

from mixseq.errors import InvalidSequenceError, MixseqWarning, OutputError  # noqa: E402
from mixseq.mesh.polygons import Polygons  # noqa: E402
from mixseq.mesh.surface import CornerValues, FaceSet, MeshObject, Surface  # noqa: E402
from mixseq.sequence.sequence import MeshSequence  # noqa: E402
from mixseq_io.alembic.writer import write_alembic  # noqa: E402
from tests.formats.alembic.alembic_maker import SQUARE, TRIANGLES, Scope, load, moving, rising, save  # noqa: E402

FULL_SURFACE = Surface(
    uvs=CornerValues(np.array([[0.0, 0], [1, 0], [1, 1], [0, 1]]), np.array([0, 1, 2, 0, 2, 3])),
    hard_edges=np.array([0, 1, 2, 3, 4, 5]),
    face_sets=(FaceSet("left", np.array([0]), "/materials/Blau"), FaceSet("right", np.array([1]))),
)


@pytest.mark.parametrize(
    "header",
    [
        {},
        {"fps": 29.97},
        {"fps": 12.3456789},
        {"fps": 30, "times": [-1, 0.1, 7 / 3]},
        {"fps": 24, "times": [0, 0.125, 0.25]},
        {"name": "Männchen 走る.001"},
        {"surface": FULL_SURFACE},
        {"surface": Surface(subdivision="loop", uvs=FULL_SURFACE.uvs)},
    ],
    ids=lambda header: "+".join(header) or "plain",
)
def test_what_is_written_is_read(path: Path, header: dict[str, Any]) -> None:
    surface = header.pop("surface", Surface())
    written = MeshSequence.from_arrays(rising(), TRIANGLES, **header)
    written = MeshSequence(**{**written.__dict__, "surface": surface, "velocities": rising() + 1})
    save(path, written)
    got = load(path)
    assert got.polygons.same_as(written.polygons)
    np.testing.assert_array_equal(got.points, written.points)
    np.testing.assert_array_equal(got.velocities, written.velocities)
    np.testing.assert_allclose(got.times, written.times, rtol=1e-14)
    assert (got.name, got.surface.subdivision) == (written.name, surface.subdivision)
    assert got.fps == pytest.approx(written.fps, rel=1e-12)
    assert [(s.name, s.material, s.polygons.tolist()) for s in got.surface.face_sets] == [
        (s.name, s.material, s.polygons.tolist()) for s in surface.face_sets
    ]
    if surface.uvs is not None:
        assert got.surface.uvs is not None
        np.testing.assert_array_equal(got.surface.uvs.at_corners, surface.uvs.at_corners)


def test_hard_edges_are_kept(path: Path) -> None:
    # A roof of two faces: along the ridge every corner has its own normal, or one for both.
    roof = np.array([[0, 0, 0], [1, 0, 1], [1, 1, 1], [0, 1, 0], [2, 0, 0], [2, 1, 0]], np.float32)
    faces = Polygons(np.array([4, 4]), np.array([0, 1, 2, 3, 1, 4, 5, 2]))
    for hard_edges, normals in ((np.arange(8), 8), (faces.indices, 6)):
        written = MeshSequence.from_arrays(roof[None], faces)
        save(path, MeshSequence(**{**written.__dict__, "surface": Surface(hard_edges=hard_edges)}))
        got = load(path).surface.hard_edges
        assert (6 if got is None else len(set(got.tolist()))) == normals


@pytest.fixture
def joined() -> MeshSequence:
    """Two squares, of which the second has a name that cannot be."""
    polygons = Polygons(np.full(4, 3), np.concatenate([TRIANGLES.indices, TRIANGLES.indices + 4]))
    surface = Surface(
        objects=(MeshObject("arm", "", 4, 2), MeshObject("arm", "", 4, 2)),
        face_sets=(FaceSet("cloth", np.array([1, 2])),),
        uvs=CornerValues(np.arange(24.0).reshape(12, 2), np.arange(12)[::-1]),
    )
    points = np.concatenate([rising(), rising() + 10], axis=1)
    return MeshSequence(
        polygons=polygons, vertex_count=8, times=np.arange(3) / 24, points=points, name="man", surface=surface
    )


def test_the_library_reads_what_is_written(path: Path, joined: MeshSequence) -> None:
    save(path, joined)
    top = Abc.IArchive(str(path)).getTop()
    assert top.getNumChildren() == 1
    man = AbcGeom.IXform(top, "man")
    assert man.getSchema().isConstantIdentity()
    assert [man.getChild(k).getName() for k in range(man.getNumChildren())] == ["arm", "arm_2"]
    schema = AbcGeom.IPolyMesh(man.getChild("arm_2"), "arm_2").getSchema()
    assert schema.getTopologyVariance() == AbcGeom.MeshTopologyVariance.kHomogenousTopology
    assert schema.getNumSamples() == 3
    sampling = schema.getTimeSampling()
    assert sampling.getTimeSamplingType().isUniform()
    assert [sampling.getSampleTime(k) for k in range(3)] == pytest.approx([0, 1 / 24, 2 / 24])
    last = schema.getValue(Abc.ISampleSelector(2 / 24))
    np.testing.assert_array_equal(np.asarray(last.getPositions()), rising()[2] + 10)
    assert list(last.getFaceIndices()) == [2, 1, 0, 3, 2, 0]
    assert last.getSelfBounds() == imath.Box3d(imath.V3d(10, 10, 12), imath.V3d(11, 11, 12))
    uvs = schema.getUVsParam()
    assert uvs.isIndexed() and uvs.getScope() == Scope.kFacevaryingScope
    expanded = np.asarray(uvs.getExpandedValue().getVals())
    assert joined.surface.uvs is not None
    np.testing.assert_array_equal(expanded, joined.surface.uvs.at_corners[[8, 7, 6, 11, 10, 9]])
    assert list(schema.getFaceSetNames()) == ["cloth"]
    assert Abc.GetArchiveInfo(Abc.IArchive(str(path)))["appName"].startswith("mixseq")


def test_normals_of_every_frame(path: Path) -> None:
    flat, turned = SQUARE, SQUARE[:, [2, 0, 1]]  # facing z, then x
    written = MeshSequence.from_arrays(np.stack([flat, turned]), TRIANGLES)
    save(path, MeshSequence(**{**written.__dict__, "surface": Surface(hard_edges=np.arange(6))}))
    top = Abc.IArchive(str(path)).getTop()
    normals = AbcGeom.IPolyMesh(top.getChild(0), "mesh").getSchema().getNormalsParam()
    assert normals.getScope() == Scope.kFacevaryingScope
    for frame, expected in enumerate(([0, 0, 1], [1, 0, 0])):
        rows = np.asarray(normals.getExpandedValue(Abc.ISampleSelector(frame / 24)).getVals())
        np.testing.assert_array_equal(rows, [expected] * 6)


def test_objects_come_back(path: Path, joined: MeshSequence) -> None:
    save(path, joined)
    got = load(path)
    assert got.name == "man"
    assert [each.path for each in got.surface.objects] == ["/man/arm/arm", "/man/arm_2/arm_2"]
    np.testing.assert_array_equal(got.points, joined.points)
    assert got.polygons.same_as(joined.polygons)
    assert [(each.name, each.polygons.tolist()) for each in got.surface.face_sets] == [("cloth", [1]), ("cloth", [2])]
    only = load(path, "arm_2")
    np.testing.assert_array_equal(only.points, joined.points[:, 4:])


def test_repeated_frames_stay_frames(path: Path) -> None:
    written = MeshSequence.from_arrays(np.repeat(SQUARE[None], 5, axis=0), TRIANGLES)
    save(path, written)
    np.testing.assert_array_equal(load(path).points, written.points)


def test_losses_are_told(path: Path) -> None:
    written = moving(up_axis="Z", metres_per_unit=0.01, name="a/b")
    lost = "Alembic files cannot hold Z up, 0.01 metres per unit, the names 'a/b'; USD"
    with pytest.warns(MixseqWarning, match=lost):
        save(path, written)
    assert load(path).name == "a_b"
    caged = MeshSequence(**{**moving().__dict__, "surface": Surface(hard_edges=np.arange(6), subdivision="bilinear")})
    with pytest.warns(MixseqWarning, match="cannot hold hard edges of subdivided meshes"):
        save(path, caged)


def test_a_sword_with_hard_edges_beside_a_subdivided_body(path: Path, joined: MeshSequence) -> None:
    body, sword = joined.objects
    hard_edges = np.concatenate([TRIANGLES.indices, 4 + np.arange(6)])
    surface = Surface(objects=(replace(body, subdivision="loop"), sword), hard_edges=hard_edges)
    save(path, replace(joined, surface=surface))
    assert load(path).surface.subdivisions == ("loop", "none")


def test_too_large_for_float32(path: Path) -> None:
    huge = moving().with_points(rising().astype(np.float64) * 1e39)
    with pytest.raises(InvalidSequenceError, match="too large for Alembic"):
        save(path, huge)
    assert not path.exists()


def test_the_room_is_checked_first(path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    asked = []

    def allocate(descriptor: int, start: int, size: int) -> None:
        asked.append(size)
        raise OSError(28, os.strerror(28))

    monkeypatch.setattr(os, "posix_fallocate", allocate, raising=False)
    with pytest.raises(OutputError, match="free some space"):
        save(path, moving())
    assert list(path.parent.iterdir()) == []
    monkeypatch.undo()
    for sequence in (moving(), MeshSequence(**{**moving().__dict__, "surface": FULL_SURFACE, "velocities": rising()})):
        save(path, sequence)
        with pytest.raises(OutputError), monkeypatch.context() as full:
            full.setattr(os, "posix_fallocate", allocate, raising=False)
            save(path, sequence)
        assert path.stat().st_size <= asked[-1]


def test_an_error_of_the_blocks_is_passed_on(path: Path) -> None:
    def broken() -> Any:
        yield rising()[:2]
        raise RuntimeError("from the caller")

    with pytest.raises(RuntimeError, match="from the caller"):
        write_alembic(path, moving().header, broken())
    assert list(path.parent.iterdir()) == []
