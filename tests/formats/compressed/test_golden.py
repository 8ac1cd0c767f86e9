"""The golden file of a compressed sequence still decodes to the same points."""

from __future__ import annotations

from dataclasses import replace
from math import inf

import numpy as np
import pytest

import mixseq
from mixseq.compression.compressed_model import CompressedModel
from mixseq.mesh.surface import FaceSet, Surface
from mixseq.sequence.sequence import MeshSequence
from mixseq_io.model_files import read_compressed, read_container
from tests.formats.compressed.stream_cases import GOLDEN
from tests.meshes import bar


def golden_sequence() -> MeshSequence:
    """What the golden file is made of: 200 frames of a bar, of which every vertex trembles a little by itself."""
    walk = bar(5, 7, 200)
    tremble = np.sin(np.outer(np.arange(200), 1 + np.arange(3 * 37)) ** 1.1).reshape(200, 37, 3)
    times = walk.times + 0.01 * np.sin(np.arange(200))
    surface = Surface(hard_edges=np.arange(len(walk.polygons.indices)), face_sets=(FaceSet("end", np.arange(5)),))
    header = replace(walk.header, times=times, surface=surface, name="golden")
    return MeshSequence.from_header(header, walk.points + 0.01 * tremble)


def test_the_golden_file_still_decodes_to_the_same_points() -> None:
    path = GOLDEN / "compressed-v1.h5"
    model = mixseq.load(path)
    with np.load(path.with_suffix(".npz")) as expected:
        np.testing.assert_array_equal(model.times, expected["times"])
        points = model.sample(frames=expected["frames"].tolist()).points
        np.testing.assert_allclose(points, expected["points"], atol=1e-9)
    coded = read_compressed(path)
    assert len(coded.basis) > 1
    assert len(coded.chunks) > 1
    assert any(chunk.residuals for chunk in coded.chunks)
    assert coded.header.polygons.same_as(golden_sequence().polygons)
    assert coded.header.surface.face_sets[0].name == "end"
    assert coded.header.surface.hard_edges is not None
    assert mixseq.verify(path, golden_sequence()).holds


def test_what_the_golden_file_says_of_the_time_between_frames_still_holds() -> None:
    path = GOLDEN / "compressed-v1-between.h5"
    model = mixseq.load(path)
    with np.load(path.with_suffix(".npz")) as expected:
        np.testing.assert_allclose(model.sample().points, expected["points"], atol=1e-9)
        assert isinstance(model, CompressedModel)
        between = model.playback.sample(expected["between_times"]).points
        np.testing.assert_allclose(between, expected["between"], atol=1e-9)
    coded = read_compressed(path)
    assert coded.between is not None
    assert 0 < coded.between.length < inf


@pytest.mark.parametrize("name", ["inbetweens", "parts", "cuts"])
def test_what_the_golden_file_says_of_inbetweens_still_holds(name: str) -> None:
    path = GOLDEN / f"compressed-v1-{name}.h5"
    model = mixseq.load(path)
    assert isinstance(model, CompressedModel)
    with np.load(path.with_suffix(".npz")) as expected:
        for times in ("times", "between_times"):
            points = expected["points" if times == "times" else "between"]
            np.testing.assert_allclose(model.playback.sample(expected[times]).points, points, atol=1e-9)
    assert len(model.playback.inbetweens) == 2
    assert (model.playback.parts_basis is None) == (name != "parts")
    assert model.playback.between.cuts == ((2, 5) if name == "cuts" else ())


def test_the_golden_glb_has_text_and_streams_of_the_golden_file() -> None:
    glb, h5 = (GOLDEN / f"compressed-v1-between{suffix}" for suffix in (".glb", ".h5"))
    assert read_container(glb) == read_container(h5)
    np.testing.assert_array_equal(mixseq.load(glb).sample().points, mixseq.load(h5).sample().points)


@pytest.mark.parametrize("suffix", [".h5", ".glb"])
def test_golden_bodies_still_decode_to_the_same_points(suffix: str) -> None:
    path = GOLDEN / "compressed-v1-bodies"
    model = mixseq.load(path.with_suffix(suffix))
    with np.load(path.with_suffix(".npz")) as expected:
        assert model.body_names == ("bar", "shuffled", "finer")
        for name in model.body_names:
            points = model.body(name).sample(frames=expected["frames"].tolist()).points
            np.testing.assert_allclose(points, expected[name], atol=1e-9)
    _, shuffled, finer = model.relations
    assert (shuffled.same_parts, finer.same_parts) == (False, True)
    assert finer.turn == pytest.approx((0.5**0.5, 0.0, 0.5**0.5, 0.0))
