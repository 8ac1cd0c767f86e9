"""Streams: basis vectors in groups that build on each other, coefficients in chunks that do not."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from mixseq.compression.bitstream.signal_coder import ROUNDING_MARGINS
from mixseq.compression.bitstream.signal_graph import mesh_graph
from mixseq.compression.bitstream.spatial_basis import (
    FIRST_GROUP_SIZE,
    BasisKind,
    SpatialBasis,
    group_slices,
    read_coefficients,
)
from mixseq.compression.encoder.components import PrincipalComponents, trajectory_components
from mixseq.compression.encoder.search import BASIS_KINDS
from mixseq.compression.encoder.trial import (
    DEFAULT_CHUNK_FRAMES,
    Candidate,
    Trial,
    add_residuals,
    chunk_ranges,
    code_coefficients,
    round_coefficients,
    try_step,
)
from mixseq.sequence.sequence import load_frames
from mixseq.types import Float
from tests.compression.one_part import basis_of, least_squares, principal_components, read_basis, write_basis
from tests.meshes import bar, torus

MESH = torus(10, 6)
GRAPH = mesh_graph(MESH[1], 60)
STEP = 0.01


def many_components(count: int, coordinates: int = 1) -> PrincipalComponents:
    """Components that are ever smaller noise, the last ones below the step."""
    rng = np.random.default_rng(count)
    vectors = rng.normal(size=(count, coordinates, 60)) * np.geomspace(2, 1e-3, count)[:, None, None]
    if coordinates == 1:
        return PrincipalComponents("trajectories", np.zeros((1, 3)), np.zeros((count, 1, 3)), vectors, 0.0)
    return PrincipalComponents("shapes", vectors[0], np.zeros((count - 1, 1, 1)), vectors[1:], 0.0)


def in_all(components: PrincipalComponents) -> Float:
    """All vectors that are coded: of shapes also the mean."""
    means = [] if components.kind == "trajectories" else [components.mean[None]]
    return np.concatenate([*means, components.vectors])


@pytest.mark.parametrize(
    "rank", [1, FIRST_GROUP_SIZE, FIRST_GROUP_SIZE + 1, 3 * FIRST_GROUP_SIZE, 3 * FIRST_GROUP_SIZE + 1, 500]
)
def test_groups_cover_the_basis(rank: int) -> None:
    parts = group_slices(rank)
    assert [number for part in parts for number in range(part.start, part.stop)] == list(range(rank))
    sizes = [part.stop - part.start for part in parts]
    assert sizes[:-1] == [FIRST_GROUP_SIZE << place for place in range(len(sizes) - 1)]
    assert 0 < sizes[-1] <= FIRST_GROUP_SIZE << (len(sizes) - 1)


@pytest.mark.parametrize(
    "count",
    [
        1,
        2,
        DEFAULT_CHUNK_FRAMES - 1,
        DEFAULT_CHUNK_FRAMES,
        DEFAULT_CHUNK_FRAMES + 1,
        3 * DEFAULT_CHUNK_FRAMES // 2 + 1,
        1000,
    ],
)
def test_chunks_cover_the_frames(count: int) -> None:
    parts = chunk_ranges(count)
    assert [frame for part in parts for frame in part] == list(range(count))
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    assert max(sizes) <= 1.5 * DEFAULT_CHUNK_FRAMES + 1


@pytest.mark.parametrize("coordinates", [1, 3])
def test_basis_vectors_come_back(coordinates: int) -> None:
    components = many_components(40, coordinates)
    vectors, streams = write_basis(components, STEP, GRAPH)
    rank = len(vectors)
    assert rank > FIRST_GROUP_SIZE
    assert len(streams) == len(group_slices(rank))
    np.testing.assert_array_equal(read_basis(streams, rank, coordinates, STEP, GRAPH), vectors)
    assert np.abs(vectors - in_all(components)[:rank]).max() <= (1 - ROUNDING_MARGINS.min() + 1e-9) * STEP


def test_components_of_zeros_are_not_coded() -> None:
    """Coding ends after three of them in a row, and these are taken back."""
    components = many_components(3 * FIRST_GROUP_SIZE)
    components.vectors[5:] = np.zeros((len(components.vectors) - 5, 1, 60))
    vectors, streams = write_basis(components, STEP, GRAPH)
    assert len(vectors) == 5
    assert len(streams) == 1
    np.testing.assert_array_equal(read_basis(streams, 5, 1, STEP, GRAPH), vectors)


def test_one_vector_is_left_of_nothing() -> None:
    components = many_components(4)
    components.vectors[:] = np.zeros((4, 1, 60))
    vectors, streams = write_basis(components, STEP, GRAPH)
    assert vectors.shape == (1, 1, 60)
    assert not read_basis(streams, 1, 1, STEP, GRAPH).any()


def test_several_groups_come_back() -> None:
    components = many_components(6 * FIRST_GROUP_SIZE)
    vectors, streams = write_basis(components, 1e-4, GRAPH)
    assert len(streams) == 3
    np.testing.assert_array_equal(read_basis(streams, len(vectors), 1, 1e-4, GRAPH), vectors)


def bars_basis(kind: BasisKind) -> tuple[SpatialBasis, Float]:
    sequence = load_frames(bar(sides=4, rings=6, frames=300))
    components = principal_components(sequence, kind, 1e-2)
    graph = mesh_graph(sequence.header.faces, sequence.header.vertex_count)
    basis = basis_of(kind, write_basis(components, STEP, graph)[0], 300)
    return basis, least_squares(basis, sequence)


@pytest.mark.parametrize("kind", BASIS_KINDS)
def test_every_chunk_comes_back_by_itself(kind: BasisKind) -> None:
    basis, coefficients = bars_basis(kind)
    parts = chunk_ranges(300, 100)
    decoded, signals = round_coefficients(basis, coefficients, STEP, parts)
    streams = [code_coefficients(some) for some in signals]
    assert len(parts) == len(streams) == 3
    for part, stream in list(zip(parts, streams, strict=True))[::-1]:
        [found] = read_coefficients(basis, stream, [len(part)], STEP)
        np.testing.assert_array_equal(found, decoded[part.start : part.stop])


@pytest.mark.parametrize("kind", BASIS_KINDS)
def test_coefficients_are_rounded_by_what_they_move(kind: BasisKind) -> None:
    """A coefficient times the norm of its vector is rounded to steps: all vectors err alike."""
    basis, coefficients = bars_basis(kind)
    decoded, _ = round_coefficients(basis, coefficients, STEP, chunk_ranges(300))
    errors = np.abs(decoded - coefficients) * basis.norms[basis.varying][:, None]
    assert errors.max() <= (1 - ROUNDING_MARGINS.min() + 1e-9) * STEP
    assert (errors.max(axis=(0, 2)) > 0.3 * STEP).all()


# Trials

SEQUENCE = load_frames(bar(sides=4, rings=12, frames=40))
FACES, COUNT = SEQUENCE.header.faces, SEQUENCE.header.vertex_count


def trial() -> Trial:
    """Two parts, several chunks."""
    components, labels = (trajectory_components(SEQUENCE, 1e-6), (np.arange(COUNT) >= COUNT // 2).astype(np.int64))
    return try_step(
        SEQUENCE, Candidate.from_labels(components, labels, FACES, mesh_graph(FACES, COUNT)), 1e-3, chunk=16
    )


def test_residuals_add_to_a_trial() -> None:
    one = trial()
    assert one.size == sum(map(len, (*one.groups, *one.coefficient_streams)))
    bounded = add_residuals(SEQUENCE, one, one.error / 1000)
    assert bounded.signal_size == one.size < bounded.size
    assert bounded.chunks == tuple(
        replace(chunk, residuals=some) for chunk, some in zip(one.chunks, bounded.residuals, strict=True)
    )


def test_streams_are_the_same_on_any_number_of_threads(monkeypatch: pytest.MonkeyPatch) -> None:
    found = []
    for threads in ("1", "2", "3"):
        monkeypatch.setenv("MIXSEQ_THREADS", threads)
        one = trial()
        found.append((one.groups, one.coefficient_streams, one.error, one.coefficients.tobytes()))
    groups, chunks = found[0][:2]
    assert groups and len(chunks) > 1
    assert found[1:] == found[:1] * 2
