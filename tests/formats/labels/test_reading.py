"""Labels of faces: found in files of all formats."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from mixseq.errors import FormatError, MixseqWarning, OutputError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.topology import Topology
from mixseq.segmentation.methods import segment_by_labels
from mixseq.sequence.provenance import Provenance
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import Labels, open_sequence, read, read_labels, write
from mixseq_io.text.label_files import extract_labels, write_labels
from mixseq_io.text.labels import triangle_labels
from tests.formats.gltf_maker import SQUARE, Maker, skinned, split_square
from tests.formats.labels.labelled_files import (
    FACES,
    OBJ,
    POINTS,
    display_colours,
    groups,
    mesh,
    ply,
    skinned_strip,
    subsets,
    told,
)
from tests.formats.usd_maker import mesh_at, problems
from tests.meshes import bar


def test_obj_groups(tmp_path: Path) -> None:
    assert told(read_labels(groups(tmp_path / "a.obj"), mesh())) == ["leg", "leg", "arm"]


def test_ply_colours(tmp_path: Path) -> None:
    path = ply(tmp_path / "a.ply", ["255 0 0", "255 0 0", "0 255 0", "255 0 0", "0 255 0"])
    assert told(read_labels(path, mesh())) == ["#ff0000", "#ff0000", "#00ff00"]


@pytest.mark.parametrize("family", ["limbs", "", "mixseq"])
def test_usd_subsets(family: str, tmp_path: Path) -> None:
    path = subsets(tmp_path / "a.usda", family).path
    assert told(read_labels(path, read(path))) == ["leg", "leg", "arm"]
    source = {"limbs": "limbs", "": "groups", "mixseq": "labels"}[family]
    assert told(read_labels(path, read(path), source)) == ["leg", "leg", "arm"]


@pytest.mark.parametrize(
    ("interpolation", "count"), [("uniform", 2), ("vertex", 5), ("varying", 5), ("faceVarying", 7)]
)
def test_usd_colours(interpolation: str, count: int, tmp_path: Path) -> None:
    values = [(0.0, 0.0, 0.0)] * (count - 1) + [(1.0, 1.0, 1.0)]
    if interpolation != "uniform":
        values[-3:] = [(1.0, 1.0, 1.0)] * 3
    if interpolation in ("vertex", "varying"):
        values = [(0.0, 0, 0), (1.0, 1, 1), (0.0, 0, 0), (0.0, 0, 0), (1.0, 1, 1)]
    path = display_colours(tmp_path / "a.usda", values, interpolation)
    assert told(read_labels(path, read(path))) == ["#000000", "#000000", "#ffffff"]


def test_meshes_without_colours_beside_others_are_white(tmp_path: Path) -> None:
    asset = subsets(tmp_path / "a.usda")
    asset.mesh.CreateDisplayColorPrimvar("constant").Set([(1, 0, 0)])
    asset.mesh.CreateDisplayOpacityPrimvar("constant").Set([0.5])
    plain = UsdGeom.Mesh.Define(asset.stage, "/plain")
    plain.CreatePointsAttr([(0, 0, 1), (1, 0, 1), (0, 1, 1)])
    plain.CreateFaceVertexCountsAttr([3])
    plain.CreateFaceVertexIndicesAttr([0, 1, 2])
    asset.stage.Save()
    both = read(asset.path, prim="/")  # the second one stands still
    assert told(read_labels(asset.path, both, "colours", prim="/")) == ["#ff000080"] * 3 + ["#ffffff"]


def test_one_colour_for_all_is_no_source_but_where_it_is_asked_for(tmp_path: Path) -> None:
    asset = subsets(tmp_path / "a.usda")
    asset.mesh.CreateDisplayColorPrimvar("constant").Set([(0.5, 0.5, 0.5)])
    asset.stage.Save()
    assert told(read_labels(asset.path, read(asset.path))) == ["leg", "leg", "arm"]
    assert read_labels(asset.path, read(asset.path), "colours").names == ("#808080",)


def test_usd_skeleton(tmp_path: Path) -> None:
    path = skinned_strip(tmp_path / "man.usda")
    square = read(path)
    assert square.vertex_count == 4
    assert told(read_labels(path, square)) == ["hip", "knee"]


def test_gltf_skeleton(tmp_path: Path) -> None:
    joints = [[1, 0, 0, 0], [0, 1, 0, 0], [0, 1, 0, 0]]
    for weights, name in (([[1, 0, 0, 0]] * 3, "first"), ([[0.3, 0.7, 0, 0]] * 3, "second")):
        path = skinned(weights, [[0, 1, 0, 0]] * len(joints)).glb(tmp_path / "skin.glb")
        assert told(read_labels(path, read(path), "skeleton")) == [name]


def test_gltf_colours_and_materials(tmp_path: Path) -> None:
    def colours(maker: Maker, values: Any, **more: Any) -> int:
        return maker.add(values, **more)

    maker = Maker()
    white = [[255, 255, 255, 255]] * 3 + [[0, 0, 0, 255]]
    on = {"COLOR_0": colours(maker, white, dtype="u1", normalized=True)}
    maker.node("square", mesh=maker.mesh(SQUARE, [[0, 1, 2], [0, 3, 3]], on=on))
    path = maker.glb(tmp_path / "colours.glb")
    assert told(read_labels(path, read(path))) == ["#ffffff", "#000000"]
    path = split_square(material=1).glb(tmp_path / "materials.glb")
    assert told(read_labels(path, read(path))) == ["red", "material 1"]


@pytest.mark.parametrize("name", ["labels", "part_of_face"])
def test_npz(name: str, tmp_path: Path) -> None:
    def saved(**arrays: Any) -> Path:
        np.savez(tmp_path / "a.npz", **arrays)
        return tmp_path / "a.npz"

    assert told(read_labels(saved(**{name: [7, 5, 7]}), mesh())) == ["7", "5", "7"]
    assert told(read_labels(saved(**{name: [7, 5]}), mesh())) == ["7", "7", "5"]
    assert told(read_labels(saved(**{name: ["leg", "arm"]}), mesh())) == ["leg", "leg", "arm"]
    named = saved(**{name: [1, 0, 1]}, names=["a", "b", "c"])
    assert (told(read_labels(named, mesh())), read_labels(named, mesh()).names) == (["b", "a", "b"], ("a", "b", "c"))


def test_a_sequence_may_bring_its_labels_along(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    arrays: dict[str, Any] = {"face_counts": FACES.counts, "face_indices": FACES.indices, "points": POINTS[None]}
    np.savez(path, labels=[0, 1, 1], **arrays)
    assert read_labels(path, read(path)).part_of_face.tolist() == [0, 1, 1]
    with open_sequence(path) as reader:
        assert extract_labels(reader).part_of_face.tolist() == [0, 1, 1]
    with pytest.raises(FormatError, match=r"no 'groups' .* it has labels"):
        read_labels(path, read(path), "groups")


def test_another_file_may_order_its_faces_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    for leg in ("f 3 4 1 2", "f 3 4 1\nf 3 1 2"):  # as a quad, and as triangles
        path.write_text(OBJ + f"g arm\nf 5 3 2\ng leg\n{leg}\n")
        with pytest.warns(MixseqWarning, match=r"^faces of a\.obj have other numbers in mesh; they are matched$"):
            assert told(read_labels(path, mesh())) == ["leg", "leg", "arm"]


def test_another_file_may_split_or_weld_vertices_if_its_faces_are_in_the_same_order(tmp_path: Path) -> None:
    split = mesh(Polygons(np.array([3, 3]), np.array([0, 1, 2, 3, 1, 4])))
    welded = tmp_path / "a.obj"
    welded.write_text(OBJ + "g leg\nf 1 2 3\ng arm\nf 1 2 4\n")  # 3 is 0
    assert told(read_labels(welded, split)) == ["leg", "arm"]
    welded.write_text(OBJ + "g leg\nf 1 2 3\ng arm\nf 4 1 3\n")
    with pytest.raises(FormatError, match=r"polygon 1 of the sequence \(vertices 3 1 4\) is not in .*a\.obj; labels"):
        read_labels(welded, split)


@pytest.mark.realdata
def test_a_character_has_the_same_labels_in_two_formats(data: Path) -> None:
    """CesiumMan.usdz was made of CesiumMan.glb; faces are the same, joints have other names."""
    found = [
        read_labels(path, read(path), "skeleton").part_of_face
        for path in (data / "gltf" / "CesiumMan.glb", data / "usd" / "CesiumMan.usdz")
    ]
    pairs = np.unique(np.stack(found, axis=1), axis=0)
    assert len(pairs) == len(set(found[0].tolist())) == len(set(found[1].tolist())) == 18


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("name", "options", "least"),
    # Measured: 0.923, 0.954, 0.507.
    [
        ("gltf/CesiumMan.glb", {}, 0.85),
        ("usd/CesiumMan.usdz", {}, 0.85),
        ("gltf/KhronosFox.glb", {"animation": "Run"}, 0.4),
    ],
)
def test_skeletons_agree_with_motion(name: str, options: dict[str, Any], least: float, data: Path) -> None:
    from mixseq.segmentation.methods import adjusted_rand_index, segment

    whole = read(data / name, **options)
    topology = Topology(whole.faces, whole.vertex_count)
    skeleton = segment_by_labels(read_labels(data / name, whole, "skeleton", **options).part_of_face, topology)
    motion = segment(whole.points, topology, "motion", int(skeleton.max()) + 1)
    assert adjusted_rand_index(skeleton, motion) > least


# Labels of faces: written as arrays, subsets and groups


def halves(sequence: MeshSequence) -> Labels:
    """Label by polygons: those before the middle, and the others."""
    count = len(sequence.polygons.counts)
    return Labels(triangle_labels(np.arange(count) < count // 2, sequence.polygons), ("upper/arm", "leg 2"))


def check_family(path: Path, prim: str, names: set[str]) -> Usd.Stage:
    stage = Usd.Stage.Open(str(path))
    body = mesh_at(stage, prim)
    assert UsdGeom.Subset.GetFamilyType(body, "mixseq") == UsdGeom.Tokens.partition
    subsets_ = UsdGeom.Subset.GetGeomSubsets(body, "face", "mixseq")
    assert {each.GetPrim().GetName() for each in subsets_} == names
    valid: Any = UsdGeom.Subset.ValidateFamily(body, "face", "mixseq")  # a pair: the type stubs are wrong
    assert valid[0], valid[1]
    return stage


@pytest.mark.parametrize("extension", ["npz", "usda", "usdc", "usdz", "abc", "h5"])
def test_labels_come_back(extension: str, tmp_path: Path) -> None:
    whole = bar(sides=5, rings=9, frames=2)
    labels = halves(whole)
    path = tmp_path / f"out.{extension}"
    write_labels(path, whole, labels)
    found = read_labels(path, whole)
    kept = "upper_arm" if extension == "abc" else "upper/arm"  # Alembic's names have no slashes
    assert told(found) == [each.replace("upper/arm", kept) for each in told(labels)]
    if extension in ("npz", "usda", "usdc", "usdz"):
        np.testing.assert_array_equal(found.part_of_face, labels.part_of_face)
        assert found.names == labels.names
    if extension != "npz":
        np.testing.assert_array_equal(read(path).points.astype(np.float32), whole.points.astype(np.float32))


def test_obj_has_groups(tmp_path: Path) -> None:
    one = mesh()
    write_labels(tmp_path / "out.obj", one, Labels(np.array([1, 1, 0]), ("arm", "leg")))
    assert told(read_labels(tmp_path / "out.obj", one)) == ["leg", "leg", "arm"]


def test_usd_stands_alone_and_is_sound(tmp_path: Path) -> None:
    whole = bar(sides=5, rings=9, frames=2)
    write(tmp_path / "plain.usda", whole)
    before = problems(Usd.Stage.Open(str(tmp_path / "plain.usda")))
    write_labels(tmp_path / "out.usda", whole, halves(whole))
    (prim,) = (each.path for each in read(tmp_path / "out.usda").objects)
    stage = check_family(tmp_path / "out.usda", prim, {"upper_arm", "leg_2"})
    assert {each.replace("plain", "") for each in problems(stage)} == before


def test_over_a_usd_file_nothing_but_subsets_is_written(tmp_path: Path) -> None:
    asset = subsets(tmp_path / "in.usda")
    asset.stage.Save()
    labels = Labels(np.array([0, 0, 1]), ("leg", "b"))
    with open_sequence(asset.path) as reader:
        write_labels(tmp_path / "out.usda", reader, labels)
    text = (tmp_path / "out.usda").read_text()
    assert "point3f[]" not in text
    assert "timeSamples" not in text
    # The name "leg" is that of a subset of another family, which stays.
    stage = check_family(tmp_path / "out.usda", "/set/walker", {"leg_1", "b"})
    assert UsdGeom.Subset.GetGeomSubsets(mesh_at(stage, "/set/walker"), "face", "limbs")
    old, new = read(asset.path), read(tmp_path / "out.usda")
    assert np.array_equal(old.points.view(np.int32), new.points.view(np.int32))
    np.testing.assert_array_equal(old.times, new.times)
    found = read_labels(tmp_path / "out.usda", old)
    assert (found.names, found.part_of_face.tolist()) == (labels.names, [0, 0, 1])
    assert told(read_labels(tmp_path / "out.usda", old, "limbs")) == ["leg", "leg", "arm"]


def test_over_a_file_with_its_faces_in_another_order(tmp_path: Path) -> None:
    asset = subsets(tmp_path / "in.usda")
    before = asset.read()
    asset.mesh.GetFaceVertexCountsAttr().Set([3, 4])
    asset.mesh.GetFaceVertexIndicesAttr().Set([4, 2, 1, 1, 2, 3, 0])
    asset.stage.Save()
    write_labels(tmp_path / "out.usda", before, Labels(np.array([0, 0, 1]), ("body", "tail")))
    found = read(tmp_path / "out.usda")
    assert found.polygons.counts.tolist() == [3, 4]
    assert told(read_labels(tmp_path / "out.usda", found)) == ["tail", "body", "body"]
    with pytest.warns(MixseqWarning, match="have other numbers in"):
        assert told(read_labels(tmp_path / "out.usda", before)) == ["body", "body", "tail"]


def test_parts_of_before_give_way(tmp_path: Path) -> None:
    asset = subsets(tmp_path / "in.usda", "mixseq")
    with open_sequence(asset.path) as reader:
        write_labels(tmp_path / "out.usda", reader, Labels(np.array([0, 0, 0]), ("leg",)))
    check_family(tmp_path / "out.usda", "/set/walker", {"leg"})
    assert told(read_labels(tmp_path / "out.usda", read(asset.path))) == ["leg"] * 3


@pytest.mark.parametrize(("family", "kept"), [("mixseq", []), ("limbs", ["arm", "leg"])])
def test_parts_of_before_are_no_groups_of_a_file_that_stands_alone(
    tmp_path: Path, family: str, kept: list[str]
) -> None:
    asset = subsets(tmp_path / "in.usda", family)
    asset.stage.Save()
    with open_sequence(asset.path) as reader:
        write_labels(tmp_path / "out.usda", reader, Labels(np.zeros(3, dtype=int), ("all",)), flatten=True)
    stage = Usd.Stage.Open(str(tmp_path / "out.usda"))
    found = [each.GetName() for each in stage.Traverse() if UsdGeom.Subset(each)]
    assert sorted(found) == sorted(["all", *kept])


def test_a_skeleton_stays_alive(tmp_path: Path) -> None:
    path = skinned_strip(tmp_path / "man.usda")
    with open_sequence(path) as reader:
        write_labels(tmp_path / "out.usda", reader, extract_labels(reader))
    old, new = read(path), read(tmp_path / "out.usda")
    assert np.array_equal(old.points.view(np.int32), new.points.view(np.int32))
    for source in (None, "skeleton"):
        assert told(read_labels(tmp_path / "out.usda", old, source)) == ["hip", "knee"]
    with open_sequence(path) as reader:
        write_labels(tmp_path / "alone.usda", reader, extract_labels(reader), flatten=True)
    assert "subLayers" not in (tmp_path / "alone.usda").read_text()
    assert told(read_labels(tmp_path / "alone.usda", old)) == ["hip", "knee"]


def test_polygons_in_several_parts_are_told(tmp_path: Path) -> None:
    one, cut = mesh(), Labels(np.array([1, 0, 0]), ("a", "b"))
    with pytest.warns(MixseqWarning, match="1 of 2 polygons are in several parts"):
        write_labels(tmp_path / "out.obj", one, cut)
    write_labels(tmp_path / "out.npz", one, cut)
    assert read_labels(tmp_path / "out.npz", one).part_of_face.tolist() == [1, 0, 0]
    with np.load(tmp_path / "out.npz") as archive:
        assert archive["part_of_polygon"].tolist() == [0, 0]


def test_formats_without_a_place_for_parts(tmp_path: Path) -> None:
    with pytest.raises(OutputError, match=r"\.ply has no place for parts; write one of \.usd, .*\.npz, \.obj"):
        write_labels(tmp_path / "out.ply", mesh(), Labels(np.zeros(3, dtype=np.int64), ("a",)))


def test_arrays_find_faces_that_a_compressed_file_has_renumbered(tmp_path: Path) -> None:
    one = mesh()
    labels = Labels(np.array([0, 0, 1]), ("a", "b"))
    write_labels(tmp_path / "parts.npz", one, labels)
    np.savez(tmp_path / "bare.npz", labels=labels.part_of_face)
    renumbered = replace(one.header, polygons=Polygons(one.polygons.counts[::-1], np.roll(one.polygons.indices, 3)))
    header = replace(renumbered, provenance=Provenance("small.h5", Provenance("one.npz"), 1e-3, order="vertices"))
    with pytest.warns(MixseqWarning, match="have other numbers in"):
        assert read_labels(tmp_path / "parts.npz", header).part_of_face.tolist() == [1, 0, 0]
    with pytest.raises(FormatError, match=r"bare\.npz has labels without a mesh, and faces of small\.h5 have other"):
        read_labels(tmp_path / "bare.npz", header)
