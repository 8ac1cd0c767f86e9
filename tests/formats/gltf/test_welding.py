"""glTF files in: accessors, primitives, welded vertices, and what is on the surface."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.errors import FormatError, MixseqWarning
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.primitives import weld_vertices
from tests.formats.gltf_maker import SQUARE, TRIANGLE, Maker, moving, split_square


def accessor(tmp_path: Path, maker: Maker, index: int) -> NDArray[Any]:
    return load_document(maker.glb(tmp_path / "numbers.glb")).accessor(index)


def test_sparse_accessors(tmp_path: Path) -> None:
    maker = Maker()
    base = maker.add(np.arange(12).reshape(4, 3))
    sparse = {
        "count": 2,
        "indices": {"bufferView": maker.view(np.array([1, 3], "<u2")), "componentType": 5123},
        "values": {"bufferView": maker.view(np.array([[-1, -2, -3], [-4, -5, -6]], "<f4"))},
    }
    maker.json["accessors"][base]["sparse"] = sparse
    maker.json["accessors"].append({"componentType": 5126, "type": "VEC3", "count": 4, "sparse": sparse})
    assert accessor(tmp_path, maker, 0).tolist() == [[0, 1, 2], [-1, -2, -3], [6, 7, 8], [-4, -5, -6]]
    assert accessor(tmp_path, maker, 1).tolist() == [[0, 0, 0], [-1, -2, -3], [0, 0, 0], [-4, -5, -6]]


@pytest.mark.parametrize(
    ("dtype", "stored", "values"),
    [
        ("i1", [-128, -127, 0, 127], [-1, -1, 0, 1]),
        ("u1", [0, 51, 255], [0, 0.2, 1]),
        ("i2", [-32768, 32767], [-1, 1]),
        ("u2", [0, 13107, 65535], [0, 0.2, 1]),
    ],
)
def test_normalised_accessors(tmp_path: Path, dtype: str, stored: list[int], values: list[float]) -> None:
    maker = Maker()
    maker.add(stored, dtype, normalized=True)
    np.testing.assert_array_equal(accessor(tmp_path, maker, 0), np.array(values, np.float32))


def test_interleaved_accessors(tmp_path: Path) -> None:
    maker = Maker()
    both = np.arange(10, dtype="<f4").reshape(2, 5)
    view = maker.view(both)
    maker.json["bufferViews"][view]["byteStride"] = 20
    for offset, kind in ((0, "VEC3"), (12, "VEC2")):
        maker.json["accessors"].append(
            {"bufferView": view, "byteOffset": offset, "componentType": 5126, "type": kind, "count": 2}
        )
    assert accessor(tmp_path, maker, 0).tolist() == [[0, 1, 2], [5, 6, 7]]
    assert accessor(tmp_path, maker, 1).tolist() == [[3, 4], [8, 9]]


@pytest.mark.parametrize("normalized", [False, True])
def test_quantised_positions(made: Callable[..., MeshSequence], normalized: bool) -> None:
    maker = Maker(extensionsRequired=["KHR_mesh_quantization"])
    mesh = maker.mesh(TRIANGLE)
    stored = np.array([[0, 0, 0], [32767, 0, 0], [0, 32767, 0]])
    maker.json["meshes"][mesh]["primitives"][0]["attributes"]["POSITION"] = maker.add(
        np.pad(stored, [(0, 0), (0, 0)]), "i2", normalized=normalized
    )
    maker.node(mesh=mesh, scale=[1 if normalized else 1 / 32767] * 3)
    np.testing.assert_allclose(made(maker).points[0], TRIANGLE, atol=1e-7)


@pytest.mark.parametrize(
    ("mode", "faces"),
    [(5, [[0, 1, 2], [1, 3, 2], [2, 3, 4]]), (6, [[1, 2, 0], [2, 3, 0], [3, 4, 0]])],
    ids=["strip", "fan"],
)
@pytest.mark.parametrize("indexed", [False, True])
def test_strips_and_fans(made: Callable[..., MeshSequence], mode: int, faces: list[list[int]], indexed: bool) -> None:
    maker = Maker()
    points = np.arange(15).reshape(5, 3) ** 2
    maker.node(mesh=maker.mesh(points, range(5) if indexed else None, mode=mode))
    assert made(maker).faces.tolist() == faces


def test_points_and_lines_are_left_out(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    mesh = maker.mesh(TRIANGLE)
    maker.json["meshes"][mesh]["primitives"] += [{"attributes": {"POSITION": 0}, "mode": mode} for mode in (0, 1)]
    maker.node(mesh=mesh)
    with pytest.warns(MixseqWarning, match="primitives 1, 2 are points, lines or empty"):
        assert made(maker).vertex_count == 3
    del maker.json["meshes"][mesh]["primitives"][0]
    with pytest.warns(MixseqWarning), pytest.raises(FormatError, match="no triangles"):
        made(maker)


def test_primitives_are_read_once(made: Callable[..., MeshSequence], monkeypatch: pytest.MonkeyPatch) -> None:
    indices: list[int] = []
    read_accessor = Document.accessor

    def accessor(document: Document, index: int) -> NDArray[Any]:
        indices.append(index)
        return read_accessor(document, index)

    monkeypatch.setattr(Document, "accessor", accessor)
    maker = split_square()
    made(maker)
    for primitive in maker.json["meshes"][0]["primitives"]:
        assert indices.count(primitive["attributes"]["POSITION"]) == 1


def test_vertices_are_welded_across_primitives(made: Callable[..., MeshSequence], tmp_path: Path) -> None:
    got = made(split_square(material=1))
    assert got.faces.tolist() == [[0, 1, 2], [0, 2, 3]]
    assert got.points[0].tolist() == SQUARE
    assert [(each.name, each.material, each.polygons.tolist()) for each in got.surface.face_sets] == [
        ("red", "red", [0]),
        ("material 1", "material 1", [1]),
    ]
    assert got.surface.uvs is not None
    assert got.surface.uvs.at_corners.tolist() == [[0, 1], [1, 1], [1, 0.75], [0, 0], [0, 0], [0, 0]]
    assert got.surface.origin is not None
    assert (got.surface.origin.format, got.surface.origin.path) == ("glTF", str(tmp_path / "made.glb"))
    found = weld_vertices(load_document(tmp_path / "made.glb"), 0)
    assert [each.tolist() for each in found.vertex_ids] == [[0, 1, 2], [0, 2, 3]]
    assert found.representatives.tolist() == [0, 1, 2, 5]


def test_without_a_material(made: Callable[..., MeshSequence]) -> None:
    assert [each.name for each in made(split_square()).surface.face_sets] == ["red"]
    assert not made(moving()).surface.face_sets


def test_texture_coordinates_of_integers(made: Callable[..., MeshSequence]) -> None:
    maker = Maker()
    maker.node(mesh=maker.mesh(TRIANGLE, on={"TEXCOORD_0": maker.add([[0, 0], [4, 3], [0, 2]], "u2")}))
    uvs = made(maker).surface.uvs
    assert uvs is not None
    assert uvs.at_corners.tolist() == [[0, 1], [4, -2], [0, -1]]


def test_what_moves_apart_is_not_welded(made: Callable[..., MeshSequence]) -> None:
    maker = split_square()
    one, two = maker.json["meshes"][0]["primitives"]
    one["targets"] = [{"POSITION": maker.add(np.zeros((3, 3)))}]
    two["targets"] = [{"POSITION": maker.add([[0, 0, 0], [0, 0, 1], [0, 0, 0]])}]
    assert made(maker).faces.tolist() == [[0, 1, 2], [0, 3, 4]]
    maker = split_square()
    joints = maker.add([[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 0, 0]], "u1"), maker.add(np.zeros((3, 4)), "u1")
    weights = maker.add([[0.5, 0.5, 0, 0], [1, 0, 0, 0], [1, 0, 0, 0]]), maker.add([[1, 0, 0, 0]] * 3)
    for primitive, joint, weight in zip(maker.json["meshes"][0]["primitives"], joints, weights, strict=True):
        primitive["attributes"].update(JOINTS_0=joint, WEIGHTS_0=weight)
    assert made(maker).faces.tolist() == [[0, 1, 2], [3, 2, 4]]


def test_vertex_numbers_tell_without_welding(made: Callable[..., MeshSequence]) -> None:
    maker = split_square()
    one, two = maker.json["meshes"][0]["primitives"]
    one["attributes"]["_VERTEX"] = maker.add([4, 1, 3])
    two["attributes"]["_VERTEX"] = maker.add([4, 0, 2])  # two vertices at one place
    assert made(maker).faces.tolist() == [[4, 1, 3], [4, 0, 2]]
    two["attributes"]["_VERTEX"] = maker.add([4, 1, 2])  # of someone else: positions differ
    assert made(maker).faces.tolist() == [[0, 1, 2], [0, 2, 3]]


def test_hard_edges_follow_normals(made: Callable[..., MeshSequence]) -> None:
    up, side = [0, 0, 1], [1, 0, 0]
    maker = split_square()
    one, two = maker.json["meshes"][0]["primitives"]
    one["attributes"]["NORMAL"], two["attributes"]["NORMAL"] = maker.add([up] * 3), maker.add([up, side, up])
    hard_edges = made(maker).surface.hard_edges
    assert hard_edges is not None
    same = hard_edges[:, None] == hard_edges
    assert same[0, 3] and not same[2, 4] and len(np.unique(hard_edges)) == 5
    two["attributes"]["NORMAL"] = one["attributes"]["NORMAL"]
    assert made(maker).surface.hard_edges is None


def test_without_normals_faces_are_flat(made: Callable[..., MeshSequence]) -> None:
    hard_edges = made(split_square()).surface.hard_edges
    assert hard_edges is not None and len(np.unique(hard_edges)) == 6


def test_further_texture_coordinates_are_warned_about(made: Callable[..., MeshSequence]) -> None:
    maker = split_square()
    attributes = maker.json["meshes"][0]["primitives"][0]["attributes"]
    attributes["TEXCOORD_1"] = attributes["TEXCOORD_0"]
    with pytest.warns(MixseqWarning, match="several sets of texture coordinates; TEXCOORD_0 is read"):
        made(maker)
