"""Vertex animation textures: what is in the folder, read back number by number."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.errors import MixseqWarning, OutputError, SettingsError
from mixseq.sequence.sequence import MeshSequence, bounding_diagonal
from mixseq_io.vat.textures import Texels
from mixseq_io.vat.writer import VatReport, write_vat
from tests.formats.gltf_files import validate
from tests.formats.vat.shader import looked_up, told, vertices_of
from tests.meshes import bar, coarse_walk, rotation

pytestmark = pytest.mark.slow


def test_points_are_as_far_off_as_is_told(written: tuple[Path, VatReport], fox: MeshSequence) -> None:
    folder, report = written
    vertices, diagonal = vertices_of(folder), bounding_diagonal(fox.points[0])
    apart = [
        np.linalg.norm(looked_up(folder, "points", frame) - fox.points[frame][vertices], axis=1).max() / diagonal
        for frame in range(fox.frame_count)
    ]
    assert max(apart) == pytest.approx(report.max_error, rel=1e-3)
    assert max(apart) <= (1e-3 if report.rank else 2e-5)
    assert told(folder)["error"]["max"] == report.max_error


def test_normals_are_as_far_off_as_is_told(written: tuple[Path, VatReport], fox: MeshSequence) -> None:
    folder, report = written
    texels, squares = Texels.from_header(fox.header), []
    for frame in range(fox.frame_count):
        found = looked_up(folder, "normals", frame)
        found /= np.linalg.norm(found, axis=1, keepdims=True)
        expected = texels.normals_of(fox.points[frame][None])[0][np.concatenate(texels.primitive_texels)]
        squares.append(np.square(np.degrees(np.arccos(np.clip(np.sum(found * expected, axis=1), -1, 1)))))
    assert np.sqrt(np.mean(squares)) == pytest.approx(report.normal_degrees, rel=0.02)
    assert report.normal_degrees < (3 if report.rank else 0.3)


def test_low_rank_textures_are_smaller(tmp_path: Path) -> None:
    walk = coarse_walk(12)
    plain, low = (write_vat(tmp_path / f"{error}.vat", walk, error) for error in (None, 1e-2))
    assert low.memory_bytes < plain.memory_bytes / 2
    assert low.file_bytes < plain.file_bytes / 2
    files = sum(each.stat().st_size for each in (tmp_path / "0.01.vat").glob("*.png"))
    assert files == low.file_bytes


def test_rigid_parts_take_four_basis_vectors_and_normals_are_exact(tmp_path: Path) -> None:
    """Two bars, one of which turns: x' = R x + t, and so do normals."""
    still = bar(frames=1)
    angles = np.linspace(0, 2, 12)
    turned = np.stack([still.points[0] @ rotation((0, 0, angle)).T + [angle, 0, 0] for angle in angles])
    sequence = MeshSequence.from_arrays(turned, still.faces)
    report = write_vat(tmp_path / "bar.vat", sequence, 1e-4)
    assert report.rank <= 4
    assert report.normal_degrees < 0.1


@pytest.mark.parametrize(("max_error", "factor"), [(None, 1), (0.01, 1), (5e-4, 2)])
def test_shaders_join_frames_by_straight_lines(tmp_path: Path, max_error: float | None, factor: int) -> None:
    """A bar turns by a quarter radian per frame about its axis, which is told and held in the steps of the textures."""
    still = bar(frames=1)
    angles = 0.25 * np.arange(5)
    turned = np.stack([still.points[0] @ rotation((0, 0, angle)).T for angle in angles])
    sequence = MeshSequence.from_arrays(turned, still.faces)
    report = write_vat(tmp_path / "bar.vat", sequence, max_error, motion=sequence, between_frames=max_error is not None)
    radius = np.linalg.norm(still.points[0, :, :2], axis=1).max()
    chord = radius * (1 - np.cos(0.25 / 2 / factor)) / sequence.diagonal
    assert report.between_error is not None
    assert abs(report.between_error - chord) <= report.max_error
    metadata = json.loads((tmp_path / "bar.vat" / "vat.json").read_text())
    assert (metadata["frames"] - 1, metadata["fps"]) == (4 * factor, 24 * factor)
    assert metadata["error"]["between"] == report.between_error <= (max_error or 1)


def test_a_bound_between_frames_needs_one_at_frames(tmp_path: Path) -> None:
    with pytest.raises(SettingsError, match="between_frames is about max_error"):
        write_vat(tmp_path / "bar.vat", bar(frames=3), between_frames=True)


def test_hard_edges_have_texels_of_their_own(tmp_path: Path) -> None:
    still = bar(frames=3)
    corners = np.arange(still.faces.size, dtype=np.int32)  # all flat
    flat = replace(still, surface=replace(still.surface, hard_edges=corners))
    write_vat(tmp_path / "bar.vat", flat)
    assert told(tmp_path / "bar.vat")["texels"] == still.faces.size
    found = looked_up(tmp_path / "bar.vat", "points", 2)
    np.testing.assert_allclose(found, flat.points[2][vertices_of(tmp_path / "bar.vat")], atol=1e-3)


def test_the_mesh(written: tuple[Path, VatReport], fox: MeshSequence) -> None:
    folder, _ = written
    with pytest.warns(MixseqWarning, match="several sets of texture coordinates"):
        shown = mixseq.read(folder / "mesh.glb")
    np.testing.assert_allclose(shown.points[0], fox.points[0], atol=1e-6)
    np.testing.assert_array_equal(shown.faces, fox.faces)
    validate(folder / "mesh.glb")


def test_shaders_have_the_numbers(written: tuple[Path, VatReport]) -> None:
    folder, _ = written
    low = int(told(folder)["kind"] != "plain")
    for name in ("godot.gdshader", "unity.shader", "unreal.hlsl"):
        text = (folder / name).read_text()
        assert "@" not in text
        assert f"LOW_RANK {low}\n" in text or f"#if {low}\n" in text


def test_exr_holds_the_numbers_themselves(fox: MeshSequence, tmp_path: Path) -> None:
    library = pytest.importorskip("OpenEXR")
    report = write_vat(tmp_path / "fox.vat", fox, texture="exr")
    assert report.max_error < 1e-6
    with library.File(str(tmp_path / "fox.vat" / "points.exr")) as file:
        pixels = np.asarray(file.channels()["RGB"].pixels)
    vat = told(tmp_path / "fox.vat")
    rows = pixels.reshape(fox.frame_count, -1, 3)[:, : vat["texels"]]
    expected = fox.points[:, Texels.from_header(fox.header).vertices].astype(np.float32)
    np.testing.assert_array_equal(rows, expected)


def test_what_is_refused(fox: MeshSequence, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    with pytest.raises(OutputError, match=r"end its name in .vat"):
        write_vat(tmp_path / "fox", fox)
    (tmp_path / "file.vat").write_text("")
    with pytest.raises(OutputError, match="is a file"):
        write_vat(tmp_path / "file.vat", fox)
    with pytest.raises(SettingsError, match="max_error is 0"):
        write_vat(tmp_path / "fox.vat", fox, 0)
    with pytest.raises(SettingsError, match=r"rounding to 16 bits alone.*--texture exr"):
        write_vat(tmp_path / "bar.vat", bar(frames=2), 1e-7)
    with pytest.raises(SettingsError, match="one of png16, exr"):
        write_vat(tmp_path / "fox.vat", fox, texture="bmp")  # type: ignore[arg-type]
    monkeypatch.setattr("mixseq_io.vat.textures.MAX_TEXTURE_SIDE_PIXELS", 16)
    with pytest.raises(SettingsError, match=r"17 frames of .* texels take 17 rows"):
        write_vat(tmp_path / "long.vat", bar(frames=17))
    assert [each.name for each in tmp_path.iterdir()] == ["file.vat"]


@pytest.mark.parametrize(
    ("max_error", "problem"), [(None, "16385 frames of 3 texels take 16385 rows"), (0.1, "16385 frames are too high")]
)
def test_too_many_frames_are_refused_before_anything_is_computed(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, max_error: float | None, problem: str
) -> None:
    monkeypatch.setattr("mixseq_io.vat.textures.VertexFrames.from_points", lambda *given: pytest.fail("computed"))
    still = np.tile(np.eye(3, dtype=np.float32), (16385, 1, 1))
    with pytest.raises(SettingsError, match=problem):
        write_vat(tmp_path / "long.vat", MeshSequence.from_arrays(still, [[0, 1, 2]]), max_error)
