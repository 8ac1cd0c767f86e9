"""Labels of faces: found in files of all formats."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import UsdGeom

from mixseq.errors import FormatError
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.topology import Topology
from mixseq.segmentation.methods import segment_by_labels
from mixseq_io import open_sequence, read, read_labels
from mixseq_io.text.label_files import labels_of
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
    assert (told(read_labels(named, mesh())), read_labels(named, mesh()).names) == (
        ["b", "a", "b"],
        ("a", "b", "c"),
    )


def test_a_sequence_may_bring_its_labels_along(tmp_path: Path) -> None:
    path = tmp_path / "a.npz"
    arrays: dict[str, Any] = {
        "face_counts": FACES.counts,
        "face_indices": FACES.indices,
        "points": POINTS[None],
    }
    np.savez(path, labels=[0, 1, 1], **arrays)
    assert read_labels(path, read(path)).part_of_face.tolist() == [0, 1, 1]
    with open_sequence(path) as reader:
        assert labels_of(reader).part_of_face.tolist() == [0, 1, 1]
    with pytest.raises(FormatError, match=r"no 'groups' .* it has labels"):
        read_labels(path, read(path), "groups")


def test_another_file_may_order_its_faces_otherwise(tmp_path: Path) -> None:
    path = tmp_path / "a.obj"
    path.write_text(OBJ + "g arm\nf 5 3 2\ng leg\nf 3 4 1 2\n")
    assert told(read_labels(path, mesh())) == ["leg", "leg", "arm"]
    path.write_text(OBJ + "g arm\nf 5 3 2\ng leg\nf 3 4 1\nf 3 1 2\n")  # and be cut into triangles
    assert told(read_labels(path, mesh())) == ["leg", "leg", "arm"]


def test_another_file_may_split_or_weld_vertices_if_its_faces_are_in_the_same_order(tmp_path: Path) -> None:
    split = mesh(Polygons(np.array([3, 3]), np.array([0, 1, 2, 3, 1, 4])))
    welded = tmp_path / "a.obj"
    welded.write_text(OBJ + "g leg\nf 1 2 3\ng arm\nf 1 2 4\n")  # 3 is 0
    assert told(read_labels(welded, split)) == ["leg", "arm"]
    welded.write_text(OBJ + "g leg\nf 1 2 3\ng arm\nf 4 1 3\n")
    with pytest.raises(
        FormatError, match=r"polygon 1 of the sequence \(vertices 3 1 4\) is not in .*a\.obj; labels"
    ):
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
    skeleton = segment_by_labels(
        read_labels(data / name, whole, "skeleton", **options).part_of_face, topology
    )
    motion = segment(whole.points, topology, "motion", int(skeleton.max()) + 1)
    assert adjusted_rand_index(skeleton, motion) > least
