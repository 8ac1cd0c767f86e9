"""Quantised and packed meshes: what is promised of every attribute, read by our own reader and told to others."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest
from numpy.typing import NDArray

from mixseq.creature import walk_cycle
from mixseq.geometry.normals import shared_normals
from mixseq.sequence import MeshSequence
from mixseq_io.gltf.buffers import Layout, writing_buffer
from mixseq_io.gltf.compression import plain
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.packed_meshes import (
    UV_EXPONENT,
    add_fixed_point,
    add_normals,
    add_triangles,
    exponent_within,
    rounded,
)
from tests.formats.gltf_files import validate
from tests.formats.gltf_maker import load

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fox() -> MeshSequence:
    return walk_cycle(frames=1)


def normals_of(fox: MeshSequence) -> NDArray[np.float32]:
    return np.asarray(shared_normals(fox.points, fox.polygons, None)[0])


@pytest.fixture(scope="module", params=[".glb", ".gltf"])
def file(fox: MeshSequence, request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Path:
    layout = Layout({"asset": {"version": "2.0"}})
    attributes = {
        "POSITION": add_fixed_point(layout, fox.points[0], exponent_within(1e-3), bounds=True),
        "NORMAL": add_normals(layout, normals_of(fox)),
        "TEXCOORD_0": add_fixed_point(layout, fox.points[0, :, :2], UV_EXPONENT),
        "_VERTEX": add_fixed_point(layout, np.arange(fox.vertex_count), 0),
    }
    primitive = {"attributes": attributes, "indices": add_triangles(layout, fox.faces)}
    layout.document.update(meshes=[{"primitives": [primitive]}], nodes=[{"mesh": 0}], scenes=[{"nodes": [0]}])
    path: Path = tmp_path_factory.mktemp("packed") / f"fox{request.param}"
    with writing_buffer(path, path, layout):
        pass
    return path


def attribute(document: Document, name: str) -> NDArray[np.float32]:
    accessors = document.items("meshes")[0].objects("primitives")[0].object("attributes")
    return np.asarray(document.accessor(accessors.integer(name)))


def test_points_keep_their_error_and_their_numbers(file: Path, fox: MeshSequence) -> None:
    found = load(file)
    error = np.linalg.norm(found.points[0].astype(np.float64) - fox.points[0], axis=1)
    assert 2e-4 < error.max() <= 1e-3
    np.testing.assert_array_equal(found.points[0], rounded(fox.points[0], exponent_within(1e-3)))
    assert {frozenset(face) for face in found.faces} == {frozenset(face) for face in fox.faces}
    np.testing.assert_array_equal(np.sort(found.faces, axis=1), np.sort(fox.faces, axis=1))


def test_attributes(file: Path, fox: MeshSequence) -> None:
    document = plain(load_document(file))
    normals = attribute(document, "NORMAL")
    lengths = np.linalg.norm(normals, axis=1)
    np.testing.assert_allclose(lengths, 1, atol=0.01)
    assert (np.sum(normals * normals_of(fox), axis=1) / lengths).min() > np.cos(np.radians(1.2))
    np.testing.assert_allclose(attribute(document, "TEXCOORD_0"), fox.points[0, :, :2], atol=2.0**-16)
    np.testing.assert_array_equal(attribute(document, "_VERTEX"), np.arange(fox.vertex_count))


def test_what_has_to_be_known_is_declared(file: Path) -> None:
    document = load_document(file)
    for member in ("extensionsUsed", "extensionsRequired"):
        assert document.top.texts(member) == ["EXT_meshopt_compression", "KHR_mesh_quantization"]


def test_files_are_a_third(file: Path, fox: MeshSequence) -> None:
    plain_bytes = fox.vertex_count * (12 + 12 + 8 + 4) + fox.faces.size * 2
    assert file.stat().st_size < plain_bytes / (3 if file.suffix == ".glb" else 2)


def test_validator(file: Path) -> None:
    validate(file)
