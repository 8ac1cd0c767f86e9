"""glTF, writing: what is carried over of the file that a sequence came from."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray
from scipy.spatial import KDTree

import mixseq
from mixseq.choices import StillName
from mixseq.errors import MixseqWarning
from mixseq.mesh.polygons import Polygons
from mixseq.mesh.surface import CornerValues
from mixseq.rigging.fitting import fit_skin
from mixseq.sequence.sequence import MeshSequence
from tests.formats.conftest import lossy
from tests.formats.gltf_files import IMAGE, Gltf, Json, read, rigged, validate, write_glb, written
from tests.formats.gltf_maker import TRIANGLE, Maker, load
from tests.given import chunks
from tests.meshes import bar

pytestmark = pytest.mark.slow


def test_what_is_carried_over(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    before, file = Gltf(rig), written(tmp_path / "new.glb", lifted)
    for kind in ("cameras", "materials", "textures", "samplers"):
        assert file.json[kind] == before.json[kind]
    image = file.json["images"][0]
    assert (image["name"], file.view(image["bufferView"])) == ("fox", IMAGE)
    assert file.json["asset"]["copyright"] == "nobody"
    assert file.node("body")["extras"]["note"] == "keep"
    np.testing.assert_array_equal(file.attribute("tree", "POSITION"), before.attribute("tree", "POSITION"))
    assert sorted(file.primitives("body")[0]["attributes"]) == ["NORMAL", "POSITION", "TEXCOORD_0", "_VERTEX"]
    assert file.primitives("body")[0]["material"] == 0
    assert file.triangles("body") == before.triangles("body")
    np.testing.assert_array_equal(file.attribute("body", "TEXCOORD_0"), before.attribute("body", "TEXCOORD_0"))
    assert file.json["skins"] == [
        {"joints": [2, 3]}
    ]  # which are bones, without what only it and the old animation used
    assert len(file.json["accessors"]) == 3 + 3 + 3 * 2
    assert [each["name"] for each in file.json["animations"]] == ["body"]


def test_every_copy_of_a_vertex_moves_with_it(lifted: MeshSequence, tmp_path: Path) -> None:
    file = written(tmp_path / "new.glb", lifted)
    for time, points in zip(lifted.times, lifted.points, strict=True):
        np.testing.assert_array_equal(file.played("body", time), points[[0, 1, 2, 0, 2, 3]])
    tilted = np.array([0, -3, 1]) / np.sqrt(10)
    np.testing.assert_allclose(file.played("body", 1, "NORMAL"), [tilted] * 6, atol=1e-6)


def test_triangles_in_another_order(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    hard = np.array([0, 1, 2, 3, 4, 5])  # triangle by triangle
    shuffled = Polygons.from_triangles(np.roll(lifted.faces[::-1], 1, axis=1))
    order = [5, 3, 4, 2, 0, 1]
    assert lifted.polygons.indices[order].tolist() == shuffled.indices.tolist()
    same = replace(lifted, surface=replace(lifted.surface, face_sets=(), uvs=None, hard_edges=hard))
    other = replace(same, polygons=shuffled, surface=replace(same.surface, hard_edges=hard[order].astype(np.int32)))
    one, two = (written(tmp_path / name, each, onto=rig) for name, each in (("1.glb", same), ("2.glb", other)))
    for attribute in ("POSITION", "NORMAL"):
        np.testing.assert_array_equal(two.played("body", 1, attribute), one.played("body", 1, attribute))


def test_what_is_written_onto_a_file_is_read_again(lifted: MeshSequence, tmp_path: Path) -> None:
    written(tmp_path / "new.glb", lifted)
    again = read(tmp_path / "new.glb", prim="body")
    np.testing.assert_array_equal(again.points, lifted.points)
    np.testing.assert_array_equal(again.times, lifted.times)
    assert again.polygons.same_as(lifted.polygons)
    assert [each.material for each in again.surface.face_sets] == ["fur"]
    written(tmp_path / "newer.glb", again)  # and onto that
    np.testing.assert_array_equal(read(tmp_path / "newer.glb", prim="body").points, lifted.points)


def test_the_node_stays_and_undoes_what_is_above_it(lifted: MeshSequence, tmp_path: Path) -> None:
    file = written(tmp_path / "new.glb", lifted)
    nodes = file.json["nodes"]
    assert file.json["scenes"] == [{"nodes": [0, 5]}]
    assert nodes[0]["children"] == [1, 6, 2]
    assert nodes[1]["translation"] == [-10, 0, 0]
    assert nodes[1]["extras"] == {"note": "keep", "mixseq:world": True}
    assert nodes[6] == {"name": "body", "children": [4]}
    again = read(tmp_path / "new.glb", prim="body")
    assert [each.path for each in again.objects] == ["rig/body"]
    np.testing.assert_array_equal(again.points, lifted.points)


UNEVEN = {"rotation": [0.36, -0.48, 0.64, 0.48], "scale": [100, 100.00001, 99.99999], "translation": [0.3, -7, 1e3]}


def in_single_precision(sequence: MeshSequence) -> MeshSequence:
    """Round what transforms move far from zero, so that no origin is needed."""
    return sequence.with_points(sequence.points.astype(np.float32))


def test_what_is_nearly_undone_is_read_exactly(rig: Path, tmp_path: Path) -> None:
    change(rig, lambda document: document["nodes"][0].update(UNEVEN))
    sequence = in_single_precision(read(rig, prim="rig/body"))
    written(tmp_path / "new.glb", sequence)
    again = read(tmp_path / "new.glb", prim="rig/body")
    np.testing.assert_array_equal(again.points, sequence.points)
    document, buffer = chunks(tmp_path / "new.glb")
    document["nodes"][0]["translation"] = [0.3, -7, 1001]  # by somebody else
    write_glb(tmp_path / "moved.glb", document, buffer)
    np.testing.assert_allclose(
        read(tmp_path / "moved.glb", prim="rig/body").points, sequence.points + np.array([0, 0, 1]), atol=2e-4
    )


def shear(document: Json) -> None:
    """Let what is above the square be undone by no translation, rotation and scale."""
    document["nodes"][0].update(scale=[1, 2, 3])
    document["nodes"].append({"name": "top", "children": [0], "rotation": [0, 0, 0.6, 0.8]})
    document["nodes"][0].update(rotation=[0.6, 0, 0, 0.8])
    document["scenes"][0]["nodes"] = [6, 5]


@pytest.mark.parametrize("edit", [shear, lambda document: document["nodes"][1].update(extras="a text")])
def test_what_cannot_be_undone_is_left(rig: Path, tmp_path: Path, edit: Callable[[Json], object]) -> None:
    """The node becomes a root, its children stay."""
    change(rig, edit)
    with lossy():
        sequence = in_single_precision(read(rig))
    file = written(tmp_path / "new.glb", sequence)
    nodes, roots = file.json["nodes"], file.json["scenes"][0]["nodes"]
    np.testing.assert_array_equal(read(tmp_path / "new.glb", prim="body").points, sequence.points)
    body = nodes.index(file.node("body"))
    assert roots[0] == body
    assert set(nodes[body]) == {"name", "mesh", "extras"}
    stand_in = nodes[nodes[0]["children"][0]]
    assert stand_in == {"name": "body", "children": [4]}
    assert nodes[0]["children"][1] == 2


def change(rig: Path, edit: Callable[[Json], object]) -> None:
    """Change the document of a file."""
    document, buffer = rigged()
    edit(document)
    write_glb(rig, document, buffer)


def test_without_normals_a_mesh_stays_flat(rig: Path, tmp_path: Path) -> None:
    change(rig, lambda document: document["meshes"][0]["primitives"][0]["attributes"].pop("NORMAL"))
    with lossy():
        file = written(tmp_path / "new.glb", read(rig))
    primitive = file.primitives("body")[0]
    assert "NORMAL" not in primitive["attributes"]
    assert [list(each) for each in primitive["targets"]] == [["POSITION"]] * 2


def test_strips_stay_strips(rig: Path, tmp_path: Path) -> None:
    change(rig, lambda document: document["meshes"][0]["primitives"][0].update(mode=5))
    with lossy():
        file = written(tmp_path / "new.glb", read(rig))
    assert file.primitives("body")[0]["mode"] == 5
    assert file.accessor(file.primitives("body")[0]["indices"]).tolist() == [0, 1, 2, 3, 4, 5]


def test_mirrored_triangles_are_turned_around(rig: Path, tmp_path: Path) -> None:
    def mirror(document: Json) -> None:
        document["nodes"][0]["scale"] = [-1, 1, 1]
        document["nodes"][1].pop("skin")

    change(rig, mirror)
    sequence = read(rig, prim="rig/body")
    assert sequence.points[0, 1].tolist() == [9, 0, 0]
    file = written(tmp_path / "new.glb", sequence)
    assert file.triangles("body") == [[0, 2, 1], [3, 5, 4]]
    np.testing.assert_array_equal(file.attribute("body", "NORMAL"), [[0, 0, 1]] * 6)


def test_meshes_that_nodes_share_become_two(rig: Path, tmp_path: Path) -> None:
    change(rig, lambda document: document["nodes"][5].update(mesh=0, translation=[0, 7, 0]))
    sequence = read(rig, prim="/")
    assert [each.name for each in sequence.objects] == ["body", "tree"]
    file = written(tmp_path / "new.glb", sequence)
    assert file.node("body")["mesh"] != file.node("tree")["mesh"]
    assert file.played("tree", 1)[0].tolist() == [0, 7, 0]
    assert [each.path for each in read(tmp_path / "new.glb", prim="/").objects] == ["rig/body", "tree"]


def test_joints_of_other_skins_stay_where_they_are(rig: Path, tmp_path: Path) -> None:
    def bind(document: Json) -> None:  # the tree to the body
        tree = document["meshes"][1]["primitives"][0]
        attributes = document["meshes"][0]["primitives"][0]["attributes"]
        document["meshes"][1]["primitives"] = [{**tree, "attributes": dict(attributes)}]
        document["skins"].append({"joints": [0, 1]})
        document["nodes"][5]["skin"] = 1

    change(rig, bind)
    with lossy():
        file = written(tmp_path / "new.glb", read(rig, prim="rig/body"))
    stand_in = file.json["skins"][1]["joints"][1]
    assert stand_in == file.json["nodes"][0]["children"][1]
    assert file.json["nodes"][stand_in]["children"] == [4]


def test_other_things_that_were_animated_are_named(rig: Path, tmp_path: Path) -> None:
    def shake(document: Json) -> None:
        nod = document["animations"][0]
        channel = {"sampler": 0, "target": {"node": 5, "path": "translation"}}
        document["animations"].append({"channels": [channel], "samplers": nod["samplers"]})

    change(rig, shake)
    with lossy():
        sequence = read(rig)
    with pytest.warns(MixseqWarning, match="the place of all its animations, 'nod', 'animation 1'; .* still: 'tree'$"):
        written(tmp_path / "new.glb", sequence)


def test_images_in_files_are_taken_along(rig: Path, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    moved = tmp_path / "in" / "rig.glb"
    rig.rename(moved)
    (tmp_path / "in" / "my fox.png").write_bytes(IMAGE)
    (tmp_path / "secret.png").write_bytes(IMAGE)
    (tmp_path / "in" / "notes.txt").write_text("not an image")
    uris = ["my%20fox.png", "gone.png", "../secret.png", "notes.txt"]
    change(moved, lambda document: document["images"].extend({"uri": uri} for uri in uris))
    with lossy():
        sequence = read(moved)
    with pytest.warns(MixseqWarning) as caught:
        file = written(tmp_path / "new.glb", sequence)
    images = file.json["images"][1:]
    assert images[0]["mimeType"] == "image/png"
    assert file.view(images[0]["bufferView"]) == IMAGE
    assert [each.get("uri") for each in images[1:]] == uris[1:]
    messages = [str(each.message) for each in caught]
    assert len(messages) == 3
    assert all("the image is not copied, only the reference to it" in each for each in messages)


def test_unknown_extensions_keep_everything(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    change(rig, lambda document: document.update(extensions={"ACME_bones": {}}))
    with pytest.warns(MixseqWarning, match=r"old animation is kept, too, because 'ACME_bones' may refer to it"):
        file = written(tmp_path / "new.glb", lifted)
    assert len(file.json["skins"]) == 1
    assert len(file.json["accessors"]) > len(rigged()[0]["accessors"])


def both(rig: Path) -> None:
    """Move the tree as the body, under one root."""

    def share(document: Json) -> None:
        document["nodes"][5].update(mesh=0, skin=0)
        document["nodes"] += [{"name": "all", "children": [0, 5]}]
        document["scenes"] = [{"nodes": [6]}]

    change(rig, share)


@pytest.mark.parametrize("several", [False, True])
@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
def test_again_and_again_nothing_grows(rig: Path, tmp_path: Path, several: bool, suffix: str) -> None:
    if several:
        both(rig)
    sizes, names, file = [], [], rig
    for number in range(4):
        with lossy():
            sequence = read(file)
        file = tmp_path / f"{number}{suffix}"
        document = written(file, sequence).json
        names.append((sequence.name, [each.path.rpartition("/")[2] for each in sequence.objects]))
        sizes.append([file.stat().st_size, *(len(document[kind]) for kind in ("nodes", "accessors"))])
    assert sizes[0] == sizes[1] == sizes[2] == sizes[3]
    assert len({str(name) for name in names}) == 1


def test_turned_triangles_leave_nothing_behind(rig: Path, tmp_path: Path) -> None:
    def mirror(document: Json) -> None:
        document["nodes"][0]["scale"] = [-1, 1, 1]
        document["nodes"][1].pop("skin")

    change(rig, mirror)
    document = written(tmp_path / "new.glb", read(rig, prim="rig/body")).json
    used = {number for sampler in document.get("animations", []) for number in sampler.values()}
    for primitive in (each for mesh in document["meshes"] for each in mesh["primitives"]):
        used |= {*primitive["attributes"].values(), *([primitive["indices"]] if "indices" in primitive else [])}
    assert used == set(range(len(document["accessors"])))


def test_compression_that_is_gone_is_not_declared(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    def compress(document: Json) -> None:
        document["meshes"][0]["primitives"][0]["extensions"] = {"KHR_draco_mesh_compression": {}}
        document["extensionsUsed"] = ["KHR_draco_mesh_compression", "KHR_mesh_quantization"]

    change(rig, compress)
    file = written(tmp_path / "new.glb", lifted)
    assert file.json["extensionsUsed"] == ["KHR_mesh_quantization"]


def test_nodes_that_nothing_transforms_stay_where_they_are(rig: Path, tmp_path: Path) -> None:
    def rest(document: Json) -> None:
        for key in ("matrix", "translation", "rotation", "scale"):
            document["nodes"][0].pop(key, None)

    change(rig, rest)
    file = rig
    for number in range(3):
        with lossy():
            sequence = read(file, prim="rig/body")
        file = tmp_path / f"{number}.glb"
        children = written(file, sequence).json["nodes"][0]["children"]
        assert children[0] == 1
        again = read(file, prim="rig/body")
        np.testing.assert_array_equal(again.points, sequence.points)


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["Stag", "KhronosFox", "RobotExpressive"])
def test_paths_that_stay_the_same(data: Path, tmp_path: Path, name: str) -> None:
    """The mesh `RootNode/Stag` is found by its path in the copy, and in the copy of that."""
    file = data / "gltf" / f"{name}.glb"
    sequence = read(file, animation=0, prim="/")
    paths = [each.path for each in sequence.objects]
    body = next(path for path in paths if path.count("/") < 2)
    for number in range(2):
        with lossy():
            written(tmp_path / f"{number}.glb", sequence)
        again = read(tmp_path / f"{number}.glb", prim="/")
        np.testing.assert_array_equal(again.faces, sequence.faces)
        assert read(tmp_path / f"{number}.glb", prim=body).objects[0].path == body
        sequence = again


# Colours in glTF: the forms that COLOR_0 has, and the one that is written

RGBA = np.array([[1, 0, 0.2, 0.4], [0, 1, 0, 1], [0.6, 0.8, 1, 0]])


@pytest.mark.parametrize("width", [3, 4])
@pytest.mark.parametrize(("dtype", "largest"), [("f4", 1), ("u1", 255), ("u2", 65535)])
@pytest.mark.parametrize("told", [True, False], ids=["normalized", "not told"])
def test_forms(tmp_path: Path, width: int, dtype: str, largest: int, told: bool) -> None:
    maker = Maker()
    more: dict[str, Any] = {"normalized": True} if told and dtype != "f4" else {}
    colours = maker.add(np.rint(RGBA[:, :width] * largest) if largest > 1 else RGBA[:, :width], dtype, **more)
    maker.node("flag", mesh=maker.mesh(TRIANGLE, on={"COLOR_0": colours}))
    found = load(maker.glb(tmp_path / "a.glb")).surface.colours
    assert found is not None
    expected = RGBA if width == 4 else np.column_stack([RGBA[:, :3], np.ones(3)])
    np.testing.assert_array_equal(found.at_corners, expected.astype(np.float32))


def test_primitives_without_colours_are_white(tmp_path: Path) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE, on={"COLOR_0": maker.add(RGBA)})
    maker.json["meshes"][mesh]["primitives"].append({"attributes": {"POSITION": maker.add(TRIANGLE)}})
    maker.node("flags", mesh=mesh)
    found = load(maker.glb(tmp_path / "a.glb")).surface.colours
    assert found is not None
    np.testing.assert_array_equal(found.at_corners[3:], np.ones((3, 4)))


def test_several_sets(tmp_path: Path) -> None:
    maker = Maker()
    on = {"COLOR_0": maker.add(RGBA), "COLOR_1": maker.add(np.ones((3, 4)))}
    maker.node("flag", mesh=maker.mesh(TRIANGLE, on=on))
    path = maker.glb(tmp_path / "a.glb")
    with pytest.warns(MixseqWarning, match="several sets of colours; COLOR_0 is read"):
        found = load(path).surface.colours
    assert found is not None
    np.testing.assert_array_equal(found.at_corners, RGBA.astype(np.float32))


def test_bytes_are_written_as_bytes(tmp_path: Path) -> None:
    sequence = painted_bar()
    file = written(tmp_path / "a.glb", sequence)
    (primitive,) = file.primitives(sequence.name)
    accessor = file.json["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5121, True, "VEC4")
    floats = with_colours(sequence, lambda values: values**2)
    (primitive,) = written(tmp_path / "b.glb", floats).primitives(sequence.name)
    assert Gltf(tmp_path / "b.glb").json["accessors"][primitive["attributes"]["COLOR_0"]]["componentType"] == 5126


def with_colours(sequence: MeshSequence, change: Any) -> MeshSequence:
    colours = sequence.surface.colours
    assert colours is not None
    return replace(
        sequence, surface=replace(sequence.surface, colours=CornerValues(change(colours.values), colours.indices))
    )


def painted_bar() -> MeshSequence:
    """A bending bar, painted along its length."""
    sequence = bar(5, 9, 6)
    height = sequence.points[0, :, 0]
    shade = np.rint(255 * (height - height.min()) / np.ptp(height)) / 255
    colours = np.column_stack([shade, 1 - shade, np.zeros_like(shade), np.ones_like(shade)])
    surface = replace(sequence.surface, colours=CornerValues(colours, sequence.polygons.indices))
    return replace(sequence, surface=surface)


@pytest.mark.parametrize("still", ["draco", "plain"])
def test_stills_are_painted(tmp_path: Path, still: StillName) -> None:
    sequence = painted_bar()
    mixseq.save(tmp_path / "a.glb", mixseq.compress(sequence, max_error=0.01), still=still)
    document = Gltf(tmp_path / "a.glb").json
    (primitive,) = document["meshes"][0]["primitives"]
    accessor = document["accessors"][primitive["attributes"]["COLOR_0"]]
    assert (accessor["componentType"], accessor["normalized"], accessor["type"]) == (5121, True, "VEC4")
    validate(tmp_path / "a.glb")


def test_skins_are_painted(tmp_path: Path) -> None:
    sequence = painted_bar()
    for name in ("a.glb", "a.usdc"):
        mixseq.write_rig(tmp_path / name, fit_skin(sequence, bones=2))
        got = mixseq.read(tmp_path / name).surface.colours
        assert got is not None and sequence.surface.colours is not None
        np.testing.assert_array_equal(np.unique(got.values, axis=0), np.unique(sequence.surface.colours.values, axis=0))


def test_vertex_animation_textures_are_painted(tmp_path: Path) -> None:
    mixseq.write_vat(tmp_path / "a.vat", painted_bar())
    document = Gltf(next((tmp_path / "a.vat").glob("*.gl*"))).json
    assert "COLOR_0" in document["meshes"][0]["primitives"][0]["attributes"]


def test_the_original_keeps_its_colours(tmp_path: Path) -> None:
    written(tmp_path / "a.glb", painted_bar())
    again = read(tmp_path / "a.glb")
    written(tmp_path / "b.glb", again.with_points(again.points + 1))
    assert Gltf(tmp_path / "b.glb").json["meshes"][0]["primitives"][0]["attributes"]["COLOR_0"] is not None
    got = read(tmp_path / "b.glb").surface.colours
    assert got is not None and again.surface.colours is not None
    np.testing.assert_array_equal(got.at_corners, again.surface.colours.at_corners)


def test_the_validator_is_content(tmp_path: Path) -> None:
    beyond = with_colours(painted_bar(), lambda values: 2 * values - 0.5)
    files = [tmp_path / f"{name}.glb" for name in ("bytes", "floats", "beyond")]
    written(files[0], painted_bar())
    written(files[1], with_colours(painted_bar(), np.square))
    with pytest.warns(MixseqWarning, match="colours below 0 and above 1"):
        written(files[2], beyond)
    validate(*files)


# glTF files in: creatures whose points others have baked


def like(baked: NDArray[np.float32], got: MeshSequence) -> NDArray[np.intp]:
    """Return the vertex of `got` at every baked vertex of frame 0."""
    nearest = np.asarray(KDTree(got.points[0]).query(baked[0])[1], dtype=np.intp)
    assert np.unique(nearest).size == got.vertex_count
    return nearest


def sorted_faces(faces: NDArray[np.integer[Any]]) -> list[list[int]]:
    """Return faces that have an area, each from its smallest vertex on, in order."""
    whole = [face for face in faces.tolist() if len(set(face)) == 3]
    return sorted(face[face.index(min(face)) :] + face[: face.index(min(face))] for face in whole)


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "animation", "fps", "baked"),
    [
        ("KhronosFox", "Survey", None, "fox_survey"),
        ("KhronosFox", "Run", 48, "fox_run"),
        ("Horse", "AnimalArmature|Eating", 12, "q_horse_eating"),
        ("Wolf", "AnimalArmature|Gallop", 48, "q_wolf_gallop"),
        ("Trex", "Armature|TRex_Run", 30, "q_trex_run"),
        ("RobotExpressive", "Dance", None, "robotexpressive_dance"),
    ],
)
def test_creatures_are_as_others_have_baked_them(
    data: Path, file: str, animation: str, fps: float | None, baked: str
) -> None:
    got = load(data / "gltf" / f"{file}.glb", animation=animation, fps=fps, prim="/")
    with np.load(data / "npz" / f"{baked}.npz") as arrays:
        points, faces = arrays["points"], arrays["faces"]
    assert got.vertex_count == points.shape[1]
    nearest = like(points, got)
    assert sorted_faces(nearest[faces]) == sorted_faces(got.faces)
    # Where the last key is between two frames, others have one more, which holds the last key.
    assert len(points) - got.frame_count in (0, 1)
    diagonal = np.linalg.norm(np.ptp(points[0], axis=0))
    errors = np.linalg.norm(got.points[:, nearest] - points[: got.frame_count], axis=2) / diagonal
    assert errors.max() < 1e-6
    if len(points) > got.frame_count:
        last = load(data / "gltf" / f"{file}.glb", animation=animation).points[-1, nearest]
        assert np.abs(last - points[-1]).max() / diagonal < 1e-6


@pytest.mark.realdata
@pytest.mark.parametrize(
    ("file", "vertices", "frames", "objects"),
    [
        ("CesiumMan", 2338, 49, ["node 0/node 1"]),
        ("RiggedFigure", 130, 31, ["node 0/node 1"]),
        ("RiggedSimple", 96, 50, ["node 0/node 1"]),
    ],
)
def test_other_characters(data: Path, file: str, vertices: int, frames: int, objects: list[str]) -> None:
    got = load(data / "gltf" / f"{file}.glb")
    assert (got.vertex_count, got.frame_count) == (vertices, frames)
    assert [each.path for each in got.objects] == objects
    assert np.linalg.norm(np.ptp(got.points, axis=0), axis=1).max() > 0.01


@pytest.mark.realdata
def test_horns_that_hang_on_a_bone(data: Path) -> None:
    got = load(data / "gltf" / "Stag.glb", animation=0)
    assert [(each.name, each.vertex_count) for each in got.objects] == [("Stag_Horns", 818), ("Stag", 1027)]
    assert got.name == "RootNode"
    # The horns touch the head in all frames.
    horns, body = got.points[:, :818], got.points[:, 818:]
    gaps = [np.min(KDTree(one).query(two)[0]) for one, two in zip(horns, body, strict=True)]
    assert max(gaps) < 0.1
