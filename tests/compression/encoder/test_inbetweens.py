"""In-betweens bring players to the model that is fitted, within the bytes and the error that are told."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

import mixseq
from mixseq.compression.bitstream.compressed_sequence import (
    CompressedSequence,
    decode,
    inbetween_intervals,
    parts_basis_of,
)
from mixseq.compression.bitstream.signal_coder import Signal
from mixseq.compression.bitstream.spatial_basis import affine_basis, encode_face_labels
from mixseq.compression.compressed_model import CompressedModel
from mixseq.compression.encoder.compress import compress
from mixseq.compression.encoder.inbetweens import MAX_SIZE_RATIO, _project
from mixseq.compression.encoder.trial import code_coefficients, round_coefficients
from mixseq.errors import FormatError, MixseqWarning, ReconstructionError, SettingsError
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.temporal import insert_midpoints
from mixseq.types import Float
from tests.compression.test_golden import stored
from tests.meshes import bar, joined, rotation, tube
from tests.motions import MESH, moving


def with_random_inbetweens(coded: CompressedSequence, levels: int, of_parts: bool = False) -> CompressedSequence:
    """Return a sequence with in-betweens of up to nine steps, twice those of frames.

    Those of the last chunk are zero if there are several.
    """
    playback, rng = decode(coded), np.random.default_rng(0)
    basis = parts_basis_of(coded, playback.basis, playback.coefficients) if of_parts else playback.basis
    norms = basis.norms[basis.varying]
    intervals = [inbetween_intervals(c.first, c.count, coded.parameters.frame_count) for c in coded.chunks]
    signals: list[list[Signal]] = [[] for _ in coded.chunks]
    step = 2 * coded.parameters.step
    for level in range(levels):
        spans = [range(chunk.start << level, chunk.stop << level) for chunk in intervals]
        numbers = rng.integers(-9, 10, (spans[-1].stop, *basis.coefficient_shape))
        _, of_level = round_coefficients(basis, step * numbers / norms[:, None], step, spans)
        for known, new in zip(signals, of_level, strict=True):
            known += new
    streams = [code_coefficients(chunk) for chunk in signals]
    if len(streams) > 1:
        streams[-1] = b""
    chunks = tuple(replace(chunk, inbetweens=stream) for chunk, stream in zip(coded.chunks, streams, strict=True))
    parameters = replace(coded.parameters, inbetween_levels=levels, inbetween_step=step)
    return replace(coded, chunks=chunks, parameters=replace(parameters, inbetween_parts=of_parts or None))


def with_parts(coded: CompressedSequence) -> CompressedSequence:
    """Label triangles by three bands along the longest axis of the first frame."""
    points = decode(coded).sample(frames=[0]).points[0][coded.header.faces].mean(axis=1)
    heights = points[:, np.ptp(points, axis=0).argmax()]
    bands = np.searchsorted(np.quantile(heights, [0.3, 0.7]), heights)
    return replace(coded, labels=encode_face_labels(bands, coded.header.faces))


def bending_tube() -> MeshSequence:
    """A tube that bends at its middle by up to 120 degrees and back, 60 degrees per frame."""
    points, faces = tube(6, 12)
    height = points[:, 2] - points[:, 2].mean()
    shares = np.clip(height / (0.2 * np.ptp(height)) + 0.5, 0, 1)
    centred = np.column_stack([points[:, :2], height])
    frames = []
    for angle in np.radians([0, 60, 120, 120, 60, 0]):
        turns = np.stack([rotation((share * angle, 0.0, 0.0)) for share in shares])
        frames.append(np.einsum("vij,vj->vi", turns, centred))
    return MeshSequence.from_arrays(np.stack(frames), faces, fps=6)


@pytest.fixture(scope="module")
def coded() -> CompressedSequence:
    return compress(bending_tube(), max_error=1e-3)


def rms(values: Float) -> float:
    return float(np.sqrt(np.square(values).mean()))


def signal_size(coded: CompressedSequence) -> int:
    return sum(map(len, coded.basis)) + sum(len(c.coefficients) + len(c.residuals) for c in coded.chunks)


def test_a_bound_holds_between_frames(coded: CompressedSequence) -> None:
    bound = 0.9 * float(coded.parameters.inbetween_error or 0)
    held = compress(bending_tube(), max_error=bound, between_frames=True)
    model, unit = CompressedModel.from_sequence(held), held.parameters.diagonal
    times = insert_midpoints(insert_midpoints(model.times))
    distances = np.linalg.norm(model.playback.decode_points(times) - model.fitted.decode_points(times), axis=2)
    assert distances.max() / unit <= held.parameters.inbetween_error <= bound  # type: ignore[operator]


def test_a_bound_that_does_not_hold_between_frames() -> None:
    with pytest.raises(SettingsError, match=r"between frames, players would be .* allow this error"):
        compress(bending_tube(), max_error=1e-5, between_frames=True)


@pytest.mark.parametrize("settings", [{"kg": 1.0}, {"max_error": 1e-3, "inbetweens": False}])
def test_between_is_about_max_error_and_in_betweens(settings: dict[str, Any]) -> None:
    with pytest.raises(SettingsError, match="between_frames keeps max_error by in-betweens"):
        compress(bending_tube(), between_frames=True, **settings)


def test_players_are_nearer_to_the_model(coded: CompressedSequence) -> None:
    model, unit = CompressedModel.from_sequence(coded), coded.parameters.diagonal
    spline = replace(model.playback, inbetweens=())
    knots = model.playback.sections[0].times
    times = np.union1d(knots, insert_midpoints(knots))
    exact = model.fitted.decode_points(times)
    before, after = (
        np.linalg.norm(playback.decode_points(times) - exact, axis=2) / unit for playback in (spline, model.playback)
    )
    assert before.max() > 5 * coded.parameters.max_error
    assert rms(after) < 0.25 * rms(before)
    assert coded.parameters.inbetween_error is not None
    assert after.max() == pytest.approx(coded.parameters.inbetween_error, rel=0.01)
    assert 0 < sum(len(chunk.inbetweens) for chunk in coded.chunks) <= MAX_SIZE_RATIO * signal_size(coded)


def turning_bars() -> MeshSequence:
    """Two bars that turn about axes of their own, 60 and 80 degrees per frame."""
    one, other = tube(9, 24), tube(9, 24)
    frames = []
    for frame in range(4):
        turned = [
            (one[0] - one[0].mean(axis=0)) @ rotation((frame * np.pi / 3, 0.0, 0.0)).T,
            (other[0] - other[0].mean(axis=0)) @ rotation((0.0, frame * np.pi / 2.25, 0.0)).T + [3.0, 0.0, 0.0],
        ]
        frames.append(np.concatenate(turned))
    return MeshSequence.from_arrays(np.stack(frames), joined(one, other)[1], fps=6)


def test_parts_span_what_few_shapes_do_not(monkeypatch: pytest.MonkeyPatch) -> None:
    """Poses between frames are affine functions of the first, but not in the span of four shapes."""
    monkeypatch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("shapes",))
    coded = compress(turning_bars(), max_error=1e-3)
    assert coded.parameters.factors == "shapes"
    assert coded.parameters.inbetween_parts
    model = CompressedModel.from_sequence(coded)
    times = insert_midpoints(model.times)[1::2]
    exact, spline = model.fitted.decode_points(times), replace(model.playback, inbetweens=(), parts_basis=None)
    shapes = spline.basis.frames(_project(spline, times, exact)) - spline.basis.frames(np.zeros((1, 3, 1)))
    before, after = (exact - playback.decode_points(times) for playback in (spline, model.playback))
    assert rms(after) < 0.1 * rms(before)
    assert rms(after) < 0.1 * rms(before - shapes)
    assert sum(len(chunk.inbetweens) for chunk in coded.chunks) <= MAX_SIZE_RATIO * signal_size(coded)


def test_frames_stay_as_they_are(coded: CompressedSequence) -> None:
    plain = compress(bending_tube(), max_error=1e-3, inbetweens=False)
    assert plain.parameters.inbetween_levels is None
    assert plain.parameters.inbetween_error is None
    np.testing.assert_array_equal(decode(coded).sample().points, decode(plain).sample().points)
    assert [(c.coefficients, c.residuals) for c in coded.chunks] == [
        (c.coefficients, c.residuals) for c in plain.chunks
    ]


def test_a_still_shape_needs_none() -> None:
    """A translation is a spline in any model: nothing is stored, and what is told is rounding."""
    sequence = bar(5, 9, 1)
    shifts = np.linspace(0, 1, 6)[:, None, None] * [1.0, 0.5, 0.0]
    coded = compress(MeshSequence.from_arrays(sequence.points + shifts, sequence.faces), max_error=1e-3)
    assert coded.parameters.inbetween_levels is None
    assert coded.parameters.inbetween_error is not None
    assert coded.parameters.inbetween_error <= 1e-3


def test_one_frame_has_nothing_between() -> None:
    assert compress(bar(5, 9, 1), max_error=1e-3).parameters.inbetween_error is None


def test_a_model_that_does_not_fit_is_told(monkeypatch: pytest.MonkeyPatch) -> None:
    def fail(*_: object) -> None:
        raise ReconstructionError("a vertex is off")

    monkeypatch.setattr(CompressedModel, "fit", fail)
    with pytest.warns(MixseqWarning, match="no in-betweens, as no model fits the decoded frames: a vertex is off"):
        coded = compress(bending_tube(), max_error=1e-3)
    assert coded.parameters.inbetween_error is None


def test_a_size_is_kept() -> None:
    sequence = bending_tube()
    coded = compress(sequence, size=600)
    labels = 0 if coded.labels is None else len(coded.labels.data)
    assert labels + signal_size(coded) + sum(len(chunk.inbetweens) for chunk in coded.chunks) <= 600


@pytest.mark.parametrize("name", ["parts", "shapes", "bounded"])
@pytest.mark.parametrize("of_parts", [False, True])
def test_projection_finds_the_offsets_of_a_basis(name: str, of_parts: bool) -> None:
    coded = with_parts(stored(name)[0])
    playback = decode(coded)
    if of_parts:
        playback = replace(playback, parts_basis=parts_basis_of(coded, playback.basis, playback.coefficients))
    basis, times = playback.inbetween_basis, insert_midpoints(playback.times)[1::2]
    offsets = np.random.default_rng(0).normal(size=(len(times), *basis.coefficient_shape))
    offsets *= coded.parameters.diagonal / basis.norms[basis.varying, None]
    moved = basis.frames(offsets) - basis.frames(0 * offsets)
    found = _project(playback, times, playback.decode_points(times) + moved)
    np.testing.assert_allclose(basis.frames(found), basis.frames(offsets), atol=1e-6 * coded.parameters.diagonal)


@pytest.mark.parametrize(("name", "levels"), [("parts", 1), ("shapes", 2), ("long", 3)])
@pytest.mark.parametrize("of_parts", [False, True])
def test_files(tmp_path: Path, name: str, levels: int, of_parts: bool) -> None:
    """Curves through a file's in-betweens differ from the spline of the level below by whole steps."""
    coded = with_random_inbetweens(with_parts(stored(name)[0]), levels, of_parts)
    mixseq.save(tmp_path / "coded.h5", coded)
    model = mixseq.load(tmp_path / "coded.h5")
    assert isinstance(model, CompressedModel)
    playback, expected = model.playback, decode(coded)
    np.testing.assert_array_equal(playback.sections[0].values, expected.sections[0].values)
    lower = replace(playback, inbetweens=playback.inbetweens[:-1]).sections[0]
    middles = insert_midpoints(playback.times) if levels == 1 else insert_midpoints(lower.times)
    basis = playback.inbetween_basis
    offsets = (playback.sections[0].values - lower(middles))[1::2, -np.prod(basis.coefficient_shape) :]
    steps = offsets.reshape(-1, *basis.coefficient_shape) * basis.norms[basis.varying, None]
    steps /= 2 * coded.parameters.step
    assert np.abs(steps).max() == pytest.approx(9, abs=1)
    np.testing.assert_allclose(64 * steps, np.rint(64 * steps), atol=1e-3)


@pytest.mark.parametrize("levels", [0, 4, 1.0, True])
def test_levels_out_of_range_are_refused(coded: CompressedSequence, levels: int) -> None:
    with pytest.raises(SettingsError, match="inbetween_levels"):
        replace(coded.parameters, inbetween_levels=levels)


def test_levels_and_step_come_together(coded: CompressedSequence) -> None:
    with pytest.raises(SettingsError, match="come together"):
        replace(coded.parameters, inbetween_step=None)
    with pytest.raises(SettingsError, match="inbetween_step"):
        replace(coded.parameters, inbetween_step=0.0)


@pytest.mark.parametrize("value", [False, 1, "parts"])
def test_wrong_bases_are_refused(coded: CompressedSequence, value: Any) -> None:
    with pytest.raises(SettingsError, match="inbetween_parts"):
        replace(coded.parameters, inbetween_parts=value)
    plain = replace(coded.parameters, inbetween_levels=None, inbetween_step=None, inbetween_parts=None)
    with pytest.raises(SettingsError, match="inbetween_parts is True; true is expected, beside inbetween_levels"):
        replace(plain, inbetween_parts=True)


def test_parts_without_labels_are_refused() -> None:
    coded = with_random_inbetweens(with_parts(stored("parts")[0]), 1, of_parts=True)
    with pytest.raises(FormatError, match="in-betweens are of parts, and no triangle has a label"):
        decode(replace(coded, labels=None))


def test_affine_fields_are_orthogonal_and_leave_out_what_is_flat() -> None:
    points, labels = np.random.default_rng(0).normal(size=(12, 3)), np.repeat([0, 1, 2], [7, 4, 1])
    points[7:11, 2] = 5.0
    basis = affine_basis(points, labels, 1.0)
    assert basis.part_ids.tolist() == [0, 1, 2, 0, 0, 0, 1, 1]
    for part in basis.part_bases:
        gram = part.vectors[:, 0] @ part.vectors[:, 0].T
        np.testing.assert_allclose(gram, np.diag(np.diag(gram)), atol=1e-12)
    own = basis.part_bases[0].vectors[:, 0]
    np.testing.assert_allclose(own.T @ np.linalg.lstsq(own.T, points[:7], rcond=None)[0], points[:7], atol=1e-12)


@pytest.mark.parametrize("error", [-1.0, np.inf, "1"])
def test_errors_out_of_range_are_refused(coded: CompressedSequence, error: float) -> None:
    with pytest.raises(SettingsError, match="inbetween_error"):
        replace(coded.parameters, inbetween_error=error)


def test_cuts_are_kept_by_players_and_by_the_model_of_the_file(tmp_path: Path) -> None:
    """A motion that is spliced, and moved away."""
    frames = np.arange(24.0)

    def shot(at: Float) -> Float:
        return moving(np.where(at < 11.5, at, at + 40)) + 20.0 * (at > 11.5)[:, None, None]

    coded = compress(MeshSequence.from_arrays(shot(frames), MESH[1], fps=24), max_error=1e-3)
    assert coded.between is not None
    assert coded.between.cuts == (12,)
    assert coded.parameters.inbetween_error is not None
    assert coded.parameters.inbetween_error < 2e-3
    mixseq.save(tmp_path / "shot.h5", coded)
    model = mixseq.load(tmp_path / "shot.h5")
    assert isinstance(model, CompressedModel)
    assert model.header.provenance is not None
    assert model.header.provenance.events == "cut between 11 and 12"
    at = np.sort([*frames, 11.4, 11.6, *(frames[:-1][frames[:-1] != 11] + 0.5)])
    for motion in (model, model.playback):
        np.testing.assert_allclose(np.concatenate(list(motion.blocks(at / 24))), shot(at), atol=0.03)
    smooth = compress(MeshSequence.from_arrays(shot(frames), MESH[1], fps=24), max_error=1e-3, cuts="none")
    assert smooth.between is not None
    assert not smooth.between.cuts
