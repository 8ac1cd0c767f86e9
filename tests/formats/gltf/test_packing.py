"""Packed glTF out: what it costs, what is promised of points, what else is in the file."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

import mixseq
from mixseq.creature import walk_cycle
from mixseq.errors import SettingsError
from mixseq.sequence import MeshSequence
from mixseq_io.gltf.buffers import writing_buffer
from mixseq_io.gltf.compression import plain
from mixseq_io.gltf.document import Document, load_document
from mixseq_io.gltf.packing import packed, told_rounding
from mixseq_io.gltf.writer import write_gltf
from tests.formats.conftest import lossy
from tests.formats.gltf.turned import turned
from tests.formats.gltf_files import Gltf, read, validate
from tests.formats.gltf_maker import TRIANGLE, Maker, load, morphing

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def fox() -> MeshSequence:
    return walk_cycle(frames=6)


def written(path: Path, sequence: MeshSequence, **options: Any) -> Path:
    write_gltf(path, sequence.header, [sequence.points], **options)
    return path


def normals_at(document: Document, frame: int) -> NDArray[Any]:
    """Return the normals in the order of the sequence's vertices, of which none is split."""
    (primitive,) = document.items("meshes")[0].objects("primitives")
    base = np.asarray(document.accessor(primitive.object("attributes").integer("NORMAL")))
    if frame:
        base = base + document.accessor(primitive.objects("targets")[frame - 1].integer("NORMAL"))
    order = np.argsort(document.accessor(primitive.object("attributes").integer("_VERTEX")))
    return np.asarray(base / np.linalg.norm(base, axis=1, keepdims=True))[order]


@pytest.mark.parametrize("suffix", [".glb", ".gltf"])
@pytest.mark.parametrize("error", [1e-3, 1e-5])
def test_all_frames_are_as_exact_as_promised(
    error: float, suffix: str, fox: MeshSequence, tmp_path: Path
) -> None:
    path = written(tmp_path / f"fox{suffix}", fox, meshopt=error)
    found = read(path)
    diagonal = np.linalg.norm(np.ptp(fox.points[0], axis=0))
    apart = np.linalg.norm(found.points.astype(np.float64) - fox.points, axis=2).max() / diagonal
    assert error / 8 < apart <= error
    assert told_rounding(path) == pytest.approx(apart, rel=1e-2)
    np.testing.assert_array_equal(found.times, fox.times)
    assert sorted(turned(found.faces)) == sorted(turned(fox.faces))


def test_a_third_or_less(fox: MeshSequence, tmp_path: Path) -> None:
    loose, tight = written(tmp_path / "a.glb", fox), written(tmp_path / "b.glb", fox, meshopt=1e-4)
    assert tight.stat().st_size < loose.stat().st_size / 3
    assert told_rounding(loose) is None
    assert not [each for each in tmp_path.iterdir() if each.name not in ("a.glb", "b.glb")]


def test_normals_keep_their_directions(fox: MeshSequence, tmp_path: Path) -> None:
    """Also where a normal turns so far that its change does not fit into -1 to 1."""
    angle = np.radians([0, 100, 180])  # about z
    turn = np.stack([[np.cos(angle), -np.sin(angle)], [np.sin(angle), np.cos(angle)]]).transpose(2, 0, 1)
    points = np.tile(fox.points[0], (3, 1, 1))
    points[:, :, :2] = points[:, :, :2] @ turn.transpose(0, 2, 1)
    turned = replace(fox, times=fox.times[:3], points=points)
    loose = load_document(written(tmp_path / "a.glb", turned))
    tight = plain(load_document(written(tmp_path / "b.glb", turned, meshopt=1e-4)))
    for frame in (0, 1, 2):
        cosines = np.sum(normals_at(loose, frame) * normals_at(tight, frame), axis=1)
        assert cosines.min() > np.cos(np.radians(3))


def test_everything_else_of_an_original(rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    loose = Gltf(written(tmp_path / "a.glb", lifted))
    tight = plain(load_document(written(tmp_path / "b.glb", lifted, meshopt=1e-4)))
    assert [each.text("name") for each in tight.items("nodes")] == [
        each.get("name", "") for each in loose.json["nodes"]
    ]
    image = tight.json["images"][0]
    assert tight.part(tight.item("bufferViews", image["bufferView"])) == loose.view(
        loose.json["images"][0]["bufferView"]
    )
    with lossy():
        again, before = read(tmp_path / "b.glb"), read(tmp_path / "a.glb")
    np.testing.assert_allclose(again.points, before.points, atol=1e-3)
    assert again.surface.uvs is not None
    assert before.surface.uvs is not None
    np.testing.assert_allclose(again.surface.uvs.at_corners, before.surface.uvs.at_corners, atol=2.0**-16)


def test_skins_and_morphs(fox: MeshSequence, tmp_path: Path) -> None:
    diagonal = np.linalg.norm(np.ptp(fox.points[0], axis=0))
    for rig in (mixseq.fit_skin(fox, 6), mixseq.fit_morph(fox, 1e-2)):
        loose, tight = tmp_path / "loose.glb", tmp_path / "tight.glb"
        mixseq.write_rig(loose, rig)
        mixseq.write_rig(tight, rig, meshopt=1e-4)
        assert tight.stat().st_size < loose.stat().st_size / 2
        apart = np.linalg.norm(read(tight).points - read(loose).points, axis=2).max() / diagonal
        assert apart < 1e-3


def test_objects_face_sets_and_sparse_accessors_come_back(tmp_path: Path) -> None:
    maker = morphing()
    maker.json["accessors"][0]["sparse"] = {
        "count": 1,
        "indices": {"bufferView": maker.view(np.array([1], "<u2")), "componentType": 5123},
        "values": {"bufferView": maker.view(np.array([[3, 0, 0]], "<f4"))},
    }
    document = load_document(maker.glb(tmp_path / "sparse.glb"))
    layout = packed(document, 1e-4)
    assert "sparse" in layout.document["accessors"][0]
    assert layout.document["accessors"][1]["count"] == 3


def test_integers_stay_exact(tmp_path: Path) -> None:
    maker = Maker()
    on = {
        "TEXCOORD_0": maker.add([[0, 65535], [1, 2], [3, 4]], "u2", normalized=True),
        "COLOR_0": maker.add([[1, 2, 3], [4, 5, 6], [7, 8, 255]], "u1", normalized=True),
    }
    maker.node("flag", mesh=maker.mesh(TRIANGLE, [[0, 1, 2]], on=on))
    document = load_document(maker.glb(tmp_path / "flag.glb"))
    path = tmp_path / "packed.glb"
    with writing_buffer(path, path, packed(document, 1e-4)):
        pass
    found = plain(load_document(path))
    for number in range(len(document.items("accessors"))):
        np.testing.assert_allclose(found.accessor(number), document.accessor(number), atol=1e-4)
    np.testing.assert_array_equal(found.accessor(0), document.accessor(0))
    np.testing.assert_array_equal(found.accessor(1), document.accessor(1))


def test_what_cannot_be_packed(fox: MeshSequence, tmp_path: Path) -> None:
    maker = Maker(extensionsUsed=["ACME_teapots"], extensions={"ACME_teapots": {"view": 0}})
    maker.node("flag", mesh=maker.mesh(TRIANGLE))
    with pytest.raises(SettingsError, match=r"'ACME_teapots' may refer to what is packed.*--flatten"):
        packed(load_document(maker.glb(tmp_path / "acme.glb")), 1e-4)
    with pytest.raises(SettingsError, match="meshopt is 0; the largest error"):
        written(tmp_path / "fox.glb", fox, meshopt=0)
    far = fox.with_points(fox.points + np.float32(1e5))
    with pytest.raises(SettingsError, match="too large for steps"):
        written(tmp_path / "fox.glb", far, meshopt=1e-6)
    assert load(tmp_path / "acme.glb").vertex_count == 3
    assert not (tmp_path / "fox.glb").exists()


def test_validator(fox: MeshSequence, rig: Path, lifted: MeshSequence, tmp_path: Path) -> None:
    files = [written(tmp_path / name, fox, meshopt=1e-4) for name in ("fox.glb", "fox.gltf")]
    mixseq.write_rig(tmp_path / "skin.glb", mixseq.fit_skin(fox, 6), meshopt=1e-4)
    validate(*files, tmp_path / "skin.glb")
