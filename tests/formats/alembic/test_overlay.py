"""Alembic, writing over an archive: everything else stays, and other programs' caches can be pointed at the result."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

imath = pytest.importorskip("imath")
from alembic3d import Abc, AbcCoreAbstract, AbcGeom, Util  # noqa: E402

import mixseq  # noqa: E402
from mixseq.errors import MixseqWarning, OutputError, SettingsError  # noqa: E402
from mixseq.mesh.polygons import Polygons  # noqa: E402
from mixseq.mesh.surface import Surface  # noqa: E402
from mixseq.sequence.sequence import MeshSequence  # noqa: E402
from mixseq_io.alembic.samples import read_imath_sample, sample_selector, sample_times  # noqa: E402
from tests.formats.alembic.alembic_maker import (  # noqa: E402
    SQUARE,
    TRIANGLES,
    Scope,
    acyclic,
    add_mesh,
    add_transform,
    filled,
    load,
    rising,
    save,
    shift,
)

TIMES = (1.0, 1.5, 2.0)


@pytest.fixture
def shot(tmp_path: Path) -> Path:
    """A rig that moves, with a body, a mirrored sword, hair, an instance of the body, a camera, and odd properties."""
    path = tmp_path / "shot.abc"
    archive = Abc.OArchive(str(path))
    sampling = acyclic(*TIMES)
    turned = shift(x=2)
    turned[:3, :3] = [[0, 1, 0], [-1, 0, 0], [0, 0, 1]]
    rig = add_transform(archive.getTop(), "rig", np.eye(4), shift(x=1), turned, sampling=sampling)

    def dressed(sample: Any, frame: int) -> None:
        normals = filled(imath.V3fArray, np.tile([0, 0, 1], (6, 1)))
        sample.setNormals(AbcGeom.ON3fGeomParamSample(normals, Scope.kFacevaryingScope))

    body = add_mesh(add_transform(rig, "body", shift(z=3)), "body", rising(), sampling, dress=dressed)
    cloth = body.getSchema().createFaceSet("cloth")
    cloth.getSchema().set(AbcGeom.OFaceSetSchemaSample(filled(imath.IntArray, [1])))
    add_mesh(add_transform(rig, "sword", shift(scale=(-0.1, 2, 1))), "sword", SQUARE[None], dress=dressed)
    ghost = add_transform(archive.getTop(), "ghost", shift(y=9))
    ghost.addChildInstance(body, "body")
    odd = Abc.OObject(rig, "hair").getProperties()
    strands = Abc.OFloatArrayProperty(Abc.OCompoundProperty(odd, ".geom"), "strands", archive.addTimeSampling(sampling))
    for value in (1.0, 2.0):
        strands.setValue(filled(imath.FloatArray, [value] * 3))
    Abc.OStringProperty(odd, "note").setValue("hero")
    nine = Abc.OScalarProperty(odd, "nine", AbcCoreAbstract.DataType(Util.POD.kFloat64POD, 7))
    nine.setValue(filled(imath.DoubleArray, np.arange(7.0)))
    camera = AbcGeom.OCamera(add_transform(archive.getTop(), "view", shift(y=-5)), "camera")
    camera.getSchema().set(AbcGeom.CameraSample(-0.1, 0.1, -0.1, 0.1))
    del archive, rig, body, cloth, ghost, odd, strands, nine, camera
    return path


def stored(path: Path) -> dict[str, tuple[str, list[str]]]:
    """Return all properties of all objects: metadata, and the samples with their times, as text."""
    found: dict[str, tuple[str, list[str]]] = {}

    def look(place: str, properties: Any) -> None:
        for header in properties.propertyheaders:
            each, name = properties.getProperty(header.getName()), f"{place}.{header.getName()}"
            if header.isCompound():
                look(name, each)
                continue
            samples = [
                f"{sample_times(each)[k]:g} {told(each.getValue(sample_selector(each, k)))}"
                for k in range(each.getNumSamples())
            ]
            found[name] = str(header.getMetaData().serialize()), samples

    stack = [Abc.IArchive(str(path)).getTop()]
    while stack:
        node = stack.pop()
        if node.isInstanceRoot():
            found[str(node.getFullName())] = "instance", [str(node.instanceSourcePath())]
            continue
        if str(node.getFullName()) != "/":
            look(str(node.getFullName()), node.getProperties())
        stack += [node.getChild(k) for k in range(node.getNumChildren())]
    return found


def told(value: Any) -> str:
    if isinstance(value, imath.M44d):
        return str(np.array(value).tolist())
    return str(list(value)) if hasattr(value, "__len__") and not isinstance(value, str) else str(value)


@pytest.fixture
def body(shot: Path) -> MeshSequence:
    return mixseq.read(shot, prim="/rig/body/body")


def test_everything_else_is_copied(shot: Path, body: MeshSequence, path: Path) -> None:
    mixseq.write(path, body.with_points(body.points + 1))
    before, after = stored(shot), stored(path)
    of_points = tuple(f"/rig/body/body..geom.{name}" for name in ("P", "N", ".velocities", ".selfBnds"))
    kept = {name: values for name, values in before.items() if not name.startswith(of_points)}
    assert {name: after.get(name) for name in kept} == kept
    assert "/rig/hair..geom.strands" in kept and kept["/ghost/body"][1] == ["/rig/body/body"]
    assert after["/rig/hair.nine"][1] == ["0 [0.0, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0]"]
    assert set(after.keys() - kept.keys()) == {*of_points[:1], of_points[3], *normals_of(of_points[1])}


def normals_of(path: str) -> list[str]:
    return [f"{path}..vals", f"{path}..indices"]


def test_points_are_below_the_transforms_that_move(shot: Path, body: MeshSequence, path: Path) -> None:
    mixseq.write(path, body)
    own = AbcGeom.IPolyMesh(Abc.IArchive(str(path)).getTop().getChild("rig").getChild("body"), "body")
    for frame, points in enumerate(rising()):
        sample = own.getSchema().getValue(Abc.ISampleSelector(TIMES[frame]))
        np.testing.assert_allclose(np.asarray(sample.getPositions()), points, atol=1e-6)
    again = mixseq.read(path, prim="/rig/body/body")
    np.testing.assert_allclose(again.points, body.points, atol=1e-6)
    assert [each.path for each in again.objects] == ["/rig/body/body"]


def test_frames_are_those_of_the_sequence(shot: Path, body: MeshSequence, path: Path) -> None:
    speeds = np.full((2, 4, 3), [1.0, 2, 3], np.float32)
    section = replace(body, points=body.points[1:], times=np.array([1.4, 1.7]), velocities=speeds)
    mixseq.write(path, section)
    again = mixseq.read(path, prim="/rig/body")
    np.testing.assert_allclose(again.times, section.times)
    np.testing.assert_allclose(again.points, section.points, atol=1e-6)
    assert again.velocities is not None
    np.testing.assert_allclose(again.velocities, speeds, atol=1e-5)


def test_what_frames_do_not_need_is_left_out(shot: Path, body: MeshSequence, path: Path) -> None:
    """So that programs show the range of the frames; constant samples beside others stay as many."""
    mixseq.write(path, replace(body, points=body.points[1:], times=np.array([1.5, 2.0])))
    after = stored(path)
    assert [sample.partition(" ")[0] for sample in after["/rig..xform..vals"][1]] == ["1.5", "2"]
    assert after["/rig..xform..ops"][1] == ["1.5 48", "2 48"]
    assert after["/rig/hair..geom.strands"][1] == ["1.5 [2.0, 2.0, 2.0]"]
    np.testing.assert_allclose(mixseq.read(path, prim="/rig/body").points, body.points[1:], atol=1e-6)


def test_velocities_are_rates_of_own_points(tmp_path: Path, path: Path) -> None:
    """Below a transform that moves by (2, 0, 0) per second, what stands still in the world moves back."""
    shot = tmp_path / "shot.abc"
    archive = Abc.OArchive(str(shot))
    rig = add_transform(archive.getTop(), "rig", np.eye(4), shift(x=1))
    add_mesh(rig, "body", np.repeat(SQUARE[None], 2, axis=0))
    del archive, rig
    still = MeshSequence.from_arrays(np.repeat(SQUARE[None], 3, axis=0), TRIANGLES, times=[0.1, 0.2, 0.3], fps=10)
    still = replace(still, velocities=np.zeros((3, 4, 3), np.float32))
    mixseq.write(path, still, onto=shot)
    schema = AbcGeom.IPolyMesh(Abc.IArchive(str(path)).getTop().getChild("rig"), "body").getSchema()
    speeds = np.asarray(schema.getVelocitiesProperty().getValue(Abc.ISampleSelector(0.2)))
    np.testing.assert_allclose(speeds, np.tile([-2.0, 0, 0], (4, 1)), atol=1e-6)
    again = load(path).velocities
    assert again is not None
    np.testing.assert_allclose(again, 0, atol=1e-6)


def test_normals_of_a_mirrored_mesh_point_outwards(shot: Path, path: Path) -> None:
    sword = mixseq.read(shot, prim="/rig/sword")
    mixseq.write(path, sword)
    assert mixseq.read(path, prim="/rig/sword").polygons.same_as(sword.polygons)
    top = Abc.IArchive(str(path)).getTop()
    for name in ("sword", "body"):
        schema = AbcGeom.IPolyMesh(top.getChild("rig").getChild(name), name).getSchema()
        normals = np.asarray(schema.getNormalsParam().getExpandedValue(Abc.ISampleSelector(1.0)).getVals())
        np.testing.assert_allclose(normals, np.tile([0.0, 0, 1], (6, 1)), atol=1e-6)


def test_an_instance_that_moves_is_a_mesh_of_its_own(shot: Path, path: Path) -> None:
    ghost = mixseq.read(shot, prim="ghost")
    mixseq.write(path, ghost.with_points(ghost.points * 2))
    np.testing.assert_allclose(mixseq.read(path, prim="ghost").points, ghost.points * 2)
    np.testing.assert_array_equal(
        mixseq.read(path, prim="/rig/body/body").points, mixseq.read(shot, prim="/rig/body/body").points
    )


def test_a_sequence_from_elsewhere_is_found_by_its_faces(shot: Path, body: MeshSequence, path: Path) -> None:
    """As a program leaves it that reorders polygons: the only mesh with these faces gets its points."""
    turned = Polygons.from_triangles([[2, 3, 0], [1, 2, 0]])
    other = MeshSequence.from_arrays(body.points + 5, turned, times=body.times)
    with pytest.raises(OutputError, match=r"shot.abc has 2 meshes with the faces of 'mesh', '/rig/body/body'"):
        mixseq.write(path, other, onto=shot)
    only = shot.with_name("only.abc")
    mixseq.write(only, body, flatten=True)
    mixseq.write(path, other, onto=only)
    again = load(path)
    assert again.polygons.same_as(body.polygons)
    np.testing.assert_array_equal(again.points, other.points)


def test_what_else_moves_is_not_retimed(shot: Path, body: MeshSequence, path: Path) -> None:
    slow = MeshSequence(**{**body.__dict__, "times": [1.0, 3, 5]})
    with pytest.warns(MixseqWarning, match="keeps its own times, 1 to 2 s, and is not retimed: '/rig', '/rig/hair'"):
        mixseq.write(path, slow)
    np.testing.assert_allclose(mixseq.read(path, prim="/rig/body").points, body.points, atol=1e-6)


def test_what_the_library_has_no_words_for(tmp_path: Path, path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Types without a name in Python cannot be made in Python either, so one that can stands for them."""

    def refusing(array: Any, sample: int, room: int) -> Any:
        if array.getName() == ".faceCounts":
            raise RuntimeError("ERROR: Unhandled type")
        return read_imath_sample(array, sample, room)

    shot = tmp_path / "shot.abc"
    save(shot, MeshSequence.from_arrays(rising(), TRIANGLES))
    monkeypatch.setattr("mixseq_io.alembic.overlay.read_imath_sample", refusing)
    with pytest.warns(MixseqWarning, match="cannot copy '/mesh/mesh..faceC"):
        mixseq.write(path, load(shot))


def test_without_the_original_it_is_written_alone(shot: Path, body: MeshSequence, path: Path) -> None:
    mixseq.write(path, body, flatten=True)
    assert [each.path for each in load(path).objects] == ["/rig/body/body"]
    assert Abc.IArchive(str(path)).getTop().getNumChildren() == 1
    shot.unlink()
    with pytest.warns(MixseqWarning, match="does not exist; the result is a stand-alone file"):
        mixseq.write(path, body)
    assert [each.path for each in load(path).objects] == ["/rig/body/body"]


def test_refusals(shot: Path, body: MeshSequence, path: Path) -> None:
    with pytest.raises(SettingsError, match="give one of them"):
        mixseq.write(path, body, onto=shot, flatten=True)
    with pytest.raises(SettingsError, match="sources are 2 times for 3 frames"):
        mixseq.write(path, body, sources=[1.0, 2.0])
    with pytest.raises(OutputError, match="is the original and would be lost"):
        mixseq.write(shot, body)
    flat = Polygons.from_triangles([[0, 1, 2], [0, 3, 2]])
    with pytest.raises(OutputError, match=r"no mesh with the faces of '/rig/body/body': polygon 1 of the sequence"):
        mixseq.write(path, MeshSequence(**{**body.__dict__, "polygons": flat, "surface": bare(body)}), onto=shot)
    fewer = MeshSequence.from_arrays(body.points[:, :3], [[0, 1, 2]])
    save(path, fewer)
    with pytest.raises(OutputError, match="/mesh/mesh has 3 vertices, the sequence 4"):
        mixseq.write(path.with_name("b.abc"), body, onto=path)


def test_the_difference_from_a_mirrored_mesh(tmp_path: Path, path: Path) -> None:
    shot = tmp_path / "shot.abc"
    archive = Abc.OArchive(str(shot))
    add_mesh(add_transform(archive.getTop(), "rig", shift(scale=(-1, 1, 1))), "body", rising())
    del archive
    body = load(shot)
    changed = body.faces.copy()
    changed[-1] = np.roll(changed[-1], 1)[[0, 2, 1]]
    other = replace(body, polygons=Polygons.from_triangles(changed))
    with pytest.raises(OutputError, match=r"polygon 1 of the sequence \(.*\) is flipped in /rig/body"):
        mixseq.write(path, other, onto=shot)


def bare(sequence: MeshSequence) -> Surface:
    return Surface(objects=sequence.objects)


def test_an_object_without_points(tmp_path: Path, path: Path) -> None:
    shot = tmp_path / "shot.abc"
    archive = Abc.OArchive(str(shot))
    rig = add_transform(archive.getTop(), "rig", np.eye(4))
    add_mesh(rig, "body", rising())
    add_mesh(rig, "nothing", np.zeros((3, 0, 3), np.float32), faces=[])
    del archive, rig
    with pytest.warns(MixseqWarning, match="are left out: /rig/nothing has no points$"):
        whole = load(shot, "/")
    mixseq.write(path, whole)
    with pytest.warns(MixseqWarning, match="are left out: /rig/nothing has no points$"):
        again = load(path)
    np.testing.assert_array_equal(again.points, whole.points)
    assert [each.vertex_count for each in again.objects] == [4]


def test_a_mesh_that_is_made_flat(tmp_path: Path, path: Path) -> None:
    shot = tmp_path / "shot.abc"
    archive = Abc.OArchive(str(shot))
    add_mesh(add_transform(archive.getTop(), "rig", np.eye(4), shift(scale=(1, 0, 1))), "body", rising())
    del archive
    with pytest.warns(
        MixseqWarning, match="'/rig/body' cannot get new points: the transforms above it make it flat in frame 1"
    ):
        mixseq.write(path, load(shot))


def test_what_shows_other_times_is_retimed(shot: Path, body: MeshSequence, path: Path) -> None:
    mixseq.write(path, body, sources=body.times)
    with pytest.warns(MixseqWarning, match="is not retimed: '/rig', '/rig/hair'"):
        mixseq.write(path, body, sources=body.times[::-1])


def test_frames_at_other_times_leave_nothing_out(shot: Path, body: MeshSequence, path: Path) -> None:
    """Of a shot that was numbered anew."""
    with pytest.warns(MixseqWarning, match="is not retimed"):
        mixseq.write(path, replace(body, times=body.times + 100))
    assert stored(path)["/rig..xform..vals"] == stored(shot)["/rig..xform..vals"]
    np.testing.assert_allclose(mixseq.read(path, prim="/rig/body").points, body.points, atol=1e-6)
