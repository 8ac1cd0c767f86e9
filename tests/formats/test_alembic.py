"""Alembic: what archives made with the library itself mean, what ours hold, and what is refused."""

from __future__ import annotations

import os
import sys
from collections.abc import Callable
from importlib import import_module
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import ArrayLike, NDArray

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcCoreAbstract, AbcGeom, AbcMaterial  # noqa: E402

from mixseq.arrays import FloatArray  # noqa: E402
from mixseq.errors import (  # noqa: E402
    AmbiguousError,
    FormatError,
    InvalidSequenceError,
    MissingExtraError,
    MixseqWarning,
    OutputError,
)
from mixseq.geometry.normals import shared_normals  # noqa: E402
from mixseq.geometry.rotations import matrices  # noqa: E402
from mixseq.sequence import MeshSequence, Polygons  # noqa: E402
from mixseq.surface import CornerValues, FaceSet, MeshObject, Surface  # noqa: E402
from mixseq_io import read  # noqa: E402
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
    return AbcCoreAbstract.TimeSampling(
        AbcCoreAbstract.TimeSamplingType(AbcCoreAbstract.AcyclicFlag.kAcyclic), listed
    )


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
        (AbcGeom.OSubD, AbcGeom.OSubDSchemaSample)
        if subdivided
        else (AbcGeom.OPolyMesh, AbcGeom.OPolyMeshSchemaSample)
    )
    mesh = kind(parent, name, sampled(parent, sampling))
    indices = filled(imath.IntArray, faces)
    counts = filled(imath.IntArray, np.full(len(indices) // 3, 3))
    for frame, points in enumerate(frames):
        sample = made(positions(points), indices, counts)
        dress(sample, frame)
        mesh.getSchema().set(sample)
    return mesh


def add_transform(
    parent: Any, name: str, *rows: ArrayLike, sampling: Any = None, inherits: bool = True
) -> Any:
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


@pytest.fixture
def path(tmp_path: Path) -> Path:
    return tmp_path / "walk.abc"


def rising(frames: int = 3) -> FloatArray:
    """The square, one unit further up z in every frame."""
    return np.stack([SQUARE + np.array([0, 0, k], np.float32) for k in range(frames)])


def moving(**header: Any) -> MeshSequence:
    return MeshSequence.from_arrays(rising(), TRIANGLES, **header)


# Reading


def test_faces_are_turned_counter_clockwise(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    add_mesh(archive.getTop(), "square", rising())
    del archive
    got = load(path)
    assert got.polygons.same_as(TRIANGLES)
    np.testing.assert_array_equal(got.points, rising())
    np.testing.assert_array_equal(got.times, [0, 0.5, 1])
    assert (got.fps, got.name, got.up_axis, got.metres_per_unit) == (2, "square", "Y", 1)
    assert got.surface.objects == (MeshObject("square", "/square", 4, 2),)
    assert shared_normals(got.points, got.polygons)[0].tolist() == [[0, 0, 1]] * 4


@pytest.mark.parametrize(
    ("sampling", "times", "fps"),
    [
        (
            lambda: AbcCoreAbstract.TimeSampling(1001 / 30000, 1.0),
            1 + np.arange(3) * 1001 / 30000,
            30000 / 1001,
        ),
        (lambda: acyclic(-1, 0.5, 7 / 3), [-1, 0.5, 7 / 3], 24),
        (lambda: acyclic(0, 1 / 25, 4 / 25), [0, 1 / 25, 4 / 25], 25),
        (lambda: acyclic(-0.2, 0, 0.2, 0.7, 9), [-0.2, 0, 0.2], 5),
        (lambda: AbcCoreAbstract.TimeSampling(1 / 24, 1e6), 1e6 + np.arange(3) / 24, 24),
    ],
    ids=["uniform", "acyclic", "acyclic on a time line", "acyclic with a pre-roll", "uniform and late"],
)
def test_times(path: Path, sampling: Callable[[], Any], times: ArrayLike, fps: float) -> None:
    archive = Abc.OArchive(str(path))
    add_mesh(archive.getTop(), "square", rising(), sampling())
    del archive
    got = load(path)
    np.testing.assert_allclose(got.times, np.asarray(times, np.float64), rtol=1e-15)
    assert got.fps == fps


def test_cycles_of_several_samples(path: Path) -> None:
    shutter = AbcCoreAbstract.TimeVector()
    shutter.extend([0.0, 0.125])
    archive = Abc.OArchive(str(path))
    cycles = AbcCoreAbstract.TimeSampling(AbcCoreAbstract.TimeSamplingType(2, 1.0), shutter)
    add_mesh(archive.getTop(), "square", rising(5), cycles)
    del archive
    got = load(path)
    np.testing.assert_array_equal(got.times, [0, 0.125, 1, 1.125, 2])
    np.testing.assert_array_equal(got.points, rising(5))


def test_frame_rate_of_the_application(path: Path) -> None:
    archive = Abc.CreateArchiveWithInfo(str(path), 24.0, "test", "")
    add_mesh(archive.getTop(), "square", rising(), AbcCoreAbstract.TimeSampling(1 / 48, 0))
    del archive
    assert load(path).fps == 24


def test_transforms_multiply_up_to_one_that_inherits_nothing(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    far = add_transform(archive.getTop(), "far", shift(100))
    middle = add_transform(far, "middle", shift(0, 10), inherits=False)
    near = add_transform(middle, "near", shift(0, 0, 1, scale=(2, 2, 2)))
    add_mesh(near, "square", rising())
    del archive, far, middle, near
    np.testing.assert_array_equal(load(path).points, 2 * rising() + np.array([0, 10, 1], np.float32))


def test_an_animated_transform_moves_a_still_mesh(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    transform = add_transform(
        archive.getTop(), "mover", shift(0), shift(1), shift(4), sampling=acyclic(0, 1, 3)
    )
    add_mesh(transform, "square", SQUARE[None])
    del archive, transform
    got = load(path)
    np.testing.assert_array_equal(got.times, [0, 1, 3])
    np.testing.assert_array_equal(got.points[:, 0, 0], [0, 1, 4])


def test_between_samples_points_and_transforms_are_interpolated(path: Path) -> None:
    quarter = np.eye(4)
    quarter[:3, :3] = matrices(np.array([0, 0, np.pi / 2])).T  # rows
    archive = Abc.OArchive(str(path))
    turn = add_transform(archive.getTop(), "turn", np.eye(4), quarter, sampling=acyclic(0, 1))
    add_mesh(turn, "square", rising(3), acyclic(0, 0.5, 2))
    del archive, turn
    got = load(path)
    np.testing.assert_array_equal(got.times, [0, 0.5, 1, 2])
    angle, height = np.array([0, 45, 90, 90]), np.array([0, 1, 4 / 3, 2])
    expected = np.stack([np.cos(np.radians(angle)), np.sin(np.radians(angle)), height], axis=1)
    np.testing.assert_allclose(got.points[:, 1], expected, atol=1e-7)


def test_transforms_are_sampled_at_times_of_their_own(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    slide = add_transform(archive.getTop(), "slide", shift(0), shift(10), sampling=acyclic(-1, 1))
    add_mesh(slide, "square", rising(3), acyclic(-0.5, 0, 0.5))
    del archive, slide
    got = load(path)
    np.testing.assert_array_equal(got.times, [-1, -0.5, 0, 0.5, 1])
    np.testing.assert_array_equal(got.points[:, 0, 0], [0, 2.5, 5, 7.5, 10])
    np.testing.assert_array_equal(got.points[:, 0, 2], [0, 0, 1, 2, 2])


def test_a_mirroring_transform_keeps_faces_outward(path: Path) -> None:
    def dress(sample: Any, frame: int) -> None:
        uvs = filled(imath.V2fArray, np.arange(12).reshape(6, 2))
        sample.setUVs(AbcGeom.OV2fGeomParamSample(uvs, Scope.kFacevaryingScope))

    archive = Abc.OArchive(str(path))
    mirror = add_transform(archive.getTop(), "mirror", shift(scale=(-1, 1, 1)))
    add_mesh(mirror, "square", rising(), dress=dress)
    del archive, mirror
    got = load(path)
    assert shared_normals(got.points, got.polygons)[0].tolist() == [[0, 0, 1]] * 4
    assert got.polygons.indices.tolist() == CLOCKWISE.tolist()
    assert got.surface.uvs is not None
    assert got.surface.uvs.at_corners.tolist() == np.arange(12).reshape(6, 2).tolist()


def test_a_transform_that_begins_to_mirror(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mirror = add_transform(archive.getTop(), "mirror", np.eye(4), shift(scale=(-1, 1, 1)))
    add_mesh(mirror, "square", rising(2))
    del archive, mirror
    with pytest.raises(
        InvalidSequenceError, match=r"frame 1 \(0.5 s\) of /mirror/square: the transform mirrors"
    ):
        load(path)


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

    archive = Abc.OArchive(str(path))
    add_mesh(archive.getTop(), "square", rising(), dress=dress)
    del archive
    uvs = load(path).surface.uvs
    assert uvs is not None
    turned = [2, 1, 0, 5, 4, 3]
    np.testing.assert_array_equal(uvs.at_corners, rows[np.asarray(places)[turned]])


def test_texture_coordinates_that_do_not_fit(path: Path) -> None:
    def dress(sample: Any, frame: int) -> None:
        sample.setUVs(
            AbcGeom.OV2fGeomParamSample(filled(imath.V2fArray, SQUARE[:, :2]), Scope.kFacevaryingScope)
        )

    archive = Abc.OArchive(str(path))
    add_mesh(archive.getTop(), "square", rising(), dress=dress)
    del archive
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

    archive = Abc.OArchive(str(path))
    add_mesh(archive.getTop(), "square", rising(), dress=dress)
    del archive
    hard_edges = load(path).surface.hard_edges
    assert (hard_edges is not None) == hard
    if (
        hard_edges is not None
    ):  # corners of triangles 0 1 2 and 0 2 3: no vertex's normal is shared by both faces
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
    assert (skin.name, skin.material, skin.polygons.tolist()) == ("skin", "/materials/skin", [0, 1])
    assert (leather.name, leather.material, leather.polygons.tolist()) == (
        "Gürtel",
        "/materials/leather",
        [1],
    )


@pytest.mark.parametrize("scheme", ["catmull-clark", "catmullClark", "loop", "bilinear"])
def test_subdivision(path: Path, scheme: str) -> None:
    archive = Abc.OArchive(str(path))
    add_mesh(
        archive.getTop(),
        "cage",
        rising(),
        subdivided=True,
        dress=lambda sample, _: sample.setSubdivisionScheme(scheme),
    )
    del archive
    got = load(path)
    assert got.surface.subdivision == scheme.replace("-c", "C")
    assert got.polygons.same_as(TRIANGLES)


def test_an_unknown_subdivision(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    add_mesh(
        archive.getTop(),
        "cage",
        rising(),
        subdivided=True,
        dress=lambda sample, _: sample.setSubdivisionScheme("doo"),
    )
    del archive
    with pytest.warns(MixseqWarning, match="/cage is subdivided by 'doo', which is taken as Catmull-Clark"):
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


def test_a_transform_that_is_not_finite(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    lost = add_transform(archive.getTop(), "lost", np.eye(4), shift(np.inf), sampling=acyclic(0, 2))
    add_mesh(lost, "square", rising(3), acyclic(0, 1, 2))
    del archive, lost
    with pytest.raises(InvalidSequenceError, match=r"walk.abc: frame 1: vertex 0 is"):
        load(path)


def test_velocities_are_turned_as_points(path: Path) -> None:
    quarter = np.eye(4)
    quarter[:3, :3] = matrices(np.array([0, 0, np.pi / 2])).T
    archive = Abc.OArchive(str(path))
    turn = add_transform(archive.getTop(), "turn", quarter)
    add_mesh(
        turn, "square", rising(), dress=lambda sample, k: sample.setVelocities(positions([[k, 0, 0]] * 4))
    )
    del archive, turn
    velocities = load(path).velocities
    assert velocities is not None
    np.testing.assert_allclose(velocities[:, 2], [[0, 0, 0], [0, 1, 0], [0, 2, 0]], atol=1e-7)


def test_velocities_under_a_moving_transform(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mover = add_transform(archive.getTop(), "mover", shift(0), shift(1))
    add_mesh(mover, "square", rising(2), dress=lambda sample, _: sample.setVelocities(positions(SQUARE)))
    del archive, mover
    with pytest.warns(
        MixseqWarning, match="velocities of /mover/square are those under a transform that moves"
    ):
        assert load(path).velocities is None


# Choosing


@pytest.fixture
def scene(path: Path) -> Path:
    """A man of body and hat, a still house, a hidden proxy, an instance of the hat, and a camera."""
    archive = Abc.OArchive(str(path))
    man = add_transform(archive.getTop(), "man", np.eye(4))
    add_mesh(man, "body", rising())
    hat = add_mesh(add_transform(man, "head", shift(z=5)), "hat", 2 * rising())
    street = add_transform(archive.getTop(), "street", np.eye(4))
    add_mesh(street, "house", SQUARE[None])
    proxy = add_mesh(man, "proxy", rising())
    AbcGeom.CreateVisibilityProperty(proxy, 0).setValue(0)
    copy = add_transform(archive.getTop(), "copy", shift(x=9))
    copy.addChildInstance(hat, "hat")
    AbcGeom.OCamera(archive.getTop(), "camera")
    del archive, man, hat, street, proxy, copy
    return path


def test_all_that_moves_is_joined(scene: Path) -> None:
    with pytest.warns(
        MixseqWarning, match=r"stand still are left out; prim='/' .* takes them, too: '/street/house'"
    ):
        got = load(scene)
    assert [each.path for each in got.surface.objects] == ["/man/body", "/man/head/hat", "/copy/hat"]
    assert got.name == "walk"  # nothing is above all
    up = np.array([0, 0, 5], np.float32)
    np.testing.assert_array_equal(got.points[:, :4], rising())
    np.testing.assert_array_equal(got.points[:, 4:8], 2 * rising() + up)
    np.testing.assert_array_equal(got.points[:, 8:], 2 * rising() + np.array([9, 0, 0], np.float32))
    assert got.polygons.indices.tolist() == [
        *TRIANGLES.indices,
        *(TRIANGLES.indices + 4),
        *(TRIANGLES.indices + 8),
    ]


@pytest.mark.parametrize(
    ("prim", "paths", "name"),
    [
        ("/", ["/man/body", "/man/head/hat", "/street/house", "/copy/hat"], "walk"),
        ("/man", ["/man/body", "/man/head/hat"], "man"),
        ("/man/body", ["/man/body"], "body"),
        ("head", ["/man/head/hat"], "hat"),
        ("house", ["/street/house"], "house"),
        ("/man/proxy", ["/man/proxy"], "proxy"),
    ],
)
def test_prim(scene: Path, prim: str, paths: list[str], name: str) -> None:
    got = load(scene, prim)
    assert [each.path for each in got.surface.objects] == paths
    assert got.name == name


def test_a_still_mesh_alone_has_one_frame(scene: Path) -> None:
    assert load(scene, "house").times.tolist() == [0]


def test_unknown_and_ambiguous_names(scene: Path) -> None:
    with pytest.raises(
        FormatError, match=r"no mesh at or below 'dog'; its meshes are '/man/body', '/man/head/hat'"
    ):
        load(scene, "dog")
    with pytest.raises(FormatError, match="no mesh at or below '/camera'"):
        load(scene, "/camera")
    with pytest.raises(
        AmbiguousError, match="'hat' is in several places, '/copy/hat', '/man/head/hat'; give its path"
    ):
        load(scene, "hat")


def test_meshes_that_flicker(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    visible = AbcGeom.CreateVisibilityProperty(add_mesh(archive.getTop(), "spark", rising()), 0)
    visible.setValue(1)
    visible.setValue(0)
    del archive, visible
    with pytest.warns(MixseqWarning, match="'/spark' are hidden at times; they are taken as visible"):
        load(path)


# Refusing


def test_no_meshes(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    for name in ("left", "right"):
        AbcGeom.OCamera(archive.getTop(), name)
    AbcGeom.OPoints(archive.getTop(), "dust")
    del archive
    with pytest.raises(FormatError, match=r"has no mesh; it has 2 Camera, 1 Points\. Export meshes"):
        load(path)


def test_only_hidden_meshes(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    AbcGeom.CreateVisibilityProperty(add_mesh(archive.getTop(), "ghost", rising()), 0).setValue(0)
    del archive
    with pytest.raises(FormatError, match=r"its meshes are hidden; name one by prim .*: '/ghost'"):
        load(path)


def test_faces_that_change(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising(2))
    add = [filled(imath.IntArray, row) for row in ([0, 1, 3], [3])]
    mesh.getSchema().set(AbcGeom.OPolyMeshSchemaSample(positions(SQUARE), *add))
    del archive, mesh
    with pytest.raises(
        InvalidSequenceError, match=r"walk.abc: the faces of /square change at 1 s \(frame 2\)"
    ):
        load(path)


def test_points_that_change_in_number(path: Path) -> None:
    archive = Abc.OArchive(str(path))
    mesh = add_mesh(archive.getTop(), "square", rising(2))
    mesh.getSchema().set(AbcGeom.OPolyMeshSchemaSample(positions([*SQUARE, [5, 5, 5]])))
    del archive, mesh
    with pytest.raises(
        InvalidSequenceError, match=r"frame 2 \(1 s\) of /square has 5 points, the first frame 4"
    ):
        load(path)


@pytest.mark.parametrize(
    ("content", "message"),
    [
        (b"\x89HDF\r\n\x1a\n" + bytes(100), "old Alembic of the HDF5 kind; convert it with abcconvert"),
        (b"Ogawa\x00\x00\x01" + bytes(100), "is not complete"),
        (b"Ogawa", "is not complete"),
        (b"Ogawa\xff\x00\x01" + b"\xff" * 8, "is not complete"),
        (b"PK\x03\x04 something else", "cannot be read as Alembic"),
        (b"", "cannot be read as Alembic"),
    ],
    ids=["HDF5", "unfinished", "short", "truncated", "zip", "empty"],
)
def test_files_of_other_kinds(path: Path, content: bytes, message: str) -> None:
    path.write_bytes(content)
    with pytest.raises(FormatError, match=rf"walk\.abc.*{message}"):
        open_alembic(path)


def test_without_the_package(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delitem(sys.modules, "mixseq_io.alembic.library")
    monkeypatch.setitem(sys.modules, "alembic3d", None)
    with pytest.raises(MissingExtraError, match=r"pip install 'mixseq\[alembic\]'"):
        import_module("mixseq_io.alembic.library")


def test_missing_file(path: Path) -> None:
    with pytest.raises(FormatError, match="does not exist"):
        open_alembic(path)


def test_a_closed_reader(path: Path) -> None:
    save(path, moving())
    with open_alembic(path) as reader:
        blocks = reader.blocks(1)
        next(blocks)
    with pytest.raises(FormatError, match="is closed"):
        next(blocks)


def test_truncated_files(path: Path) -> None:
    save(path, moving())
    content = path.read_bytes()
    for end in range(0, len(content), 50):
        path.write_bytes(content[:end])
        with pytest.raises(FormatError, match="walk"):
            load(path)


# Writing


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
    assert [(each.name, each.polygons.tolist()) for each in got.surface.face_sets] == [
        ("cloth", [1]),
        ("cloth", [2]),
    ]
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
    caged = MeshSequence(
        **{**moving().__dict__, "surface": Surface(hard_edges=np.arange(6), subdivision="bilinear")}
    )
    with pytest.warns(MixseqWarning, match="cannot hold hard edges of subdivided meshes"):
        save(path, caged)


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
    for sequence in (
        moving(),
        MeshSequence(**{**moving().__dict__, "surface": FULL_SURFACE, "velocities": rising()}),
    ):
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


# Real files


@pytest.mark.realdata
def test_a_cache_of_maya(data: Path) -> None:
    got = load(data / "alembic" / "Bone_Anim.abc")
    expected = np.load(data / "npz" / "abc_dembones_bone.npz")  # Z up
    assert (got.frame_count, got.fps, got.name) == (400, 24, "BoneShape")
    assert set(got.polygons.counts) == {4}
    np.testing.assert_array_equal(got.faces, expected["faces"])
    turned = np.stack(
        [expected["points"][..., 0], expected["points"][..., 2], -expected["points"][..., 1]], -1
    )
    np.testing.assert_allclose(got.points, turned, rtol=0, atol=1e-7)


@pytest.mark.realdata
def test_a_cache_of_blender(data: Path, path: Path) -> None:
    got = load(data / "alembic" / "q_man_run_blender50.abc")
    expected = np.load(data / "npz" / "q_man_run.npz")
    np.testing.assert_array_equal(got.faces, expected["faces"])
    turned = np.stack(
        [expected["points"][..., 0], expected["points"][..., 2], -expected["points"][..., 1]], -1
    )
    np.testing.assert_allclose(got.points, turned, rtol=0, atol=3e-7)
    assert got.surface.hard_edges is not None
    save(path, got)
    again = load(path)
    np.testing.assert_array_equal(again.points, got.points)
    np.testing.assert_allclose(again.times, got.times, rtol=1e-14)
    assert again.polygons.same_as(got.polygons)


@pytest.mark.realdata
def test_alembic_and_usd_of_one_scene(data: Path) -> None:
    got, other = (
        load(data / "alembic" / "q_man_run_blender50.abc"),
        read(data / "usd" / "q_man_run_blender50.usdc"),
    )
    assert got.polygons.same_as(other.polygons)
    turned = np.stack([other.points[..., 0], other.points[..., 2], -other.points[..., 1]], -1)  # Z up
    np.testing.assert_allclose(got.points, turned, rtol=0, atol=1e-6)
