"""Alembic, reading: what is on a mesh."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcCoreAbstract, AbcGeom, AbcMaterial  # noqa: E402

from mixseq.errors import MixseqWarning  # noqa: E402
from mixseq_io.alembic.samples import create_array  # noqa: E402
from tests.formats.alembic.alembic_maker import (  # noqa: E402
    CLOCKWISE,
    SQUARE,
    TRIANGLES,
    Scope,
    add_mesh,
    filled,
    load,
    positions,
    rising,
    sampled,
    save_mesh,
)


@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize(
    ("scope", "places"),
    [
        (Scope.kFacevaryingScope, [0, 1, 2, 3, 4, 5]),
        (Scope.kVertexScope, CLOCKWISE),
        (Scope.kVaryingScope, CLOCKWISE),
        (Scope.kUniformScope, [0, 0, 0, 1, 1, 1]),
        (Scope.kConstantScope, [0] * 6),
    ],
    ids=["corners", "vertices", "varying", "faces", "constant"],
)
def test_texture_coordinates(path: Path, scope: Any, places: ArrayLike, indexed: bool) -> None:
    count = int(np.max(places)) + 1
    rows = np.arange(2 * count, dtype=np.float32).reshape(count, 2)

    def dress(sample: Any, frame: int) -> None:
        if indexed:  # the rows backwards
            order = filled(imath.UnsignedIntArray, np.arange(count)[::-1])
            sample.setUVs(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, rows[::-1]), order, scope))
        else:
            sample.setUVs(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, rows), scope))

    save_mesh(path, "square", rising(), dress=dress)
    uvs = load(path).surface.uvs
    assert uvs is not None
    turned = [2, 1, 0, 5, 4, 3]
    np.testing.assert_array_equal(uvs.at_corners, rows[np.asarray(places)[turned]])


@pytest.mark.parametrize(
    ("count", "places"),
    [(6, [0, 1, 2, 3, 4, 5]), (4, CLOCKWISE), (2, [0, 0, 0, 1, 1, 1]), (1, [0] * 6), (5, None)],
    ids=["corners", "vertices", "faces", "constant", "nothing"],
)
@pytest.mark.parametrize("name", ["uv", "N", "Cd"])
def test_values_without_a_scope(path: Path, name: str, count: int, places: ArrayLike | None) -> None:
    """Archives of other programs may leave out ``geoScope``; their values have the scope that fits."""
    kind, array, width = {
        "uv": (Abc.OV2fArrayProperty, imath.V2fArray, 2),
        "N": (Abc.ON3fArrayProperty, imath.V3fArray, 3),
        "Cd": (Abc.OC3fArrayProperty, imath.C3fArray, 3),
    }[name]
    rows = np.arange(width * count, dtype=np.float32).reshape(count, width) % 7
    archive = Abc.OArchive(str(path))
    metadata = AbcCoreAbstract.MetaData()
    metadata.set("schema", "AbcGeom_PolyMesh_v1")
    metadata.set("schemaObjTitle", "AbcGeom_PolyMesh_v1:.geom")
    mesh = Abc.OObject(archive.getTop(), "square", metadata)  # the library's own meshes would add a scope
    geometry = Abc.OCompoundProperty(mesh.getProperties(), ".geom", metadata)
    Abc.OBox3dProperty(geometry, ".selfBnds").setValue(imath.Box3d())
    Abc.OP3fArrayProperty(geometry, "P").setValue(positions(SQUARE))
    Abc.OInt32ArrayProperty(geometry, ".faceIndices").setValue(filled(imath.IntArray, CLOCKWISE))
    Abc.OInt32ArrayProperty(geometry, ".faceCounts").setValue(filled(imath.IntArray, [3, 3]))
    parent = Abc.OCompoundProperty(geometry, ".arbGeomParams") if name == "Cd" else geometry
    kind(parent, name).setValue(create_array(array, rows))
    del archive, mesh, geometry, parent
    if places is None:
        with pytest.warns(MixseqWarning, match="of /square do not fit its faces"):
            load(path)
        return
    surface = load(path).surface
    turned = rows[np.asarray(places)[[2, 1, 0, 5, 4, 3]]]
    if name == "N":
        is_hard = any((turned[[0, 2]] != turned[[3, 4]]).any(axis=1))  # corners at the ends of the shared edge
        assert (surface.hard_edges is not None) == is_hard
    else:
        values = surface.uvs if name == "uv" else surface.colours
        assert values is not None
        np.testing.assert_array_equal(values.at_corners[:, :width], turned)


def test_texture_coordinates_that_do_not_fit(path: Path) -> None:
    def dress(sample: Any, frame: int) -> None:
        sample.setUVs(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, SQUARE[:, :2]), Scope.kFacevaryingScope))

    save_mesh(path, "square", rising(), dress=dress)
    with pytest.warns(MixseqWarning, match="texture coordinates of /square do not fit its faces"):
        assert load(path).surface.uvs is None


@pytest.mark.parametrize(
    ("scope", "normals", "hard"),
    [
        (Scope.kFacevaryingScope, [[0, 0, 1]] * 3 + [[0, 1, 0]] * 3, True),
        (Scope.kFacevaryingScope, [[0, 0, 1]] * 6, False),
        (Scope.kVertexScope, [[0, 0, 1], [0, 1, 0], [1, 0, 0], [0, 0, 1]], False),
        (Scope.kUniformScope, [[0, 0, 1], [0, 1, 0]], True),
    ],
    ids=["hard", "soft", "vertices", "flat"],
)
def test_normals_are_hard_edges(path: Path, scope: Any, normals: ArrayLike, hard: bool) -> None:
    def dress(sample: Any, frame: int) -> None:
        sample.setNormals(AbcGeom.ON3fGeomParamSample(positions(normals), scope))

    save_mesh(path, "square", rising(), dress=dress)
    hard_edges = load(path).surface.hard_edges
    assert (hard_edges is not None) == hard
    if hard_edges is not None:  # corners of triangles 0 1 2 and 0 2 3: no vertex's normal is shared by both faces
        assert len(set(hard_edges.tolist())) == 6


def test_face_sets_and_materials(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    belt = mesh.getSchema().createFaceSet("Gürtel")
    belt.getSchema().set(AbcGeom.OFaceSetSchemaSample(filled(imath.IntArray, [1])))
    AbcMaterial.addMaterialAssignment(belt, "/materials/leather")
    AbcMaterial.addMaterialAssignment(mesh, "/materials/skin")
    del archive, mesh, belt
    skin, leather = load(path).surface.face_sets
    assert (skin.name, skin.material, skin.polygons.tolist()) == ("skin", "/materials/skin", [0])
    assert (leather.name, leather.material, leather.polygons.tolist()) == ("Gürtel", "/materials/leather", [1])


@pytest.mark.parametrize("scheme", ["catmull-clark", "catmullClark", "loop", "bilinear"])
def test_subdivision(path: Path, scheme: str) -> None:
    save_mesh(path, "cage", rising(), subdivided=True, dress=lambda sample, _: sample.setSubdivisionScheme(scheme))
    got = load(path)
    assert got.surface.subdivision == scheme.replace("-c", "C")
    assert got.polygons.same_as(TRIANGLES)


def test_an_unknown_subdivision(path: Path) -> None:
    save_mesh(path, "cage", rising(), subdivided=True, dress=lambda sample, _: sample.setSubdivisionScheme("doo"))
    with pytest.warns(MixseqWarning, match="/cage is subdivided by 'doo', which is read as Catmull-Clark"):
        assert load(path).surface.subdivision == "catmullClark"


def test_more_texture_coordinates(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    metadata = AbcCoreAbstract.MetaData()
    metadata.setIsUV(True)
    others = mesh.getSchema().getArbGeomParams()
    second = AbcGeom.OV2fGeomParam(others, "dirt", False, Scope.kVertexScope, 1, 0, metadata)
    second.set(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, SQUARE[:, :2]), Scope.kVertexScope))
    del archive, mesh, others, second
    with pytest.warns(MixseqWarning, match="/square has more texture coordinates, dirt; they are left out"):
        assert load(path).surface.uvs is None


@pytest.mark.parametrize("indexed", [False, True])
@pytest.mark.parametrize(
    ("scope", "places"),
    [(Scope.kFacevaryingScope, [0, 1, 2, 3, 4, 5]), (Scope.kVertexScope, CLOCKWISE), (Scope.kConstantScope, [0] * 6)],
    ids=["corners", "vertices", "constant"],
)
@pytest.mark.parametrize("channels", [3, 4])
def test_colours(path: Path, scope: Any, places: ArrayLike, indexed: bool, channels: int) -> None:
    count = int(np.max(places)) + 1
    rows = np.arange(count * channels, dtype=np.float32).reshape(count, channels) / 32
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    add_colours(mesh, "paint", rows, scope, indexed)
    del archive, mesh
    colours = load(path).surface.colours
    assert colours is not None
    expected = (rows[::-1] if indexed else rows)[np.asarray(places)[[2, 1, 0, 5, 4, 3]]]
    np.testing.assert_array_equal(colours.at_corners[:, :channels], expected)
    if channels == 3:
        np.testing.assert_array_equal(colours.at_corners[:, 3], 1)


def add_colours(
    mesh: Any, name: str, rows: ArrayLike, scope: Any, indexed: bool = False, later: ArrayLike = ()
) -> None:
    """Add colours as a parameter, maybe others `later`; indexed ones are stored the other way round."""
    content = np.asarray(rows)
    parameter, sample, kind = (
        (AbcGeom.OC3fGeomParam, AbcGeom.OC3fGeomParamSample, imath.C3fArray)
        if content.shape[1] == 3
        else (AbcGeom.OC4fGeomParam, AbcGeom.OC4fGeomParamSample, imath.C4fArray)
    )
    sampling = sampled(mesh, None)
    made = parameter(mesh.getSchema().getArbGeomParams(), name, indexed, scope, 1, sampling)
    backwards = filled(imath.UnsignedIntArray, np.arange(len(content))[::-1])
    for colours in (content, *np.asarray(later)):
        values = kind(len(content))
        for channel, column in zip("rgba", colours.T, strict=False):
            np.asarray(getattr(values, channel))[...] = column
        made.set(sample(values, backwards, scope) if indexed else sample(values, scope))


@pytest.mark.parametrize("indexed", [False, True])
def test_colours_that_change_over_time(path: Path, indexed: bool) -> None:
    reds = np.array([[n / 8, 0, 0] for n in range(4)])
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    add_colours(mesh, "Cd", reds, Scope.kVertexScope, indexed, later=[reds, reds / 2])
    del archive, mesh
    told = "colours of /square that change over time stay as they are in the first frame"
    with pytest.warns(MixseqWarning, match=told):
        colours = load(path).surface.colours
    assert colours is not None
    expected = (reds[::-1] if indexed else reds)[CLOCKWISE[[2, 1, 0, 5, 4, 3]]]
    np.testing.assert_array_equal(colours.at_corners[:, :3], expected)


def test_colours_that_are_repeated_do_not_change(path: Path) -> None:
    reds = np.array([[n / 8, 0, 0] for n in range(4)])
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    add_colours(mesh, "Cd", reds, Scope.kVertexScope, later=[reds, reds])
    del archive, mesh
    assert load(path).surface.colours is not None


def test_texture_coordinates_that_change_over_time(path: Path) -> None:
    def dress(sample: Any, frame: int) -> None:
        rows = np.full((4, 2), frame, np.float32)
        sample.setUVs(AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, rows), Scope.kVertexScope))

    save_mesh(path, "square", rising(), dress=dress)
    with pytest.warns(MixseqWarning, match="texture coordinates of /square that change over time stay"):
        assert load(path).surface.uvs is not None


def test_of_several_sets_of_colours_that_of_houdini_is_kept(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    add_colours(mesh, "mask", [[0, 0, 1]] * 4, Scope.kVertexScope)
    add_colours(mesh, "Cd", [[1, 0, 0]] * 4, Scope.kVertexScope)
    del archive, mesh
    with pytest.warns(MixseqWarning, match="square has several sets of colours; Cd is kept"):
        colours = load(path).surface.colours
    assert colours is not None
    assert colours.at_corners[0].tolist() == [1, 0, 0, 1]


def test_colours_that_do_not_fit(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising())
    add_colours(mesh, "Cd", [[1, 0, 0]] * 3, Scope.kVertexScope)
    del archive, mesh
    with pytest.warns(MixseqWarning, match="the colours of .*square do not fit its faces"):
        assert load(path).surface.colours is None
