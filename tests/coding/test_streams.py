"""Streams: fields in groups that build on each other, tracks in chunks that do not."""

from __future__ import annotations

import numpy as np
import pytest

from mixseq.arrays import Float
from mixseq.coding import streams as module
from mixseq.coding.basis import Basis
from mixseq.coding.coded import FactorName
from mixseq.coding.factors import Factors, factor
from mixseq.coding.graph import mesh_graph
from mixseq.coding.prediction import MARGIN
from mixseq.coding.search import FACTORS
from mixseq.coding.streams import (
    CHUNK,
    GROUP,
    chunks,
    groups,
    read_tracks,
    write_tracks,
)
from mixseq.frame_store import frame_store
from tests.coding.one_part import basis_of, read_fields, write_fields
from tests.meshes import bar, torus

MESH = torus(10, 6)
GRAPH = mesh_graph(MESH[1], 60)
STEP = 0.01


def many_fields(count: int, coordinates: int = 1) -> Factors:
    """Fields that are ever smaller noise, the last ones below the step."""
    rng = np.random.default_rng(count)
    fields = rng.normal(size=(count, coordinates, 60)) * np.geomspace(2, 1e-3, count)[:, None, None]
    name: FactorName = "trajectories" if coordinates == 1 else "shapes"
    return Factors(name, fields, np.linalg.norm(fields, axis=(1, 2)))


@pytest.mark.parametrize("rank", [1, GROUP, GROUP + 1, 3 * GROUP, 3 * GROUP + 1, 500])
def test_groups_cover_the_fields(rank: int) -> None:
    parts = groups(rank)
    assert [number for part in parts for number in range(part.start, part.stop)] == list(range(rank))
    sizes = [part.stop - part.start for part in parts]
    assert sizes[:-1] == [GROUP << place for place in range(len(sizes) - 1)]
    assert 0 < sizes[-1] <= GROUP << (len(sizes) - 1)


@pytest.mark.parametrize("count", [1, 2, CHUNK - 1, CHUNK, CHUNK + 1, 3 * CHUNK // 2 + 1, 1000])
def test_chunks_cover_the_frames(count: int) -> None:
    parts = chunks(count)
    assert [frame for part in parts for frame in part] == list(range(count))
    sizes = [len(part) for part in parts]
    assert max(sizes) - min(sizes) <= 1
    assert max(sizes) <= 1.5 * CHUNK + 1


@pytest.mark.parametrize("coordinates", [1, 3])
def test_fields_come_back(coordinates: int) -> None:
    factors = many_fields(40, coordinates)
    fields, streams = write_fields(factors, STEP, GRAPH)
    rank = len(fields)
    assert rank > GROUP
    assert len(streams) == len(groups(rank))
    np.testing.assert_array_equal(read_fields(streams, rank, coordinates, STEP, GRAPH), fields)
    assert np.abs(fields - factors.fields[:rank]).max() <= (1 - MARGIN + 1e-9) * STEP


def test_dry_fields_are_the_same() -> None:
    factors = many_fields(40)
    fields, streams = write_fields(factors, STEP, GRAPH, dry=True)
    np.testing.assert_array_equal(fields, write_fields(factors, STEP, GRAPH)[0])
    assert not any(streams)


def test_fields_of_zeros_are_not_coded() -> None:
    """Coding ends after three of them in a row, and these are taken back."""
    factors = many_fields(3 * GROUP)
    factors.fields[5:] = np.zeros((len(factors.fields) - 5, 1, 60))
    fields, streams = write_fields(factors, STEP, GRAPH)
    assert len(fields) == 5
    assert len(streams) == 1
    np.testing.assert_array_equal(read_fields(streams, 5, 1, STEP, GRAPH), fields)


def test_one_field_is_left_of_nothing() -> None:
    factors = many_fields(4)
    factors.fields[:] = np.zeros((4, 1, 60))
    fields, streams = write_fields(factors, STEP, GRAPH)
    assert fields.shape == (1, 1, 60)
    assert not read_fields(streams, 1, 1, STEP, GRAPH).any()


@pytest.mark.parametrize("kept", [0, 1, 2])
def test_groups_that_are_there_come_back_without_those_behind(kept: int) -> None:
    factors = many_fields(6 * GROUP)
    fields, streams = write_fields(factors, 1e-4, GRAPH)
    assert len(streams) == 3
    found = read_fields(streams[:kept], len(fields), 1, 1e-4, GRAPH)
    np.testing.assert_array_equal(found, fields[: [0, GROUP, 3 * GROUP][kept]])


def bars_basis(name: FactorName) -> tuple[Basis, Float]:
    sequence = frame_store(bar(sides=4, rings=6, frames=300))
    factors = factor(sequence, name, 1e-2)
    graph = mesh_graph(sequence.header.faces, sequence.header.vertex_count)
    basis = basis_of(name, write_fields(factors, STEP, graph)[0], 300)
    return basis, basis.fit(sequence)


@pytest.mark.parametrize("name", FACTORS)
def test_every_chunk_comes_back_by_itself(name: FactorName, monkeypatch: pytest.MonkeyPatch) -> None:
    basis, tracks = bars_basis(name)
    monkeypatch.setattr(module, "CHUNK", 100)
    decoded, streams = write_tracks(basis, tracks, STEP)
    parts = chunks(300)
    assert len(parts) == len(streams) == 3
    for part, stream in list(zip(parts, streams, strict=True))[::-1]:
        found = read_tracks(basis, stream, len(part), STEP)
        np.testing.assert_array_equal(found, decoded[part.start : part.stop])
    np.testing.assert_array_equal(write_tracks(basis, tracks, STEP, dry=True)[0], decoded)


@pytest.mark.parametrize("name", FACTORS)
def test_tracks_are_rounded_by_what_they_move(name: FactorName) -> None:
    """A track times the norm of its field is rounded to steps: all fields spoil alike."""
    basis, tracks = bars_basis(name)
    decoded, _ = write_tracks(basis, tracks, STEP)
    errors = np.abs(decoded - tracks) * basis.norms[basis.free][:, None]
    assert errors.max() <= (1 - MARGIN + 1e-9) * STEP
    assert (errors.max(axis=(0, 2)) > 0.3 * STEP).all()
