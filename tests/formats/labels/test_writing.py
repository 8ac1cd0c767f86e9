"""Labels of faces: written as arrays, subsets and groups."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Usd, UsdGeom

from mixseq.errors import MixseqWarning, OutputError
from mixseq.sequence.sequence import MeshSequence
from mixseq_io import Labels, open_sequence, read, read_labels, write
from mixseq_io.text.label_files import labels_of, write_labels
from mixseq_io.text.labels import triangle_labels
from tests.formats.labels.labelled_files import mesh, skinned_strip, subsets, told
from tests.formats.usd_maker import mesh_at, problems
from tests.meshes import bar


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
        write_labels(tmp_path / "out.usda", reader, labels_of(reader))
    old, new = read(path), read(tmp_path / "out.usda")
    assert np.array_equal(old.points.view(np.int32), new.points.view(np.int32))
    for source in (None, "skeleton"):
        assert told(read_labels(tmp_path / "out.usda", old, source)) == ["hip", "knee"]
    with open_sequence(path) as reader:
        write_labels(tmp_path / "alone.usda", reader, labels_of(reader), flatten=True)
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
    with pytest.raises(
        OutputError, match=r"\.ply has no place for parts; write one of \.usd, .*\.npz, \.obj"
    ):
        write_labels(tmp_path / "out.ply", mesh(), Labels(np.zeros(3, dtype=np.int64), ("a",)))
