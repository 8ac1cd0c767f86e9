"""The coefficients of a basis are those nearest to the sequence, and frames are the sums."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.compression.bitstream.spatial_basis import SpatialBasis, decode_face_labels, encode_face_labels
from mixseq.compression.encoder.trial import decode_blocks
from mixseq.errors import FormatError
from mixseq.sequence.sequence import FrameStore, MeshSequence, block_size, load_frames
from tests.compression.one_part import basis_of, least_squares
from tests.meshes import Mesh, bar, grid, torus, tube

RNG = np.random.default_rng(4)
VERTICES = len(tube(5, 6)[0])


def sequence_of(frames: int = 11) -> FrameStore:
    points, faces = tube(5, 6)
    noise = np.random.default_rng(frames).normal(size=(frames, *points.shape))
    return load_frames(MeshSequence.from_arrays(points + noise, faces))


def trajectories(count: int = 4) -> SpatialBasis:
    return basis_of(
        "trajectories", RNG.normal(size=(count, 1, VERTICES)) * 10.0 ** -np.arange(count)[:, None, None], 11
    )


def shapes(count: int = 4) -> SpatialBasis:
    return basis_of("shapes", RNG.normal(size=(count, 3, VERTICES)) * 10.0 ** -np.arange(count)[:, None, None], 11)


def test_coefficients_of_trajectories_are_least_squares() -> None:
    basis, sequence = trajectories(), sequence_of()
    vectors = basis.vectors[:, 0]
    expected = np.stack([np.linalg.lstsq(vectors.T, frame, rcond=None)[0] for frame in np.asarray(sequence.points)])
    coefficients = least_squares(basis, sequence)
    assert coefficients.shape == (11, 5, 3)
    np.testing.assert_allclose(coefficients * basis.norms[:, None], expected * basis.norms[:, None], atol=1e-9)
    np.testing.assert_allclose(basis.frames(coefficients), np.einsum("tki,kv->tvi", expected, vectors), atol=1e-9)


def test_coefficients_of_shapes_are_least_squares() -> None:
    basis, sequence = shapes(), sequence_of()
    directions = basis.vectors[1:].transpose(0, 2, 1).reshape(3, -1)
    mean = basis.vectors[0].T / np.sqrt(11)
    centred = (sequence.points[:] - mean).reshape(11, -1)
    expected = np.linalg.lstsq(directions.T, centred.T, rcond=None)[0].T
    coefficients = least_squares(basis, sequence)
    assert coefficients.shape == (11, 3, 1)
    np.testing.assert_allclose(coefficients[..., 0], expected, rtol=1e-7)
    frames = mean + (expected @ directions).reshape(11, -1, 3)
    np.testing.assert_allclose(basis.frames(coefficients), frames, atol=1e-9)


def test_what_the_vectors_span_comes_back() -> None:
    basis = trajectories()
    coefficients = RNG.normal(size=(3, 5, 3)) / basis.norms[:, None]
    sequence = load_frames(MeshSequence.from_arrays(basis.frames(coefficients), tube(5, 6)[1]))
    np.testing.assert_allclose(
        least_squares(basis, sequence) * basis.norms[:, None], coefficients * basis.norms[:, None], atol=1e-9
    )


def test_vectors_that_are_the_same_are_no_harm() -> None:
    """Rounding may make two vectors the same, or the constant one."""
    vector = RNG.normal(size=(1, 1, VERTICES))
    basis = basis_of("trajectories", np.concatenate([vector, vector, np.ones_like(vector)]), 11)
    sequence = sequence_of()
    once = basis_of("trajectories", vector, 11)
    np.testing.assert_allclose(
        basis.frames(least_squares(basis, sequence)), once.frames(least_squares(once, sequence)), atol=1e-5
    )


def test_places_far_from_the_origin_are_exact() -> None:
    """The damping that makes equal vectors harmless takes nothing from coordinates that are large."""
    basis = trajectories()
    coefficients = np.zeros((3, 5, 3))
    coefficients[:, 0] = 1e6 * np.sqrt(VERTICES)
    sequence = load_frames(MeshSequence.from_arrays(basis.frames(coefficients), tube(5, 6)[1]))
    np.testing.assert_allclose(basis.frames(least_squares(basis, sequence)), 1e6, atol=1e-7)


def test_the_known_field_is_a_unit_vector() -> None:
    basis = trajectories(2)
    assert len(basis.vectors) == 3
    np.testing.assert_allclose(basis.vectors[0, 0], 1 / np.sqrt(VERTICES), rtol=1e-15)
    assert basis.norms[0] == pytest.approx(1)
    assert basis.varying == slice(0, None)
    assert shapes().varying == slice(1, None)


def test_vectors_of_zeros_have_no_coefficients() -> None:
    vectors = np.zeros((3, 1, VERTICES))
    vectors[1] = 2
    assert len(basis_of("trajectories", vectors, 5).vectors) == 2
    assert len(basis_of("trajectories", vectors[:1], 5).vectors) == 1


def test_a_mean_of_zeros_stays_the_mean() -> None:
    """A mesh that swings about the origin: what moves must not be taken for the mean."""
    vectors = RNG.normal(size=(2, 3, VERTICES))
    vectors[0] = 0
    basis = basis_of("shapes", vectors, 4)
    assert len(basis.vectors) == 2
    swing = np.array([1.0, -1, 2, -2])
    points = np.einsum("t,iv->tvi", swing, vectors[1])
    sequence = load_frames(MeshSequence.from_arrays(points, tube(5, 6)[1]))
    np.testing.assert_allclose(least_squares(basis, sequence)[:, 0, 0], swing, rtol=1e-12)


def test_a_mean_alone_has_no_coefficients() -> None:
    basis, sequence = shapes(1), sequence_of()
    coefficients = least_squares(basis, sequence)
    assert coefficients.shape == (11, 0, 1)
    np.testing.assert_allclose(
        basis.frames(coefficients), np.repeat(basis.vectors[:1] / np.sqrt(11), 11, axis=0).transpose(0, 2, 1)
    )


def test_blocks_are_all_frames() -> None:
    basis = trajectories()
    coefficients = least_squares(basis, sequence_of(21))
    blocks = list(decode_blocks(basis, coefficients))
    assert [len(block) for block in blocks[:-1]] == [block_size(VERTICES)] * (len(blocks) - 1)
    np.testing.assert_allclose(np.concatenate(blocks), basis.frames(coefficients), atol=1e-12)


def test_a_sequence_of_single_precision_is_fitted_in_double() -> None:
    sequence = bar()
    single = load_frames(sequence.with_points(sequence.points.astype(np.float32)))
    basis = basis_of("trajectories", RNG.normal(size=(2, 1, sequence.vertex_count)), 5)
    assert least_squares(basis, single).dtype == np.float64


# Labels of triangles ----------------------------------------------------------------------------------------


@pytest.mark.parametrize("shape", [tube(5, 9), grid(6, 4), torus(7, 5)], ids=["tube", "grid", "torus"])
def test_labels_of_triangles_come_back(shape: Mesh) -> None:
    faces = np.asarray(shape[1])
    for count in (1, 2, 7):
        labels = np.arange(len(faces)) * count // len(faces)
        coded = encode_face_labels(labels, faces)
        assert coded.count == count
        np.testing.assert_array_equal(decode_face_labels(coded, faces), labels)
        with pytest.raises(FormatError, match=f"{count + 1} parts are expected"):
            decode_face_labels(replace(coded, count=count + 1), faces)


def test_labels_of_triangles_at_an_edge_of_three() -> None:
    faces = np.array([[0, 1, 2], [1, 0, 3], [0, 1, 4], [2, 1, 5]])
    labels = np.array([0, 1, 2, 1])
    np.testing.assert_array_equal(decode_face_labels(encode_face_labels(labels, faces), faces), labels)


def test_labels_of_triangles_are_the_same_bytes_for_ever() -> None:
    faces = np.asarray(torus(12, 9)[1])
    labels = np.arange(len(faces)) * 5 // len(faces)
    expected = "fcf1ae7f4c6de9d11e78238316e551d55c7796f5c593cac53117e6ae9de144c9357d"
    assert encode_face_labels(labels, faces).data.hex() == expected
