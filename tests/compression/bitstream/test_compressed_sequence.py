"""Models of compressed sequences: the streams' frames, what is between them, and damage."""

from __future__ import annotations

import pickle
from dataclasses import replace
from functools import cache
from itertools import pairwise
from math import inf

import numpy as np
import pytest

from mixseq.compression.bitstream import compressed_sequence, residual_layer
from mixseq.compression.bitstream.compressed_sequence import (
    CompressedSequence,
    TemporalInterpolation,
    decode,
    decode_basis,
    decode_coefficients,
)
from mixseq.compression.bitstream.residual_layer import FRAMES_PER_RUN, CodedResidualLayer, read_residuals
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.bitstream.spatial_basis import MAX_NORM
from mixseq.compression.encoder.compress import compress
from mixseq.errors import FormatError, InvalidSequenceError
from mixseq.sequence.sequence import MeshSequence
from mixseq.spaces.temporal import TemporalOperator, insert_midpoints
from mixseq.types import Float
from tests.meshes import bar, tetrahedron, tube

pytestmark = pytest.mark.slow


@cache
def bounded() -> CompressedSequence:
    """Trajectories, with residuals in several runs and in both chunks."""
    smooth = bar(sides=4, rings=6, frames=200)
    noise = np.random.default_rng(4).laplace(scale=0.01, size=smooth.points.shape)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("trajectories",))
        return compress(smooth.with_points(smooth.points + noise), max_error=0.02, chunk=100, inbetweens=False)


@cache
def noisy() -> CompressedSequence:
    """Shapes, in several groups of the basis."""
    points, faces = tube(6, 9)
    noise = np.random.default_rng(1).normal(size=(20, *points.shape))
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("shapes",))
        return compress(MeshSequence.from_arrays(points + 0.1 * noise, faces), kg=0.5, inbetweens=False)


@cache
def grouped() -> tuple[MeshSequence, CompressedSequence]:
    """Trajectories, in several groups of the basis: each of many vertices' modes has its own three coefficients."""
    points, faces = tube(8, 20)
    rng = np.random.default_rng(2)
    modes = rng.normal(size=(30, len(points))) * np.geomspace(0.3, 0.02, 30)[:, None]
    frames = points + np.einsum("tki,kv->tvi", rng.normal(size=(20, 30, 3)), modes)
    sequence = MeshSequence.from_arrays(frames, faces)
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr("mixseq.compression.encoder.search.BASIS_KINDS", ("trajectories",))
        patch.setattr("mixseq.compression.encoder.search.PART_COUNTS", (10_000,))
        return sequence, compress(sequence, kg=0.2, inbetweens=False)


def frames_of(coded: CompressedSequence) -> Float:
    """The frames that the streams stand for, put together by hand."""
    header, parameters = coded.header, coded.parameters
    graph = mesh_graph(header.faces, header.vertex_count)
    basis = decode_basis(coded, graph)
    points = np.concatenate([basis.frames(decode_coefficients(coded, chunk, basis)) for chunk in coded.chunks])
    for chunk in coded.chunks:
        for run in range(-(-chunk.count // FRAMES_PER_RUN)):
            residuals = read_residuals(chunk.residuals, chunk.count, run, graph)
            for place, (vertices, numbers) in enumerate(residuals):
                points[chunk.first + run * FRAMES_PER_RUN + place, vertices] += parameters.correction * numbers
    return points


@pytest.mark.parametrize("coded", [bounded, noisy], ids=["trajectories", "shapes"])
def test_frames_are_those_of_the_streams(coded: object) -> None:
    made = coded()  # type: ignore[operator]
    model = decode(made)
    assert model.header is made.header
    np.testing.assert_allclose(model.sample().points, frames_of(made), atol=1e-11)


def test_frames_are_the_same_bits_however_they_are_asked_for() -> None:
    model = decode(bounded())
    whole = model.sample().points
    np.testing.assert_array_equal(model.sample(frames=[3, 77, 199]).points, whole[[3, 77, 199]])
    np.testing.assert_array_equal(model(model.times[130]), whole[130])
    blocks = decode(bounded()).blocks(model.times[::-1], size=7)
    np.testing.assert_array_equal(np.concatenate(list(blocks)), whole[::-1])


# Between frames ---------------------------------------------------------------------------------------------


@pytest.mark.parametrize("coded", [bounded, noisy], ids=["trajectories", "shapes"])
def test_what_encoders_choose_between_frames_is_what_decoders_would(
    coded: object, monkeypatch: pytest.MonkeyPatch
) -> None:
    made = coded()  # type: ignore[operator]
    expected = decode(replace(made, between=None)).sections[0]
    monkeypatch.setattr(compressed_sequence, "select_operator", None)  # nobody asks for it
    found = decode(made).sections[0]
    np.testing.assert_array_equal(found.times, expected.times)
    np.testing.assert_array_equal(found.values, expected.values)


def test_what_a_file_says_is_between_frames_is_there() -> None:
    made = noisy()
    for between in (TemporalInterpolation(inf, (0.25, 1.0)), TemporalInterpolation(1.0, (0.0, 0.0))):
        playback = decode(replace(made, between=between))
        operator = TemporalOperator(playback.times, between.length, between.cubic)
        coefficients = playback.coefficients.reshape(len(playback.times), -1)
        expected = operator.weights_at(insert_midpoints(playback.times)).interpolate(coefficients)
        np.testing.assert_allclose(playback.sections[0].values, expected, atol=1e-12)


@pytest.mark.parametrize("cuts", [(5,), (1, 4), (7, 8)], ids=str)
def test_frames_between_cuts_are_splines_of_their_own_and_go_on_straight(cuts: tuple[int, ...]) -> None:
    made = replace(noisy(), between=TemporalInterpolation(2.0, (0.5, 0.25), cuts))
    playback, times = decode(made), made.header.times
    frames = frames_of(made)
    for first, end in pairwise((0, *cuts, len(times))):
        own = slice(first, end)
        alone = replace(playback, header=made.header.with_times(times[own]), coefficients=playback.coefficients[own])
        alone = replace(alone, between=TemporalInterpolation(2.0, (0.5, 0.25)))
        at = np.linspace(times[first], times[end - 1], 11)
        np.testing.assert_allclose(playback.decode_points(at), alone.decode_points(at), atol=1e-11)
        beside = [max(first, end - 2), min(first + 1, end - 1)]
        for frame, other, neighbour in ((end - 1, beside[0], end), (first, beside[1], first - 1)):
            if not 0 <= neighbour < len(times):
                continue
            share = 0.4 * (times[neighbour] - times[frame])
            slope = (frames[frame] - frames[other]) / ((times[frame] - times[other]) or 1.0)
            points, velocities = playback.decode_moving(times[frame : frame + 1] + share)
            np.testing.assert_allclose(points[0], frames[frame] + share * slope, atol=1e-10)
            np.testing.assert_allclose(velocities[0], slope, atol=1e-9)


def test_residuals_are_linear_between_frames() -> None:
    model = decode(bounded())
    residuals = model.residual_layer
    assert residuals is not None
    frames = residuals.at(model.times)
    assert frames.any()
    for share in (0.25, 0.5):
        between = (1 - share) * model.times[:-1] + share * model.times[1:]
        expected = (1 - share) * frames[:-1] + share * frames[1:]
        np.testing.assert_allclose(residuals.at(between), expected, atol=1e-12)
        alone = replace(model, residual_layer=None).sample(between[:20]).points
        np.testing.assert_allclose(model.sample(between[:20]).points, alone + expected[:20], atol=1e-12)


def test_times_that_are_nearly_frames_are_frames() -> None:
    residuals = decode(bounded()).residual_layer
    assert residuals is not None
    times = bounded().header.times
    np.testing.assert_array_equal(residuals.at(times * (1 + 1e-15)), residuals.at(times))


def test_velocities_are_derivatives() -> None:
    model = decode(bounded())
    step = 1e-6
    times = model.times[:-1] + 0.3 * np.diff(model.times)
    _, velocities = zip(*model.moving_blocks(times), strict=True)
    ahead, behind = (np.concatenate(list(model.blocks(times + shift))) for shift in (step, -step))
    np.testing.assert_allclose(np.concatenate(velocities), (ahead - behind) / (2 * step), atol=1e-6)


def test_one_frame_stands_still() -> None:
    sequence = bar(sides=4, rings=6, frames=1)
    noise = np.random.default_rng(0).laplace(scale=0.3, size=sequence.points.shape)
    model = decode(compress(sequence.with_points(sequence.points + noise), max_error=0.1))
    points, velocities = next(model.moving_blocks(model.times))
    assert not velocities.any()
    np.testing.assert_array_equal(points, model.sample().points)
    faces = sequence.faces
    alone = CodedResidualLayer(np.zeros(1), ((1, bounded().chunks[0].residuals),), faces, sequence.vertex_count, 0.1)
    assert not alone.rates(np.zeros(1)).any()


def test_the_graph_of_a_mesh_is_found_once(monkeypatch: pytest.MonkeyPatch) -> None:
    model = decode(bounded())
    expected = model.sample().points
    monkeypatch.setattr(residual_layer, "mesh_graph", None)
    np.testing.assert_array_equal(decode(bounded()).sample().points, expected)


# Pickles ----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("coded", [bounded, noisy], ids=["trajectories", "shapes"])
def test_pickled_models_decode_to_the_same_bits(coded: object) -> None:
    model = decode(coded())  # type: ignore[operator]
    expected = model.sample(model.times[:5], velocities=True)  # decodes, and remembers what it decoded
    found = pickle.loads(pickle.dumps(model)).sample(model.times[:5], velocities=True)
    np.testing.assert_array_equal(found.points, expected.points)
    np.testing.assert_array_equal(found.velocities, expected.velocities)


# Damage -----------------------------------------------------------------------------------------------------


@pytest.mark.parametrize("kept", [0, 1])
def test_missing_groups_are_refused(kept: int) -> None:
    _, coded = grouped()
    groups = len(coded.basis)
    assert groups >= 2
    with pytest.raises(FormatError, match=f"is damaged, it has {kept} groups of {groups}; restore the file"):
        decode(replace(coded, basis=coded.basis[:kept]))


def test_more_vectors_than_a_sequence_can_have_are_refused() -> None:
    coded = bounded()
    many = replace(coded, parameters=replace(coded.parameters, rank=10**9))
    with pytest.raises(FormatError, match="the parameters are damaged: 1000000000 basis vectors"):
        decode(many)


@pytest.mark.parametrize("which", [0, 1])
def test_chunks_decode_without_each_other(which: int) -> None:
    coded = bounded()
    chunk = coded.chunks[which]
    frames = slice(chunk.first, chunk.first + chunk.count)
    some = replace(coded, header=coded.header.with_times(coded.header.times[frames]), chunks=(chunk,))
    np.testing.assert_allclose(decode(some).sample().points, frames_of(coded)[frames], atol=1e-11)


def test_damaged_streams_give_another_model_or_an_error() -> None:
    """Files have checksums, which notice: this is about not falling over."""
    small = compress(MeshSequence.from_arrays(np.random.default_rng(3).normal(size=(8, 4, 3)), tetrahedron()[1]), kg=1)
    for stream in (0, 1):
        data = small.basis[0] if stream == 0 else small.chunks[0].coefficients
        for place in range(len(data)):
            damaged = bytearray(data)
            damaged[place] ^= 1 << place % 8
            if stream == 0:
                coded = replace(small, basis=(bytes(damaged),))
            else:
                coded = replace(small, chunks=(replace(small.chunks[0], coefficients=bytes(damaged)),))
            try:
                assert np.isfinite(decode(coded).sample().points).all()
            except FormatError as error:
                assert "damaged" in str(error)


def test_vectors_that_players_cannot_hold_are_neither_read_nor_written() -> None:
    """Norms from 2^127 on are beyond the single precision of players."""
    coded = noisy()
    graph = mesh_graph(coded.header.faces, coded.header.vertex_count)
    largest = decode_basis(coded, graph).norms.max()
    scales = np.array([0.99, 1.01]) * MAX_NORM / largest
    held, beyond = (
        replace(coded, parameters=replace(coded.parameters, step=coded.parameters.step * k)) for k in scales
    )
    assert decode_basis(held, graph).norms.max() == pytest.approx(0.99 * MAX_NORM)
    with pytest.raises(FormatError, match="basis vectors are beyond single precision"):
        decode_basis(beyond, graph)
    far = bar(sides=4, rings=3)
    with pytest.raises(InvalidSequenceError, match="players of compressed models compute in single precision; scale"):
        compress(far.with_points(far.points * 1e39), max_error=1e-3)
