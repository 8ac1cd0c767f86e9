"""Labels that others made: every source, which one is meant, what is refused, and what is written."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from pxr import Gf, Usd, UsdGeom, UsdSkel, Vt

from mixseq.errors import AmbiguousError, FormatError, MixseqError, MixseqWarning, OutputError, SettingsError
from mixseq.polygons import Polygons
from mixseq.segmentation import segment_by_labels
from mixseq.sequence import MeshSequence
from mixseq.surface import FaceSet
from mixseq.topology import Topology
from mixseq_io import Labels, open_sequence, read, read_labels, write
from mixseq_io.labels.faces import polygon_labels, triangle_labels
from mixseq_io.labels.from_markings import (
    labels_of_colours,
    labels_of_sets,
    labels_of_skinning,
    without_small_regions,
)
from mixseq_io.labels.markings import Skinning, joined_skinning
from mixseq_io.labels.reading import labels_of
from mixseq_io.labels.writing import write_labels
from tests.formats.gltf_maker import SQUARE, Maker, skinned, split_square
from tests.formats.usd_maker import Asset, mesh_at, problems
from tests.meshes import bar, grid

# A quad and a triangle beside it, as in usd_maker.
FACES = Polygons(np.array([4, 3]), np.array([0, 1, 2, 3, 1, 4, 2]))
POINTS = np.array([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 1, 0), (2, 0, 0)], dtype=np.float32)

OBJ = "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in POINTS)


def mesh(polygons: Polygons = FACES, count: int = 5) -> MeshSequence:
    return MeshSequence.from_arrays(POINTS[None, :count], polygons)


def told(labels: Labels) -> list[str]:
    """Return the name of the label of every triangle."""
    return [labels.names[part] for part in labels.part_of_face]


# From polygons to labels.


def test_triangles_have_the_labels_of_their_polygons_and_polygons_those_of_most_triangles() -> None:
    pentagon = Polygons(np.array([5, 3]), np.array([0, 1, 2, 3, 4, 0, 2, 1]))
    assert triangle_labels([4, 7], pentagon).tolist() == [4, 4, 4, 7]
    assert polygon_labels(np.array([1, 2, 2, 0]), pentagon).tolist() == [2, 0]
    assert polygon_labels(np.array([3, 2, 1, 9]), pentagon).tolist() == [1, 9]  # of a tie the lowest


def test_polygons_in_several_sets_or_in_none() -> None:
    strip = Polygons.from_triangles(grid(1, 2)[1])
    sets = [
        FaceSet("arm", np.array([0, 1])),
        FaceSet("skin", np.array([1, 2])),
        FaceSet("arm", np.array([2])),
    ]
    assert told(labels_of_sets(sets, strip)) == ["arm", "arm+skin", "arm+skin", "(none)"]
    assert labels_of_sets(sets, strip).names == ("arm", "arm+skin", "(none)")


def test_a_polygon_takes_the_colour_of_most_of_its_corners() -> None:
    red, blue = (1.0, 0.0, 0.0), (0.0, 0.0, 1.0)
    colours = np.array([red, red, blue, red, blue, blue, red])
    assert told(labels_of_colours(colours, FACES)) == ["#ff0000", "#ff0000", "#0000ff"]
    tie = np.array([red, red, blue, blue, red, red, blue])
    assert told(labels_of_colours(tie, FACES)) == ["#0000ff", "#0000ff", "#ff0000"]
    assert told(labels_of_colours(colours + 0.001, FACES)) == told(labels_of_colours(colours, FACES))


def test_more_than_256_colours_are_no_segmentation() -> None:
    triangles = Polygons.from_triangles(np.arange(300).reshape(-1, 3))
    colours = np.zeros((300, 3))
    colours[:256, 0] = np.arange(256) / 255
    assert len(labels_of_colours(colours, triangles).names) > 1
    colours[256:, 1] = 1
    with pytest.raises(FormatError, match="257 vertex colours, which is no segmentation"):
        labels_of_colours(colours, triangles)


def chain(weights: Any, parents: tuple[str, ...] = ("", "a", "a/b")) -> Skinning:
    from scipy.sparse import csr_array

    return Skinning(csr_array(np.array(weights, dtype=float)), ("a", "a/b", "a/b/c"), parents)


def test_a_face_follows_the_joint_with_the_largest_sum_of_weights() -> None:
    # Quad: a 1.4, b 1.6, c 1; triangle: a 0.4, b 1, c 1.6.
    weights = [[1, 0, 0], [0.4, 0.6, 0], [0, 0.4, 0.6], [0, 0.6, 0.4], [0, 0, 1]]
    assert told(labels_of_skinning(chain(weights), FACES, smallest=0)) == ["b", "b", "c"]
    tie = [[1, 0, 0], [1, 0, 0], [0, 1, 0], [0, 1, 0], [0, 1, 0]]
    assert told(labels_of_skinning(chain(tie), FACES, smallest=0)) == ["a", "a", "b"]


def test_small_joints_join_those_above_the_lowest_first() -> None:
    """Of 12 quads in a row joint a has 6, b has 1 and c has 5, which make 6 for b."""
    points, triangles = grid(1, 12)
    quads = Polygons(np.full(12, 4), quads_of(triangles))
    joint = np.repeat([0, 1, 2], [6, 1, 5])
    weights = np.zeros((len(points), 3))
    for quad, corners in enumerate(quads.indices.reshape(-1, 4)):
        weights[corners, joint[quad]] += 1
    skinning = chain(weights)
    names = {share: labels_of_skinning(skinning, quads, share).names for share in (0, 0.2, 0.5)}
    assert names == {0: ("a", "b", "c"), 0.2: ("a", "c"), 0.5: ("a", "b")}


def quads_of(triangles: Any) -> Any:
    """Return the corners of quads, of which every two triangles are the halves."""
    pairs = np.asarray(triangles).reshape(-1, 6)
    return np.stack([pairs[:, 0], pairs[:, 1], pairs[:, 2], pairs[:, 5]], axis=1).reshape(-1)


def test_meshes_share_joints_and_those_without_a_skin_follow_themselves() -> None:
    whole = joined_skinning([chain(np.eye(3)), Skinning.rigid("/hat", 2), chain(np.eye(3)[::-1])])
    assert whole.joints == ("a", "a/b", "a/b/c", "/hat")
    assert whole.weights.toarray().argmax(axis=1).tolist() == [0, 1, 2, 3, 3, 2, 1, 0]


def test_small_regions_join_the_neighbour_with_most_edges_in_common() -> None:
    points, triangles = grid(4, 4)
    polygons = Polygons.from_triangles(triangles)
    labels = np.repeat([0, 1], 16)
    labels[2] = 1  # one astray, amidst of zeros
    tidy = without_small_regions(labels, polygons, len(points), fewest=2)
    assert tidy.tolist() == [0] * 16 + [1] * 16
    np.testing.assert_array_equal(without_small_regions(labels, polygons, len(points), fewest=0), labels)
    assert len(set(without_small_regions(labels, polygons, len(points), fewest=99).tolist())) == 1


# Files.


def groups(path: Path) -> Path:
    path.write_text(OBJ + "g leg\nf 1 2 3 4\ng arm\nf 2 5 3\n")
    return path


def ply(path: Path, colours: list[str]) -> Path:
    rows = [f"{x:g} {y:g} {z:g} {colour}" for (x, y, z), colour in zip(POINTS, colours, strict=True)]
    kinds = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    path.write_text(
        "ply\nformat ascii 1.0\nelement vertex 5\nproperty float x\nproperty float y\nproperty float z\n"
        + kinds
        + "element face 2\nproperty list uchar int vertex_indices\nend_header\n"
        + "\n".join([*rows, "4 0 1 2 3", "3 1 4 2"])
        + "\n"
    )
    return path


def subsets(path: Path, family: str = "limbs") -> Asset:
    asset = Asset(path)
    for name, faces in (("leg", [0]), ("arm", [1])):
        UsdGeom.Subset.CreateGeomSubset(asset.mesh, name, "face", Vt.IntArray(faces), family)
    asset.stage.Save()
    return asset


def display_colours(path: Path, values: list[tuple[float, float, float]], interpolation: str) -> Path:
    asset = Asset(path)
    asset.mesh.CreateDisplayColorPrimvar(interpolation).Set(values)
    asset.stage.Save()
    return path


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


def test_one_colour_for_all_is_no_source_but_where_it_is_asked_for(tmp_path: Path) -> None:
    asset = subsets(tmp_path / "a.usda")
    asset.mesh.CreateDisplayColorPrimvar("constant").Set([(0.5, 0.5, 0.5)])
    asset.stage.Save()
    assert told(read_labels(asset.path, read(asset.path))) == ["leg", "leg", "arm"]
    assert read_labels(asset.path, read(asset.path), "colours").names == ("#808080",)


def skinned_strip(path: Path) -> Path:
    """Save two triangles of a square that share no point, each on a joint of its own; the second joint rises."""
    stage = Usd.Stage.CreateNew(str(path))
    UsdGeom.SetStageUpAxis(stage, "Y")
    UsdSkel.Root.Define(stage, "/man")
    skeleton = UsdSkel.Skeleton.Define(stage, "/man/bones")
    skeleton.CreateJointsAttr(["hip", "hip/knee"])
    for attribute in (skeleton.CreateBindTransformsAttr(), skeleton.CreateRestTransformsAttr()):
        attribute.Set(Vt.Matrix4dArray([Gf.Matrix4d(1.0)] * 2))
    motion = UsdSkel.Animation.Define(stage, "/man/motion")
    motion.CreateJointsAttr(["hip", "hip/knee"])
    motion.CreateRotationsAttr([Gf.Quatf(1.0)] * 2)
    motion.CreateScalesAttr([Gf.Vec3h(1, 1, 1)] * 2)
    for code in (0, 1):
        motion.CreateTranslationsAttr().Set([(0, 0, 0), (0, code, 0)], code)
    UsdSkel.BindingAPI.Apply(skeleton.GetPrim()).CreateAnimationSourceRel().SetTargets(["/man/motion"])
    body = UsdGeom.Mesh.Define(stage, "/man/body")
    body.CreatePointsAttr([(0, 0, 0), (1, 0, 0), (1, 1, 0), (0, 0, 0), (1, 1, 0), (0, 1, 0)])
    body.CreateFaceVertexCountsAttr([3, 3])
    body.CreateFaceVertexIndicesAttr([0, 1, 2, 3, 4, 5])
    binding = UsdSkel.BindingAPI.Apply(body.GetPrim())
    binding.CreateSkeletonRel().SetTargets(["/man/bones"])
    # In an order of the mesh's own: index 0 is the knee. Points on the diagonal are halves, and are welded.
    binding.CreateJointsAttr(["hip/knee", "hip"])
    binding.CreateJointIndicesPrimvar(False, 2).Set([0, 1] * 6)
    halves = [0.5, 0.5]
    weights = [*halves, 0.0, 1.0, *halves, *halves, *halves, 1.0, 0.0]
    binding.CreateJointWeightsPrimvar(False, 2).Set(weights)
    stage.Save()
    return path


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


def test_another_file_may_split_or_weld_vertices_but_not_order_faces_otherwise(tmp_path: Path) -> None:
    split = mesh(Polygons(np.array([3, 3]), np.array([0, 1, 2, 3, 1, 4])))
    welded = tmp_path / "a.obj"
    welded.write_text(OBJ + "g leg\nf 1 2 3\ng arm\nf 1 2 4\n")  # 3 is 0
    assert told(read_labels(welded, split)) == ["leg", "arm"]
    welded.write_text(OBJ + "g leg\nf 1 2 3\ng arm\nf 4 1 3\n")
    with pytest.raises(FormatError, match="in another order"):
        read_labels(welded, split)


# What is refused.


def two_sources(path: Path) -> Path:
    asset = subsets(path)
    asset.mesh.CreateDisplayColorPrimvar("uniform").Set([(0, 0, 0), (1, 1, 1)])
    asset.stage.Save()
    return path


def nothing(path: Path) -> Path:
    path.write_text(OBJ + "f 1 2 3 4\nf 2 5 3\n")
    return path


def arrays(**values: Any) -> Callable[[Path], Path]:
    def save(path: Path) -> Path:
        np.savez(path, **values)
        return path

    return save


def many_colours(path: Path) -> Path:
    points, faces = grid(20, 20)
    rows = [f"{x:g} {y:g} {z:g} {n % 256} {n // 256} 0" for n, (x, y, z) in enumerate(points)]
    rows += ["3 " + " ".join(map(str, face)) for face in faces]
    colours = "".join(f"property uchar {name}\n" for name in ("red", "green", "blue"))
    head = f"ply\nformat ascii 1.0\nelement vertex {len(points)}\n"
    head += "property float x\nproperty float y\nproperty float z\n" + colours
    head += f"element face {len(faces)}\nproperty list uchar int vertex_indices\nend_header\n"
    path.write_text(head + "\n".join(rows) + "\n")
    return path


@pytest.mark.parametrize(
    ("name", "make", "source", "kind", "message"),
    [
        ("a.obj", nothing, None, FormatError, "no labels of faces; it has no array of labels, sets of faces"),
        ("a.obj", groups, "skeleton", FormatError, "no 'skeleton' to label faces by; it has groups"),
        (
            "a.usda",
            two_sources,
            None,
            AmbiguousError,
            "several sources of labels: limbs, colours; choose one",
        ),
        ("a.ply", many_colours, None, FormatError, "441 vertex colours, which is no segmentation"),
        (
            "a.npz",
            arrays(labels=np.zeros(4, int)),
            None,
            FormatError,
            "4 labels, .* 3 triangles and 2 polygons",
        ),
        ("a.npz", arrays(labels=[0.5, 1, 2]), None, FormatError, "whole numbers or names"),
        ("a.npz", arrays(labels=[[0, 1, 2]]), None, FormatError, r"shape \(1, 3\)"),
        ("a.npz", arrays(paint=[0, 1, 2]), None, FormatError, "arrays paint; `part_of_face` or `labels`"),
        ("a.npz", lambda path: path, None, FormatError, "does not exist"),
        ("a.npz", groups, None, FormatError, "damaged, truncated or of another type"),
    ],
)
def test_refusals(
    name: str,
    make: Callable[[Path], Path],
    source: str | None,
    kind: type[MixseqError],
    message: str,
    tmp_path: Path,
) -> None:
    path = make(tmp_path / name)
    whole = read(path) if name.endswith(("usda", "ply")) else mesh()
    with pytest.raises(kind, match=message) as caught:
        read_labels(path, whole, source)
    assert str(path) in str(caught.value)


def test_labels_of_another_mesh(tmp_path: Path) -> None:
    with pytest.raises(FormatError, match="3 triangles, the sequence 1"):
        read_labels(groups(tmp_path / "a.obj"), mesh(Polygons.from_triangles([[0, 1, 2]])))


def test_the_smallest_joint_is_a_share(tmp_path: Path) -> None:
    path = skinned_strip(tmp_path / "man.usda")
    with pytest.raises(SettingsError, match="smallest_joint is 7"):
        read_labels(path, read(path), "skeleton", smallest_joint=7)


def test_a_painted_mesh_does_not_stand_in_the_way_of_labels(tmp_path: Path) -> None:
    many_colours(tmp_path / "a.ply")
    points, faces = grid(20, 20)
    asset = Asset(tmp_path / "a.usda", Polygons.from_triangles(faces))
    asset.mesh.GetPointsAttr().Clear()
    asset.mesh.GetPointsAttr().Set(Vt.Vec3fArrayFromBuffer(points.astype(np.float32)))
    asset.mesh.CreateDisplayColorPrimvar("vertex").Set([(n / 440, n % 2, 0) for n in range(441)])
    UsdGeom.Subset.CreateGeomSubset(asset.mesh, "half", "face", Vt.IntArray(list(range(400))), "")
    asset.stage.Save()
    assert set(told(read_labels(asset.path, read(asset.path)))) == {"half", "(none)"}


# Writing.


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


# Real characters.


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
    from mixseq.segmentation.agreement import adjusted_rand_index
    from mixseq.segmentation.methods import segment

    whole = read(data / name, **options)
    topology = Topology(whole.faces, whole.vertex_count)
    skeleton = segment_by_labels(
        read_labels(data / name, whole, "skeleton", **options).part_of_face, topology
    )
    motion = segment(whole.points, topology, "motion", int(skeleton.max()) + 1)
    assert adjusted_rand_index(skeleton, motion) > least
