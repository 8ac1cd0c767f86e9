"""Texture coordinates in files of compressed models: a stream of their own, and a promise."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import CompressedSequence
from mixseq.compression.encoder.uvs import UV_ERROR
from mixseq.errors import FormatError, InvalidSequenceError, SettingsError
from mixseq.mesh.surface import CornerValues, FaceSet, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.coded.sizes import static_size
from mixseq_io.model_files import compressed_sizes, read_compressed
from tests.formats.compressed.stream_cases import GOLDEN, damage, index_of
from tests.meshes import bar

pytestmark = pytest.mark.slow


def textured_sequence(frames: int = 3) -> MeshSequence:
    """A bending bar, unwrapped from above, with a seam where one polygon in nine is elsewhere."""
    sequence = bar(5, 15, frames)
    corners = sequence.points[0][sequence.polygons.indices]
    uvs = (corners[:, [0, 2]] - corners.min(axis=0)[[0, 2]]) * 0.317 + 0.003
    uvs[np.repeat(np.arange(len(sequence.polygons.counts)) % 9 == 0, 3)] += [0.211, 1.0]
    surface = Surface(uvs=CornerValues(uvs, np.arange(len(uvs))), face_sets=(FaceSet("end", np.arange(4), "skin"),))
    return MeshSequence.from_header(replace(sequence.header, surface=surface), sequence.points)


def sharp_sequence() -> MeshSequence:
    """The same with hard edges around one polygon in six."""
    sequence = textured_sequence()
    sharp = np.repeat(np.arange(len(sequence.polygons.counts)) % 6 == 0, 3)
    numbers = sequence.polygons.indices + sequence.vertex_count * sharp
    surface = replace(sequence.header.surface, hard_edges=numbers)
    return MeshSequence.from_header(replace(sequence.header, surface=surface), sequence.points)


@pytest.fixture(scope="module")
def sequence() -> MeshSequence:
    return textured_sequence()


@pytest.fixture(scope="module")
def coded(sequence: MeshSequence) -> CompressedSequence:
    coded: CompressedSequence = mixseq.compress(sequence, max_error=0.01)
    return coded


@pytest.fixture
def path(tmp_path: Path, coded: CompressedSequence) -> Path:
    file = tmp_path / "textured.h5"
    mixseq.save(file, coded)
    return file


def at_corners(header: mixseq.SequenceHeader) -> np.ndarray:
    assert header.surface.uvs is not None
    return header.surface.uvs.at_corners


def test_coordinates_come_back_within_what_is_promised(
    path: Path, sequence: MeshSequence, coded: CompressedSequence
) -> None:
    model = mixseq.load(path)
    found = at_corners(model.header)
    np.testing.assert_array_equal(found, at_corners(coded.header))
    apart = np.abs(found.astype(np.float64) - at_corners(sequence.header)).max()
    assert 0 < apart <= UV_ERROR
    assert model.header.surface.face_sets[0].material == "skin"
    assert read_compressed(path).parameters == coded.parameters
    verified = mixseq.verify(path, sequence)
    assert (verified.uv_bound, verified.uv_error, verified.holds) == (UV_ERROR, apart, True)
    assert mixseq.verify(path).uv_error is None


def test_a_promise_that_is_not_kept_is_told(path: Path, sequence: MeshSequence) -> None:
    uvs = at_corners(sequence.header).copy()
    uvs[7, 1] += 0.01
    surface = replace(sequence.header.surface, uvs=CornerValues(uvs, np.arange(len(uvs))))
    other = MeshSequence.from_header(replace(sequence.header, surface=surface), sequence.points)
    found = mixseq.verify(path, other)
    assert not found.holds
    assert found.uv_error == pytest.approx(0.01, abs=1e-4)


def test_saving_what_was_loaded_changes_nothing(path: Path, tmp_path: Path) -> None:
    again = tmp_path / "again.h5"
    mixseq.save(again, read_compressed(path))
    np.testing.assert_array_equal(at_corners(mixseq.load(again).header), at_corners(mixseq.load(path).header))
    assert compressed_sizes(again) == compressed_sizes(path)


def test_only_grid_coordinates_have_a_stream_of_their_own(path: Path, sequence: MeshSequence) -> None:
    sizes = compressed_sizes(path)
    for options in ({"uv_error": 0}, {"uvs": False}):
        mixseq.save(path, mixseq.compress(sequence, max_error=0.01, **options))
        assert compressed_sizes(path)["uvs"] == 0
        if "uvs" in options:
            assert mixseq.load(path).header.surface.uvs is None
        else:
            found = at_corners(mixseq.load(path).header)
            np.testing.assert_array_equal(found, at_corners(sequence.header))
            assert sizes["uvs"] + sizes["surface"] < 0.4 * compressed_sizes(path)["surface"]


def test_damage_is_named(path: Path) -> None:
    damage(path, index_of(path).header["uvs"])
    with pytest.raises(FormatError, match="the texture coordinates are damaged; restore the file"):
        mixseq.load(path)


def test_coordinates_off_the_grid_are_refused(
    tmp_path: Path, sequence: MeshSequence, coded: CompressedSequence
) -> None:
    header = replace(coded.header, surface=sequence.header.surface)
    with pytest.raises(InvalidSequenceError, match="not multiples of 1 / 32768; compress the sequence again"):
        mixseq.save(tmp_path / "off.h5", replace(coded, header=header))
    assert not (tmp_path / "off.h5").exists()


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"uv_steps": 100, "uv_error": None}, "come together"),
        ({"uv_steps": 0, "uv_error": 0.1}, "uv_steps is 0"),
        ({"uv_steps": True, "uv_error": 0.1}, "uv_steps is True"),
        ({"uv_steps": 1 << 40, "uv_error": 0.1}, "from 1 to"),
        ({"uv_steps": 100, "uv_error": float("nan")}, "uv_error is nan"),
        ({"uv_steps": 100, "uv_error": "x"}, "uv_error is 'x'"),
    ],
)
def test_parameters_out_of_range_are_refused(
    coded: CompressedSequence, changes: dict[str, object], message: str
) -> None:
    with pytest.raises(SettingsError, match=message):
        replace(coded.parameters, **changes)  # type: ignore[arg-type]


def test_a_size_counts_coordinates_as_they_will_be(sequence: MeshSequence) -> None:
    exact, rounded, none = (
        static_size(sequence, **options).total for options in ({"uv_error": 0.0}, {}, {"uvs": False})
    )
    assert exact > rounded > none


def test_the_golden_file_still_decodes_to_the_same() -> None:
    path = GOLDEN / "compressed-v1-uvs.h5"
    with np.load(path.with_suffix(".npz")) as file:
        expected = dict(file)
    model = mixseq.load(path)
    np.testing.assert_array_equal(at_corners(model.header), expected["uvs"])
    np.testing.assert_allclose(model.sample().points, expected["points"], atol=1e-9)
    np.testing.assert_array_equal(model.header.surface.hard_edges, expected["hard_edges"])
    assert mixseq.verify(path, sharp_sequence()).holds


@pytest.mark.realdata
@pytest.mark.parametrize("name", ["CesiumMan.glb", "KhronosFox.glb"])
def test_real_coordinates_take_two_bytes(data: Path, name: str, tmp_path: Path) -> None:
    """A ten-thousandth of the square at two bytes for u and v."""
    file = tmp_path / "small.h5"
    whole = mixseq.read(data / "gltf" / name, animation=0)
    frames = mixseq.MeshSequence.from_header(whole.header.with_times(whole.times[:6]), whole.points[:6])
    mixseq.save(file, mixseq.compress(frames, kg=5, uv_error=1e-4))
    assert mixseq.verify(file, frames).holds
    uvs = mixseq.load(file).header.surface.uvs
    assert uvs is not None
    assert compressed_sizes(file)["uvs"] <= 2 * len(uvs.values) + 4  # and what they decode to
